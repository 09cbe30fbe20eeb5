/* What every integrator does again and again: it sets time, inputs and states of its FMU and gets derivatives. Inlined,
 * because a model's derivatives often take no longer than the calls around them. */
#ifndef CALLS_H
#define CALLS_H

#include <math.h>

#include "integrator.h"

/* Note what has failed; return FAILED. */
Outcome give_up(Integrator *self, Failure failure, int32_t status);

/* REJECTED if a number is not finite. */
Outcome check_finite(Integrator *self, const double *x, const double *dx);

/* Find the derivatives of the unknowns along the seeds of the knowns, where the FMU is. */
Outcome directional(Integrator *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns,
                    size_t n_knowns, const double *seeds, double *found, int32_t *status);

INLINE void copy(size_t n, const double *from, double *to) {
  for (size_t i = 0; i < n; i++) to[i] = from[i];
}

/* Judge the status of a function that may discard what it is given. */
INLINE Outcome check(Integrator *self, Failure function, int32_t status) {
  if (good(status)) return DONE;
  give_up(self, function, status);
  return status == fmi2Discard ? REJECTED : FAILED;
}

/* The absolute tolerance of a state. One far below a nominal value of 1, which may be one that nobody has stated, is
 * measured by its size. */
INLINE double absolute_of(const Integrator *self, size_t i, double size) {
  const double most_times = 1e3, absolute = self->absolute[i], own = self->how.tolerance * most_times * size;
  return absolute == self->how.tolerance && size > 0.0 && own < absolute ? own : absolute;
}

/* Note the sizes of the states at the step's end, as long as one of them is small. */
INLINE void note_sizes(Integrator *self) {
  if (!self->small) return;
  self->small = false;
  for (size_t i = 0; i < self->how.n_states; i++) {
    const double size = self->x_sizes[i] = fmax(self->x_sizes[i], fabs(self->x_end[i]));
    self->small = self->small || size == 0.0 || absolute_of(self, i, size) < self->absolute[i];
  }
}

INLINE double input_at(const Integrator *self, size_t j, double t) {
  const Curve *curve = &self->how.curves[j];
  const double after = t - self->origin;
  return self->how.straight ? curve->a[0] + after * curve->a[1] : value_at(curve, after);
}

/* Set the inputs as of time t, unless the FMU holds them already. */
INLINE Outcome put_inputs(Integrator *self, double t) {
  const Integration *how = &self->how;
  const size_t n = how->n_inputs;
  double *values = self->input_values, *sizes = self->input_sizes;
  bool same = true;
  if (t == self->held) return DONE;
  for (size_t j = 0; j < n; j++) {
    const double value = input_at(self, j, t), size = fabs(value);
    same = same && value == values[j];
    values[j] = value;
    sizes[j] = size > sizes[j] ? size : sizes[j];
  }
  int32_t status = fmi2OK;
  if (same)
    ;
  else if (how->fmi2)
    status = how->fmi2->SetReal(how->instance, how->input_references, how->n_input_references, values);
  else
    status = how->fmi3->SetFloat64(how->instance, how->input_references, how->n_input_references, values, n);
  self->held = t;
  return check(self, (Failure)FLOAT64, status) == DONE ? DONE : FAILED;
}

/* Set time, inputs and states; time and inputs only where the FMU has others. */
INLINE Outcome put(Integrator *self, double t, const double *x) {
  self->fmu_is_at_end = false;
  self->time = t;
  if (t != self->held) {
    if (check(self, SET_TIME, self->call.SetTime(self->how.instance, t)) != DONE) return FAILED;
    if (put_inputs(self, t) != DONE) return FAILED;
  }
  if (self->how.n_states == 0) return DONE;
  return check(self, SET_STATES, self->call.SetContinuousStates(self->how.instance, x, self->how.n_states));
}

INLINE Outcome get_derivatives(Integrator *self, double *dx) {
  if (self->how.n_states == 0) return DONE;
  return check(self, GET_DERIVATIVES, self->call.GetDerivatives(self->how.instance, dx, self->how.n_states));
}

INLINE Outcome get_indicators(Integrator *self, double *z) {
  if (self->how.n_indicators == 0) return DONE;
  return check(self, GET_INDICATORS, self->call.GetEventIndicators(self->how.instance, z, self->how.n_indicators));
}

/* Find the derivatives dx of all that is integrated, x, at time t, inputs as of t; REJECTED where there are none. */
INLINE Outcome right_hand_side(Integrator *self, double t, const double *x, double *dx) {
  Outcome outcome = put(self, t, x);
  if (outcome == DONE) outcome = get_derivatives(self, dx);
  if (outcome == DONE && self->extension) outcome = self->extension->extend(self, t, x, dx);
  if (outcome != DONE) return outcome;
  int finite = 1; /* without a branch for each */
  for (size_t i = 0; i < self->n_total; i++) finite &= (int)(isfinite(x[i]) != 0) & (int)(isfinite(dx[i]) != 0);
  return finite ? DONE : check_finite(self, x, dx);
}

#endif
