/* Sensitivities of a model-exchange FMU's states to parameters, integrated with them (1.26).
 *
 * Integrated is [x, s_1, ..., s_N], s_j = dx/dp_j, with s_j' = (dg/dx) s_j + dg/dp_j. The right-hand sides are
 * directional derivatives that the FMU gives, or differences to *twins*: instances with p_j + d_j, put beside the
 * model at x + d_j s_j. Twins are also taken through the model's events. At a state event the time of the event
 * depends on p_j too: dt_j/dp_j = -(dz/dx s_j + dz/dp_j)/(dz/dt), and with it s_j jumps (E. N. Rozenvasser, Autom.
 * Remote Control 28 (1967) 52). */ \
#include "sensitivities.h"

#include <float.h>
#include <math.h>

#include "calls.h"
#include "events.h"

/* A change of derivatives that is less, relatively or over a step and a state's nominal value, is none. */
static const double SAME = 1e-9;
static const double PROBE = 1.0 / (1 << 17); /* of a step: how far from an event the rate of its indicator is found */
/* Events of parameters that differ a little are this close: a share of the step, and of the time. */
static const double NEAR = 0.1, NEARLY = 1e-6;
static const int NUDGES = 20; /* doublings of a rounding of time that bring a twin across a threshold */

static double jump_back(double a, double b) { return (a + b) - a; }

/* ---- directional derivatives ---- */

/* The derivatives of unknowns along (s_j, dp_j = 1), where the FMU is. */
static Outcome along(Integrator *self, size_t j, const double *x, const uint32_t *unknowns, size_t count,
                     double *found) {
  const size_t n = self->how.n_states;
  int32_t status;
  copy(n, x + n * (j + 1), self->seeds);
  self->seeds[n] = 1.0;
  const uint32_t *knowns = self->how.sensitivities->knowns + (n + 1) * j;
  return directional(self, unknowns, count, knowns, n + 1, self->seeds, found, &status);
}

static Outcome extend(Integrator *self, double t, const double *x, double *dx) {
  (void)t;
  const size_t n = self->how.n_states;
  for (size_t j = 0; n > 0 && j < self->how.sensitivities->count; j++)
    if (along(self, j, x, self->how.derivative_references, n, dx + n * (j + 1)) != DONE) return FAILED;
  return DONE;
}

/* The sensitivities of outputs (N, count) where the FMU is; a status, as of a getting function. */
int32_t output_sensitivities(Integrator *self, const uint32_t *references, size_t count, double *values) {
  const double *x = self->time < self->step_end ? self->x_at : self->x_end;
  for (size_t j = 0; j < self->how.sensitivities->count; j++)
    if (along(self, j, x, references, count, values + count * j) != DONE) return fmi2Error;
  return fmi2OK;
}

static Outcome before(Integrator *self, double t, const double *x) {
  (void)t;
  copy(self->how.n_states, x, self->x_before);
  return self->inside ? get_derivatives(self, self->slopes_before) : DONE;
}

/* Begin with the given sensitivities; fail after an event that they may not go through unchanged. */
static Outcome after(Integrator *self, double t, double *x) {
  (void)t;
  const size_t n = self->how.n_states;
  if (self->starting) {
    copy(n * self->how.sensitivities->count, self->how.sensitivities->initial, x + n);
    return DONE;
  }
  for (size_t i = 0; i < n; i++)
    if (x[i] != self->x_before[i]) return give_up(self, JUMP_UNKNOWN, fmi2OK);
  if (!self->inside) return DONE;
  if (get_derivatives(self, self->slopes_after) != DONE) return FAILED;
  for (size_t i = 0; i < n; i++) {
    const double one = self->slopes_before[i], other = self->slopes_after[i];
    const double nominal = self->absolute[i] / self->how.tolerance, length = self->step_length;
    if (fabs(one - other) * length > SAME * ((fabs(one) + fabs(other)) * length + nominal))
      return give_up(self, JUMP_UNKNOWN, fmi2OK);
  }
  return DONE;
}

