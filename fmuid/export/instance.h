/* One instance of the FMU: all that FMI 2.0 and 3.0 do alike, over the core. Both number their statuses alike.
   Defined before: Logger, a function pointer, and SEND(logger, environment, name, text), which logs an error. */
#include <stdarg.h>
#include <stdio.h>
#include "model.h"
#include "core.h"

enum { OK = 0, FAILED = 3 };
typedef int Status;
typedef unsigned int Reference;

typedef struct {
  State s;
  Logger logger;
  void *environment;
  int model_exchange;
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
static Status fail(Instance *m, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  m->s.mode = ERROR;
  if (m->logger) SEND(m->logger, m->environment, m->name, text);
  return FAILED;
}

/* Every function begins with it: the instance m of the component c, if the function is allowed in its mode. */
#define ENTER(function, modes) \
  Instance *m = (Instance *)c; \
  if (!m) return FAILED; \
  if (!(m->s.mode & (modes))) return fail(m, "%s cannot be called %s", function, mode_name(m->s.mode))
#define REQUIRE(condition, ...) do { if (!(condition)) return fail(m, __VA_ARGS__); } while (0)

#define NOT_FINITE "%s is not finite at t = %g: parameters, inputs or states are out of the range of the model"

/* Is r one of the count value references from the first on? */
static inline int among(Reference r, Reference first, Reference count) {
  return r - first < count; /* unsigned: r < first wraps around */
}

/* ---- life */

static inline Instance *create(const char *name, const char *guid, Logger logger, void *environment,
                               int model_exchange) {
  const char *problem = !name || !*name ? "the instance has no name"
    : !guid || strcmp(guid, MODEL_GUID) ? "wrong token: modelDescription.xml and binary are not of the same export"
    : NULL;
  Instance *m = problem ? NULL : (Instance *)calloc(1, sizeof *m + strlen(name));
  if (!m) {
    if (logger) SEND(logger, environment, name ? name : "", problem ? problem : "out of memory");
    return NULL;
  }
  strcpy(m->name, name);
  m->logger = logger;
  m->environment = environment;
  m->model_exchange = model_exchange;
  set_defaults(&m->s);
  return m;
}

static inline Status exit_initialization(void *c, const char *function) {
  ENTER(function, INITIALIZATION);
  refresh(&m->s);
  m->s.mode = m->model_exchange ? EVENT : STEP;
  return OK;
}

static inline Status terminate(void *c, const char *function) {
  ENTER(function, RUNNING);
  m->s.mode = TERMINATED;
  return OK;
}

static inline Status reset(void *c, const char *function) {
  ENTER(function, ANY | ERROR);
  set_defaults(&m->s);
  return OK;
}

/* ---- variables */

static inline Status get_values(void *c, const char *function, const Reference r[], size_t n, double values[]) {
  size_t i;
  ENTER(function, ANY);
  refresh(&m->s);
  for (i = 0; i < n; i++) {
    REQUIRE(r[i] < NV, "%s: there is no variable of value reference %u", function, r[i]);
    if (r[i] >= V_DX) evaluate(&m->s);
    values[i] = m->s.v[r[i]];
    REQUIRE(isfinite(values[i]), NOT_FINITE, model_names[r[i]], m->s.v[V_T]);
  }
  return OK;
}

/* May the variable be given this value now? Apart, because at every step of a simulation inputs alone are set. */
static Status check_value(Instance *m, const char *function, Reference r, double value) {
  const int input = among(r, V_U, NU), parameter = among(r, V_P, NP);
  REQUIRE(r < NV, "%s: there is no variable of value reference %u", function, r);
  REQUIRE(input || parameter, "%s: %s is computed by the model: only inputs and parameters can be set", function,
          model_names[r]);
  REQUIRE(input || m->s.mode != CONTINUOUS, "%s: parameter %s cannot be set in continuous-time mode", function,
          model_names[r]);
  REQUIRE(isfinite(value), "%s: the value given for %s at t = %g is not finite", function, model_names[r],
          m->s.v[V_T]);
  return OK;
}

static inline Status set_values(void *c, const char *function, const Reference r[], size_t n, const double values[]) {
  size_t i;
  ENTER(function, ANY & ~TERMINATED);
  for (i = 0; i < n; i++) {
    if (!among(r[i], V_U, NU) || !isfinite(values[i])) {
      if (check_value(m, function, r[i], values[i]) != OK) return FAILED;
      m->s.stale |= CACHE;
    }
    m->s.v[r[i]] = values[i];
  }
  m->s.stale |= ALL_BUT_CACHE;
  return OK;
}

static inline Status directional_derivative(void *c, const char *function, const Reference unknowns[],
                                            size_t n_unknowns, const Reference knowns[], size_t n_knowns,
                                            const double seeds[], double values[]) {
  double seed[NV] = {0};
  int rates = 0, others = 0;
  size_t i;
  ENTER(function, ANY & ~INSTANTIATED);
  for (i = 0; i < n_knowns; i++) {
    REQUIRE(knowns[i] < V_DX, "%s: value reference %u is no state, input or parameter", function, knowns[i]);
    seed[knowns[i]] = seeds[i];
  }
  for (i = 0; i < n_unknowns; i++) {
    REQUIRE(unknowns[i] < NV, "%s: there is no variable of value reference %u", function, unknowns[i]);
    rates |= among(unknowns[i], V_DX, NX);
    others |= unknowns[i] >= V_W;
  }
  directional(&m->s, seed, rates, others);
  for (i = 0; i < n_unknowns; i++) values[i] = seed[unknowns[i]];
  return OK;
}

/* ---- the FMU state */

static inline Status get_state(void *c, const char *function, void **state) {
  ENTER(function, ANY);
  if (!*state) *state = malloc(sizeof m->s);
  REQUIRE(*state, "%s: out of memory", function);
  memcpy(*state, &m->s, sizeof m->s);
  return OK;
}

static inline Status set_state(void *c, const char *function, const void *state) {
  ENTER(function, ANY | ERROR);
  REQUIRE(state, "%s: no state given", function);
  memcpy(&m->s, state, sizeof m->s);
  return OK;
}

static inline Status free_state(void **state) {
  if (state) {
    free(*state);
    *state = NULL;
  }
  return OK;
}

static inline Status serialised_size(void *c, const char *function, size_t *size) {
  ENTER(function, ANY | ERROR);
  *size = sizeof(Serialised);
  return OK;
}

static inline Status serialise(void *c, const char *function, const void *state, void *bytes, size_t size) {
  Serialised whole;
  ENTER(function, ANY | ERROR);
  REQUIRE(state && size >= sizeof whole, "%s: no state, or too few bytes for it", function);
  memset(&whole, 0, sizeof whole);
  memcpy(whole.guid, MODEL_GUID, sizeof whole.guid);
  memcpy(&whole.s, state, sizeof whole.s);
  memcpy(bytes, &whole, sizeof whole);
  return OK;
}

static inline Status deserialise(void *c, const char *function, const void *bytes, size_t size, void **state) {
  Serialised whole;
  ENTER(function, ANY | ERROR);
  REQUIRE(size == sizeof whole && !memcmp(bytes, MODEL_GUID, sizeof whole.guid),
          "%s: these bytes are not a state of this FMU", function);
  memcpy(&whole, bytes, sizeof whole);
  if (!*state) *state = malloc(sizeof whole.s);
  REQUIRE(*state, "%s: out of memory", function);
  memcpy(*state, &whole.s, sizeof whole.s);
  return OK;
}

/* ---- model exchange */

static inline Status enter_event_mode(void *c, const char *function) {
  ENTER(function, EVENT | CONTINUOUS);
  m->s.mode = EVENT;
  m->s.stale |= ALL_BUT_CACHE; /* the relations may change now */
  return OK;
}

/* One round is always enough: the relations settle in it. */
static inline Status update_discrete_states(void *c, const char *function) {
  ENTER(function, EVENT);
  evaluate(&m->s);
  return OK;
}

static inline Status enter_continuous_time_mode(void *c, const char *function) {
  ENTER(function, EVENT | CONTINUOUS);
  evaluate(&m->s);
  m->s.mode = CONTINUOUS;
  return OK;
}

static inline Status completed_integrator_step(void *c, const char *function) {
  ENTER(function, CONTINUOUS);
  return OK;
}

static inline Status set_time(void *c, const char *function, double time) {
  ENTER(function, EVENT | CONTINUOUS);
  m->s.v[V_T] = time;
  m->s.stale |= ALL_BUT_CACHE;
  return OK;
}

#define REQUIRE_SIZE(n, size) REQUIRE((n) == (size), "%s: the size is %d, not %d", function, (int)(size), (int)(n))

static inline Status set_states(void *c, const char *function, const double x[], size_t n) {
  int i;
  ENTER(function, EVENT | CONTINUOUS);
  REQUIRE_SIZE(n, NX);
  for (i = 0; i < NX; i++) {
    REQUIRE(isfinite(x[i]), "%s: the value given for %s at t = %g is not finite", function, model_names[i],
            m->s.v[V_T]);
    m->s.v[V_X + i] = x[i];
  }
  m->s.stale |= ALL_BUT_CACHE;
  return OK;
}

/* Get the variables of the value references from first on, all n that there are. */
static inline Status get_block(void *c, const char *function, int first, int size, double values[], size_t n) {
  int i;
  ENTER(function, ANY & ~INSTANTIATED);
  REQUIRE_SIZE(n, (size_t)size);
  refresh(&m->s);
  if (first == V_DX) evaluate_rates(&m->s);
  if (first > V_DX) evaluate(&m->s);
  for (i = 0; i < size; i++) {
    values[i] = m->s.v[first + i];
    REQUIRE(isfinite(values[i]), NOT_FINITE, model_names[first + i], m->s.v[V_T]);
  }
  return OK;
}

static inline Status get_nominals(void *c, const char *function, double x[], size_t n) {
  ENTER(function, ANY & ~INSTANTIATED);
  REQUIRE_SIZE(n, NX);
  memcpy(x, model_nominals, NX * sizeof(double));
  return OK;
}

/* ---- co-simulation */

static inline Status do_step(void *c, const char *function, double time, double h) {
  int bad;
  ENTER(function, STEP);
  REQUIRE(isfinite(time) && isfinite(h) && h >= 0, "%s: from t = %g by %g is no step", function, time, h);
  m->s.v[V_T] = time;
  bad = integrate(&m->s, h);
  if (bad < 0) return OK;
  REQUIRE(bad >= NX, "state %s is not finite at t = %g: parameters or inputs are out of the range of the model, or "
          "make it too fast for its integration step of %g s", model_names[bad], m->s.v[V_T], MODEL_STEP);
  REQUIRE(bad >= NX + NZ, "%s chatters at t = %.9g: more than %d events within one integration step of %g s; "
          "smooth it, as with tanh, put it into noEvent(), or give a shorter Interval", model_jumps[bad - NX],
          m->s.v[V_T], EVENTS, MODEL_STEP);
  return fail(m, NOT_FINITE, model_jumps[bad - NX - NZ], m->s.v[V_T]);
}
