/* An FMI 3.0 FMU for tests only: x' = gain (u + b - n x), n an Int32 and b a Boolean parameter, each step exact for an
   input that holds. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { GAIN, U, X, N_REALS, N = N_REALS, B }; /* value references */
typedef struct {
  double r[N_REALS];
  int32_t n;
  bool b;
} Model;

fmi3Status fmi3Reset(fmi3Instance c) {
  *(Model *)c = (Model){.r = {1, 0, 0}, .n = 1};
  return fmi3OK;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference r[], size_t n, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
  Model *m = malloc(sizeof *m);
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)r, (void)n;
  (void)environment, (void)log, (void)update;
  fmi3Reset(m);
  return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerant, double tolerance, double start,
                                       fmi3Boolean stops, double stop) {
  return (void)c, (void)tolerant, (void)tolerance, (void)start, (void)stops, (void)stop, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String k[]) {
  return (void)c, (void)on, (void)n, (void)k, fmi3OK;
}
/* Values of the wrong type are refused, as one reference is of one type. */
#define ACCESS(name, type, low, high, place)                                                                          \
  fmi3Status fmi3Set##name(fmi3Instance c, const fmi3ValueReference r[], size_t n, const type v[], size_t k) {         \
    Model *m = c;                                                                                                      \
    for (size_t i = 0; i < n; i++) {                                                                                   \
      if (r[i] < low || r[i] > high || n != k) return fmi3Error;                                                       \
      place = v[i];                                                                                                    \
    }                                                                                                                  \
    return fmi3OK;                                                                                                     \
  }                                                                                                                    \
  fmi3Status fmi3Get##name(fmi3Instance c, const fmi3ValueReference r[], size_t n, type v[], size_t k) {               \
    Model *m = c;                                                                                                      \
    for (size_t i = 0; i < n; i++) {                                                                                   \
      if (r[i] < low || r[i] > high || n != k) return fmi3Error;                                                       \
      v[i] = place;                                                                                                    \
    }                                                                                                                  \
    return fmi3OK;                                                                                                     \
  }
ACCESS(Float64, double, GAIN, X, m->r[r[i]])
ACCESS(Int32, int32_t, N, N, m->n)
ACCESS(Boolean, bool, B, B, m->b)
fmi3Status fmi3DoStep(fmi3Instance c, double t, double h, fmi3Boolean none, fmi3Boolean *event, fmi3Boolean *terminate,
                      fmi3Boolean *early, double *reached) {
  Model *m = c;
  double end = (m->r[U] + m->b) / m->n;
  (void)none;
  m->r[X] = end + (m->r[X] - end) * exp(-m->r[GAIN] * m->n * h);
  return *event = *terminate = *early = 0, *reached = t + h, fmi3OK;
}
