/* What the files of the core call of each other. None of it is seen from outside: a library that was loaded before and
 * exports such a name would take the calls over. */
#ifndef CORE_H
#define CORE_H

#include "integrator.h"
#include "plan.h"

#ifndef _WIN32
#pragma GCC visibility push(hidden)
#endif

#define INLINE static inline __attribute__((always_inline))

/* One simulation in progress. */
typedef struct {
  const Plan *plan;
  const Grid *grid;
  double *outputs; /* (n_times, n_outputs) */
  Report *report;
  const atomic_int *cancel;
  double now;      /* time of the present communication point */
  int64_t substep; /* number of the present one in its interval */
  bool stepped;    /* the time of this sample was given twice: inputs step */
} Simulation;

INLINE bool good(int32_t status) { return status == fmi2OK || status == fmi2Warning; }

/* Write what failed into the report; return false. */
bool fail(Simulation *self, Failure failure, size_t component, int32_t status);

/* Return whether a function of a component did well; if not, write it into the report. */
INLINE bool did(Simulation *self, Failure function, size_t component, int32_t status) {
  return good(status) || fail(self, function, component, status);
}

/* transfer.c */
bool perform_other(Simulation *self, Operation *operation);

/* loops.c */
void begin_loops(const Plan *plan);
bool solve_loop(Simulation *self, Loop *loop, size_t number);

/* coupling.c */
bool exchange(Simulation *self);
bool settle_events(Simulation *self);
void bend(Simulation *self, size_t sample);
void set_chords(Simulation *self, double after, double length);

/* co_simulation.c, model_exchange.c: the life of a component, whatever it is. */
bool prepare(Simulation *self, size_t component);
bool enter_initialization(Simulation *self, size_t component);
bool exit_initialization(Simulation *self, size_t component);
bool enter_events(Simulation *self, size_t component);
bool leave_events(Simulation *self, size_t component, double time);
bool step_on(Simulation *self, size_t component, double from, double until);
bool show_states(Simulation *self, size_t sample);
bool correct_states(Simulation *self, size_t sample);
bool step_after_discard(Simulation *self, size_t component, double from, double until);

INLINE double value_at(const Curve *curve, double after) {
  return curve->a[0] + after * (curve->a[1] + after * (curve->a[2] + after * curve->a[3]));
}

/* Perform operations; stop at the first that fails. */
INLINE bool perform(Simulation *self, Range range) {
  for (size_t i = range.first; i < range.last; i++) {
    Operation *o = &self->plan->operations[i];
    int32_t status = fmi2OK;
    if (o->kind == SET_REALS)
      status = o->fmi2->SetReal(o->instance, o->references, o->count, o->values);
    else if (o->kind == GET_REALS)
      status = o->fmi2->GetReal(o->instance, o->references, o->count, o->values);
    else if (o->kind == SET_SLOPES)
      status = o->fmi2->SetRealInputDerivatives(o->instance, o->references, o->count, self->plan->ones, o->values);
    else if (!perform_other(self, o))
      return false;
    if (!good(status)) return fail(self, (Failure)o->function, (size_t)o->component, status);
  }
  return true;
}

#ifndef _WIN32
#pragma GCC visibility pop
#endif

#endif
