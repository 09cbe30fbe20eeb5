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

/* The types of values but strings: name in the standard, type in C. */
#define FMI3_TYPES(X) \
  X(Float64, double)  \
  X(Float32, float)   \
  X(Int8, int8_t)     \
  X(UInt8, uint8_t)   \
  X(Int16, int16_t)   \
  X(UInt16, uint16_t) \
  X(Int32, int32_t)   \
  X(UInt32, uint32_t) \
  X(Int64, int64_t)   \
  X(UInt64, uint64_t) \
  X(Boolean, fmi3Boolean)

/* The functions of one binary; NULL where it has none. */
typedef struct {
  fmi3Status (*Reset)(fmi3Instance);
  fmi3Status (*EnterInitializationMode)(fmi3Instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                        fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime);
  fmi3Status (*ExitInitializationMode)(fmi3Instance);
#define SETTER(name, type) \
  fmi3Status (*Set##name)(fmi3Instance, const fmi3ValueReference *, size_t, const type *, size_t nValues);
  FMI3_TYPES(SETTER)
  SETTER(String, fmi3String)
#undef SETTER
#define GETTER(name, type) \
  fmi3Status (*Get##name)(fmi3Instance, const fmi3ValueReference *, size_t, type *, size_t nValues);
  FMI3_TYPES(GETTER)
#undef GETTER
  fmi3Status (*GetDirectionalDerivative)(fmi3Instance, const fmi3ValueReference *unknowns, size_t,
                                         const fmi3ValueReference *knowns, size_t, const fmi3Float64 *seed, size_t,
                                         fmi3Float64 *sensitivity, size_t);
  fmi3Status (*EnterEventMode)(fmi3Instance);
  fmi3Status (*UpdateDiscreteStates)(fmi3Instance, fmi3Boolean *discreteStatesNeedUpdate,
                                     fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                     fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                     fmi3Float64 *nextEventTime);
  /* co-simulation */
  fmi3Status (*EnterStepMode)(fmi3Instance);
  fmi3Status (*DoStep)(fmi3Instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                       fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                       fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime);
  /* model exchange */
  fmi3Status (*SetTime)(fmi3Instance, fmi3Float64);
  fmi3Status (*SetContinuousStates)(fmi3Instance, const fmi3Float64 *, size_t);
  fmi3Status (*GetContinuousStates)(fmi3Instance, fmi3Float64 *, size_t);
  fmi3Status (*GetNominalsOfContinuousStates)(fmi3Instance, fmi3Float64 *, size_t);
  fmi3Status (*GetContinuousStateDerivatives)(fmi3Instance, fmi3Float64 *, size_t);
  fmi3Status (*GetEventIndicators)(fmi3Instance, fmi3Float64 *, size_t);
  fmi3Status (*EnterContinuousTimeMode)(fmi3Instance);
  fmi3Status (*CompletedIntegratorStep)(fmi3Instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                        fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation);
} Fmi3;

#endif
