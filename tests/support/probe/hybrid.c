/* Model-exchange models for tests only, one chosen by parameter; compiled as FMI 2.0 (-DFMI=2) and as FMI 3.0 (-DFMI=3).
   The functions that an integrator calls, and those of the life cycle. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#if FMI == 2
#include "fmi2Functions.h"
#define NAME(name) fmi2##name
#define STATUS fmi2Status
#define INSTANCE fmi2Component
#define REFERENCE fmi2ValueReference
#define FLAG fmi2Boolean
enum { OK = fmi2OK, DISCARD = fmi2Discard, ERROR = fmi2Error };
#else
#include "fmi3Functions.h"
#define NAME(name) fmi3##name
#define STATUS fmi3Status
#define INSTANCE fmi3Instance
#define REFERENCE fmi3ValueReference
#define FLAG fmi3Boolean
enum { OK = fmi3OK, DISCARD = fmi3Discard, ERROR = fmi3Error };
#endif
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

enum { BALL, TRIANGLE, ROBERTSON, VAN_DER_POL, LINEAR, CHATTER, STAIRS, DECAY, SWITCH, THRESHOLD };
/* value references: states first, then their derivatives */
enum { X = 0, DX = 3, P = 6, U = 10, MODEL = 12, COUNT, EVENT_TIME, TERMINATE_AT, STEP_EVENT_AT, FAIL_AT, ENDLESS,
       BROKEN_JACOBIAN, NOMINAL, CALLS, BACKWARDS, START, N_REALS = START + 3 };
typedef struct {
  double r[N_REALS], time, completed, nominal; /* the nominal value last told */
  int mode; /* 0 event, 1 continuous time */
} Model;
static const int states[] = {2, 1, 3, 2, 1, 1, 1, 1, 0, 1}, indicators[] = {1, 0, 0, 0, 0, 1, 3, 0, 1, 1};

static void set_defaults(Model *m) {
  memset(m, 0, sizeof *m);
  m->r[TERMINATE_AT] = m->r[STEP_EVENT_AT] = m->r[FAIL_AT] = 1e99;
  m->r[NOMINAL] = 1, m->completed = -1e99;
}
EXPORT void *make(double model) {
  Model *m = malloc(sizeof *m);
  set_defaults(m);
  m->r[MODEL] = model;
  return m;
}
EXPORT void rewind_to_event_mode(Model *m) { m->mode = 0, m->completed = -1e99, m->r[COUNT] = m->r[EVENT_TIME] = 0; }
EXPORT void drop(void *m) { free(m); }
EXPORT int n_states(Model *m) { return states[(int)m->r[MODEL]]; }
EXPORT int n_indicators(Model *m) { return indicators[(int)m->r[MODEL]]; }

static int derivatives(Model *m, const double *x, double *d) {
  const double *p = m->r + P, u = m->r[U];
  switch ((int)m->r[MODEL]) {
  case BALL: d[0] = x[1], d[1] = -p[0]; break;
  case TRIANGLE: d[0] = (int)m->r[COUNT] % 2 ? -1 : 1; break;
  case ROBERTSON:
    d[0] = -0.04 * x[0] + 1e4 * x[1] * x[2];
    d[2] = 3e7 * x[1] * x[1];
    d[1] = -d[0] - d[2];
    break;
  case VAN_DER_POL: d[0] = x[1], d[1] = p[0] * (1 - x[0] * x[0]) * x[1] - x[0]; break;
  case LINEAR: d[0] = -p[0] * x[0] + u + m->r[U + 1]; break;
  case CHATTER: d[0] = (int)m->r[COUNT] % 2 ? 1 : -1; break;
  case STAIRS: d[0] = 1; break;
  case THRESHOLD: d[0] = -p[0] * (m->r[COUNT] > 0 ? p[2] : 1); break;
  case DECAY: /* has a meaning for x >= 0 only */
    if (x[0] < 0) return DISCARD;
    d[0] = -p[0] * x[0];
  }
  return m->time > m->r[FAIL_AT] ? ERROR : OK;
}
static void handle_event(Model *m) {
  double *x = m->r + X, *p = m->r + P;
  m->r[COUNT] += 1, m->r[EVENT_TIME] = m->time;
  if (m->r[MODEL] == BALL && x[0] <= 0 && x[1] < 0) x[0] = 1e-300, x[1] *= -p[1];
}
static double next_event(Model *m) { /* TRIANGLE: at multiples of p[0] */
  return m->r[MODEL] == TRIANGLE && m->r[P] > 0 ? (m->r[COUNT] + 1) * m->r[P] : INFINITY;
}

