/* The model-independent core: variables, evaluation on demand, events, integration.
   model.h, included before, is generated from the equations: sizes, start values, model_*() functions. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A variable's index in State.v is its FMI value reference. */
enum {
  V_X = 0, V_U = V_X + NX, V_P = V_U + NU, V_DX = V_P + NP, V_W = V_DX + NX, V_Z = V_W + NW,
  NZ = NR + 2 * NI, V_T = V_Z + NZ, NV = V_T + 1
};

/* So many events within one internal step are no sequence of events any more. */
enum { EVENTS = 100 };

typedef enum {
  INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32, ERROR = 64
} Mode;

/* What is to be computed anew before it is used. */
enum {
  CACHE = 1,  /* a parameter was set: the subexpressions of the parameters, and the start values */
  RATES = 2,  /* something was set: the derivatives; */
  VALUES = 4, /* all else that the model computes; */
  POINT = 8,  /* what the derivatives along all directions share */
  ALL_BUT_CACHE = RATES | VALUES | POINT
};

typedef struct {           /* all that get, set and serialise of the FMU state copy */
  double v[NV];            /* states, inputs, parameters, their derivatives, algebraic variables, indicators, time */
  double slope[NU + 1];    /* time derivatives of the inputs */
  double cache[NC + 1];    /* subexpressions of the parameters alone */
  double point[ND + 1];    /* what derivatives of dx along all directions have in common */
  double relation[NR + NI + 1]; /* 0 or 1, then whole numbers; only events change them */
  int mode;                /* a Mode */
  int stale;               /* CACHE and so on */
} State;

static void set_defaults(State *s) {
  memset(s, 0, sizeof *s);
  memcpy(s->v + V_U, model_values, sizeof(double) * (NU + NP));
  s->mode = INSTANTIATED;
  s->stale = CACHE | ALL_BUT_CACHE;
}

/* After a parameter was set: the cache, and until the end of the initialisation the states. */
static void refresh(State *s) {
  if (!(s->stale & CACHE)) return;
  model_cache(s->v + V_P, s->cache);
  if (s->mode & (INSTANTIATED | INITIALIZATION)) model_starts(s->v + V_P, s->v + V_X);
  s->stale &= ~CACHE;
}

/* The event indicators for states x, t0 after the inputs had their values in v. */
static void indicators(const State *s, double t0, const double *x, double *z) {
  const double t = s->v[V_T] + t0;
  double u[NU + 1];
  int i;
  for (i = 0; i < NU; i++) u[i] = s->v[V_U + i] + t0 * s->slope[i];
  model_indicators(x, u, s->v + V_P, &t, s->relation, s->cache, z);
}

/* An event: bring the relations and whole numbers up to date. None acts on itself, not even through others: a few
   passes are enough. What was - down loses to rounding, the next pass brings: it starts from a number close by. */
static void settle(State *s, double t0) {
  double z[NZ + 1];
  int i, changed = NZ;
  while (changed) {
    indicators(s, t0, s->v + V_X, z);
    for (changed = i = 0; i < NR; i++) {
      changed |= (z[i] > 0) != (s->relation[i] > 0);
      s->relation[i] = z[i] > 0;
    }
    for (i = 0; i < NI; i++) {
      const double was = s->relation[NR + i], up = z[NR + 2 * i], down = z[NR + 2 * i + 1];
      if ((up <= 0 || down > 0) && isfinite(down)) s->relation[NR + i] = floor(was - down);
      changed |= s->relation[NR + i] != was;
    }
  }
}

/* Before anything is evaluated. In continuous-time mode the relations stay as they are. */
static void prepare(State *s) {
  refresh(s);
  if (NZ > 0 && s->mode != CONTINUOUS) {
    settle(s, 0.0);
    s->stale |= POINT;
  }
}

/* Load numbers one by one, as they were stored a moment ago: a processor waits before it loads two of them at once. */
static inline void load(const volatile double *from, int n, double *to) {
  int i;
  for (i = 0; i < n; i++) to[i] = from[i];
}

/* The derivatives alone, all that integrators want in most of their calls. */
static void evaluate_rates(State *s) {
  double x[NX + 1];
  if (!(s->stale & RATES)) return;
  prepare(s);
  load(s->v + V_X, NX, x);
  model_derivatives(x, s->v + V_U, s->v + V_P, s->v + V_T, s->relation, s->cache, s->v + V_DX);
  s->stale &= ~RATES;
}

static void evaluate(State *s) {
  if (!(s->stale & VALUES)) return;
  prepare(s);
  model_evaluate(s->v + V_X, s->v + V_U, s->v + V_P, s->v + V_T, s->relation, s->cache, s->v + V_DX, s->v + V_W);
  if (NZ > 0) indicators(s, 0.0, s->v + V_X, s->v + V_Z);
  s->stale &= ~(RATES | VALUES);
}

/* One step of Butcher's seven-stage method of order six (J. C. Butcher, "On Runge-Kutta processes of high order",
   J. Austral. Math. Soc. 4 (1964) 179-194), t0 after the inputs had their values in v. In the sums, x comes first and
   the latest k last: while the model computes that k, the processor adds up the others. */
