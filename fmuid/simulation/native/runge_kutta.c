/* Runge–Kutta steps: the classical method, and Dormand and Prince's of order 5(4) with step-size control.
 *
 * Both are tables of one loop. The last stage of each stands at the end of the step (of the classical method it is an
 * extra one), so that it is the first stage of the next step, and the FMU is left where the step ends. */ \
#include "runge_kutta.h"

#include <float.h>
#include <math.h>

#include "calls.h"

typedef struct {
  double nodes[MOST_STAGES];
  double weights[MOST_STAGES][MOST_STAGES];
  double error[MOST_STAGES];
  double dense[MOST_STAGES]; /* of the dense output's term of fourth order */
  size_t n_stages;
} Tableau;

EXPORT extern const Tableau dormand_prince; /* seen from outside, to be compared with others' */

static const Tableau classical = {
    .nodes = {0.0, 1.0 / 2, 1.0 / 2, 1.0, 1.0},
    .weights = {{0.0}, {1.0 / 2}, {0.0, 1.0 / 2}, {0.0, 0.0, 1.0}, {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6}},
    .n_stages = 5,
};

/* J. R. Dormand, P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19; the dense output: E. Hairer, S. P. Norsett,
 * G. Wanner, Solving Ordinary Differential Equations I (1993), section II.6 and the code DOPRI5. */
