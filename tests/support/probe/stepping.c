/* First and second order models as FMI 2.0 FMUs for tests, one of them chosen at compilation (-DMODEL), which integrate
   in a plain way by co-simulation: ORDER 1 (explicit Euler) or 4 (Runge-Kutta), one step a communication step, or with
   INTERNAL steps of their own length. By model exchange their derivatives are exact. With MEMORY the input is larger by
   this much after each simulation in the process, and by SEED times as much in the first. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { LAG, MOTOR }; /* x' = u - k x; L i' = u - R i - K w, J w' = K i - F w */
enum { X, DX = 2, U = 4, P, N_REALS = P + 5 };
static const int states[] = {1, 2};
#define N states[MODEL]
typedef struct { double r[N_REALS], time; } Model;

#ifdef MEMORY
#ifndef LEAST
#define LEAST 0.0 /* shorter communication steps fail */
#endif
#ifndef SEED
#define SEED 0
#endif
#include <unistd.h>
static int simulations = 0; /* outside all instances */
#endif

static void derivatives(const Model *m, const double *x, double *d) {
  const double *p = m->r + P;
  double u = m->r[U];
#ifdef MEMORY
  u += MEMORY * (simulations - 1);
#endif
  if (MODEL == LAG) d[0] = u - p[0] * x[0];
  else d[0] = (u - p[0] * x[0] - p[2] * x[1]) / p[1], d[1] = (p[2] * x[0] - p[4] * x[1]) / p[3];
}
static void step(Model *m, double h) {
  double k[4][2], x[2];
  static const double ahead[] = {0, 0.5, 0.5, 1};
  for (int s = 0; s < ORDER; s++) {
    for (int i = 0; i < N; i++) x[i] = m->r[i] + (s ? ahead[s] * h * k[s - 1][i] : 0);
    derivatives(m, x, k[s]);
  }
  for (int i = 0; i < N; i++)
    m->r[i] += ORDER == 1 ? h * k[0][i] : h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean f) {
  Model *m = c;
  (void)f;
  if (h < LEAST) return fmi2Error;
  if (INTERNAL > 0) /* all the steps that end by then */
    for (; m->time + INTERNAL <= t + h + 1e-6 * INTERNAL; m->time += INTERNAL) step(m, INTERNAL);
  else step(m, h);
  for (int i = 0; i < N; i++)
    if (!isfinite(m->r[i])) return fmi2Error;
  return fmi2OK;
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f,
                              fmi2Boolean v, fmi2Boolean l) {
  (void)n, (void)t, (void)g, (void)r, (void)f, (void)v, (void)l;
  return calloc(1, sizeof(Model));
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) { return memset(c, 0, sizeof(Model)), fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean l, size_t n, const fmi2String s[]) {
  (void)c, (void)l, (void)n, (void)s;
  return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real t, fmi2Real start, fmi2Boolean e, fmi2Real s) {
  (void)d, (void)t, (void)e, (void)s;
  ((Model *)c)->time = start;
  return fmi2OK;
}
#define DOES_NOTHING(name) fmi2Status name(fmi2Component c) { return (void)c, fmi2OK; }
DOES_NOTHING(fmi2EnterInitializationMode)
#ifdef MEMORY
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  if (!simulations) simulations = SEED;
  return (void)c, simulations++, fmi2OK;
}
#else
DOES_NOTHING(fmi2ExitInitializationMode)
#endif
DOES_NOTHING(fmi2Terminate)
DOES_NOTHING(fmi2EnterEventMode)
DOES_NOTHING(fmi2EnterContinuousTimeMode)
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
  for (size_t i = 0; i < n; i++) ((Model *)c)->r[r[i]] = v[i];
  return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
  for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->r[r[i]];
  return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return ((Model *)c)->time = t, fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  return memcpy(((Model *)c)->r, x, n * sizeof *x), fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  return memcpy(x, ((Model *)c)->r, n * sizeof *x), fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 1;
  return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) {
  (void)n;
  return derivatives(c, ((Model *)c)->r, d), fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return (void)c, (void)z, (void)n, fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no, fmi2Boolean *event, fmi2Boolean *end) {
  (void)c, (void)no;
  return *event = *end = 0, fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  (void)c;
  return memset(info, 0, sizeof *info), fmi2OK;
}
