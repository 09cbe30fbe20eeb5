/* Loops of direct feed-through. */
#ifndef LOOPS_H
#define LOOPS_H

#include "simulation.h"

/* Forget what the simulation before has found. */
void begin_loops(const Plan *plan);

/* Solve a loop for the inputs in it. */
bool solve_loop(Simulation *self, Loop *loop, size_t number);

#endif
