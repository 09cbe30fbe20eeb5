/* The life of a component, and its steps between communication points; how model exchange does it is elsewhere. */ \
#include "components.h"

#include <math.h>

#include "model_exchange.h"

enum { EVENT_ITERATIONS = 100, EARLY_RETURNS = 100000 }; /* of one event; of one step of an FMU that does not get on */
/* Steps that are discarded are shortened down to this share of the communication step, and tried this often. */
static const double SHORTEST = 1e-9;
enum { TRIALS = 1000 };

/* Judge the outcome of a function of an integrator. */
static bool integrated(Simulation *self, size_t c, int outcome) {
  if (outcome == DONE) return true;
  const Integrator *integrator = self->plan->components[c].integrator;
  const int64_t sample = self->report->sample;
  *self->report = integrator->report;
  self->report->component = (int64_t)c;
  self->report->sample = sample;
  self->report->time = integrator->step_end;
  self->report->step = integrator->next_step;
  return false;
}

/* ---- the beginning ---- */

/* Reset what was used, and set up the experiment; the stop time stays open. */
bool prepare(Simulation *self, size_t c) {
  Component *component = &self->plan->components[c];
  void *instance = component->instance;
  if (*component->used) {
    const int32_t status = component->fmi2 ? component->fmi2->Reset(instance) : component->fmi3->Reset(instance);
    if (!did(self, RESET, c, status)) return false;
  }
  *component->used = 1;
  component->mode = INITIALIZING;
  component->time = component->begun = self->grid->times[0];
  if (component->integrator) component->integrator->cancel = self->cancel;
  if (component->fmi3) return true;
  const double tolerance = component->tolerance, start = component->time;
  return did(self, SETUP, c, component->fmi2->SetupExperiment(instance, tolerance > 0.0, tolerance, start, 0, 0.0));
}

bool enter_initialization(Simulation *self, size_t c) {
  const Component *component = &self->plan->components[c];
  const double tolerance = component->tolerance;
  const int32_t status = component->fmi2
                             ? component->fmi2->EnterInitializationMode(component->instance)
                             : component->fmi3->EnterInitializationMode(component->instance, tolerance > 0.0, tolerance,
                                                                        component->time, 0, 0.0);
  return did(self, ENTER_INITIALIZATION, c, status);
}

bool exit_initialization(Simulation *self, size_t c) {
  Component *component = &self->plan->components[c];
  void *instance = component->instance;
  const int32_t status = component->fmi2 ? component->fmi2->ExitInitializationMode(instance)
                                         : component->fmi3->ExitInitializationMode(instance);
  if (!did(self, EXIT_INITIALIZATION, c, status)) return false;
  /* Co-simulation by FMI 2.0 has no Event Mode. */
  component->mode = component->fmi2 && !component->integrator ? RUNNING : IN_EVENTS;
  return !component->integrator || integrated(self, c, integrator_begin(component->integrator, component->time));
}

/* ---- Event Mode ---- */

bool enter_events(Simulation *self, size_t c) {
  Component *component = &self->plan->components[c];
  component->mode = IN_EVENTS;
  if (component->integrator) return integrated(self, c, integrator_enter_events(component->integrator, self->now));
  return !component->event_mode || did(self, ENTER_EVENT_MODE, c, component->fmi3->EnterEventMode(component->instance));
}

/* Iterate the discrete states of a co-simulation by FMI 3.0 until they rest, and enter Step Mode. */
static bool leave_event_mode3(Simulation *self, size_t c) {
  const Component *component = &self->plan->components[c];
  for (int i = 0; i < EVENT_ITERATIONS; i++) {
    fmi3Boolean again = 0, terminate = 0, nominals = 0, values = 0, defined = 0;
    double next = 0.0;
    const int32_t status = component->fmi3->UpdateDiscreteStates(component->instance, &again, &terminate, &nominals,
                                                                 &values, &defined, &next);
    if (!did(self, UPDATE_DISCRETE_STATES, c, status)) return false;
    if (terminate) return fail(self, ENDED, c, fmi2OK);
    if (!again) return did(self, ENTER_STEP_MODE, c, component->fmi3->EnterStepMode(component->instance));
  }
  return fail(self, ENDLESS_EVENT, c, fmi2OK);
}

bool leave_events(Simulation *self, size_t c, double time) {
  Component *component = &self->plan->components[c];
  component->mode = RUNNING;
  if (component->integrator) return integrated(self, c, integrator_leave_events(component->integrator, time));
  return !component->event_mode || leave_event_mode3(self, c);
}

