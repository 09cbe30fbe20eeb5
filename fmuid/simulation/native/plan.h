/* What is simulated: components, what is set and got in which order, and the experiment. Python fills all this in. */
#ifndef PLAN_H
#define PLAN_H

#include <stdatomic.h>
#include <stdbool.h>

#include "fmi2.h"
#include "fmi3.h"

/* How a binary takes the values of a variable. In FMI 2.0 a Real is a Float64, an Integer or enumeration an Int32. */
#define WIRES(X) \
  X(FLOAT64) X(FLOAT32) X(INT8) X(UINT8) X(INT16) X(UINT16) X(INT32) X(UINT32) X(INT64) X(UINT64) X(BOOLEAN) X(STRING)
#define NAMED(name) name,
typedef enum { WIRES(NAMED) N_WIRES } Wire;

/* What an operation does, and what a report names: setting functions by wire, getting ones, other functions of the
 * FMI, and what else may go wrong. */
/* clang-format off */
#define FAILURES(X)                                                                               \
  X(SET_DERIVATIVES) X(DO_STEP) X(RESET) X(SETUP) X(ENTER_INITIALIZATION) X(EXIT_INITIALIZATION)  \
  X(ENTER_EVENT_MODE) X(UPDATE_DISCRETE_STATES) X(ENTER_STEP_MODE) X(SET_TIME) X(SET_STATES)      \
  X(GET_STATES) X(GET_NOMINALS) X(GET_DERIVATIVES) X(GET_INDICATORS)                              \
  X(ENTER_CONTINUOUS_TIME_MODE) X(COMPLETED_STEP) X(DIRECTIONAL_DERIVATIVE)                       \
  X(COPY)          /* never fails: one signal to another */                                       \
  X(SENSITIVITIES) /* those of outputs, from the integrator's memory */                           \
  X(LOOP)          /* of direct feed-through, not solved; the component is its number */          \
  X(ENDED)         /* by the FMU */                                                               \
  X(OUT_OF_RANGE)  /* a value that the type of its variable cannot hold */                        \
  X(STUCK)         /* steps return early again and again */                                       \
  X(ENDLESS_EVENT)                                                                                \
  X(ENDLESS_ROUNDS) /* of events at one time that cause one another; the component had the last */ \
  X(TOO_MANY_EVENTS) X(TOO_MANY_STEPS) X(STEP_TOO_SMALL) X(STATE_NOT_FINITE) X(STIFF)                                                                                        \
  X(CVODE_FAILED)  /* the status is its flag */                                                   \
  X(JUMP_UNKNOWN) X(JUMP_REFUSED)                                                                 \
  X(CANCELLED)
/* clang-format on */
typedef enum { NOTHING = -1, BEFORE_FAILURES = 2 * N_WIRES - 1, FAILURES(NAMED) N_FAILURES } Failure;

enum { UNDONE = -2, DONE_WELL = -1 }; /* the status of a simulation that is not over, or that nothing ended early */

/* How a simulation ended. */
typedef struct {
  int64_t failure; /* Failure; NOTHING if it went well */
  int64_t component;
  int64_t status; /* what the FMI function returned */
  int64_t sample; /* the last that was begun */
  int64_t state;  /* number of the state to blame, where one is */
  double time;    /* that the component had reached, and the step that it tried last, s; NAN where unknown */
  double step;
} Report;

/* A polynomial of an input in the time since the last sample, lowest power first. */
typedef struct {
  double a[4];
} Curve;

INLINE double value_at(const Curve *curve, double after) {
  return curve->a[0] + after * (curve->a[1] + after * (curve->a[2] + after * curve->a[3]));
}

typedef struct Integrator Integrator;

/* INITIALIZING: values are set just so; IN_EVENTS: likewise; RUNNING: `When` counts. */
typedef enum { RUNNING, IN_EVENTS, INITIALIZING } Mode;

/* An instance of an FMU, for co-simulation or, with an integrator, for model exchange. */
typedef struct {
  void *instance;
  const Fmi2 *fmi2; /* one of these two is NULL */
  const Fmi3 *fmi3;
  Integrator *integrator; /* NULL for co-simulation */
  double tolerance;       /* 0 leaves it to the FMU */
  int64_t *used;          /* whether it must be reset before its next simulation, whoever runs that */
  int32_t event_mode;     /* of co-simulation by FMI 3.0: events are handled between steps */
  int32_t mode;           /* Mode */
  double time;            /* that its steps have reached, or where it begins */
  double begun;           /* when its present step began, where components have steps of their own */
} Component;