const Tableau dormand_prince = {
    .nodes = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0},
    .weights =
        {
            {0.0},
            {1.0 / 5},
            {3.0 / 40, 9.0 / 40},
            {44.0 / 45, -56.0 / 15, 32.0 / 9},
            {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
            {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
            {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
        },
    .error = {71.0 / 57600, 0.0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525, -1.0 / 40},
    .dense = {-12715105075.0 / 11282082432, 0.0, 87487479700.0 / 32700410799, -10690763975.0 / 1880347072,
              701980252875.0 / 199316789632, -1453857185.0 / 822651844, 69997945.0 / 29380423},
    .n_stages = 7,
};

/* Step-size control of Hairer's DOPRI5, and its test of stiffness: |h lambda|, and how often in a row of how many. */
static const double SAFETY = 0.9, SHRINK = 0.2, GROW = 10.0, PI_EXPONENT = 0.04;
static const double NO_ERROR = 5e-8; /* less makes the next step longer by GROW, whatever the step before */
static const double STIFF_BOUND = 3.25;
static const size_t STIFF_EVERY = 200;
static const int32_t STIFF_AFTER = 15, STIFF_FORGOTTEN = 6;

static const Tableau *tableau(const Integrator *self) { return self->how.method == RK4 ? &classical : &dormand_prince; }

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }
static double square(double a) { return a * a; }

/* y = x + h times the weighted sum of the first slopes, added in their order. */
INLINE void combine(const Integrator *self, size_t count, const double *weights, double h, const double *x,
                    double *restrict y) {
  for (size_t i = 0; i < self->n_total; i++) {
    double sum = x[i];
    for (size_t q = 0; q < count; q++)
      if (weights[q] != 0.0) sum += h * weights[q] * self->slopes[q][i];
    y[i] = sum;
  }
}

/* The states of a stage. Its number is a constant in each case, so that weights are constants too, and none of zero. */
INLINE void combine_stage(const Integrator *self, const Tableau *table, size_t stage, double h, double *y) {
  switch (stage) {
#define STAGE(r)                                              \
  case r:                                                     \
    combine(self, r, table->weights[r], h, self->x_start, y); \
    break;
    STAGE(1) STAGE(2) STAGE(3) STAGE(4) STAGE(5) STAGE(6) default : break;
  }
}

/* All stages but the first; the last leaves x_end, and the FMU there. */
INLINE Outcome stages(Integrator *self, const Tableau *table, double begin, double end, double h) {
  const size_t last = table->n_stages - 1;
  for (size_t r = 1; r <= last; r++) {
    double *y = r == last ? self->x_end : self->x_stage;
    combine_stage(self, table, r, h, y);
    const double t = table->nodes[r] == 1.0 ? end : begin + table->nodes[r] * h;
    const Outcome outcome = right_hand_side(self, t, y, self->slopes[r]);
    if (outcome != DONE) return outcome;
  }
  return DONE;
}

static double scale(const Integrator *self, size_t i, const double *x, const double *other) {
  return self->absolute[i] + self->how.tolerance * larger(fabs(x[i]), fabs(other[i]));
}

/* The same where a state is measured by its own size. */
static double own_scale(const Integrator *self, size_t i, const double *x, const double *other) {
  if (i >= self->how.n_states) return scale(self, i, x, other);
  const double present = larger(fabs(x[i]), fabs(other[i]));
  return absolute_of(self, i, larger(present, self->x_sizes[i])) + self->how.tolerance * present;
}

/* The root of the mean square of values, each measured by its tolerance at x_start and `other`. */
static double norm(const Integrator *self, const double *values, const double *other) {
  double total = 0.0;
  for (size_t i = 0; i < self->n_total; i++) total += square(values[i] / scale(self, i, self->x_start, other));
  return sqrt(total / (double)self->n_total);
}

/* The root of the mean square of the errors, likewise, small states by their own size. */
static double error_norm(const Integrator *self, const double *errors) {
  if (!self->small) return norm(self, errors, self->x_end);
  double total = 0.0;
  for (size_t i = 0; i < self->n_total; i++)
    total += square(errors[i] / own_scale(self, i, self->x_start, self->x_end));
  return sqrt(total / (double)self->n_total);
}

/* Find the first step length to try (Hairer, Norsett, Wanner, section II.4). Size and speed are measured by tolerances;
 * the lengths in s are where to begin, and the control lengthens them tenfold a step. */
static Outcome find_first_step(Integrator *self, double begin, double gap) {
  const double *x = self->x_start;
  double *y = self->x_stage, **slopes = self->slopes;
  const double size = norm(self, x, x), speed = norm(self, slopes[0], x);
  double h = size < 1e-5 || speed < 1e-5 ? 1e-6 : 0.01 * size / speed;
  h = smaller(smaller(h, gap), self->how.largest_step);
  for (size_t i = 0; i < self->n_total; i++) y[i] = x[i] + h * slopes[0][i];
  const Outcome outcome = right_hand_side(self, begin + h, y, slopes[1]);
  self->next_step = h;
  if (outcome != DONE) return outcome == REJECTED ? DONE : outcome;
  for (size_t i = 0; i < self->n_total; i++) y[i] = slopes[1][i] - slopes[0][i];
  const double fastest = larger(speed, norm(self, y, x) / h);
  const double longest = fastest <= 1e-15 ? larger(1e-6, 1e-3 * h) : pow(0.01 / fastest, 0.2);
  self->next_step = smaller(100.0 * h, longest);
  return DONE;
}

/* A power of the last step's error, which is the same from step to step where errors are small. */
static double power_of_old(Integrator *self) {
  if (self->powered_error != self->old_error) self->power = pow(self->old_error, PI_EXPONENT);
  self->powered_error = self->old_error;
  return self->power;
}

/* Estimate the error; return the length of the next step: PI control (Hairer, Wanner, volume II, section IV.2). */
static double judge(Integrator *self, double h, bool clipped, bool again) {
  double *y = self->x_at;
  combine(self, MOST_STAGES, dormand_prince.error, h, self->zeros, y);
  const double error = self->error = error_norm(self, y);
  double factor = GROW;
  if (!(error < NO_ERROR)) {
    const double raw = pow(error, 0.2 - 0.75 * PI_EXPONENT);
    if (!(error <= 1.0)) return error > 1.0 ? h * larger(SHRINK, SAFETY / raw) : h * SHRINK; /* it may be NAN */
    factor = smaller(GROW, larger(SHRINK, SAFETY * power_of_old(self) / raw));
  }
  self->old_error = larger(error, 1e-4);
  if (again) factor = smaller(factor, 1.0);
  if (clipped && factor == GROW) /* a short step towards a given time says nothing against the length before */
    return larger(self->next_step, GROW * h);
  return factor * h;
}

/* Note the state whose error is the largest. */
static void blame(Integrator *self) {
  double worst = -1.0;
  for (size_t i = 0; i < self->n_total; i++) {
    const double error = fabs(self->x_at[i]) / own_scale(self, i, self->x_end, self->x_end);
    if (error <= worst) continue; /* not if it is NAN */
    worst = error;
    self->report.state = (int64_t)i;
  }
}

/* Whether stability, not accuracy, has bounded the steps for long (Hairer, Wanner, volume II, section IV.2). */
static bool is_stiff(Integrator *self, double h) {
  const size_t taken = self->n_steps - self->steps_before; /* few steps from sample to sample are no complaint */
  const bool looks = taken >= STIFF_EVERY && taken % STIFF_EVERY == 0; /* a division is dear here */
  if (!looks && self->stiff_hits == 0) return false;
  double above = 0.0, below = 0.0;
  for (size_t i = 0; i < self->how.n_states; i++) {
    above += square(self->slopes[6][i] - self->slopes[5][i]);
    below += square(self->x_end[i] - self->x_stage[i]);
  }
  if (below > 0.0 && h * sqrt(above / below) > STIFF_BOUND) {
    self->stiff_misses = 0;
    self->stiff_hits++;
  } else if (++self->stiff_misses == STIFF_FORGOTTEN) {
    self->stiff_hits = 0;
  }
  return self->stiff_hits >= STIFF_AFTER;
}

/* The length of the step to try, the gap to the bound at most. */
static Outcome find_length(Integrator *self, double begin, double gap, double *length) {
  const double largest = self->how.largest_step;
  if (self->how.method == RK4) {
    double h = gap;
    if (largest < INFINITY) h = gap / larger(1.0, ceil(gap / largest * (1.0 - 1e-3)));
    *length = self->next_step > 0.0 ? smaller(h, self->next_step) : h;
    return DONE;
  }
  if (self->next_step == 0.0 && find_first_step(self, begin, gap) != DONE) return FAILED;
  const double h = smaller(self->next_step, largest);
  *length = 1.01 * h >= gap && gap <= 1.001 * largest ? gap : h;
  return DONE;
}

/* Make the attempt the present step. */
static void accept(Integrator *self, double begin, double end, double h) {
  self->bent = false;
  self->step_start = begin;
  self->step_end = end;
  self->step_length = h;
  self->can_go_on = self->fmu_is_at_end = true;
  note_sizes(self);
}

/* Try a step of length h; *following is the length of the next one, or of the next attempt. */
static Outcome attempt(Integrator *self, double begin, double end, double h, bool again, double *following) {
  *following = 2.0 * self->next_step; /* of the classical method: back to full steps after a halved one */
  const Outcome outcome =
      self->how.method == RK4 ? stages(self, &classical, begin, end, h) : stages(self, &dormand_prince, begin, end, h);
  if (outcome != DONE) return outcome;
  if (self->how.method != RK4) {
    *following = judge(self, h, h < self->next_step, again);
    if (!(self->error <= 1.0)) {
      give_up(self, STEP_TOO_SMALL, fmi2OK);
      return REJECTED;
    }
  }
  return get_indicators(self, self->z_end);
}

static void swap(double **one, double **other) {
  double *kept = *one;
  *one = *other;
  *other = kept;
}

/* One accepted step from the present time towards `bound`, event indicators at its end included. */
Outcome runge_kutta_step(Integrator *self, double bound) {
  const double begin = self->step_end, gap = bound - begin;
  swap(&self->x_end, &self->x_start);
  if (self->can_go_on)
    swap(&self->slopes[tableau(self)->n_stages - 1], &self->slopes[0]);
  else if (right_hand_side(self, begin, self->x_start, self->slopes[0]) != DONE)
    return FAILED;
  double h, following;
  if (find_length(self, begin, gap, &h) != DONE) return FAILED;
  const double smallest = 4.0 * DBL_EPSILON * (fabs(begin) + h);
  for (bool again = false;; again = true) {
    const double end = h >= gap ? bound : begin + h;
    const Outcome outcome = attempt(self, begin, end, h, again, &following);
    if (outcome == FAILED) return FAILED;
    if (outcome == DONE) {
      self->next_step = following;
      if (self->how.method != RK4 && is_stiff(self, h)) return give_up(self, STIFF, fmi2OK);
      accept(self, begin, end, h);
      return DONE;
    }
    h = self->how.method == RK4 || following >= h ? 0.5 * h : following;
    self->next_step = h;
    if (h >= smallest) continue; /* not if it is NAN */
    if (self->report.failure == STEP_TOO_SMALL) blame(self);
    return FAILED;
  }
}

/* Prepare the dense output of the present step, of which x_end is not cut yet. */
static void bend_step(Integrator *self) {
  copy(self->n_total, self->x_end, self->x_whole);
  combine(self, MOST_STAGES, tableau(self)->dense, 1.0, self->zeros, self->bend);
  self->bent = true;
}

/* Put the states at a time t within the step into x_at: the cubic of the values and slopes at both ends; for Dormand
 * and Prince's method with the term that makes it one of fourth order. */
void runge_kutta_interpolate(Integrator *self, double t) {
  if (!self->bent) bend_step(self);
  const double *first = self->slopes[0], *last = self->slopes[tableau(self)->n_stages - 1], *x = self->x_start;
  const double h = self->step_length, theta = (t - self->step_start) / h, rest = 1.0 - theta;
  for (size_t i = 0; i < self->n_total; i++) {
    const double rise = self->x_whole[i] - x[i];
    const double bend = h * first[i] - rise;
    const double turn = rise - h * last[i] - bend;
    const double inner = turn + rest * h * self->bend[i];
    self->x_at[i] = x[i] + theta * (rise + rest * (bend + theta * inner));
  }
}
