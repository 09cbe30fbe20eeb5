/* The model-independent core: variables, evaluation on demand, integration.
   model.h, included before, is generated from the equations: sizes, start values, model_*() functions. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A variable's index in State.v is its FMI value reference. */
enum { V_X = 0, V_U = V_X + NX, V_P = V_U + NU, V_DX = V_P + NP, V_W = V_DX + NX, NV = V_W + NW };

typedef enum {
  INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32, ERROR = 64
} Mode;

typedef struct {           /* all that get, set and serialise of the FMU state copy */
  double v[NV + 1];        /* states, inputs, parameters, their derivatives, algebraic variables */
  double slope[NU + 1];    /* time derivatives of the inputs */
  double cache[NC + 1];    /* subexpressions of the parameters alone */
  double time;
  int mode;                /* a Mode */
  int stale_cache;         /* a parameter was set since the cache (and the start values) were computed */
  int stale_values;        /* something was set since the derivatives and algebraic variables were computed */
} State;

static void set_defaults(State *s) {
  memset(s, 0, sizeof *s);
  memcpy(s->v + V_U, model_values, sizeof(double) * (NU + NP));
  s->mode = INSTANTIATED;
  s->stale_cache = s->stale_values = 1;
}

/* After a parameter was set: the cache, and until the end of the initialisation the states. */
static void refresh(State *s) {
  if (!s->stale_cache) return;
  model_cache(s->v + V_P, s->cache);
  if (s->mode & (INSTANTIATED | INITIALIZATION)) model_starts(s->v + V_P, s->v + V_X);
  s->stale_cache = 0;
}

static void evaluate(State *s) {
  refresh(s);
  if (!s->stale_values) return;
  model_evaluate(s->v + V_X, s->v + V_U, s->v + V_P, s->cache, s->v + V_DX, s->v + V_W);
  s->stale_values = 0;
}

/* One step of Butcher's seven-stage method of order six (J. C. Butcher, "On Runge-Kutta processes of high order",
   J. Austral. Math. Soc. 4 (1964) 179-194), t0 after the inputs had their values in v. In the sums, x comes first and
   the latest k last: while the model computes that k, the processor adds up the others. */
static void rk6(const State *s, double t0, double h, double *x) {
  double y[NX + 1], u[NU + 1], k1[NX + 1], k2[NX + 1], k3[NX + 1], k4[NX + 1], k5[NX + 1], k6[NX + 1], k7[NX + 1];
  int i;
#define STAGE(k, c, state) \
  for (i = 0; i < NX; i++) y[i] = state; \
  for (i = 0; i < NU; i++) u[i] = s->v[V_U + i] + (t0 + (c) * h) * s->slope[i]; \
  model_derivatives(y, u, s->v + V_P, s->cache, k)
#define ADD(a, k) + h * (a) * k[i]
  STAGE(k1, 0.0, x[i]);
  STAGE(k2, 1.0 / 3, x[i] ADD(1.0 / 3, k1));
  STAGE(k3, 2.0 / 3, x[i] ADD(2.0 / 3, k2));
  STAGE(k4, 1.0 / 3, x[i] ADD(1.0 / 12, k1) ADD(1.0 / 3, k2) ADD(-1.0 / 12, k3));
  STAGE(k5, 1.0 / 2, x[i] ADD(-1.0 / 16, k1) ADD(9.0 / 8, k2) ADD(-3.0 / 16, k3) ADD(-3.0 / 8, k4));
  STAGE(k6, 1.0 / 2, x[i] ADD(9.0 / 8, k2) ADD(-3.0 / 8, k3) ADD(-3.0 / 4, k4) ADD(1.0 / 2, k5));
  STAGE(k7, 1.0, x[i] ADD(9.0 / 44, k1) ADD(-9.0 / 11, k2) ADD(63.0 / 44, k3) ADD(18.0 / 11, k4) ADD(-16.0 / 11, k6));
  for (i = 0; i < NX; i++)
    x[i] = x[i] ADD(11.0 / 120, k1) ADD(27.0 / 40, k3) ADD(27.0 / 40, k4) ADD(-4.0 / 15, k5) ADD(-4.0 / 15, k6)
      ADD(11.0 / 120, k7);
}

/* Advance by h in equal substeps of at most MODEL_STEP; return -1, or the index of a state that is not finite. */
static int integrate(State *s, double h) {
  const double wanted = h / MODEL_STEP * (1 - 1e-6); /* rounded table times must not cost a second substep */
  const double n = wanted > 1 ? ceil(wanted) : 1;
  double k;
  int i;
  refresh(s);
  for (k = 0; k < n; k++) {
    rk6(s, k * (h / n), h / n, s->v + V_X);
    for (i = 0; i < NX; i++)
      if (!isfinite(s->v[V_X + i])) {
        s->time += (k + 1) * (h / n);
        return i;
      }
  }
  for (i = 0; i < NU; i++) s->v[V_U + i] += h * s->slope[i];
  s->time += h;
  s->stale_values = 1;
  return -1;
}

/* seed[unknown] = sum over the knowns (states, inputs, parameters) of d unknown / d known * seed[known] */
static void directional(State *s, double *seed) {
  double starts[NX + 1];
  int i;
  refresh(s);
  if (s->mode & (INSTANTIATED | INITIALIZATION)) { /* the states are still functions of the parameters */
    model_starts_seed(s->v + V_P, seed + V_P, starts);
    for (i = 0; i < NX; i++) seed[V_X + i] = starts[i];
  }
  model_seed(s->v + V_X, s->v + V_U, s->v + V_P, seed + V_X, seed + V_U, seed + V_P, seed + V_DX, seed + V_W);
}
