/* Steps by CVODE, and its memory. */
#ifndef CVODE_H
#define CVODE_H

#include "integrator.h"

bool cvode_create(Integrator *self);
void cvode_free(Integrator *self);
Outcome cvode_step(Integrator *self, double bound);
Outcome cvode_interpolate(Integrator *self, double t);

#endif