EXPORT STATUS NAME(SetTime)(INSTANCE c, double t) {
  Model *m = c;
  if (m->mode != 1) return ERROR;
  if (t < m->completed) m->r[BACKWARDS] += 1;
  m->time = t;
  return OK;
}
EXPORT STATUS NAME(SetContinuousStates)(INSTANCE c, const double x[], size_t n) {
  Model *m = c;
  if (m->mode != 1 || (int)n != n_states(m)) return ERROR;
  memcpy(m->r + X, x, n * sizeof *x);
  return OK;
}
EXPORT STATUS NAME(GetContinuousStates)(INSTANCE c, double x[], size_t n) {
  memcpy(x, ((Model *)c)->r + X, n * sizeof *x);
  return OK;
}
EXPORT STATUS NAME(GetNominalsOfContinuousStates)(INSTANCE c, double x[], size_t n) {
  Model *m = c;
  for (size_t i = 0; i < n; i++) x[i] = m->r[NOMINAL];
  m->nominal = m->r[NOMINAL];
  return OK;
}
static STATUS get_derivatives(Model *m, double d[], size_t n) {
  if (m->mode != 1 || (int)n != n_states(m)) return ERROR;
  m->r[CALLS] += 1;
  return derivatives(m, m->r + X, d);
}
EXPORT STATUS NAME(GetEventIndicators)(INSTANCE c, double z[], size_t n) {
  Model *m = c;
  const double x = m->r[X];
  if ((int)n != n_indicators(m)) return ERROR;
  switch ((int)m->r[MODEL]) {
  case STAIRS: /* p[2] is crossed twice */
    z[0] = x - m->r[P], z[1] = m->r[P + 1] - x, z[2] = (x - m->r[P + 2]) * (x - m->r[P + 3]);
    break;
  case THRESHOLD: z[0] = x - m->r[P + 1]; break;
  case SWITCH: z[0] = m->r[U] - m->r[P]; break;
  default: z[0] = x;
  }
  return OK;
}
EXPORT STATUS NAME(EnterEventMode)(INSTANCE c) {
  Model *m = c;
  if (m->mode != 1) return ERROR;
  m->mode = 0;
  handle_event(m);
  return OK;
}
EXPORT STATUS NAME(EnterContinuousTimeMode)(INSTANCE c) {
  Model *m = c;
  if (m->mode != 0) return ERROR;
  m->mode = 1;
  return OK;
}
EXPORT STATUS NAME(CompletedIntegratorStep)(INSTANCE c, FLAG no_set_state, FLAG *event, FLAG *terminate) {
  Model *m = c;
  if (m->mode != 1 || !no_set_state) return ERROR;
  m->completed = m->time;
  *event = m->time >= m->r[STEP_EVENT_AT];
  if (*event) m->r[STEP_EVENT_AT] = 1e99;
  *terminate = 0;
  return OK;
}
#if FMI == 2
EXPORT STATUS fmi2GetDerivatives(INSTANCE c, double d[], size_t n) { return get_derivatives(c, d, n); }
EXPORT STATUS fmi2NewDiscreteStates(INSTANCE c, fmi2EventInfo *info) {
  Model *m = c;
  info->newDiscreteStatesNeeded = m->r[ENDLESS] > 0;
  info->terminateSimulation = m->time >= m->r[TERMINATE_AT];
  info->nominalsOfContinuousStatesChanged = m->nominal != m->r[NOMINAL];
  info->valuesOfContinuousStatesChanged = 1;
  info->nextEventTime = next_event(m);
  info->nextEventTimeDefined = isfinite(info->nextEventTime) != 0;
  return OK;
}
#define SIZES
#else
EXPORT STATUS fmi3GetContinuousStateDerivatives(INSTANCE c, double d[], size_t n) { return get_derivatives(c, d, n); }
EXPORT STATUS fmi3UpdateDiscreteStates(INSTANCE c, bool *needed, bool *terminate, bool *nominals, bool *values,
                                       bool *defined, double *next) {
  Model *m = c;
  *needed = m->r[ENDLESS] > 0;
  *terminate = m->time >= m->r[TERMINATE_AT];
  *nominals = m->nominal != m->r[NOMINAL], *values = true;
  *next = next_event(m);
  *defined = isfinite(*next);
  return OK;
}
#define SIZES , size_t n_values
#endif
#if FMI == 2
EXPORT STATUS fmi2SetReal(INSTANCE c, const REFERENCE r[], size_t n, const double v[]) {
#else
EXPORT STATUS fmi3SetFloat64(INSTANCE c, const REFERENCE r[], size_t n, const double v[], size_t n_values) {
  if (n == 1 && n_values == 2 && r[0] == U) memcpy(((Model *)c)->r + U, v, 2 * sizeof *v); /* u as an array */
  else if (n_values != n) return ERROR;
#endif
  for (size_t i = 0; i < n; i++) ((Model *)c)->r[r[i]] = v[i];
  return OK;
}
#if FMI == 2
EXPORT STATUS fmi2GetReal(INSTANCE c, const REFERENCE r[], size_t n, double v[]) {
#else
EXPORT STATUS fmi3GetFloat64(INSTANCE c, const REFERENCE r[], size_t n, double v[], size_t n_values) {
  if (n_values != n) return ERROR;
#endif
  for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->r[r[i]];
  return OK;
}
#if FMI == 2
EXPORT STATUS fmi2GetDirectionalDerivative(INSTANCE c, const REFERENCE unknown[], size_t n, const REFERENCE known[],
                                           size_t k, const double seed[], double out[]) {
#else
EXPORT STATUS fmi3GetDirectionalDerivative(INSTANCE c, const REFERENCE unknown[], size_t n, const REFERENCE known[],
                                           size_t k, const double seed[], size_t n_seed, double out[], size_t n_out) {
  if (n_seed != k || n_out != n) return ERROR;
#endif
  Model *m = c;
  const double *x = m->r + X, mu = m->r[P];
  if (m->r[MODEL] == LINEAR) { /* for states and inputs, as FMI promises: as if nothing depended on parameters */
    for (size_t i = 0; i < n; i++) {
      out[i] = 0;
      for (size_t j = 0; j < k; j++) {
        if (known[j] == X) out[i] += (unknown[i] == DX ? -mu : 1) * seed[j];
        else if (known[j] == U && unknown[i] == DX) out[i] += seed[j];
      }
    }
    return OK;
  }
  if (m->r[MODEL] != VAN_DER_POL || m->r[BROKEN_JACOBIAN] > 0 || k != 1) return DISCARD;
  m->r[COUNT] += 1; /* of columns */
  for (size_t i = 0; i < n; i++) {
    const int row = (int)unknown[i] - DX, column = (int)known[0] - X;
    const double jacobian[2][2] = {{0, 1}, {-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] * x[0])}};
    out[i] = jacobian[row][column] * seed[0];
  }
  return OK;
}

/* ---- life cycle; the GUID is the number of the model */

#if FMI == 2
EXPORT INSTANCE fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                const fmi2CallbackFunctions *callbacks, FLAG visible, FLAG logging) {
  return make(atof(guid));
}
EXPORT STATUS fmi2SetupExperiment(INSTANCE c, FLAG tolerant, double tolerance, double start, FLAG stops, double stop) {
  ((Model *)c)->time = start;
  return OK;
}
EXPORT STATUS fmi2EnterInitializationMode(INSTANCE c) { return OK; }
EXPORT STATUS fmi2SetDebugLogging(INSTANCE c, FLAG on, size_t n, const fmi2String categories[]) { return OK; }
#else
EXPORT INSTANCE fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, FLAG visible,
                                             FLAG logging, fmi3InstanceEnvironment environment,
                                             fmi3LogMessageCallback log) {
  return make(atof(token));
}
EXPORT STATUS fmi3EnterInitializationMode(INSTANCE c, FLAG tolerant, double tolerance, double start, FLAG stops,
                                          double stop) {
  ((Model *)c)->time = start;
  return OK;
}
EXPORT STATUS fmi3SetDebugLogging(INSTANCE c, FLAG on, size_t n, const fmi3String categories[]) { return OK; }
#endif
EXPORT STATUS NAME(ExitInitializationMode)(INSTANCE c) {
  Model *m = c;
  memcpy(m->r + X, m->r + START, 3 * sizeof(double));
  m->mode = 0;
  return OK;
}
EXPORT STATUS NAME(Reset)(INSTANCE c) {
  const double model = ((Model *)c)->r[MODEL];
  set_defaults(c);
  ((Model *)c)->r[MODEL] = model;
  return OK;
}
EXPORT void NAME(FreeInstance)(INSTANCE c) { free(c); }