static void rk6(const State *s, double t0, double h, double *x) {
  double y[NX + 1], u[NU + 1], k1[NX + 1], k2[NX + 1], k3[NX + 1], k4[NX + 1], k5[NX + 1], k6[NX + 1], k7[NX + 1], t;
  int i;
#define STAGE(k, c, state) \
  for (i = 0; i < NX; i++) y[i] = state; \
  for (i = 0; i < NU; i++) u[i] = s->v[V_U + i] + (t0 + (c) * h) * s->slope[i]; \
  t = s->v[V_T] + (t0 + (c) * h); \
  model_derivatives(y, u, s->v + V_P, &t, s->relation, s->cache, k)
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

/* What a step by h with the relations as they are would lead to. */
typedef struct {
  double x[NX + 1]; /* the states */
  double beyond;    /* the event indicator that is farthest across zero; below zero before the first event, or NaN */
  int crossed;      /* the first event indicator that demands an event, or is not finite; or -1 */
} Trial;

static Trial try_step(const State *s, double t0, double h) {
  Trial trial;
  double z[NZ + 1];
  int i;
  memcpy(trial.x, s->v + V_X, sizeof(double) * NX);
  rk6(s, t0, h, trial.x);
  indicators(s, t0 + h, trial.x, z);
  trial.crossed = -1;
  trial.beyond = -INFINITY;
  for (i = 0; i < NZ; i++) {
    const int was = i < NR ? s->relation[i] > 0 : (i - NR) % 2 == 0;
    if (trial.crossed < 0 && was != (z[i] > 0)) trial.crossed = i;
    trial.beyond = fmax(trial.beyond, was ? -z[i] : z[i]);
    if (!isfinite(z[i])) {
      trial.crossed = i, trial.beyond = NAN;
      break;
    }
  }
  return trial;
}

/* The shortest step after which an event is due, up to rounding, given that one is after *h. The bracket shrinks
   by regula falsi, where one end stays its value is halved (the Illinois method), and every third time by bisection. */
static Trial first_event(const State *s, double t0, double *h, Trial end) {
  double a = 0, b = *h, at_a = try_step(s, t0, 0.0).beyond, at_b = end.beyond;
  const double close = 1e-13 * b + 2.3e-16 * fabs(s->v[V_T] + t0);
  int turn, last = 0;
  for (turn = 1; b - a > close; turn++) {
    double c = b - at_b * ((b - a) / (at_b - at_a));
    Trial middle;
    if (!isfinite(c) || turn % 3 == 0) c = a + (b - a) / 2;
    c = fmin(fmax(c, a + close / 2), b - close / 2); /* from beside the event the next one comes to its other side */
    middle = try_step(s, t0, c);
    if (middle.crossed >= 0) {
      b = c, at_b = middle.beyond, end = middle;
      if (last > 0) at_a /= 2;
      last = 1;
    } else {
      a = c, at_a = middle.beyond;
      if (last < 0) at_b /= 2;
      last = -1;
    }
  }
  *h = b;
  return end;
}

/* A step from event to event, each located to rounding. Return -1, or NX plus the event indicator that demands events
   too often, or NX + NZ plus the one that is not finite; then v has the time of the failure. */
static int step_over_events(State *s, double t0, double h) {
  double done = 0, part;
  int count;
  for (count = 0; done < h; count++) {
    Trial trial = try_step(s, t0 + done, part = h - done);
    const int end = trial.crossed < 0;
    if (!end) trial = first_event(s, t0 + done, &part, trial);
    done = end ? h : done + part;
    memcpy(s->v + V_X, trial.x, sizeof(double) * NX);
    if (end) break;
    settle(s, t0 + done);
    if (count == EVENTS || !isfinite(trial.beyond)) {
      s->v[V_T] += t0 + done;
      return NX + trial.crossed + (count == EVENTS ? 0 : NZ);
    }
  }
  return -1;
}

/* Advance by h in equal substeps of at most MODEL_STEP; return -1, or the index of a state that is not finite, or what
   step_over_events() returns. */
static int integrate(State *s, double h) {
  const double wanted = h / MODEL_STEP * (1 - 1e-6); /* rounded table times must not cost a second substep */
  const double n = wanted > 1 ? ceil(wanted) : 1;
  double k;
  int i;
  prepare(s);
  for (k = 0; k < n; k++) {
    int bad = -1;
    if (NZ > 0) bad = step_over_events(s, k * (h / n), h / n);
    else rk6(s, k * (h / n), h / n, s->v + V_X);
    for (i = 0; i < NX; i++)
      if (!isfinite(s->v[V_X + i])) {
        if (bad < 0) s->v[V_T] += (k + 1) * (h / n);
        return i;
      }
    if (bad >= 0) return bad;
  }
  for (i = 0; i < NU; i++) s->v[V_U + i] += h * s->slope[i];
  s->v[V_T] += h;
  s->stale |= ALL_BUT_CACHE;
  return -1;
}

/* seed[unknown] = sum over the knowns (states, inputs, parameters) of d unknown / d known * seed[known]; of the
   derivatives, or of the other unknowns, only where they are wanted */
static void directional(State *s, double *seed, int rates, int others) {
  double starts[NX + 1], known[V_DX + 1];
  int i;
  prepare(s);
  if (s->mode & (INSTANTIATED | INITIALIZATION)) { /* the states are still functions of the parameters */
    model_starts_seed(s->v + V_P, seed + V_P, starts);
    for (i = 0; i < NX; i++) seed[V_X + i] = starts[i];
  }
  if (rates && s->stale & POINT) {
    model_point(s->v + V_X, s->v + V_U, s->v + V_P, s->v + V_T, s->relation, s->point);
    s->stale &= ~POINT;
  }
  load(seed, V_DX, known);
  if (rates)
    model_rates_seed(s->v + V_X, s->v + V_U, s->v + V_P, s->v + V_T, s->relation, s->point, known + V_X, known + V_U,
                     known + V_P, seed + V_DX);
  if (others)
    model_others_seed(s->v + V_X, s->v + V_U, s->v + V_P, s->v + V_T, s->relation, known + V_X, known + V_U,
                      known + V_P, seed + V_W, seed + V_Z);
}
