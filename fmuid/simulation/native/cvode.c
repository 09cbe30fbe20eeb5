/* Steps of a model-exchange FMU by CVODE (BDF, dense linear solver).
 *
 * The libraries are those that FMPy carries (SUNDIALS 7). A. C. Hindmarsh et al., ACM Trans. Math. Softw. 31 (2005)
 * 363. */ \
#include "cvode.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "calls.h"

enum { CV_BDF = 2, CV_ONE_STEP = 2, CV_TSTOP_RETURN = 1, CV_LSETUP_FAIL = -6 };
static const double INCREMENT = 1.0 / (1 << 26); /* of a state, relatively, for differences */

struct Solver {
  void *context, *memory, *matrix, *linear;
  void *state, *at, *absolute; /* N_Vectors of x_end, x_at and the tolerances */
};

/* ---- what CVODE calls; an Outcome is what it wants ---- */

static int slopes(double t, void *y, void *dy, void *data) {
  Integrator *self = data;
  const Sundials *cv = self->how.sundials;
  return right_hand_side(self, t, cv->N_VGetArrayPointer(y), cv->N_VGetArrayPointer(dy));
}

/* The columns of the model's Jacobian by directional derivatives where the FMU is. */
static Outcome columns(Integrator *self, double *entries) {
  const double one = 1.0;
  for (size_t j = 0; j < self->how.n_states; j++) {
    int32_t status;
    const Outcome outcome = directional(self, self->how.derivative_references, self->how.n_states,
                                        &self->how.state_references[j], 1, &one, entries + self->n_total * j, &status);
    if (outcome == DONE) continue;
    if (status >= fmi2OK && status <= fmi2Error) self->has_directional = false;
    return FAILED;
  }
  return DONE;
}

/* The same by differences of the model's right-hand side, for a system with sensitivities. */
static Outcome difference_columns(Integrator *self, double t, const double *x, double *entries) {
  const size_t n = self->how.n_states;
  double *y = self->bend, *base = self->x_whole;
  Outcome outcome = get_derivatives(self, base);
  for (size_t j = 0; j < n && outcome == DONE; j++) {
    double *column = entries + self->n_total * j;
    copy(n, x, y);
    const double nominal = self->absolute[j] / self->how.tolerance;
    y[j] = x[j] + INCREMENT * fmax(fabs(x[j]), nominal);
    const double step = y[j] - x[j];
    outcome = put(self, t, y);
    if (outcome == DONE) outcome = get_derivatives(self, column);
    for (size_t i = 0; i < n && outcome == DONE; i++) column[i] = (column[i] - base[i]) / step;
  }
  return outcome;
}

/* One directional derivative a column; where the FMU fails to give one, none is asked for again.
 *
 * What is integrated with the states are their sensitivities, all with the same matrix: it is repeated along the
 * diagonal, and what couples them to the states is left out, which Newton's iteration bears (T. Maly, L. R. Petzold,
 * Appl. Numer. Math. 20 (1996) 57). */
static int jacobian(double t, void *y, void *dy, void *matrix, void *data, void *work1, void *work2, void *work3) {
  (void)dy, (void)work1, (void)work2, (void)work3;
  Integrator *self = data;
  const size_t n = self->how.n_states, total = self->n_total;
  const double *x = self->how.sundials->N_VGetArrayPointer(y);
  double *entries = self->how.sundials->SUNDenseMatrix_Data(matrix);
  Outcome outcome = put(self, t, x);
  if (outcome == DONE)
    outcome = self->has_directional ? columns(self, entries) : difference_columns(self, t, x, entries);
  if (outcome != DONE) return outcome;
  for (size_t shift = n; shift < total; shift += n)
    for (size_t j = 0; j < n; j++) copy(n, entries + total * j, entries + total * (shift + j) + shift);
  return DONE;
}

/* ---- its memory ---- */

static bool make(Integrator *self, Solver *s) {
  const Sundials *cv = self->how.sundials;
  const int64_t n = (int64_t)self->n_total;
  if (cv->SUNContext_Create(0, &s->context) != 0) return false;
  cv->SUNContext_ClearErrHandlers(s->context); /* they would print; the flags say what is wrong */
  s->state = cv->N_VMake_Serial(n, self->x_end, s->context);
  s->at = cv->N_VMake_Serial(n, self->x_at, s->context);
  s->absolute = cv->N_VMake_Serial(n, self->own_absolute, s->context);
  s->matrix = cv->SUNDenseMatrix(n, n, s->context);
  if (!s->state || !s->at || !s->absolute || !s->matrix) return false;
  s->linear = cv->SUNLinSol_Dense(s->state, s->matrix, s->context);
  s->memory = cv->CVodeCreate(CV_BDF, s->context);
  if (!s->linear || !s->memory) return false;
  bool done = cv->CVodeInit(s->memory, slopes, 0.0, s->state) == 0 && cv->CVodeSetUserData(s->memory, self) == 0;
  done = done && cv->CVodeSVtolerances(s->memory, self->how.tolerance, s->absolute) == 0;
  done = done && cv->CVodeSetLinearSolver(s->memory, s->linear, s->matrix) == 0;
  done = done && cv->CVodeSetMaxHnilWarns(s->memory, -1) == 0;
  if (self->how.largest_step < INFINITY) done = done && cv->CVodeSetMaxStep(s->memory, self->how.largest_step) == 0;
  if (self->has_directional || self->n_total > self->how.n_states)
    done = done && cv->CVodeSetJacFn(s->memory, jacobian) == 0;
  return done;
}

