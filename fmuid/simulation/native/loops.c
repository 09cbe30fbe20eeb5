/* Loops of direct feed-through, solved by Newton's method with differences.
 *
 * The unknowns x are the inputs in the loop; the residual is what the outputs, passed on, would make of them, less x.
 */ \
#include "loops.h"

#include <math.h>
#include <string.h>

#include "integrator.h"
#include "transfer.h"

enum { ITERATIONS = 30, PATIENCE = 2, CAUTIOUS_FROM = 10 };
/* An unknown is right when residual and correction are within TOLERANCE of it; less than VANISHING of its largest
 * magnitude so far is zero. Where rounding keeps the corrections from shrinking, ROUNDING of that magnitude will do. */
static const double TOLERANCE = 1e-11, VANISHING = 1e-24, ROUNDING = 1e-10;
/* A difference is this share of the unknown, and at least this of its largest magnitude so far, above its rounding. */
static const double DIFFERENCE = 1e-6, LEAST_DIFFERENCE = 1e-10;
static const double CONTRACTION = 0.1; /* of the corrections: a matrix that does not give it is found again */
static const double SINGULAR = 1e-8;   /* a smaller pivot is rounding: all rows and columns are of order one */

/* The nominal value of an unknown; where none is stated, 1 (FMI 2.0.4, section 2.2.7; FMI 3.0.2, section 2.4.7.4). */
static double nominal(const Loop *loop, size_t j) { return loop->nominals[j] > 0.0 ? loop->nominals[j] : 1.0; }

/* Forget what the simulation before has found. */
void begin_loops(const Plan *plan) {
  for (size_t g = 0; g < plan->n_groups; g++) {
    Loop *loop = plan->groups[g].loop;
    if (!loop) continue;
    loop->inverted = 0;
    memcpy(loop->magnitudes, loop->nominals, loop->n * sizeof(double));
  }
}

/* Set the unknowns, pass the outputs on, and compare. */
static bool find_residual(Simulation *self, const Loop *loop, double *residual) {
  double *signals = self->plan->signals;
  for (size_t j = 0; j < loop->n; j++) signals[loop->signals[j]] = loop->unknowns[j];
  if (!perform(self, loop->set) || !perform(self, loop->get)) return false;
  for (size_t j = 0; j < loop->n; j++) residual[j] = signals[loop->signals[j]] - loop->unknowns[j];
  return true;
}

/* ---- the matrix and its inverse, row by row ---- */

/* The derivatives of the residual by differences; cautious ones are of nominal size at least. */
static bool find_matrix(Simulation *self, const Loop *loop, bool cautious) {
  const size_t n = loop->n;
  for (size_t j = 0; j < n; j++) {
    const double value = loop->unknowns[j];
    double size = fmax(fabs(value), fabs(value + loop->residual[j])); /* both sides of the equation */
    size = fmax(size, LEAST_DIFFERENCE / DIFFERENCE * loop->magnitudes[j]);
    if (cautious || size == 0.0) size = fmax(size, nominal(loop, j));
    const double step = (value + DIFFERENCE * size) - value;
    loop->unknowns[j] = value + step;
    if (!find_residual(self, loop, loop->correction)) return false;
    loop->unknowns[j] = value;
    for (size_t i = 0; i < n; i++) loop->matrix[n * i + j] = (loop->correction[i] - loop->residual[i]) / step;
  }
  return true;
}

/* The largest magnitude of n numbers; NAN if there is one among them. */
static double largest(size_t n, const double *numbers, size_t stride) {
  double found = 0.0;
  for (size_t i = 0; i < n; i++)
    if (!(fabs(numbers[stride * i]) <= found)) found = fabs(numbers[stride * i]);
  return found;
}

static void scale(size_t n, double *numbers, size_t stride, double factor) {
  for (size_t i = 0; i < n; i++) numbers[stride * i] *= factor;
}

/* Make row j that of the pivot, one there, and the rest of the column zero; false if there is no pivot. */
static bool eliminate(const Loop *loop, size_t j) {
  const size_t n = loop->n;
  double *a = loop->matrix, *b = loop->inverse;
  size_t pivot = j;
  for (size_t i = j + 1; i < n; i++)
    if (fabs(a[n * i + j]) > fabs(a[n * pivot + j])) pivot = i;
  const double value = a[n * pivot + j];
  if (!(fabs(value) >= SINGULAR)) return false;
  for (size_t c = 0; c < n; c++) {
    const double one = a[n * pivot + c], other = b[n * pivot + c];
    a[n * pivot + c] = a[n * j + c], b[n * pivot + c] = b[n * j + c];
    a[n * j + c] = one / value, b[n * j + c] = other / value;
  }
  for (size_t i = 0; i < n; i++) {
    const double factor = a[n * i + j];
    if (i == j || factor == 0.0) continue;
    for (size_t c = 0; c < n; c++) {
      a[n * i + c] -= factor * a[n * j + c];
      b[n * i + c] -= factor * b[n * j + c];
    }
  }
  return true;
}

/* Invert the matrix by Gauss and Jordan. Signals differ in size, so rows and columns are divided by their largest
 * number first. False if the matrix is singular. */
