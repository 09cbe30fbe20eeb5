/* What is called of FMI 2.0.4, in the words of the standard. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>
#include <stdint.h>

#include "linkage.h"

typedef void *fmi2Component;
typedef uint32_t fmi2ValueReference;
typedef double fmi2Real;
typedef int32_t fmi2Integer;
typedef int32_t fmi2Boolean;
typedef const char *fmi2String;

/* Enums in the standard; numbers here, because an FMU may return one that is none of these. */
typedef int32_t fmi2Status;
enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending };
typedef int32_t fmi2StatusKind;
enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated };

typedef struct {
  fmi2Boolean newDiscreteStatesNeeded;
  fmi2Boolean terminateSimulation;
  fmi2Boolean nominalsOfContinuousStatesChanged;
  fmi2Boolean valuesOfContinuousStatesChanged;
  fmi2Boolean nextEventTimeDefined;
  fmi2Real nextEventTime;
} fmi2EventInfo;

/* The functions of one binary: name, what it takes. */
/* clang-format off */
#define FMI2_FUNCTIONS(X) \
  X(Reset, (fmi2Component)) \
  X(SetupExperiment, (fmi2Component, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime, \
        fmi2Boolean stopTimeDefined, fmi2Real stopTime)) \
  X(EnterInitializationMode, (fmi2Component)) \
  X(ExitInitializationMode, (fmi2Component)) \
  X(SetReal, (fmi2Component, const fmi2ValueReference *, size_t, const fmi2Real *)) \
  X(SetInteger, (fmi2Component, const fmi2ValueReference *, size_t, const fmi2Integer *)) \
  X(SetBoolean, (fmi2Component, const fmi2ValueReference *, size_t, const fmi2Boolean *)) \
  X(SetString, (fmi2Component, const fmi2ValueReference *, size_t, const fmi2String *)) \
  X(GetReal, (fmi2Component, const fmi2ValueReference *, size_t, fmi2Real *)) \
  X(GetInteger, (fmi2Component, const fmi2ValueReference *, size_t, fmi2Integer *)) \
  X(GetBoolean, (fmi2Component, const fmi2ValueReference *, size_t, fmi2Boolean *)) \
  X(GetDirectionalDerivative, (fmi2Component, const fmi2ValueReference *unknowns, size_t, \
        const fmi2ValueReference *knowns, size_t, const fmi2Real *seeds, fmi2Real *derivatives)) \
  /* co-simulation */ \
  X(SetRealInputDerivatives, (fmi2Component, const fmi2ValueReference *, size_t, const fmi2Integer *orders, \
        const fmi2Real *)) \
  X(DoStep, (fmi2Component, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize, \
        fmi2Boolean noSetFMUStatePriorToCurrentPoint)) \
  X(GetRealStatus, (fmi2Component, fmi2StatusKind, fmi2Real *)) \
  X(GetBooleanStatus, (fmi2Component, fmi2StatusKind, fmi2Boolean *)) \
  /* model exchange */ \
  X(SetTime, (fmi2Component, fmi2Real)) \
  X(SetContinuousStates, (fmi2Component, const fmi2Real *, size_t)) \
  X(GetContinuousStates, (fmi2Component, fmi2Real *, size_t)) \
  X(GetNominalsOfContinuousStates, (fmi2Component, fmi2Real *, size_t)) \
  X(GetDerivatives, (fmi2Component, fmi2Real *, size_t)) \
  X(GetEventIndicators, (fmi2Component, fmi2Real *, size_t)) \
  X(EnterEventMode, (fmi2Component)) \
  X(NewDiscreteStates, (fmi2Component, fmi2EventInfo *)) \
  X(EnterContinuousTimeMode, (fmi2Component)) \
  X(CompletedIntegratorStep, (fmi2Component, fmi2Boolean noSetFMUStatePriorToCurrentPoint, \
        fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation))
/* clang-format on */

/* Their addresses; NULL where a binary has none. */
typedef struct {
#define FUNCTION(name, takes) fmi2Status(*name) takes;
  FMI2_FUNCTIONS(FUNCTION)
#undef FUNCTION
} Fmi2;

INLINE int good(fmi2Status status) { return status == fmi2OK || status == fmi2Warning; }

#endif