/* Return false where memory is short; what was made is freed with the integrator. */
bool cvode_create(Integrator *self) {
  self->solver = calloc(1, sizeof *self->solver);
  return self->solver && make(self, self->solver);
}

void cvode_free(Integrator *self) {
  const Sundials *cv = self->how.sundials;
  Solver *s = self->solver;
  if (s->memory) cv->CVodeFree(&s->memory);
  if (s->linear) cv->SUNLinSolFree(s->linear);
  if (s->matrix) cv->SUNMatDestroy(s->matrix);
  if (s->state) cv->N_VDestroy(s->state);
  if (s->at) cv->N_VDestroy(s->at);
  if (s->absolute) cv->N_VDestroy(s->absolute);
  if (s->context) cv->SUNContext_Free(&s->context);
  free(s);
}

/* ---- steps ---- */

/* Find the absolute tolerances for the time ahead. The size of a state that has had none yet is what its slope makes of
 * it by the wanted time. */
static void measure(Integrator *self) {
  const size_t n = self->how.n_states;
  double *own = self->own_absolute, *slope = self->slopes[0];
  copy(self->n_total, self->absolute, own);
  note_sizes(self);
  if (!self->small || right_hand_side(self, self->step_end, self->x_end, slope) != DONE) return;
  const double ahead = self->wanted - self->step_end;
  for (size_t i = 0; i < n; i++) own[i] = absolute_of(self, i, fmax(self->x_sizes[i], fabs(slope[i]) * ahead));
}

/* Let CVODE begin anew at the step's end; next_step is the first step length, 0 leaves it to CVODE. */
static Outcome restart(Integrator *self) {
  const Sundials *cv = self->how.sundials;
  const Solver *s = self->solver;
  measure(self);
  int flag = cv->CVodeReInit(s->memory, self->step_end, s->state);
  if (flag == 0)
    flag = cv->CVodeSVtolerances(s->memory, self->how.tolerance, s->absolute); /* it has a copy of its own */
  if (flag == 0) flag = cv->CVodeSetInitStep(s->memory, self->next_step);
  self->next_step = 0.0;
  return flag < 0 ? give_up(self, CVODE_FAILED, flag) : DONE;
}

/* One internal step of CVODE; return its flag, negative if it failed (and then the failure is noted). */
static int one_step(Integrator *self, double bound, double *reached) {
  const Sundials *cv = self->how.sundials;
  const Solver *s = self->solver;
  if (!self->can_go_on && restart(self) != DONE) return FAILED;
  self->report.failure = NOTHING;
  int flag = cv->CVodeSetStopTime(s->memory, bound);
  if (flag == 0) flag = cv->CVode(s->memory, bound, s->state, reached, CV_ONE_STEP);
  if (flag < 0 && self->report.failure == NOTHING) give_up(self, CVODE_FAILED, flag); /* not the FMU's doing */
  return flag;
}

/* One accepted step from the present time towards `bound`, event indicators at its end included. */
Outcome cvode_step(Integrator *self, double bound) {
  const double begin = self->step_end;
  double end, reached = begin;
  copy(self->n_total, self->x_end, self->x_start);
  for (;;) {
    int flag = one_step(self, bound, &reached);
    if (flag == CV_LSETUP_FAIL && !self->has_directional) {
      /* The first directional derivative failed: from here on CVODE takes differences. */
      self->how.sundials->CVodeSetJacFn(self->solver->memory, NULL);
      copy(self->n_total, self->x_start, self->x_end);
      self->can_go_on = false;
      flag = one_step(self, bound, &reached);
    }
    if (flag < 0) return FAILED;
    end = flag == CV_TSTOP_RETURN ? bound : reached;
    Outcome outcome = DONE;
    if (self->how.n_indicators) outcome = put(self, end, self->x_end);
    if (outcome == DONE) outcome = get_indicators(self, self->z_end);
    if (outcome == DONE) break;
    if (outcome == FAILED) return FAILED;
    self->next_step = 0.5 * (end - begin);
    copy(self->n_total, self->x_start, self->x_end);
    self->can_go_on = false;
    if (begin + self->next_step == begin) return FAILED;
  }
  self->fmu_is_at_end = self->how.n_indicators > 0;
  self->can_go_on = true;
  self->step_start = begin;
  self->step_end = end;
  self->step_length = end - begin;
  note_sizes(self);
  return DONE;
}

/* Put the states at a time t within the step into x_at. */
Outcome cvode_interpolate(Integrator *self, double t) {
  const int flag = self->how.sundials->CVodeGetDky(self->solver->memory, t, 0, self->solver->at);
  return flag < 0 ? give_up(self, CVODE_FAILED, flag) : DONE;
}
