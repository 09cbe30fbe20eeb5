/* What every integrator does again and again, where it is not worth inlining. */
#include "calls.h"

Outcome give_up(Integrator *self, Failure failure, int32_t status) {
  self->report.failure = failure;
  self->report.status = failure == CVODE_FAILED ? status : (int64_t)(uint32_t)status;
  return FAILED;
}

Outcome check_finite(Integrator *self, const double *x, const double *dx) {
  for (size_t i = 0; i < self->n_total; i++) {
    if (isfinite(x[i]) && isfinite(dx[i])) continue;
    give_up(self, STATE_NOT_FINITE, fmi2OK);
    self->report.state = (int64_t)i;
    return REJECTED;
  }
  return DONE;
}

Outcome directional(Integrator *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns,
                    size_t n_knowns, const double *seeds, double *found, int32_t *status) {
  const Integration *how = &self->how;
  if (!self->has_directional)
    *status = fmi2Error;
  else if (how->fmi2)
    *status = how->fmi2->GetDirectionalDerivative(how->instance, unknowns, n_unknowns, knowns, n_knowns, seeds, found);
  else
    *status = how->fmi3->GetDirectionalDerivative(how->instance, unknowns, n_unknowns, knowns, n_knowns, seeds,
                                                  n_knowns, found, n_unknowns);
  return check(self, DIRECTIONAL_DERIVATIVE, *status) == DONE ? DONE : FAILED;
}
