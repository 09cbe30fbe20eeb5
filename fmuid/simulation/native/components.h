/* The life of a component, for co-simulation or model exchange. */
#ifndef COMPONENTS_H
#define COMPONENTS_H

#include "simulation.h"

bool prepare(Simulation *self, size_t component);
bool enter_initialization(Simulation *self, size_t component);
bool exit_initialization(Simulation *self, size_t component);
bool enter_events(Simulation *self, size_t component);
bool leave_events(Simulation *self, size_t component, double time);
bool step_on(Simulation *self, size_t component, double from, double until);
bool show_states(Simulation *self, size_t sample);
bool correct_states(Simulation *self, size_t sample);
bool step_after_discard(Simulation *self, size_t component, double from, double until);

#endif
