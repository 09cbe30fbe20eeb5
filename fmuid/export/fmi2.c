/* FMI 2.0, model exchange and co-simulation, over the core. */
#include <stdarg.h>
#include <stdio.h>
#include "model.h"
#include "core.h"
#include "fmi2Functions.h"

typedef struct {
  State s;
  fmi2CallbackLogger logger;
  fmi2ComponentEnvironment environment;
  fmi2Type type;
  char name[1]; /* allocated longer */
} Instance;

typedef struct { /* a serialised state says of which FMU it is */
  char guid[sizeof MODEL_GUID];
  State s;
} Serialised;

#define ANY (INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED)
#define RUNNING (EVENT | CONTINUOUS | STEP)

static const char *mode_name(int mode) {
  switch (mode) {
    case INSTANTIATED: return "before initialization mode";
    case INITIALIZATION: return "in initialization mode";
    case EVENT: return "in event mode";
    case CONTINUOUS: return "in continuous-time mode";
    case STEP: return "between steps";
    case TERMINATED: return "after termination";
    default: return "after an error (reset the instance or restore a state)";
  }
}

/* Log an error and enter the error mode. The text is complete: loggers without variable arguments can show it. */
static fmi2Status fail(Instance *m, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  m->s.mode = ERROR;
  if (m->logger) m->logger(m->environment, m->name, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

/* Every function begins with it: the instance, if the function is allowed in its mode. */
#define ENTER(function, modes) \
  Instance *m = (Instance *)c; \
  if (!m) return fmi2Error; \
  if (!(m->s.mode & (modes))) return fail(m, "%s cannot be called %s", function, mode_name(m->s.mode))
#define REQUIRE(condition, ...) do { if (!(condition)) return fail(m, __VA_ARGS__); } while (0)

#define NOT_FINITE "%s is not finite at t = %g: parameters, inputs or states are out of the range of the model"

/* Is r one of the count value references from the first on? */
static inline int among(fmi2ValueReference r, fmi2ValueReference first, fmi2ValueReference count) {
  return r - first < count; /* unsigned: r < first wraps around */
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  const char *problem = !name || !*name ? "the instance has no name"
    : !guid || strcmp(guid, MODEL_GUID) ? "wrong GUID: modelDescription.xml and binary are not of the same export"
    : !callbacks ? "no callback functions" : NULL;
  Instance *m = problem ? NULL : (Instance *)calloc(1, sizeof *m + strlen(name));
  (void)resources, (void)visible, (void)logging;
  if (!m) {
    if (callbacks && callbacks->logger)
      callbacks->logger(callbacks->componentEnvironment, name ? name : "", fmi2Error, "logStatusError",
                        problem ? problem : "out of memory");
    return NULL;
  }
  strcpy(m->name, name);
  m->type = type;
  m->logger = callbacks->logger;
  m->environment = callbacks->componentEnvironment;
  set_defaults(&m->s);
  return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories; /* errors are always logged, and nothing else ever is */
  return c ? fmi2OK : fmi2Error;
}

/* ---- life */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_given, fmi2Real stop) {
  ENTER("fmi2SetupExperiment", INSTANTIATED);
  (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
  REQUIRE(isfinite(start), "fmi2SetupExperiment: the start time is not finite");
  m->s.time = start;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  ENTER("fmi2EnterInitializationMode", INSTANTIATED);
  m->s.mode = INITIALIZATION;
  return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  ENTER("fmi2ExitInitializationMode", INITIALIZATION);
  refresh(&m->s);
  m->s.mode = m->type == fmi2ModelExchange ? EVENT : STEP;
  return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
  ENTER("fmi2Terminate", RUNNING);
  m->s.mode = TERMINATED;
  return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
  ENTER("fmi2Reset", ANY | ERROR);
  set_defaults(&m->s);
  return fmi2OK;
}

/* ---- variables */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[]) {
  size_t i;
  ENTER("fmi2GetReal", ANY);
  refresh(&m->s);
  for (i = 0; i < n; i++) {
    REQUIRE(r[i] < NV, "fmi2GetReal: there is no variable of value reference %u", r[i]);
    if (r[i] >= V_DX) evaluate(&m->s);
    values[i] = m->s.v[r[i]];
    REQUIRE(isfinite(values[i]), NOT_FINITE, model_names[r[i]], m->s.time);
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[]) {
  size_t i;
  ENTER("fmi2SetReal", ANY & ~TERMINATED);
  for (i = 0; i < n; i++) {
    const int input = among(r[i], V_U, NU), parameter = among(r[i], V_P, NP);
    REQUIRE(r[i] < NV, "fmi2SetReal: there is no variable of value reference %u", r[i]);
    REQUIRE(input || parameter, "fmi2SetReal: %s is computed by the model: only inputs and parameters can be set",
            model_names[r[i]]);
    REQUIRE(input || m->s.mode != CONTINUOUS, "fmi2SetReal: parameter %s cannot be set in continuous-time mode",
            model_names[r[i]]);
    REQUIRE(isfinite(values[i]), "fmi2SetReal: the value given for %s at t = %g is not finite", model_names[r[i]],
            m->s.time);
    m->s.v[r[i]] = values[i];
    m->s.stale_cache |= parameter;
  }
  m->s.stale_values = 1;
  return fmi2OK;
}

/* The other types: no model has variables of theirs. */
#define NO_VARIABLES(function, type) \
  fmi2Status function(fmi2Component c, const fmi2ValueReference r[], size_t n, type values[]) { \
    ENTER(#function, ANY); \
    (void)r, (void)values; \
    REQUIRE(n == 0, #function ": all variables of the model are Real"); \
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
  double seed[NV + 1] = {0};
  size_t i;
  ENTER("fmi2GetDirectionalDerivative", ANY & ~INSTANTIATED);
  for (i = 0; i < n_knowns; i++) {
    REQUIRE(knowns[i] < V_DX, "fmi2GetDirectionalDerivative: value reference %u is no state, input or parameter",
            knowns[i]);
    seed[knowns[i]] = seeds[i];
  }
  directional(&m->s, seed);
  for (i = 0; i < n_unknowns; i++) {
    REQUIRE(unknowns[i] < NV, "fmi2GetDirectionalDerivative: there is no variable of value reference %u", unknowns[i]);
    values[i] = seed[unknowns[i]];
  }
  return fmi2OK;
}

/* ---- the FMU state */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  ENTER("fmi2GetFMUstate", ANY);
  if (!*state) *state = malloc(sizeof m->s);
  REQUIRE(*state, "fmi2GetFMUstate: out of memory");
  memcpy(*state, &m->s, sizeof m->s);
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  ENTER("fmi2SetFMUstate", ANY | ERROR);
  REQUIRE(state, "fmi2SetFMUstate: no state given");
  memcpy(&m->s, state, sizeof m->s);
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  if (state) {
    free(*state);
    *state = NULL;
  }
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  ENTER("fmi2SerializedFMUstateSize", ANY | ERROR);
  (void)state;
  *size = sizeof(Serialised);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  Serialised whole;
  ENTER("fmi2SerializeFMUstate", ANY | ERROR);
  REQUIRE(state && size >= sizeof whole, "fmi2SerializeFMUstate: no state, or too few bytes for it");
  memset(&whole, 0, sizeof whole);
  memcpy(whole.guid, MODEL_GUID, sizeof whole.guid);
  memcpy(&whole.s, state, sizeof whole.s);
  memcpy(bytes, &whole, sizeof whole);
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  Serialised whole;
  ENTER("fmi2DeSerializeFMUstate", ANY | ERROR);
  REQUIRE(size == sizeof whole && !memcmp(bytes, MODEL_GUID, sizeof whole.guid),
          "fmi2DeSerializeFMUstate: these bytes are not a state of this FMU");
  memcpy(&whole, bytes, sizeof whole);
  if (!*state) *state = malloc(sizeof whole.s);
  REQUIRE(*state, "fmi2DeSerializeFMUstate: out of memory");
  memcpy(*state, &whole.s, sizeof whole.s);
  return fmi2OK;
}

/* ---- model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
  ENTER("fmi2EnterEventMode", EVENT | CONTINUOUS);
  m->s.mode = EVENT;
  return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  ENTER("fmi2NewDiscreteStates", EVENT);
  memset(info, 0, sizeof *info);
  return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
  ENTER("fmi2EnterContinuousTimeMode", EVENT | CONTINUOUS);
  m->s.mode = CONTINUOUS;
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_return, fmi2Boolean *event, fmi2Boolean *stop) {
  ENTER("fmi2CompletedIntegratorStep", CONTINUOUS);
  (void)no_return;
  *event = *stop = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  ENTER("fmi2SetTime", EVENT | CONTINUOUS);
  m->s.time = time;
  return fmi2OK;
}

#define REQUIRE_SIZE(function, n, size) REQUIRE((n) == (size), function ": the size is %d, not %d", (int)(size), (int)(n))

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  int i;
  ENTER("fmi2SetContinuousStates", EVENT | CONTINUOUS);
  REQUIRE_SIZE("fmi2SetContinuousStates", n, NX);
  for (i = 0; i < NX; i++) {
    REQUIRE(isfinite(x[i]), "fmi2SetContinuousStates: the value given for %s at t = %g is not finite", model_names[i],
            m->s.time);
    m->s.v[V_X + i] = x[i];
  }
  m->s.stale_values = 1;
  return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  int i;
  ENTER("fmi2GetDerivatives", ANY & ~INSTANTIATED);
  REQUIRE_SIZE("fmi2GetDerivatives", n, NX);
  evaluate(&m->s);
  for (i = 0; i < NX; i++) {
    REQUIRE(isfinite(m->s.v[V_DX + i]), NOT_FINITE, model_names[V_DX + i], m->s.time);
    dx[i] = m->s.v[V_DX + i];
  }
  return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  ENTER("fmi2GetEventIndicators", ANY & ~INSTANTIATED);
  (void)z;
  REQUIRE_SIZE("fmi2GetEventIndicators", n, 0);
  return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  ENTER("fmi2GetContinuousStates", ANY & ~INSTANTIATED);
  REQUIRE_SIZE("fmi2GetContinuousStates", n, NX);
  refresh(&m->s);
  memcpy(x, m->s.v + V_X, NX * sizeof(double));
  return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  ENTER("fmi2GetNominalsOfContinuousStates", ANY & ~INSTANTIATED);
  REQUIRE_SIZE("fmi2GetNominalsOfContinuousStates", n, NX);
  memcpy(x, model_nominals, NX * sizeof(double));
  return fmi2OK;
}

/* ---- co-simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real values[]) {
  size_t i;
  ENTER("fmi2SetRealInputDerivatives", INSTANTIATED | INITIALIZATION | STEP);
  for (i = 0; i < n; i++) {
    REQUIRE(among(r[i], V_U, NU), "fmi2SetRealInputDerivatives: value reference %u is no input", r[i]);
    REQUIRE(orders[i] == 1, "fmi2SetRealInputDerivatives: order %d of %s: only order 1 is supported", orders[i],
            model_names[r[i]]);
    REQUIRE(isfinite(values[i]), "fmi2SetRealInputDerivatives: the value given for %s at t = %g is not finite",
            model_names[r[i]], m->s.time);
    m->s.slope[r[i] - V_U] = values[i];
  }
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer orders[], fmi2Real values[]) {
  ENTER("fmi2GetRealOutputDerivatives", STEP | TERMINATED);
  (void)r, (void)orders, (void)values;
  REQUIRE(n == 0, "fmi2GetRealOutputDerivatives: not provided (maxOutputDerivativeOrder is 0)");
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_return) {
  int bad;
  ENTER("fmi2DoStep", STEP);
  (void)no_return;
  REQUIRE(isfinite(time) && isfinite(h) && h >= 0, "fmi2DoStep: from t = %g by %g is no step", time, h);
  m->s.time = time;
  bad = integrate(&m->s, h);
  REQUIRE(bad < 0, "state %s is not finite at t = %g: parameters or inputs are out of the range of the model, or make it "
          "too fast for its integration step of %g s", model_names[bad], m->s.time, MODEL_STEP);
  return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
  ENTER("fmi2CancelStep", STEP);
  return fail(m, "fmi2CancelStep: steps are never pending");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  ENTER("fmi2GetRealStatus", ANY | ERROR);
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = m->s.time;
  return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  ENTER("fmi2GetBooleanStatus", ANY | ERROR);
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
