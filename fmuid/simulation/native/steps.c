/* One step of whichever method, and the states within it. */
#include "steps.h"

#include <float.h>

#include "calls.h"
#include "cvode.h"
#include "runge_kutta.h"

Outcome interpolate(Integrator *self, double t) {
  if (self->step_length == 0.0)
    copy(self->n_total, self->x_end, self->x_at);
  else if (self->solver)
    return cvode_interpolate(self, t);
  else
    runge_kutta_interpolate(self, t);
  return DONE;
}

/* Let time pass without integrating: there are no states, or the time is too short to change them. */
static Outcome coast(Integrator *self, double end) {
  self->step_start = self->step_end;
  self->step_end = end;
  self->step_length = 0.0;
  if (put(self, end, self->x_end) != DONE) return FAILED;
  self->fmu_is_at_end = true;
  return get_indicators(self, self->z_end);
}

Outcome take_step(Integrator *self, double bound) {
  const double begin = self->step_end;
  self->n_steps++;
  if (self->n_total == 0) return coast(self, fmin(bound, begin + self->how.largest_step));
  if (bound - begin <= 100.0 * DBL_EPSILON * fmax(fabs(begin), fabs(bound))) return coast(self, bound);
  return self->solver ? cvode_step(self, bound) : runge_kutta_step(self, bound);
}
