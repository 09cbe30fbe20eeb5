/* Events of a model-exchange FMU: finding them within a step, and Event Mode (FMI 2.0.4, section 3.2; 3.0.2, 3.3.2).
 */ \
#include "events.h"

#include <float.h>
#include <math.h>

#include "calls.h"
#include "steps.h"

static const int MAX_ITERATIONS = 100; /* the standard sets no bound, but an event that needs as many never ends */

static bool differs(double before, double after) { return (before > 0.0) != (after > 0.0); }

/* Whether an indicator has left its domain, z > 0 or z <= 0 (FMI 2.0.4, section 3.1.1), since the step's start. */
bool crossed(const Integrator *self, const double *z) {
  for (size_t i = 0; i < self->how.n_indicators; i++)
    if (differs(self->z_start[i], z[i])) return true;
  return false;
}

/* The first time at which a straight line through an indicator's values at both ends crosses zero. */
static double secant(const Integrator *self, double low, double high) {
  double first = high;
  for (size_t i = 0; i < self->how.n_indicators; i++) {
    const double before = self->z_start[i], after = self->z_end[i];
    if (differs(before, after)) first = fmin(first, low + (high - low) * (before / (before - after)));
  }
  return first;
}

/* Cut the step just after the first crossing in it.
 *
 * A bracket is kept, no indicator having crossed at its low end; it shrinks by the method ITP (I. F. D. Oliveira,
 * R. H. C. Takahashi, ACM Trans. Math. Softw. 47 (2021) 5), which needs one probe more than bisection at worst. */
Outcome locate_event(Integrator *self) {
  double low = self->step_start, high = self->step_end;
  const double width = high - low, half = 2.0 * DBL_EPSILON * fmax(fabs(low), fabs(high));
  double radius = ldexp(half, (int)ceil(log2(fmax(width / (2.0 * half), 1.0))) + 1);
  while (high - low > 2.0 * half) {
    const double middle = 0.5 * (low + high), gap = high - low;
    const double reach = radius - 0.5 * gap, nudge = 0.2 / width * (gap * gap);
    radius *= 0.5;
    const double guess = secant(self, low, high), side = copysign(1.0, middle - guess);
    double t = nudge <= fabs(middle - guess) ? guess + side * nudge : middle;
    if (!(fabs(t - middle) <= reach)) t = middle - side * reach;
    if (!(low < t && t < high)) t = middle;
    if (interpolate(self, t) != DONE || put(self, t, self->x_at) != DONE) return FAILED;
    if (get_indicators(self, self->z_at) != DONE) return FAILED;
    const bool after = crossed(self, self->z_at);
    copy(self->how.n_indicators, self->z_at, after ? self->z_end : self->z_start);
    if (after) {
      high = t;
      copy(self->n_total, self->x_at, self->x_end);
    } else {
      low = t;
    }
    self->fmu_is_at_end = after;
  }
  self->step_end = high;
  return DONE;
}

/* ---- Event Mode ---- */

/* What an iteration of the discrete states has found, as FMI 2.0 has it. */
static Outcome update_discrete_states(Integrator *self, fmi2EventInfo *info) {
  const Integration *how = &self->how;
  *info = (fmi2EventInfo){0};
  if (how->fmi2)
    return check(self, UPDATE_DISCRETE_STATES, how->fmi2->NewDiscreteStates(how->instance, info)) == DONE ? DONE
                                                                                                          : FAILED;
  fmi3Boolean told[5] = {0};
  const fmi3Status status = how->fmi3->UpdateDiscreteStates(how->instance, &told[0], &told[1], &told[2], &told[3],
                                                            &told[4], &info->nextEventTime);
  if (check(self, UPDATE_DISCRETE_STATES, status) != DONE) return FAILED;
  info->newDiscreteStatesNeeded = told[0];
  info->terminateSimulation = told[1];
  info->nominalsOfContinuousStatesChanged = told[2];
  info->nextEventTimeDefined = told[4];
  return DONE;
}

/* Iterate until the discrete states stay as they are; note the next time event. */
static Outcome iterate(Integrator *self, double t) {
  self->time = t;
  for (int i = 0; i < MAX_ITERATIONS; i++) {
    fmi2EventInfo info;
    if (update_discrete_states(self, &info) != DONE) return FAILED;
    if (info.terminateSimulation) return give_up(self, ENDED, fmi2OK);
    if (info.nominalsOfContinuousStatesChanged) self->nominals_known = false;
    if (!info.newDiscreteStatesNeeded) {
      self->next_event = info.nextEventTimeDefined ? info.nextEventTime : INFINITY;
      return DONE;
    }
  }
  return give_up(self, ENDLESS_EVENT, fmi2OK);
}