typedef enum { SET_REALS, GET_REALS, SET_SLOPES, COPY_ONE, GET_SENSITIVITIES, OTHER } OperationKind;

/* When a value is set (bits): always; only where it changed, then in Event Mode; the same, but only after a step of the
 * inputs; with a restart of the integrator where it changed; only at the communication points of its component. */
enum { ALWAYS = 0, AS_EVENT = 1, AT_STEPS = 2, WITH_RESTART = 4, LATCHED = 8 };

/* One transfer of values: between a component and the signals, or from one signal to another. */
typedef struct {
  int32_t kind;     /* OperationKind; the first three are Reals of FMI 2.0, without conditions */
  int32_t function; /* what a report calls it */
  int32_t component;
  int32_t wire; /* Wire: of the values, not of the function: Booleans are INT32 or UINT8 */
  int32_t when;
  size_t count; /* of value references */
  const uint32_t *references;
  size_t signal, n_values; /* the signals; of a copy its target */
  void *values;            /* the signals themselves, or memory for values of another type, or texts */
  double *last;            /* what was set last */
  void *instance;
  const Fmi2 *fmi2;
  size_t source; /* of a copy: target = factor * source + offset */
  double factor, offset;
} Operation;

/* Operations from number `first` up to `last`. */
typedef struct {
  size_t first, last;
} Range;

/* A loop of direct feed-through: what gets and copies, what sets, and the unknowns, its inputs. `inverse` is that of
 * their matrix where `inverted`, and kept from step to step; `magnitudes` are their largest values in the simulation.
 */
typedef struct {
  Range get, set;
  size_t n;
  const int64_t *signals;
  const double *nominals;                                         /* of the unknowns, 0 where none is stated */
  double *unknowns, *residual, *correction, *starts, *magnitudes; /* (n), work memory like the matrices (n, n) */
  double *matrix, *inverse;
  int32_t inverted;
} Loop;

/* A part of the exchange: operations, or a loop to be solved. */
typedef struct {
  Range range;
  Loop *loop; /* NULL if it is none */
} Group;

typedef enum { HELD, BY_DERIVATIVE, BY_STEPPER, BY_MIDPOINT } InputMode;

typedef struct {
  size_t n_components, n_signals, n_parameters, n_inputs, n_outputs, n_groups;
  Component *components;
  Operation *operations;
  Range start_values, inputs, exchange, outputs, slopes;
  const Range *after_step; /* of each component, by Gauss and Seidel; NULL by Jacobi */
  const Group *groups;     /* the exchange once more, in parts; NULL where there is neither loop nor Event Mode */
  double *signals;         /* values on their way between components, table and results */
  const double *start_signals;
  const int64_t *parameter_signals, *input_signals, *slope_signals, *output_signals;
  const int64_t *output_terms; /* output j is the sum of the signals output_signals[output_terms[j]] and following */
  const int64_t *input_modes;
  Curve *const *curves;      /* of each input; those of integrators are theirs */
  Operation *direct_inputs;  /* the one that takes a whole row of the table as it is; NULL if there is none */
  Operation *direct_outputs; /* likewise for a row of the outputs */
  const fmi2Integer *ones;   /* as many as any operation has slopes: the order of their derivatives */
  int32_t curved;            /* whether the grid has slopes */
  int32_t midpoints;         /* whether any input goes by midpoints */
  int32_t by_rows; /* whether direct inputs and outputs of one FMU, and slopes of all inputs, are all there is */
} Plan;

/* The samples: times (n_times), inputs (n_times, n_inputs), their slopes likewise or NULL, substeps of the intervals
 * (n_times - 1), and how many of these a component's own step has (n_components), NULL where all have one.
 *
 * Components that are all for model exchange may be shown states (n_times, n_states) at the samples in place of
 * integration: they follow each theta, and times need not increase then; n_states is -1 without. Or states are
 * corrected after each sample by a gain (n_states, n_outputs) times what was measured (n_times, n_outputs) less the
 * outputs, but for what is NAN. Both are NULL without. */
typedef struct {
  size_t n_times;
  int64_t n_states;
  const double *times, *inputs, *slopes;
  const int64_t *substeps, *strides;
  const double *gain, *measured;
} Grid;

#endif
