/* What is called of FMI 3.0.2, in the words of the standard. */
#ifndef FMI3_H
#define FMI3_H

#include <stddef.h>
#include <stdint.h>

typedef void *fmi3Instance;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
/* C's bool in the standard, of one byte; a number here, because an FMU may write one that is neither 0 nor 1. */
typedef uint8_t fmi3Boolean;
typedef const char *fmi3String;
typedef int32_t fmi3Status; /* the same numbers as fmi2Status, without the last */

/* The types of values but strings: name in the standard, type in C, `Wire`. */
#define FMI3_TYPES(X)         \
  X(Float64, double, FLOAT64) \
  X(Float32, float, FLOAT32)  \
  X(Int8, int8_t, INT8)       \
  X(UInt8, uint8_t, UINT8)    \
  X(Int16, int16_t, INT16)    \
  X(UInt16, uint16_t, UINT16) \
  X(Int32, int32_t, INT32)    \
  X(UInt32, uint32_t, UINT32) \
  X(Int64, int64_t, INT64)    \
  X(UInt64, uint64_t, UINT64) \
  X(Boolean, fmi3Boolean, BOOLEAN)

/* The other functions of one binary: name, what it takes. */
/* clang-format off */
#define FMI3_FUNCTIONS(X) \
  X(Reset, (fmi3Instance)) \
  X(EnterInitializationMode, (fmi3Instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance, \
        fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)) \
  X(ExitInitializationMode, (fmi3Instance)) \
  X(GetDirectionalDerivative, (fmi3Instance, const fmi3ValueReference *unknowns, size_t, \
        const fmi3ValueReference *knowns, size_t, const fmi3Float64 *seed, size_t, fmi3Float64 *sensitivity, size_t)) \
  X(EnterEventMode, (fmi3Instance)) \
  X(UpdateDiscreteStates, (fmi3Instance, fmi3Boolean *discreteStatesNeedUpdate, fmi3Boolean *terminateSimulation, \
        fmi3Boolean *nominalsOfContinuousStatesChanged, fmi3Boolean *valuesOfContinuousStatesChanged, \
        fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)) \
  /* co-simulation */ \
  X(EnterStepMode, (fmi3Instance)) \
  X(DoStep, (fmi3Instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize, \
        fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded, \
        fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)) \
  /* model exchange */ \
  X(SetTime, (fmi3Instance, fmi3Float64)) \
  X(SetContinuousStates, (fmi3Instance, const fmi3Float64 *, size_t)) \
  X(GetContinuousStates, (fmi3Instance, fmi3Float64 *, size_t)) \
  X(GetNominalsOfContinuousStates, (fmi3Instance, fmi3Float64 *, size_t)) \
  X(GetContinuousStateDerivatives, (fmi3Instance, fmi3Float64 *, size_t)) \
  X(GetEventIndicators, (fmi3Instance, fmi3Float64 *, size_t)) \
  X(EnterContinuousTimeMode, (fmi3Instance)) \
  X(CompletedIntegratorStep, (fmi3Instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint, \
        fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation))
/* clang-format on */

/* The addresses of all; NULL where a binary has none. */
typedef struct {
#define SETTER(name, type, wire) \
  fmi3Status (*Set##name)(fmi3Instance, const fmi3ValueReference *, size_t, const type *, size_t nValues);
  FMI3_TYPES(SETTER)
  SETTER(String, fmi3String, STRING)
#define GETTER(name, type, wire) \
  fmi3Status (*Get##name)(fmi3Instance, const fmi3ValueReference *, size_t, type *, size_t nValues);
  FMI3_TYPES(GETTER)
#define FUNCTION(name, takes) fmi3Status(*name) takes;
  FMI3_FUNCTIONS(FUNCTION)
#undef SETTER
#undef GETTER
#undef FUNCTION
} Fmi3;

#endif
