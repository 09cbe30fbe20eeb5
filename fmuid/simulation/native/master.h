/* Whole simulations, and what Python calls of them. */
#ifndef MASTER_H
#define MASTER_H

#include "plan.h"

/* Simulate for each row of thetas (count, n_parameters), on the same instances one after the other, into outputs
 * (count, n_times, n_outputs) and reports (count). Ends soon after *cancel becomes other than zero. After a fatal
 * failure the rest is not simulated: its status is UNDONE. */
EXPORT void simulate(const Plan *plan, const Grid *grid, size_t count, const double *thetas, double *outputs,
                     Report *reports, const atomic_int *cancel);

/* Keep and restore how the present thread calculates with floating-point numbers, in as many bytes as this takes. */
EXPORT size_t environment_size(void);
EXPORT void environment_keep(void *room);
EXPORT void environment_restore(const void *room);

#endif
