/* The master: a whole simulation of connected components, sample by sample, and one simulation after the other. */ \
#include "master.h"

#include <fenv.h>
#include <math.h>
#include <string.h>

#include "components.h"
#include "coupling.h"
#include "integrator.h"
#include "loops.h"
#include "transfer.h"

INLINE bool is_cancelled(Simulation *self) {
  return atomic_load_explicit(self->cancel, memory_order_relaxed) && !fail(self, CANCELLED, 0, fmi2OK);
}

/* Put the inputs, a time `after` past a sample, into the signals; only those of a mode from `least` on. */
INLINE void set_inputs(Simulation *self, size_t sample, double after, int64_t least) {
  const Plan *plan = self->plan;
  const double *row = self->grid->inputs + sample * plan->n_inputs;
  if (plan->direct_inputs) {
    plan->direct_inputs->values = after == 0.0 ? (void *)row : plan->signals + plan->direct_inputs->signal;
    if (after == 0.0) return;
  }
  for (size_t j = 0; j < plan->n_inputs; j++) {
    const int64_t mode = plan->input_modes[j];
    if (mode < least) continue;
    const bool moves = after != 0.0 && mode != HELD;
    plan->signals[plan->input_signals[j]] = moves ? value_at(plan->curves[j], after) : row[j];
  }
}

/* Find the curves of the inputs in an interval. */
INLINE void set_curves(Simulation *self, size_t sample, double length, bool wanted) {
  const Plan *plan = self->plan;
  const double *row = self->grid->inputs + sample * plan->n_inputs, *next = row + plan->n_inputs;
  for (size_t j = 0; j < plan->n_inputs; j++) {
    const int64_t mode = plan->input_modes[j];
    if (mode == HELD) continue;
    const double slope = (next[j] - row[j]) / length;
    plan->signals[plan->slope_signals[j]] = slope;
    if (!wanted && mode == BY_DERIVATIVE) continue; /* an FMU that goes along the slope needs no more */
    plan->curves[j]->a[0] = row[j];
    plan->curves[j]->a[1] = slope;
  }
  if (plan->curved) bend(self, sample);
  for (size_t c = 0; c < plan->n_components; c++)
    if (plan->components[c].integrator) plan->components[c].integrator->origin = self->now;
}

/* Give the components their inputs from each other. */
INLINE bool pass_on(Simulation *self) {
  return self->plan->groups ? settle_events(self) : perform(self, self->plan->exchange);
}

/* Give the components their inputs, from the table and from each other. */
INLINE bool settle_inputs(Simulation *self) { return perform(self, self->plan->inputs) && pass_on(self); }

/* Take one component over one of its steps. */
INLINE bool advance(Simulation *self, size_t c, double now, double h, double until) {
  const Component *component = &self->plan->components[c];
  if (component->integrator || component->fmi3) return step_on(self, c, now, until);
  const int32_t status = component->fmi2->DoStep(component->instance, now, h, 1);
  if (good(status)) return true;
  return status == fmi2Discard ? step_after_discard(self, c, now, until) : fail(self, DO_STEP, c, status);
}

/* Take those components over a substep whose own step ends with it. */
static bool advance_by_strides(Simulation *self, double until, bool last) {
  const Plan *plan = self->plan;
  for (size_t c = 0; c < plan->n_components; c++) {
    Component *component = &plan->components[c];
    if ((self->substep + 1) % self->grid->strides[c] == 0 || last) {
      const double own = component->begun;
      component->begun = until;
      if (!advance(self, c, own, until - own, until)) return false;
    }
    if (plan->after_step && !perform(self, plan->after_step[c])) return false;
  }
  return true;
}

INLINE bool advance_all(Simulation *self, double now, double h, double until, bool last) {
  const Plan *plan = self->plan;
  if (self->grid->strides) return advance_by_strides(self, until, last);
  for (size_t c = 0; c < plan->n_components; c++) {
    if (!advance(self, c, now, h, until)) return false;
    if (plan->after_step && !perform(self, plan->after_step[c])) return false;
  }
  return true;
}

/* All components from one sample to the next, in equal substeps; the first exchange is done already. */
INLINE bool walk_interval(Simulation *self, size_t sample) {
  const Plan *plan = self->plan;
  const double begin = self->grid->times[sample], end = self->grid->times[sample + 1], length = end - begin;
  self->stepped = length <= 0.0 || self->grid->n_states >= 0;
  if (self->stepped) return true; /* a time given twice: a step of the inputs */
  const int64_t n = self->grid->substeps[sample];
  const double h = n == 1 ? length : length / (double)n; /* a division is dear here */
  set_curves(self, sample, length, n > 1 || plan->curved);
  for (int64_t s = 0; s < n; s++) {
    const double after = (double)s * h, now = begin + after;
    self->substep = s;
    if (s > 0) {
      if (is_cancelled(self)) return false;
      self->now = now;
      set_inputs(self, sample, after, HELD);
      if (!settle_inputs(self)) return false;
    }
    if (plan->midpoints) {
      set_inputs(self, sample, ((double)s + 0.5) * h, BY_MIDPOINT);
      if (!perform(self, plan->inputs)) return false;
    }
    if (plan->curved) set_chords(self, after, h);
    if (!perform(self, plan->slopes)) return false;
    const bool last = s == n - 1;
    if (!advance_all(self, now, h, last ? end : begin + (double)(s + 1) * h, last)) return false;
  }
  return true;
}

