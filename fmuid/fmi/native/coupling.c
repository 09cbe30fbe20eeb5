/* Components that act on each other: loops of direct feed-through, events that cause events; and curved inputs. */
#include <math.h>

#include "core.h"

enum { LOOP_ITERATIONS = 30, EVENT_ROUNDS = 20 }; /* rounds: events at one time that cause one another */
static const double LOOP_TOLERANCE = 1e-10, LOOP_DIFFERENCE = 1e-6;
static const double SINGULAR = 1e-8; /* a pivot below this is rounding: the derivatives are differences, of order one */

/* Set the unknowns, pass the outputs on, and compare. */
static bool find_residual(Simulation *self, const Loop *loop, double *residual) {
  double *signals = self->plan->signals;
  for (size_t j = 0; j < loop->n; j++) signals[loop->signals[j]] = loop->unknowns[j];
  if (!perform(self, loop->set) || !perform(self, loop->get)) return false;
  for (size_t j = 0; j < loop->n; j++) residual[j] = signals[loop->signals[j]] - loop->unknowns[j];
  return true;
}

static void swap(double *a, double *b) {
  const double kept = *a;
  *a = *b;
  *b = kept;
}

/* Solve by elimination with pivots, in place; the matrix is stored column by column. False if it is singular. */
static bool solve(size_t n, double *matrix, double *right) {
  for (size_t j = 0; j < n; j++) {
    size_t pivot = j;
    for (size_t i = j + 1; i < n; i++)
      if (fabs(matrix[n * j + i]) > fabs(matrix[n * j + pivot])) pivot = i;
    const double largest = matrix[n * j + pivot];
    if (fabs(largest) < SINGULAR || !isfinite(largest)) return false;
    for (size_t c = j; c < n; c++) swap(&matrix[n * c + j], &matrix[n * c + pivot]);
    swap(&right[j], &right[pivot]);
    for (size_t i = j + 1; i < n; i++) {
      const double factor = matrix[n * j + i] / largest;
      for (size_t c = j; c < n; c++) matrix[n * c + i] -= factor * matrix[n * c + j];
      right[i] -= factor * right[j];
    }
  }
  for (size_t j = n; j-- > 0;) {
    right[j] /= matrix[n * j + j];
    for (size_t i = 0; i < j; i++) right[i] -= matrix[n * j + i] * right[j];
  }
  return true;
}

/* The derivatives of the residual by differences, column by column. */
static bool find_matrix(Simulation *self, const Loop *loop) {
  for (size_t j = 0; j < loop->n; j++) {
    const double value = loop->unknowns[j], step = LOOP_DIFFERENCE * fmax(1.0, fabs(value));
    double *column = loop->matrix + loop->n * j;
    loop->unknowns[j] = value + step;
    if (!find_residual(self, loop, column)) return false;
    loop->unknowns[j] = value;
    for (size_t i = 0; i < loop->n; i++) column[i] = (column[i] - loop->residual[i]) / step;
  }
  return true;
}

/* Solve a loop of direct feed-through for the inputs in it, by Newton's method with differences.
 *
 * The unknowns x are the inputs; the residual is what the outputs, passed on, would make of them, less x. */
static bool solve_loop(Simulation *self, const Loop *loop, size_t number) {
  const size_t n = loop->n;
  double *signals = self->plan->signals, *x = loop->unknowns;
  for (size_t j = 0; j < n; j++) x[j] = signals[loop->signals[j]];
  for (int k = 0; k < LOOP_ITERATIONS; k++) {
    if (!find_residual(self, loop, loop->residual)) return false;
    bool solved = true;
    for (size_t j = 0; j < n; j++) solved = solved && fabs(loop->residual[j]) <= LOOP_TOLERANCE * (1.0 + fabs(x[j]));
    if (solved) {
      for (size_t j = 0; j < n; j++) signals[loop->signals[j]] = x[j];
      return true;
    }
    if (!find_matrix(self, loop)) return false;
    if (!solve(n, loop->matrix, loop->residual)) break;
    for (size_t j = 0; j < n; j++) x[j] -= loop->residual[j];
  }
  return fail(self, LOOP, number, fmi2OK);
}

/* Pass the outputs on, group by group. */
bool exchange(Simulation *self) {
  const Plan *plan = self->plan;
  if (!plan->groups) return perform(self, plan->exchange);
  size_t number = 0;
  for (size_t g = 0; g < plan->n_groups; g++) {
    const Group *group = &plan->groups[g];
    if (group->loop ? !solve_loop(self, group->loop, number++) : !perform(self, group->range)) return false;
  }
  return true;
}

/* Pass the outputs on until no component is left in Event Mode, as all are after initialization: when they leave it,
 * their outputs may change. */
bool settle_events(Simulation *self) {
  const Plan *plan = self->plan;
  for (int round = 0; round < EVENT_ROUNDS; round++) {
    bool left = false;
    if (!exchange(self)) return false;
    for (size_t c = 0; c < plan->n_components; c++) {
      if (plan->components[c].mode != IN_EVENTS) continue;
      if (!leave_events(self, c, self->now)) return false;
      left = true;
    }
    if (!left) break;
  }
  return true;
}

/* Make straight inputs the cubic curves (Hermite) that have the slopes given at their ends, if these are given. */
void bend(Simulation *self, size_t sample) {
  const size_t n = self->plan->n_inputs;
  const double length = self->grid->times[sample + 1] - self->grid->times[sample];
  for (size_t j = 0; j < n; j++) {
    const double first = self->grid->slopes[n * sample + j], last = self->grid->slopes[n * (sample + 1) + j];
    if (!isfinite(first)) continue;
    double *a = self->plan->curves[j]->a;
    const double slope = a[1];
    a[1] = first;
    a[2] = (3.0 * slope - 2.0 * first - last) / length;
    a[3] = (first + last - 2.0 * slope) / (length * length);
  }
}

/* Give curved inputs, where an FMU interpolates them, the slope of the chord over the coming step. */
void set_chords(Simulation *self, double after, double length) {
  const Plan *plan = self->plan;
  for (size_t j = 0; j < plan->n_inputs; j++) {
    if (plan->input_modes[j] != BY_DERIVATIVE) continue;
    const double change = value_at(plan->curves[j], after + length) - value_at(plan->curves[j], after);
    plan->signals[plan->slope_signals[j]] = change / length;
  }
}
