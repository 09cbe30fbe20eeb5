/* Components that act on each other: exchange, and events that cause events; and curved inputs. */ #include \
    "coupling.h"

#include <math.h>

#include "components.h"
#include "loops.h"
#include "transfer.h"

enum { EVENT_ROUNDS = 20 }; /* events at one time that cause one another */

/* Pass the outputs on, group by group. */
bool exchange(Simulation *self) {
  const Plan *plan = self->plan;
  if (!plan->groups) return perform(self, plan->exchange);
  size_t number = 0;
  for (size_t g = 0; g < plan->n_groups; g++) {
    const Group *group = &plan->groups[g];
    if (group->loop ? !solve_loop(self, group->loop, number++) : !perform(self, group->range)) return false;
  }
  return true;
}

/* Pass the outputs on until no component is left in Event Mode, as all are after initialization: when they leave it,
 * their outputs may change. */
bool settle_events(Simulation *self) {
  const Plan *plan = self->plan;
  const size_t none = plan->n_components;
  size_t last = none; /* that left Event Mode */
  for (int round = 0; round < EVENT_ROUNDS; round++) {
    if (!exchange(self)) return false;
    last = none;
    for (size_t c = 0; c < plan->n_components; c++) {
      if (plan->components[c].mode != IN_EVENTS) continue;
      if (!leave_events(self, c, self->now)) return false;
      last = c;
    }
    if (last == none) return true;
  }
  return fail(self, ENDLESS_ROUNDS, last, fmi2OK);
}

/* Make straight inputs the cubic curves (Hermite) that have the slopes given at their ends, if these are given. */
void bend(Simulation *self, size_t sample) {
  const size_t n = self->plan->n_inputs;
  const double length = self->grid->times[sample + 1] - self->grid->times[sample];
  for (size_t j = 0; j < n; j++) {
    const double first = self->grid->slopes[n * sample + j], last = self->grid->slopes[n * (sample + 1) + j];
    if (!isfinite(first)) continue;
    double *a = self->plan->curves[j]->a;
    const double slope = a[1];
    a[1] = first;
    a[2] = (3.0 * slope - 2.0 * first - last) / length;
    a[3] = (first + last - 2.0 * slope) / (length * length);
  }
}

/* Give curved inputs, where an FMU interpolates them, the slope of the chord over the coming step. */
void set_chords(Simulation *self, double after, double length) {
  const Plan *plan = self->plan;
  for (size_t j = 0; j < plan->n_inputs; j++) {
    if (plan->input_modes[j] != BY_DERIVATIVE) continue;
    const double change = value_at(plan->curves[j], after + length) - value_at(plan->curves[j], after);
    plan->signals[plan->slope_signals[j]] = change / length;
  }
}
