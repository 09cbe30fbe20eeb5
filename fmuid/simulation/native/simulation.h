/* One simulation in progress, and what has failed in it. */
#ifndef SIMULATION_H
#define SIMULATION_H

#include "plan.h"

typedef struct {
  const Plan *plan;
  const Grid *grid;
  const double *states; /* (n_times, n_states), if they are given */
  double *outputs;      /* (n_times, n_outputs) */
  Report *report;
  const atomic_int *cancel;
  double now;      /* time of the present communication point */
  int64_t substep; /* number of the present one in its interval */
  bool stepped;    /* the time of this sample was given twice: inputs step */
} Simulation;

/* Write what failed into the report; return false. */
__attribute__((cold)) static inline bool fail(Simulation *self, Failure failure, size_t component, int32_t status) {
  self->report->failure = failure;
  self->report->component = (int64_t)component;
  self->report->status = (int64_t)(uint32_t)status; /* negative ones would be taken for UNDONE */
  self->report->time = self->now;
  return false;
}

/* Return whether a function of a component did well; if not, write it into the report. */
INLINE bool did(Simulation *self, Failure function, size_t component, int32_t status) {
  return good(status) || fail(self, function, component, status);
}

#endif
