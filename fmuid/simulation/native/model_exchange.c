/* A model-exchange instance from one communication point to the next: its memory, the calls of the FMU, the steps. */
#include "model_exchange.h"

#include <math.h>
#include <stdlib.h>

#include "calls.h"
#include "cvode.h"
#include "events.h"
#include "sensitivities.h"
#include "steps.h"

static const size_t MAX_EVENTS = 10000; /* of one advance: chattering, or bounces without end */
static const double INPUT_JUMP = 1e-9;  /* of an input's largest magnitude so far: less is rounding of its curves */

/* ---- memory ---- */

#define CALLS_OF(fmi, Derivatives)                                                                               \
  ((Calls){fmi->SetTime, fmi->SetContinuousStates, fmi->GetContinuousStates, fmi->GetNominalsOfContinuousStates, \
           fmi->Derivatives, fmi->GetEventIndicators, fmi->EnterEventMode, fmi->EnterContinuousTimeMode})

/* Take n numbers from the memory at *rest. */
static double *take(double **rest, size_t n) {
  double *taken = *rest;
  *rest += n;
  return taken;
}

static bool allot(Integrator *self, size_t count) {
  const size_t n = self->n_total, n_x = self->how.n_states, n_z = self->how.n_indicators, n_u = self->how.n_inputs;
  double *rest = self->memory = calloc((9 + MOST_STAGES) * n + 6 * n_z + 2 * n_u + 6 * n_x + 1 + count, sizeof(double));
  if (!rest) return false;
  double **by_total[] = {&self->x_start, &self->x_end,   &self->x_stage, &self->x_at,        &self->absolute,
                         &self->bend,    &self->x_whole, &self->zeros,   &self->own_absolute};
  for (size_t i = 0; i < sizeof by_total / sizeof *by_total; i++) *by_total[i] = take(&rest, n);
  for (size_t i = 0; i < MOST_STAGES; i++) self->slopes[i] = take(&rest, n);
  double **by_indicators[] = {&self->z_start, &self->z_end, &self->z_at, &self->z_event, &self->z_early, &self->z_late};
  for (size_t i = 0; i < sizeof by_indicators / sizeof *by_indicators; i++) *by_indicators[i] = take(&rest, n_z);
  self->input_values = take(&rest, n_u);
  self->input_sizes = take(&rest, n_u);
  double **by_states[] = {&self->x_before, &self->slopes_before, &self->slopes_after, &self->x_work, &self->x_sizes};
  for (size_t i = 0; i < sizeof by_states / sizeof *by_states; i++) *by_states[i] = take(&rest, n_x);
  self->seeds = take(&rest, n_x + 1);
  self->shifts = take(&rest, count);
  return true;
}

Integrator *integrator_create(const Integration *how) {
  Integrator *self = calloc(1, sizeof *self);
  if (!self) return NULL;
  const size_t count = how->sensitivities ? how->sensitivities->count : 0;
  self->how = *how;
  self->call = how->fmi2 ? CALLS_OF(how->fmi2, GetDerivatives) : CALLS_OF(how->fmi3, GetContinuousStateDerivatives);
  self->n_total = how->n_states * (1 + count);
  self->report.failure = NOTHING;
  if (how->sensitivities)
    self->extension = how->sensitivities->twins ? &twin_sensitivities : &directional_sensitivities;
  const bool has_it =
      how->fmi2 ? how->fmi2->GetDirectionalDerivative != NULL : how->fmi3->GetDirectionalDerivative != NULL;
  self->has_directional = has_it && how->state_references && how->derivative_references;
  const bool needs_solver = how->method == CVODE && how->n_states > 0;
  if (allot(self, count) && (!needs_solver || cvode_create(self))) return self;
  integrator_free(self);
  return NULL;
}

void integrator_free(Integrator *self) {
  if (!self) return;
  if (self->solver) cvode_free(self);
  free(self->memory);
  free(self);
}

/* ---- steps ---- */

/* One step towards `bound`, cut at the first state event in it. */
static Outcome step(Integrator *self, double bound) {
  if (take_step(self, bound) != DONE) return FAILED;
  self->pending = COMPLETION;
  if (!crossed(self, self->z_end)) return DONE;
  self->pending = EVENT;
  return locate_event(self);
}

/* See whether an input has jumped at the present time: integration starts anew, maybe with a state event. */
static Outcome heed_inputs(Integrator *self, double t) {
  bool jump = false;
  for (size_t j = 0; j < self->how.n_inputs; j++) {
    const double change = fabs(input_at(self, j, t) - self->input_values[j]);
    jump = jump || change > INPUT_JUMP * self->input_sizes[j];
  }
  if (!jump) return DONE;
  self->can_go_on = false;
  if (self->how.n_indicators == 0) return DONE;
  if (put_inputs(self, t) != DONE || get_indicators(self, self->z_at) != DONE) return FAILED;
  if (crossed(self, self->z_at)) self->pending = EVENT;
  return DONE;
}

/* Leave time t, the inputs and the states as of t in the FMU; t is within the step or its settled end. */
static Outcome arrive(Integrator *self, double t) {
  const bool at_end = t == self->step_end;
  const double *x = at_end ? self->x_end : self->x_at;
  Outcome outcome;
  if (at_end && self->fmu_is_at_end) {
    outcome = put_inputs(self, t); /* which may go along new curves */
  } else if (at_end) {
    outcome = put(self, t, x);
    self->fmu_is_at_end = true;
  } else {
    outcome = interpolate(self, t) == DONE ? put(self, t, x) : FAILED;
  }
  if (outcome != DONE || !self->extension || !self->extension->follow) return outcome;
  return self->extension->follow(self, t, x);
}

