/* FMI 3.0, model exchange and co-simulation. */
#include "fmi3Functions.h"

typedef fmi3LogMessageCallback Logger;
#define SEND(logger, environment, name, text) ((void)(name), logger(environment, fmi3Error, "logStatusError", text))
#include "instance.h"

#define REFERENCES const fmi3ValueReference r[], size_t n
#define REQUIRE_COUNT(n, values) \
  REQUIRE((n) == (values), "%s: %d variables have %d values, not %d", __func__, (int)(n), (int)(n), (int)(values))

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger) {
  (void)resources, (void)visible, (void)logging;
  return create(name, token, logger, environment, 1);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         REFERENCES, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update) {
  const char *problem = event_mode ? "there is no event mode in co-simulation (hasEventMode is false)"
    : n ? "there is no intermediate update (providesIntermediateUpdate is false)" : NULL;
  (void)resources, (void)visible, (void)logging, (void)early_return, (void)r, (void)update;
  if (problem && logger) SEND(logger, environment, name, problem);
  return problem ? NULL : create(name, token, logger, environment, 0);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
  (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
  if (logger) SEND(logger, environment, name, "there is no scheduled execution");
  return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)on, (void)n, (void)categories; /* errors are always logged, and nothing else ever is */
  return c ? fmi3OK : fmi3Error;
}

/* ---- life */

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_given, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_given, fmi3Float64 stop) {
  ENTER(__func__, INSTANTIATED);
  (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
  REQUIRE(isfinite(start), "%s: the start time is not finite", __func__);
  m->s.v[V_T] = start;
  m->s.stale |= ALL_BUT_CACHE;
  m->s.mode = INITIALIZATION;
  return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return exit_initialization(c, __func__); }
fmi3Status fmi3Terminate(fmi3Instance c) { return terminate(c, __func__); }
fmi3Status fmi3Reset(fmi3Instance c) { return reset(c, __func__); }

/* ---- variables */

fmi3Status fmi3GetFloat64(fmi3Instance c, REFERENCES, fmi3Float64 values[], size_t n_values) {
  ENTER(__func__, ANY);
  REQUIRE_COUNT(n, n_values);
  return get_values(m, __func__, r, n, values);
}

fmi3Status fmi3SetFloat64(fmi3Instance c, REFERENCES, const fmi3Float64 values[], size_t n_values) {
  ENTER(__func__, ANY);
  REQUIRE_COUNT(n, n_values);
  return set_values(m, __func__, r, n, values);
}

/* The other types, and all that only clocks or configurations have: no model has variables of theirs. */
#define NO_VARIABLES(function, ...) \
  fmi3Status function(fmi3Instance c, REFERENCES, __VA_ARGS__) { \
    ENTER(__func__, ANY); \
    (void)r; \
    REQUIRE(n == 0, "%s: all variables of the model are Float64", __func__); \
    return fmi3OK; \
  }
#define NO_TYPE(type) \
  NO_VARIABLES(fmi3Get##type, fmi3##type values[], size_t n_values) \
  NO_VARIABLES(fmi3Set##type, const fmi3##type values[], size_t n_values)
NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(Boolean)
NO_TYPE(String)
NO_VARIABLES(fmi3GetBinary, size_t sizes[], fmi3Binary values[], size_t n_values)
NO_VARIABLES(fmi3SetBinary, const size_t sizes[], const fmi3Binary values[], size_t n_values)
NO_VARIABLES(fmi3GetClock, fmi3Clock values[])
NO_VARIABLES(fmi3SetClock, const fmi3Clock values[])
NO_VARIABLES(fmi3GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(fmi3GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
             fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(fmi3GetShiftDecimal, fmi3Float64 shifts[])
NO_VARIABLES(fmi3GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NO_VARIABLES(fmi3SetIntervalDecimal, const fmi3Float64 intervals[])
NO_VARIABLES(fmi3SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_VARIABLES(fmi3SetShiftDecimal, const fmi3Float64 shifts[])
NO_VARIABLES(fmi3SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_VARIABLES(fmi3GetOutputDerivatives, const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)

/* Functions that modelDescription.xml does not promise. */
#define NOT_PROVIDED(function, parameters) \
  fmi3Status function parameters { \
    ENTER(__func__, ANY); \
    return fail(m, "%s: not provided", __func__); \
  }
NOT_PROVIDED(fmi3EnterConfigurationMode, (fmi3Instance c))
NOT_PROVIDED(fmi3ExitConfigurationMode, (fmi3Instance c))
NOT_PROVIDED(fmi3EnterStepMode, (fmi3Instance c))
NOT_PROVIDED(fmi3EvaluateDiscreteStates, (fmi3Instance c))
NOT_PROVIDED(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time))
NOT_PROVIDED(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference r, size_t *n))
NOT_PROVIDED(fmi3GetVariableDependencies,
             (fmi3Instance c, fmi3ValueReference r, size_t elements[], fmi3ValueReference knowns[],
              size_t known_elements[], fmi3DependencyKind kinds[], size_t n))
NOT_PROVIDED(fmi3GetAdjointDerivative,
             (fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
              size_t n_knowns, const fmi3Float64 seeds[], size_t n_seeds, fmi3Float64 values[], size_t n_values))

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                        const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seeds[],
                                        size_t n_seeds, fmi3Float64 values[], size_t n_values) {
  ENTER(__func__, ANY & ~INSTANTIATED);
  REQUIRE_COUNT(n_knowns, n_seeds);
  REQUIRE_COUNT(n_unknowns, n_values);
  return directional_derivative(m, __func__, unknowns, n_unknowns, knowns, n_knowns, seeds, values);
}

/* ---- the FMU state */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return get_state(c, __func__, state); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return set_state(c, __func__, state); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
  (void)c;
  return free_state(state);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
  (void)state;
  return serialised_size(c, __func__, size);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  return serialise(c, __func__, state, bytes, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  return deserialise(c, __func__, bytes, size, state);
}

/* ---- model exchange */

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return enter_event_mode(c, __func__); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *stop, fmi3Boolean *nominals,
                                    fmi3Boolean *states, fmi3Boolean *next_event, fmi3Float64 *next_event_time) {
  *again = *stop = *nominals = *states = *next_event = fmi3False;
  *next_event_time = 0.0;
  return update_discrete_states(c, __func__);
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return enter_continuous_time_mode(c, __func__); }

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *stop) {
  (void)no_return;
  *event = *stop = fmi3False;
  return completed_integrator_step(c, __func__);
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return set_time(c, __func__, time); }

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
  return set_states(c, __func__, x, n);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
  return get_block(c, __func__, V_DX, NX, dx, n);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
  return get_block(c, __func__, V_Z, NZ, z, n);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  return get_block(c, __func__, V_X, NX, x, n);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  return get_nominals(c, __func__, x, n);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
  *n = NZ;
  return c ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
  *n = NX;
  return c ? fmi3OK : fmi3Error;
}

/* ---- co-simulation */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 h, fmi3Boolean no_return, fmi3Boolean *event,
                      fmi3Boolean *stop, fmi3Boolean *early, fmi3Float64 *reached) {
  (void)no_return;
  *event = *stop = *early = fmi3False;
  *reached = time;
  const Status status = do_step(c, __func__, time, h);
  if (status == OK) *reached = ((Instance *)c)->s.v[V_T];
  return status;
}