static bool invert(const Loop *loop) {
  const size_t n = loop->n;
  double *a = loop->matrix, *b = loop->inverse, *columns = loop->correction;
  memset(b, 0, n * n * sizeof(double));
  for (size_t i = 0; i < n; i++) {
    const double size = largest(n, a + n * i, 1);
    if (!(size > 0.0 && size < INFINITY)) return false;
    scale(n, a + n * i, 1, 1.0 / size);
    b[n * i + i] = 1.0 / size;
  }
  for (size_t j = 0; j < n; j++) {
    columns[j] = largest(n, a + j, n);
    if (!(columns[j] > 0.0)) return false;
    scale(n, a + j, n, 1.0 / columns[j]);
  }
  for (size_t j = 0; j < n; j++)
    if (!eliminate(loop, j)) return false;
  for (size_t i = 0; i < n; i++) scale(n, b + n * i, 1, 1.0 / columns[i]);
  return true;
}

/* ---- Newton's method ---- */

static void note_magnitudes(const Loop *loop) {
  for (size_t j = 0; j < loop->n; j++) {
    const double x = loop->unknowns[j], other = x + loop->residual[j];
    loop->magnitudes[j] = fmax(loop->magnitudes[j], fmax(fabs(x), fabs(other)));
  }
}

/* Find the correction; return its largest part, relative to the magnitudes. */
static double correct(const Loop *loop) {
  double found = 0.0;
  for (size_t i = 0; i < loop->n; i++) {
    double sum = 0.0;
    for (size_t j = 0; j < loop->n; j++) sum += loop->inverse[loop->n * i + j] * loop->residual[j];
    loop->correction[i] = sum;
    const double part = sum == 0.0 ? 0.0 : fabs(sum) / loop->magnitudes[i];
    if (!(part <= found)) found = part; /* also if it is NAN */
  }
  return found;
}

static bool is_exact(const Loop *loop) {
  bool exact = true;
  for (size_t j = 0; j < loop->n; j++) {
    const double bound = fmax(TOLERANCE * fabs(loop->unknowns[j]), VANISHING * loop->magnitudes[j]);
    exact = exact && fabs(loop->residual[j]) <= bound && fabs(loop->correction[j]) <= bound;
  }
  return exact;
}

static bool is_rounding(const Loop *loop, bool by_nominal) {
  bool small = true;
  for (size_t j = 0; j < loop->n; j++) {
    const double size = by_nominal ? fmax(loop->magnitudes[j], nominal(loop, j)) : loop->magnitudes[j];
    small = small && fabs(loop->correction[j]) <= ROUNDING * size;
  }
  return small;
}

/* Find the inverse where the unknowns are; REJECTED if there is none. */
static Outcome linearize(Simulation *self, Loop *loop, bool cautious) {
  if (!find_matrix(self, loop, cautious)) return FAILED;
  loop->inverted = invert(loop);
  return loop->inverted ? DONE : REJECTED;
}

/* Find the inverse anew. One that was kept may have led astray: then it is found where the iteration began. */
static Outcome renew(Simulation *self, Loop *loop, bool kept, bool cautious) {
  if (kept) {
    memcpy(loop->unknowns, loop->starts, loop->n * sizeof(double));
    if (!find_residual(self, loop, loop->residual)) return FAILED;
  }
  return linearize(self, loop, cautious);
}

/* Iterate until the unknowns are right, which the components then hold; REJECTED if they are not found. */
static Outcome iterate(Simulation *self, Loop *loop) {
  double last = INFINITY, best = INFINITY;
  int idle = 0; /* corrections in a row that have not halved the best one */
  bool kept = loop->inverted;
  for (int k = 0;; k++) {
    if (!find_residual(self, loop, loop->residual)) return FAILED;
    if (largest(loop->n, loop->residual, 1) == 0.0) return DONE;
    note_magnitudes(loop);
    double size = loop->inverted ? correct(loop) : NAN;
    if (loop->inverted && (is_exact(loop) || (idle >= PATIENCE && is_rounding(loop, false)))) return DONE;
    if (k == ITERATIONS) return is_rounding(loop, true) ? DONE : REJECTED;
    if (!(size <= CONTRACTION * last)) {
      const Outcome outcome = renew(self, loop, kept, k >= CAUTIOUS_FROM);
      if (outcome != DONE) return outcome;
      size = correct(loop);
      kept = false;
    }
    for (size_t j = 0; j < loop->n; j++) loop->unknowns[j] -= loop->correction[j];
    idle = size <= 0.5 * best ? 0 : idle + 1;
    best = fmin(best, size);
    last = size;
  }
}

/* Solve a loop for the inputs in it. */
bool solve_loop(Simulation *self, Loop *loop, size_t number) {
  double *signals = self->plan->signals;
  for (size_t j = 0; j < loop->n; j++) loop->unknowns[j] = loop->starts[j] = signals[loop->signals[j]];
  const Outcome outcome = iterate(self, loop);
  if (outcome != DONE) return outcome == REJECTED ? fail(self, LOOP, number, fmi2OK) : false;
  for (size_t j = 0; j < loop->n; j++) signals[loop->signals[j]] = loop->unknowns[j];
  return true;
}