/* ---- life ---- */

/* Make the memory fresh for a simulation from time t on; the FMU has left Initialization Mode for Event Mode. */
int integrator_begin(Integrator *self, double t) {
  self->nominals_known = self->can_go_on = self->fmu_is_at_end = self->inside = false;
  self->n_steps = self->n_events = 0;
  self->in_event_mode = self->starting = true;
  self->pending = SETTLED;
  self->time = self->step_start = self->step_end = t;
  self->step_length = self->next_step = 0.0;
  self->next_event = INFINITY;
  self->report.state = -1;
  self->held = NAN;
  for (size_t j = 0; j < self->how.n_inputs; j++) {
    self->input_values[j] = NAN;
    self->input_sizes[j] = 0.0;
  }
  self->small = true;
  for (size_t i = 0; i < self->how.n_states; i++) self->x_sizes[i] = 0.0;
  return DONE;
}

/* Enter Event Mode at the present time t, which may lie within the last step: something outside changes there. */
int integrator_enter_events(Integrator *self, double t) {
  self->held = NAN; /* the curves may be others */
  if (self->in_event_mode) return DONE;
  if (self->how.follows) return enter_event_mode(self); /* the model has put the twin at its place */
  if (t < self->step_end) {
    if (interpolate(self, t) != DONE) return FAILED;
    copy(self->n_total, self->x_at, self->x_end);
    self->step_end = t;
    self->fmu_is_at_end = false;
  }
  if (!self->fmu_is_at_end && put(self, t, self->x_end) != DONE) return FAILED;
  if (self->pending != SETTLED && complete_step(self) != DONE) return FAILED;
  return enter_event_mode(self);
}

int integrator_leave_events(Integrator *self, double t) { return leave_event_mode(self, t); }

/* Give the FMU states x at time t, and the events that they cause; integration starts anew from there, sensitivities
 * from their initial values. */
int integrator_show(Integrator *self, double t, const double *x) {
  const size_t n = self->how.n_states;
  copy(n, x, self->x_end);
  if (self->how.sensitivities)
    copy(n * self->how.sensitivities->count, self->how.sensitivities->initial, self->x_end + n);
  self->step_start = self->step_end = t;
  self->step_length = 0.0;
  self->can_go_on = false;
  self->pending = SETTLED;
  self->held = NAN;
  const Outcome outcome = put(self, t, self->x_end);
  if (outcome != DONE || get_indicators(self, self->z_at) != DONE) return FAILED;
  self->fmu_is_at_end = true;
  if (crossed(self, self->z_at) || self->next_event <= t)
    return enter_event_mode(self) == DONE ? leave_event_mode(self, t) : FAILED;
  copy(self->how.n_indicators, self->z_at, self->z_start);
  return DONE;
}

/* Move the states at the present time t, which may lie within the last step, by gain (n_states, n) times what was
 * measured less the outputs; NAN was not. */
int integrator_correct(Integrator *self, double t, const double *gain, const double *measured, const double *outputs,
                       size_t n) {
  if (t < self->step_end && interpolate(self, t) != DONE) return FAILED;
  if (t == self->step_end && self->pending != SETTLED && complete_step(self) != DONE) return FAILED;
  double *x = self->x_at;
  if (t == self->step_end) copy(self->n_total, self->x_end, x);
  for (size_t i = 0; i < self->how.n_states; i++)
    for (size_t j = 0; j < n; j++)
      if (!isnan(measured[j])) x[i] += gain[i * n + j] * (measured[j] - outputs[j]);
  return integrator_show(self, t, x);
}

/* Integrate from the present time to t, events handled on the way and at t; the FMU then holds t, u(t), x(t). */
int integrator_advance(Integrator *self, double t) {
  self->held = NAN; /* the curves are others */
  if (self->how.follows) return DONE;
  const size_t last_event = self->n_events + MAX_EVENTS, last_step = self->n_steps + self->how.most_steps;
  const bool chooses_steps = self->how.method != RK4 && self->n_total > 0;
  self->steps_before = self->n_steps;
  self->wanted = t;
  self->stiff_hits = 0;
  for (;;) {
    if (self->cancel && atomic_load_explicit(self->cancel, memory_order_relaxed))
      return give_up(self, CANCELLED, fmi2OK);
    if (t < self->step_end) return arrive(self, t);
    if (self->pending != SETTLED || self->next_event <= self->step_end) {
      if (self->n_events >= last_event) return give_up(self, TOO_MANY_EVENTS, fmi2OK);
      if (settle(self) != DONE) return FAILED;
    } else if (t == self->step_end) {
      return arrive(self, t);
    } else {
      if (self->fmu_is_at_end && heed_inputs(self, self->step_end) != DONE) return FAILED;
      if (self->pending == EVENT) continue;
      if (chooses_steps && self->n_steps >= last_step) return give_up(self, TOO_MANY_STEPS, fmi2OK);
      const double bound = chooses_steps ? fmax(t, self->how.limit) : t;
      if (step(self, fmin(bound, self->next_event)) != DONE) return FAILED;
    }
  }
}
