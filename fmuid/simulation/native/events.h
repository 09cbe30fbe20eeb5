/* Events of a model-exchange FMU. */
#ifndef EVENTS_H
#define EVENTS_H

#include "integrator.h"

bool crossed(const Integrator *self, const double *z);
Outcome locate_event(Integrator *self);
Outcome settle(Integrator *self);
Outcome complete_step(Integrator *self);
Outcome enter_event_mode(Integrator *self);
Outcome leave_event_mode(Integrator *self, double t);

#endif
