/* What is called of FMI 2.0.4, in the words of the standard. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>
#include <stdint.h>

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

/* The functions of one binary; NULL where it has none. */
typedef struct {
  fmi2Status (*Reset)(fmi2Component);
  fmi2Status (*SetupExperiment)(fmi2Component, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                                fmi2Boolean stopTimeDefined, fmi2Real stopTime);
  fmi2Status (*EnterInitializationMode)(fmi2Component);
  fmi2Status (*ExitInitializationMode)(fmi2Component);
  fmi2Status (*SetReal)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2Real *);
  fmi2Status (*SetInteger)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2Integer *);
  fmi2Status (*SetBoolean)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2Boolean *);
  fmi2Status (*SetString)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2String *);
  fmi2Status (*GetReal)(fmi2Component, const fmi2ValueReference *, size_t, fmi2Real *);
  fmi2Status (*GetInteger)(fmi2Component, const fmi2ValueReference *, size_t, fmi2Integer *);
  fmi2Status (*GetBoolean)(fmi2Component, const fmi2ValueReference *, size_t, fmi2Boolean *);
  fmi2Status (*GetDirectionalDerivative)(fmi2Component, const fmi2ValueReference *unknowns, size_t,
                                         const fmi2ValueReference *knowns, size_t, const fmi2Real *seeds,
                                         fmi2Real *derivatives);
  /* co-simulation */
  fmi2Status (*SetRealInputDerivatives)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2Integer *orders,
                                        const fmi2Real *);
  fmi2Status (*DoStep)(fmi2Component, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                       fmi2Boolean noSetFMUStatePriorToCurrentPoint);
  fmi2Status (*GetRealStatus)(fmi2Component, fmi2StatusKind, fmi2Real *);
  fmi2Status (*GetBooleanStatus)(fmi2Component, fmi2StatusKind, fmi2Boolean *);
  /* model exchange */
  fmi2Status (*SetTime)(fmi2Component, fmi2Real);
  fmi2Status (*SetContinuousStates)(fmi2Component, const fmi2Real *, size_t);
  fmi2Status (*GetContinuousStates)(fmi2Component, fmi2Real *, size_t);
  fmi2Status (*GetNominalsOfContinuousStates)(fmi2Component, fmi2Real *, size_t);
  fmi2Status (*GetDerivatives)(fmi2Component, fmi2Real *, size_t);
  fmi2Status (*GetEventIndicators)(fmi2Component, fmi2Real *, size_t);
  fmi2Status (*EnterEventMode)(fmi2Component);
  fmi2Status (*NewDiscreteStates)(fmi2Component, fmi2EventInfo *);
  fmi2Status (*EnterContinuousTimeMode)(fmi2Component);
  fmi2Status (*CompletedIntegratorStep)(fmi2Component, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                        fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation);
} Fmi2;

#endif
