/* What is integrated beside the states: their derivatives to parameters. */
#ifndef SENSITIVITIES_H
#define SENSITIVITIES_H

#include "integrator.h"

extern const Extension directional_sensitivities, twin_sensitivities;

int32_t output_sensitivities(Integrator *self, const uint32_t *references, size_t count, double *values);

#endif
