/* Runge–Kutta steps. */
#ifndef RUNGE_KUTTA_H
#define RUNGE_KUTTA_H

#include "integrator.h"

Outcome runge_kutta_step(Integrator *self, double bound);
void runge_kutta_interpolate(Integrator *self, double t);

#endif