/* Set the inputs of a sample, pass outputs on, and record the outputs. */
INLINE bool record(Simulation *self, size_t sample) {
  const Plan *plan = self->plan;
  double *row = self->outputs + sample * plan->n_outputs;
  if (plan->direct_outputs) plan->direct_outputs->values = row;
  self->report->sample = (int64_t)sample;
  self->now = self->grid->times[sample];
  self->substep = 0;
  set_inputs(self, sample, 0.0, HELD);
  if (!settle_inputs(self)) return false;
  if (self->grid->n_states >= 0 && !(show_states(self, sample) && pass_on(self))) return false;
  if (!perform(self, plan->outputs)) return false;
  if (plan->direct_outputs) return true;
  for (size_t j = 0; j < plan->n_outputs; j++) {
    double value = 0.0;
    for (int64_t i = plan->output_terms[j]; i < plan->output_terms[j + 1]; i++)
      value += plan->signals[plan->output_signals[i]];
    row[j] = value;
  }
  return true;
}

/* Walk all samples where whole rows of the tables go to and from one FMU of co-simulation and nothing else is done: the
 * same calls as by `record` and `walk_interval`, without their questions. */
static bool walk_rows(Simulation *self) {
  const Plan *plan = self->plan;
  const size_t n_u = plan->n_inputs, n_times = self->grid->n_times;
  const double *times = self->grid->times, *row = self->grid->inputs;
  const Operation in = *plan->direct_inputs, out = *plan->direct_outputs;
  const bool moves = plan->slopes.first < plan->slopes.last;
  const Operation *slopes = &plan->operations[plan->slopes.first];
  const Fmi2 fmi = *in.fmi2;
  for (size_t k = 0;; k++, row += n_u) {
    if (is_cancelled(self)) return false;
    self->report->sample = (int64_t)k;
    self->now = times[k];
    int32_t status = fmi.SetReal(in.instance, in.references, in.count, row);
    if (!did(self, (Failure)in.function, 0, status)) return false;
    status = fmi.GetReal(in.instance, out.references, out.count, self->outputs + k * plan->n_outputs);
    if (!did(self, (Failure)out.function, 0, status)) return false;
    if (k + 1 == n_times) return true;
    const double length = times[k + 1] - times[k];
    if (length <= 0.0) continue; /* a time given twice: a step of the inputs */
    if (moves) {
      double *values = slopes->values;
      for (size_t j = 0; j < n_u; j++) values[j] = (row[n_u + j] - row[j]) / length;
      status = fmi.SetRealInputDerivatives(in.instance, slopes->references, slopes->count, plan->ones, values);
      if (!did(self, SET_DERIVATIVES, 0, status)) return false;
    }
    if (!advance(self, 0, times[k], length, times[k + 1])) return false;
  }
}

static bool initialize(Simulation *self) {
  const Plan *plan = self->plan;
  const size_t n = plan->n_components;
  self->now = self->grid->times[0];
  begin_loops(plan);
  for (size_t c = 0; c < n; c++)
    if (!prepare(self, c)) return false;
  if (!perform(self, plan->start_values)) return false;
  for (size_t c = 0; c < n; c++)
    if (!enter_initialization(self, c)) return false;
  set_inputs(self, 0, 0.0, HELD);
  if (!perform(self, plan->inputs) || !exchange(self)) return false;
  for (size_t c = 0; c < n; c++)
    if (!exit_initialization(self, c)) return false;
  return true;
}

static bool run(Simulation *self, const double *theta) {
  const Plan *plan = self->plan;
  memcpy(plan->signals, plan->start_signals, plan->n_signals * sizeof(double));
  for (size_t j = 0; j < plan->n_parameters; j++) plan->signals[plan->parameter_signals[j]] = theta[j];
  if (!initialize(self)) return false;
  if (plan->by_rows) return walk_rows(self);
  for (size_t k = 0; k < self->grid->n_times; k++) {
    if (is_cancelled(self) || !record(self, k)) return false;
    if (self->grid->gain && !(correct_states(self, k) && pass_on(self))) return false;
    if (k + 1 < self->grid->n_times && !walk_interval(self, k)) return false;
  }
  return true;
}

size_t environment_size(void) { return sizeof(fenv_t); }
void environment_keep(void *room) { fegetenv(room); }
void environment_restore(const void *room) { fesetenv(room); }

void simulate(const Plan *plan, const Grid *grid, size_t count, const double *thetas, double *outputs, Report *reports,
              const atomic_int *cancel) {
  fenv_t environment;
  fegetenv(&environment);
  const size_t n_states = grid->n_states > 0 ? (size_t)grid->n_states : 0;
  const size_t given = plan->n_parameters + grid->n_times * n_states;
  bool spoiled = false;
  for (size_t i = 0; i < count; i++) {
    reports[i] = (Report){NOTHING, -1, UNDONE, -1, -1, NAN, NAN};
    if (spoiled) continue; /* the instance must not be touched any more */
    Simulation simulation = {.plan = plan, .grid = grid, .report = &reports[i], .cancel = cancel};
    const double *theta = thetas + i * given;
    simulation.states = theta + plan->n_parameters;
    simulation.outputs = outputs + i * grid->n_times * plan->n_outputs;
    if (run(&simulation, theta)) reports[i].status = DONE_WELL;
    spoiled = reports[i].failure >= 0 && reports[i].status > fmi2Error;
    fesetenv(&environment); /* what an FMU changes in the rounding of numbers ends with its simulation */
  }
}