/* Set the absolute tolerances from the nominal values of the states, which are 1 where the FMU states none. */
static Outcome find_tolerances(Integrator *self) {
  const Integration *how = &self->how;
  const size_t n = how->n_states;
  if (n > 0 && check(self, GET_NOMINALS, self->call.GetNominals(how->instance, self->absolute, n)) != DONE)
    return FAILED;
  for (size_t i = 0; i < n; i++) {
    const double nominal = fabs(self->absolute[i]);
    self->absolute[i] = how->tolerance * (nominal > 0.0 && nominal < INFINITY ? nominal : 1.0);
  }
  for (size_t i = n; i < self->n_total; i++)
    self->absolute[i] = self->absolute[i % n] / how->sensitivities->magnitudes[i / n - 1];
  self->nominals_known = true;
  return DONE;
}

/* Event iteration, then Continuous-Time Mode at time t; integration starts anew from there. */
Outcome leave_event_mode(Integrator *self, double t) {
  void *instance = self->how.instance;
  if (iterate(self, t) != DONE || (!self->nominals_known && find_tolerances(self) != DONE)) return FAILED;
  if (check(self, ENTER_CONTINUOUS_TIME_MODE, self->call.EnterContinuousTimeMode(instance)) != DONE) return FAILED;
  /* The states are read whether or not the FMU says that it changed them: not all that do so say so. */
  const size_t n = self->how.n_states;
  if (n > 0 && check(self, GET_STATES, self->call.GetContinuousStates(instance, self->x_end, n)) != DONE) return FAILED;
  if (get_indicators(self, self->z_start) != DONE) return FAILED;
  self->step_start = self->step_end = t;
  self->old_error = 1e-4;
  self->in_event_mode = false;
  self->pending = SETTLED;
  self->can_go_on = false;
  self->fmu_is_at_end = true;
  self->held = NAN;
  for (size_t j = 0; j < self->how.n_inputs; j++) self->input_values[j] = NAN;
  const Outcome outcome = self->extension ? self->extension->after_event(self, t, self->x_end) : DONE;
  self->inside = self->starting = false;
  return outcome;
}

/* Enter Event Mode from the step's end, which the FMU holds. */
Outcome enter_event_mode(Integrator *self) {
  if (self->extension && self->extension->before_event(self, self->step_end, self->x_end) != DONE) return FAILED;
  self->in_event_mode = true;
  self->n_events++;
  return check(self, ENTER_EVENT_MODE, self->call.EnterEventMode(self->how.instance)) == DONE ? DONE : FAILED;
}

/* Tell the FMU that the step to the time that it holds is complete; an event is pending if it wants one. */
Outcome complete_step(Integrator *self) {
  const Integration *how = &self->how;
  int32_t status = fmi2OK;
  bool event = false, terminate = false;
  if (how->fmi2) {
    if (!how->fmi2->CompletedIntegratorStep) return DONE;
    fmi2Boolean wants[2] = {0};
    status = how->fmi2->CompletedIntegratorStep(how->instance, 1, &wants[0], &wants[1]);
    event = wants[0], terminate = wants[1];
  } else {
    if (!how->fmi3->CompletedIntegratorStep) return DONE;
    fmi3Boolean wants[2] = {0};
    status = how->fmi3->CompletedIntegratorStep(how->instance, 1, &wants[0], &wants[1]);
    event = wants[0], terminate = wants[1];
  }
  if (check(self, COMPLETED_STEP, status) != DONE) return FAILED;
  if (terminate) return give_up(self, ENDED, fmi2OK);
  if (event) self->pending = EVENT;
  if (!self->extension || !self->extension->complete) return DONE;
  return self->extension->complete(self, self->step_end, self->x_end);
}

static bool completes_steps(const Integrator *self) {
  return self->how.fmi2 ? self->how.fmi2->CompletedIntegratorStep != NULL
                        : self->how.fmi3->CompletedIntegratorStep != NULL;
}

/* Bring the FMU to the end of the step and do what is pending there: completion, a state, step or time event. */
Outcome settle(Integrator *self) {
  const double end = self->step_end;
  self->time = end;
  const bool event = self->pending == EVENT || self->next_event <= end;
  if (!self->fmu_is_at_end && (event || completes_steps(self))) {
    if (put(self, end, self->x_end) != DONE) return FAILED;
    self->fmu_is_at_end = true;
  }
  if (self->pending != SETTLED && complete_step(self) != DONE) return FAILED;
  self->inside = true;
  if (event || self->pending == EVENT) return enter_event_mode(self) == DONE ? leave_event_mode(self, end) : FAILED;
  self->inside = false;
  self->pending = SETTLED;
  copy(self->how.n_indicators, self->z_end, self->z_start);
  return DONE;
}
