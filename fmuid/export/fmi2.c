/* FMI 2.0, model exchange and co-simulation. */
#include "fmi2Functions.h"

typedef fmi2CallbackLogger Logger;
#define SEND(logger, environment, name, text) logger(environment, name, fmi2Error, "logStatusError", text)
#include "instance.h"

#define REFERENCES const fmi2ValueReference r[], size_t n

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)resources, (void)visible, (void)logging;
  if (!callbacks) return NULL;
  return create(name, guid, callbacks->logger, callbacks->componentEnvironment, type == fmi2ModelExchange);
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories; /* errors are always logged, and nothing else ever is */
  return c ? fmi2OK : fmi2Error;
}

/* ---- life */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_given, fmi2Real stop) {
  ENTER(__func__, INSTANTIATED);
  (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
  REQUIRE(isfinite(start), "%s: the start time is not finite", __func__);
  m->s.v[V_T] = start;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  ENTER(__func__, INSTANTIATED);
  m->s.mode = INITIALIZATION;
  return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return exit_initialization(c, __func__); }
fmi2Status fmi2Terminate(fmi2Component c) { return terminate(c, __func__); }
fmi2Status fmi2Reset(fmi2Component c) { return reset(c, __func__); }

/* ---- variables */

fmi2Status fmi2GetReal(fmi2Component c, REFERENCES, fmi2Real values[]) { return get_values(c, __func__, r, n, values); }

fmi2Status fmi2SetReal(fmi2Component c, REFERENCES, const fmi2Real values[]) {
  return set_values(c, __func__, r, n, values);
}

/* The other types: no model has variables of theirs. */
#define NO_VARIABLES(function, type) \
  fmi2Status function(fmi2Component c, REFERENCES, type values[]) { \
    ENTER(__func__, ANY); \
    (void)r, (void)values; \
    REQUIRE(n == 0, "%s: all variables of the model are Real", __func__); \
    return fmi2OK; \
  }
NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seeds[],
                                        fmi2Real values[]) {
  return directional_derivative(c, __func__, unknowns, n_unknowns, knowns, n_knowns, seeds, values);
}

/* ---- the FMU state */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return get_state(c, __func__, state); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return set_state(c, __func__, state); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  return free_state(state);
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)state;
  return serialised_size(c, __func__, size);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  return serialise(c, __func__, state, bytes, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  return deserialise(c, __func__, bytes, size, state);
}

/* ---- model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return enter_event_mode(c, __func__); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  memset(info, 0, sizeof *info);
  return update_discrete_states(c, __func__);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return enter_continuous_time_mode(c, __func__); }

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_return, fmi2Boolean *event, fmi2Boolean *stop) {
  (void)no_return;
  *event = *stop = fmi2False;
  return completed_integrator_step(c, __func__);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return set_time(c, __func__, time); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  return set_states(c, __func__, x, n);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  return get_block(c, __func__, V_DX, NX, dx, n);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  return get_block(c, __func__, V_Z, NZ, z, n);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  return get_block(c, __func__, V_X, NX, x, n);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  return get_nominals(c, __func__, x, n);
}

/* ---- co-simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, REFERENCES, const fmi2Integer orders[],
                                       const fmi2Real values[]) {
  size_t i;
  ENTER(__func__, INSTANTIATED | INITIALIZATION | STEP);
  for (i = 0; i < n; i++) {
    REQUIRE(among(r[i], V_U, NU), "%s: value reference %u is no input", __func__, r[i]);
    REQUIRE(orders[i] == 1, "%s: order %d of %s: only order 1 is supported", __func__, orders[i], model_names[r[i]]);
    REQUIRE(isfinite(values[i]), "%s: the value given for %s at t = %g is not finite", __func__, model_names[r[i]],
            m->s.v[V_T]);
    m->s.slope[r[i] - V_U] = values[i];
  }
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, REFERENCES, const fmi2Integer orders[], fmi2Real values[]) {
  ENTER(__func__, STEP | TERMINATED);
  (void)r, (void)orders, (void)values;
  REQUIRE(n == 0, "%s: not provided (maxOutputDerivativeOrder is 0)", __func__);
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_return) {
  (void)no_return;
  return do_step(c, __func__, time, h);
}

fmi2Status fmi2CancelStep(fmi2Component c) {
  ENTER(__func__, STEP);
  return fail(m, "%s: steps are never pending", __func__);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  ENTER(__func__, ANY | ERROR);
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = m->s.v[V_T];
  return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  ENTER(__func__, ANY | ERROR);
  if (kind != fmi2Terminated) return fmi2Discard;
  *value = fmi2False;
  return fmi2OK;
}

/* Steps are never pending: nothing to tell. */
#define NO_STATUS(function, type) \
  fmi2Status function(fmi2Component c, const fmi2StatusKind kind, type *value) { \
    (void)c, (void)kind, (void)value; \
    return fmi2Discard; \
  }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)