/* ---- steps ---- */

/* Go on from the last successful time (FMI 2.0.4, section 4.2.2); in shorter steps where the FMU did not get on. */
bool step_after_discard(Simulation *self, size_t c, double from, double until) {
  const Component *component = &self->plan->components[c];
  const Fmi2 *fmi = component->fmi2;
  const double whole = until - from;
  double now = from, step = whole;
  const bool may_ask = fmi->GetRealStatus && fmi->GetBooleanStatus;
  for (int i = 0; may_ask && i < TRIALS; i++) {
    fmi2Boolean ended = 0;
    double reached = now;
    if (good(fmi->GetBooleanStatus(component->instance, fmi2Terminated, &ended)) && ended)
      return fail(self, ENDED, c, fmi2Discard);
    fmi->GetRealStatus(component->instance, fmi2LastSuccessfulTime, &reached);
    if (!(now <= reached && reached <= until)) break;
    if (reached == now) step *= 0.5;
    now = reached;
    if (step < SHORTEST * whole) break;
    int32_t status = fmi2OK;
    while (now < until && good(status)) {
      const double length = until - now < step ? until - now : step;
      status = fmi->DoStep(component->instance, now, length, 1);
      if (good(status)) now = length == until - now ? until : now + length;
    }
    if (good(status)) return true;
    if (status != fmi2Discard) return fail(self, DO_STEP, c, status);
  }
  return fail(self, DO_STEP, c, fmi2Discard);
}

/* Step a component of FMI 3.0 to a time, through the events and early returns on the way. */
static bool step3(Simulation *self, size_t c, double until) {
  Component *component = &self->plan->components[c];
  for (int i = 0; i < EARLY_RETURNS; i++) {
    const double now = component->time;
    if (!(now < until)) return true;
    fmi3Boolean event = 0, terminate = 0, early = 0;
    double reached = until;
    const int32_t status =
        component->fmi3->DoStep(component->instance, now, until - now, 1, &event, &terminate, &early, &reached);
    if (!did(self, DO_STEP, c, status)) return false;
    if (terminate) return fail(self, ENDED, c, fmi2OK);
    if (!early) reached = until;
    component->time = reached;
    if (event && component->event_mode) {
      if (!did(self, ENTER_EVENT_MODE, c, component->fmi3->EnterEventMode(component->instance))) return false;
      if (!leave_event_mode3(self, c)) return false;
    } else if (reached <= now) {
      break;
    }
  }
  return fail(self, STUCK, c, fmi2OK);
}

/* Leave Event Mode where a component is in it. */
static bool run_on(Simulation *self, size_t c, double time) {
  return self->plan->components[c].mode != IN_EVENTS || leave_events(self, c, time);
}

/* Show all components, each for model exchange, their states of a sample. */
bool show_states(Simulation *self, size_t sample) {
  const double *states = self->states + sample * (size_t)self->grid->n_states;
  for (size_t c = 0; c < self->plan->n_components; c++) {
    Integrator *integrator = self->plan->components[c].integrator;
    if (!run_on(self, c, self->now)) return false;
    if (!integrated(self, c, integrator_show(integrator, self->now, states))) return false;
    states += integrator->how.n_states;
  }
  return true;
}

/* Correct the states of all components by the errors of the outputs. */
bool correct_states(Simulation *self, size_t sample) {
  const Grid *grid = self->grid;
  const size_t n = self->plan->n_outputs;
  const double *measured = grid->measured + sample * n, *outputs = self->outputs + sample * n, *gain = grid->gain;
  size_t missing = 0;
  while (missing < n && isnan(measured[missing])) missing++;
  if (missing == n) return true; /* integration goes on without a new beginning */
  for (size_t c = 0; c < self->plan->n_components; c++) {
    Integrator *integrator = self->plan->components[c].integrator;
    if (!run_on(self, c, self->now)) return false;
    if (!integrated(self, c, integrator_correct(integrator, self->now, gain, measured, outputs, n))) return false;
    gain += integrator->how.n_states * n;
  }
  return true;
}

/* Take a component that is not of co-simulation by FMI 2.0 from one of its communication points to the next. */
bool step_on(Simulation *self, size_t c, double from, double until) {
  Component *component = &self->plan->components[c];
  if (!run_on(self, c, from)) return false;
  if (component->integrator) return integrated(self, c, integrator_advance(component->integrator, until));
  return step3(self, c, until);
}
