/* An FMU for tests only: an integrator x' = gain * u that can hold its inputs only, passes whole numbers, truth
   values and text through, counts instances, and fails in every way when told to. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { GAIN, FAIL_AT, NAN_AT, FAIL_INIT, U, X, Y, N_REALS };
typedef struct {
  double r[N_REALS], time;
  int n, b;
  char word[64], name[64];
  const fmi2CallbackFunctions *callbacks;
  int logging;
} Probe;
static int instances = 0;

static void defaults(Probe *m) {
  memset(m->r, 0, sizeof m->r);
  m->r[GAIN] = 1.0;
  m->r[FAIL_AT] = m->r[NAN_AT] = 1e9;
  m->n = 0, m->b = 0, m->time = 0;
  strcpy(m->word, "nothing");
}
static void say(Probe *m, fmi2Status status, const char *format, double a) {
  m->callbacks->logger(m->callbacks->componentEnvironment, m->name, status, "probe", format, m->word, a);
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  Probe *m;
  (void)type, (void)guid, (void)where, (void)visible;
#ifdef ONCE
  if (instances) return 0;
#endif
  m = callbacks->allocateMemory(1, sizeof *m);
  m->callbacks = callbacks, m->logging = logging;
  strncpy(m->name, name, sizeof m->name - 1);
  defaults(m);
  instances++;
  return m;
}
void fmi2FreeInstance(fmi2Component c) { instances--; ((Probe *)c)->callbacks->freeMemory(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[]) {
  (void)n, (void)k;
  ((Probe *)c)->logging = on;
  return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start, fmi2Boolean d, fmi2Real e) {
  (void)a, (void)b, (void)d, (void)e;
  ((Probe *)c)->time = start;
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  Probe *m = c;
  if (m->r[FAIL_INIT] > 0) { say(m, fmi2Error, "%s: cannot initialise with %g", m->r[FAIL_INIT]); return fmi2Error; }
  return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) {
#ifdef NO_RESET
  (void)c;
  return fmi2Error;
#elif defined(LEAKY_RESET)
  double kept = ((Probe *)c)->r[X];
  defaults(c);
  ((Probe *)c)->r[X] = kept;
  return fmi2OK;
#else
  defaults(c);
  return fmi2OK;
#endif
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
  Probe *m = c;
  for (size_t i = 0; i < n; i++)
    v[i] = r[i] == Y ? m->r[X] + m->r[U] : r[i] == N_REALS ? instances : m->r[r[i]]; /* y passes u straight on */
  return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
  for (size_t i = 0; i < n; i++) ((Probe *)c)->r[r[i]] = v[i];
  return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
  for (size_t i = 0; i < n; i++) v[i] = r[i] ? 10 * ((Probe *)c)->n : ((Probe *)c)->n;
  return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[]) {
  (void)r;
  if (n) ((Probe *)c)->n = v[0];
  return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
  for (size_t i = 0; i < n; i++) v[i] = r[i] ? !((Probe *)c)->b : ((Probe *)c)->b;
  return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[]) {
  (void)r;
  if (n) ((Probe *)c)->b = v[0];
  return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[]) {
  (void)r;
  if (n) strncpy(((Probe *)c)->word, v[0], 63);
  return fmi2OK;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
                                       const fmi2Real v[]) {
  (void)c, (void)r, (void)n, (void)o, (void)v;
  return fmi2Error;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
  Probe *m = c;
  (void)no;
  if (fabs(t - m->time) > 1e-9) { say(m, fmi2Error, "%s: step from a wrong time %g", t); return fmi2Error; }
  if (m->logging) say(m, fmi2OK, "%s: stepping at %g", t);
  if (t + h > m->r[FAIL_AT]) {
#ifdef FATAL
    return fmi2Fatal;
#else
    if (m->logging) say(m, fmi2Warning, "%s: the solver gave up at %g", t);
    return fmi2Discard;
#endif
  }
#ifdef DISCARDS
  if (h > 0.3 + 1e-9) { /* takes what it can of the step; -DDISCARDS=2: nothing of it */
    if (DISCARDS == 1) m->r[X] += m->r[GAIN] * m->r[U] * 0.3, m->time = t + 0.3;
    return fmi2Discard;
  }
#endif
#ifdef CHOICES /* x' = gain * (u + b - n * x), exactly for an input that holds */
  double rate = m->r[GAIN] * m->n, end = m->n ? (m->r[U] + m->b) / m->n : 0;
  if (m->n == 9) return fmi2Error;
  m->r[X] = m->n ? end + (m->r[X] - end) * exp(-rate * h) : m->r[X] + m->r[GAIN] * (m->r[U] + m->b) * h;
#else
  m->r[X] += m->r[GAIN] * m->r[U] * h;
#endif
  m->time = t + h;
  if (t + h > m->r[NAN_AT]) m->r[X] = NAN;
  if (m->n == 7) say(m, fmi2Warning, "%s: seven at %g", t);
  return fmi2OK;
}
/* required by the standard, not by these tests */
#define UNUSED(name, ...) fmi2Status name(__VA_ARGS__) { return fmi2Error; }
UNUSED(fmi2GetString, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
UNUSED(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *s)
UNUSED(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate s)
UNUSED(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *s)
UNUSED(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
UNUSED(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
UNUSED(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
UNUSED(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference a[], size_t n,
       const fmi2ValueReference b[], size_t k, const fmi2Real d[], fmi2Real e[])
UNUSED(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
       fmi2Real v[])
#ifndef INCOMPLETE
UNUSED(fmi2CancelStep, fmi2Component c)
#endif
UNUSED(fmi2GetStatus, fmi2Component c, const fmi2StatusKind k, fmi2Status *s)
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *s) {
  *s = ((Probe *)c)->time;
  return k == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
UNUSED(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind k, fmi2Integer *s)
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *s) {
  (void)c;
#ifdef ENDS
  *s = fmi2True;
#else
  *s = fmi2False;
#endif
  return k == fmi2Terminated ? fmi2OK : fmi2Discard;
}
UNUSED(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind k, fmi2String *s)