const Extension directional_sensitivities = {.extend = extend, .before_event = before, .after_event = after};

/* ---- twins ---- */

static size_t count_of(const Integrator *self) { return self->how.sensitivities->count; }
static Integrator *twin_of(const Integrator *self, size_t j) { return self->how.sensitivities->twins[j]; }
static double change_of(const Integrator *self, size_t j) { return self->how.sensitivities->steps[j]; }

/* Make a twin's failure that of the model. */
static Outcome heed(Integrator *self, const Integrator *twin, Outcome outcome) {
  if (outcome != DONE) {
    self->report.failure = twin->report.failure;
    self->report.status = twin->report.status;
  }
  return outcome;
}

/* Put a twin at time t where its states are: x + d_j s_j, and further along the slopes before an event. */
static Outcome place(Integrator *self, size_t j, double t, const double *x, double shift) {
  const size_t n = self->how.n_states;
  Integrator *twin = twin_of(self, j);
  const double *s = x + n * (j + 1), change = change_of(self, j);
  double *y = twin->x_start;
  for (size_t i = 0; i < n; i++) y[i] = x[i] + change * s[i];
  if (shift != 0.0)
    for (size_t i = 0; i < n; i++) y[i] = y[i] + shift * self->slopes_before[i];
  return heed(self, twin, put(twin, t, y));
}

static Outcome extend_twins(Integrator *self, double t, const double *x, double *dx) {
  const size_t n = self->how.n_states;
  for (size_t j = 0; j < count_of(self); j++) {
    double *slopes = dx + n * (j + 1);
    Outcome outcome = place(self, j, t, x, 0.0);
    if (outcome == DONE) outcome = heed(self, twin_of(self, j), get_derivatives(twin_of(self, j), slopes));
    if (outcome != DONE) return outcome;
    for (size_t i = 0; i < n; i++) slopes[i] = (slopes[i] - dx[i]) / change_of(self, j);
  }
  return DONE;
}

static Outcome follow(Integrator *self, double t, const double *x) {
  for (size_t j = 0; j < count_of(self); j++)
    if (place(self, j, t, x, 0.0) != DONE) return FAILED;
  return DONE;
}

static Outcome complete(Integrator *self, double t, const double *x) {
  for (size_t j = 0; j < count_of(self); j++) {
    Integrator *twin = twin_of(self, j);
    if (place(self, j, t, x, 0.0) != DONE || heed(self, twin, complete_step(twin)) != DONE) return FAILED;
  }
  return DONE;
}

/* Which indicator crossed zero in the step that ends with the event; n_indicators if none did. */
static size_t crossing(const Integrator *self) {
  size_t i = 0;
  while (i < self->how.n_indicators && (self->z_start[i] > 0.0) == (self->z_end[i] > 0.0)) i++;
  return i;
}

/* The model's indicators a time after t, the states going on along their slopes. */
static Outcome indicators_at(Integrator *self, double t, double shift, const double *x, double *z) {
  for (size_t i = 0; i < self->how.n_states; i++) self->x_work[i] = x[i] + shift * self->slopes_before[i];
  const Outcome outcome = put(self, t + shift, self->x_work);
  return outcome == DONE ? get_indicators(self, z) : outcome;
}

/* The time derivative of indicator k at the event, zero after a failure; the model is left at t, z_event. */
static double rate_of(Integrator *self, double t, const double *x, size_t k) {
  const double late = jump_back(t, PROBE * self->step_length);
  if (late == 0.0) return 0.0;
  bool done = indicators_at(self, t, late, x, self->z_late) == DONE;
  done = done && indicators_at(self, t, -late, x, self->z_early) == DONE;
  done = done && indicators_at(self, t, 0.0, x, self->z_event) == DONE;
  self->fmu_is_at_end = true;
  return done ? (self->z_late[k] - self->z_early[k]) / (2.0 * late) : 0.0;
}

static bool sides_differ(const Integrator *self, const double *z) {
  for (size_t i = 0; i < self->how.n_indicators; i++)
    if ((z[i] > 0.0) != (self->z_end[i] > 0.0)) return true;
  return false;
}

