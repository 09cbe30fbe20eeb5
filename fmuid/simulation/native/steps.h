/* One step of whichever method, and the states within it. */
#ifndef STEPS_H
#define STEPS_H

#include "integrator.h"

/* One step towards `bound`, event indicators at its end included. */
Outcome take_step(Integrator *self, double bound);

/* Put the states at a time t within the step into x_at. */
Outcome interpolate(Integrator *self, double t);

#endif
