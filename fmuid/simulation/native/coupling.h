/* Components that act on each other. */
#ifndef COUPLING_H
#define COUPLING_H

#include "simulation.h"

bool exchange(Simulation *self);
bool settle_events(Simulation *self);
void bend(Simulation *self, size_t sample);
void set_chords(Simulation *self, double after, double length);

#endif