/* Whether two events may be the same one; not so if the shift is NAN. */
static bool is_near(const Integrator *self, double shift, double t) {
  return fabs(shift) <= NEAR * self->step_length + NEARLY * fabs(t);
}

/* Put a twin just after its own crossing of indicator k; note by how much that is later. */
static Outcome cross(Integrator *self, size_t j, double t, const double *x, size_t k, double rate) {
  Integrator *twin = twin_of(self, j);
  double *z = self->z_late;
  if (place(self, j, t, x, 0.0) != DONE || heed(self, twin, get_indicators(twin, z)) != DONE) return FAILED;
  double shift = (self->z_event[k] - z[k]) / rate, nudge = DBL_EPSILON * fabs(t);
  for (int i = 0; i < NUDGES && is_near(self, shift, t); i++) {
    shift = jump_back(t, shift);
    if (place(self, j, t + shift, x, shift) != DONE || heed(self, twin, get_indicators(twin, z)) != DONE) return FAILED;
    if (!sides_differ(self, z)) {
      self->shifts[j] = shift;
      return DONE;
    }
    shift += nudge;
    nudge *= 2.0;
  }
  return give_up(self, JUMP_REFUSED, fmi2OK);
}

/* Take all twins through their own events, each at its own time. */
static Outcome go_through(Integrator *self, double t, const double *x) {
  const size_t k = crossing(self);
  const bool by_state = k < self->how.n_indicators, by_time = self->next_event <= t;
  if (get_derivatives(self, self->slopes_before) != DONE) return FAILED;
  const double rate = by_state ? rate_of(self, t, x, k) : 1.0;
  if (rate == 0.0 || (by_state && by_time)) return give_up(self, JUMP_REFUSED, fmi2OK);
  for (size_t j = 0; j < count_of(self); j++) {
    Integrator *twin = twin_of(self, j);
    if (by_state) {
      if (cross(self, j, t, x, k, rate) != DONE) return FAILED;
    } else {
      const double shift = by_time ? twin->next_event - t : 0.0;
      if (!is_near(self, shift, t)) return give_up(self, JUMP_REFUSED, fmi2OK);
      if (place(self, j, t + shift, x, shift) != DONE) return FAILED;
      self->shifts[j] = shift;
    }
    const bool done = complete_step(twin) == DONE && enter_event_mode(twin) == DONE;
    if (!done || leave_event_mode(twin, t + self->shifts[j]) != DONE) return heed(self, twin, FAILED);
  }
  return DONE;
}

static Outcome before_twins(Integrator *self, double t, const double *x) {
  copy(self->how.n_states, x, self->x_before);
  for (size_t j = 0; j < count_of(self); j++) self->shifts[j] = 0.0;
  return self->inside ? go_through(self, t, x) : DONE;
}

/* Find the sensitivities after an event, or at the beginning, from where the twins have come out of it. */
static Outcome after_twins(Integrator *self, double t, double *x) {
  (void)t;
  const size_t n = self->how.n_states;
  const double *old = self->slopes_before, *new = self->slopes_after;
  if (self->inside && get_derivatives(self, self->slopes_after) != DONE) return FAILED;
  for (size_t j = 0; j < count_of(self); j++) {
    const Integrator *twin = twin_of(self, j);
    const double change = change_of(self, j), shift = self->shifts[j];
    double *s = x + n * (j + 1);
    for (size_t i = 0; i < n; i++) {
      const bool kept = x[i] == self->x_before[i] && twin->x_end[i] == twin->x_start[i];
      const double drift = self->inside ? shift * new[i] : 0.0;
      if (!kept || self->starting)
        s[i] = (twin->x_end[i] - drift - x[i]) / change;
      else if (self->inside) /* free of the rounding of a difference */
        s[i] = s[i] + (shift * old[i] - drift) / change;
    }
  }
  return DONE;
}

const Extension twin_sensitivities = {extend_twins, follow, complete, before_twins, after_twins};
