/* The life of an integrator: of a model-exchange instance from one communication point to the next. */
#ifndef MODEL_EXCHANGE_H
#define MODEL_EXCHANGE_H

#include "integrator.h"

/* All but the first two return 0 or, after a failure, another number. */
EXPORT Integrator *integrator_create(const Integration *how); /* NULL where memory is short */
EXPORT void integrator_free(Integrator *self);
EXPORT int integrator_begin(Integrator *self, double t);
EXPORT int integrator_enter_events(Integrator *self, double t);
EXPORT int integrator_leave_events(Integrator *self, double t);
EXPORT int integrator_advance(Integrator *self, double t);
EXPORT int integrator_show(Integrator *self, double t, const double *x);
EXPORT int integrator_correct(Integrator *self, double t, const double *gain, const double *measured,
                              const double *outputs, size_t n);

#endif
