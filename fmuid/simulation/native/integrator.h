/* The integration of one model-exchange instance: its memory, and who does what to it. */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "plan.h"

typedef enum { RK4, RK45, CVODE } Method;

/* The functions of SUNDIALS 7 that are called, and of its vectors and matrices only what gives access to their numbers:
 * their types are opaque here. `sunindextype` is int64_t, `sunrealtype` double. */
/* clang-format off */
#define SUNDIALS_FUNCTIONS(X) \
  X(int, SUNContext_Create, (int communicator, void **context)) \
  X(int, SUNContext_ClearErrHandlers, (void *context)) \
  X(int, SUNContext_Free, (void **context)) \
  X(void *, N_VMake_Serial, (int64_t n, double *numbers, void *context)) \
  X(double *, N_VGetArrayPointer, (void *vector)) \
  X(void, N_VDestroy, (void *vector)) \
  X(void *, SUNDenseMatrix, (int64_t rows, int64_t columns, void *context)) \
  X(double *, SUNDenseMatrix_Data, (void *matrix)) \
  X(void, SUNMatDestroy, (void *matrix)) \
  X(void *, SUNLinSol_Dense, (void *vector, void *matrix, void *context)) \
  X(int, SUNLinSolFree, (void *solver)) \
  X(void *, CVodeCreate, (int method, void *context)) \
  X(int, CVodeInit, (void *memory, int (*slopes)(double t, void *y, void *dy, void *data), double t, void *y)) \
  X(int, CVodeReInit, (void *memory, double t, void *y)) \
  X(int, CVodeSetUserData, (void *memory, void *data)) \
  X(int, CVodeSVtolerances, (void *memory, double relative, void *absolute)) \
  X(int, CVodeSetLinearSolver, (void *memory, void *solver, void *matrix)) \
  X(int, CVodeSetJacFn, (void *memory, int (*jacobian)(double t, void *y, void *dy, void *matrix, void *data, \
        void *work1, void *work2, void *work3))) \
  X(int, CVodeSetMaxHnilWarns, (void *memory, int count)) \
  X(int, CVodeSetMaxStep, (void *memory, double length)) \
  X(int, CVodeSetStopTime, (void *memory, double t)) \
  X(int, CVodeSetInitStep, (void *memory, double length)) \
  X(int, CVode, (void *memory, double until, void *y, double *reached, int task)) \
  X(int, CVodeGetDky, (void *memory, double t, int derivative, void *y)) \
  X(void, CVodeFree, (void **memory))
/* clang-format on */

typedef struct {
#define FUNCTION(gives, name, takes) gives(*name) takes;
  SUNDIALS_FUNCTIONS(FUNCTION)
#undef FUNCTION
} Sundials;

/* The sensitivities of the states to `count` parameters, integrated with the n states. With directional derivatives
 * `initial` (count, n) are those to begin with and `knowns` (count, n + 1) the references of states and parameter; else
 * each of the `twins`, instances of the same model, has one parameter changed by one of the `steps` (count). */
typedef struct {
  size_t count;
  const double *magnitudes; /* of the parameters: an absolute tolerance is that of its state over the magnitude */
  const double *initial, *steps;
  const uint32_t *knowns;
  Integrator *const *twins; /* NULL with directional derivatives */
} Sensitivities;

/* How a component is integrated; filled in from Python. */
typedef struct {
  void *instance;
  const Fmi2 *fmi2; /* one of these two is NULL */
  const Fmi3 *fmi3;
  size_t n_states, n_indicators;
  size_t n_inputs, n_input_references; /* that vary continuously; an array of FMI 3.0 has one reference */
  const uint32_t *input_references;
  Curve *curves;                                            /* of these inputs, from `origin` on */
  const uint32_t *state_references, *derivative_references; /* NULL where no directional derivatives are to be had */
  double tolerance;                   /* relative; that of a state near zero is relative to its nominal value */
  double largest_step;                /* infinity where there is no bound */
  double limit;                       /* steps may go beyond the wanted time up to here */
  size_t most_steps;                  /* from one wanted time to the next, of methods that choose them */
  int32_t method;                     /* Method */
  int32_t straight;                   /* the curves are straight lines */
  int32_t follows;                    /* this is the twin of another: it is not integrated */
  const Sensitivities *sensitivities; /* NULL without */
  const Sundials *sundials;           /* NULL but for CVODE */
} Integration;

typedef enum { DONE = 0, REJECTED = 1, FAILED = -1 } Outcome; /* REJECTED: a smaller step may do. As CVODE reads them */

typedef enum { SETTLED, COMPLETION, EVENT } Pending; /* what is still to be done at the end of the step */

enum { MOST_STAGES = 7 };

/* What deals with what is integrated beside the states. */
typedef struct {
  Outcome (*extend)(Integrator *self, double t, const double *x, double *dx); /* find its derivatives */
  Outcome (*follow)(Integrator *self, double t, const double *x);             /* a time has been arrived at */
  Outcome (*complete)(Integrator *self, double t, const double *x);           /* a step is complete */
  Outcome (*before_event)(Integrator *self, double t, const double *x);
  Outcome (*after_event)(Integrator *self, double t, double *x);
} Extension;

typedef struct Solver Solver; /* CVODE's memory */

/* Functions that both versions of the FMI have in the same shape. */
typedef struct {
  int32_t (*SetTime)(void *, double);
  int32_t (*SetContinuousStates)(void *, const double *, size_t);
  int32_t (*GetContinuousStates)(void *, double *, size_t);
  int32_t (*GetNominals)(void *, double *, size_t);
  int32_t (*GetDerivatives)(void *, double *, size_t);
  int32_t (*GetEventIndicators)(void *, double *, size_t);
  int32_t (*EnterEventMode)(void *);
  int32_t (*EnterContinuousTimeMode)(void *);
} Calls;

struct Integrator {
  /* What Python looks at; `origin` and `cancel` are the master's to set. */
  Integration how;
  double origin;               /* of the curves' time */
  double time;                 /* that the FMU holds, or was given last before it failed */
  double step_start, step_end; /* of the step that was accepted last; between steps the present time */
  double step_length;          /* before an event cut the step; 0 if nothing was integrated */
  double next_step;            /* length to try next; 0 where unknown */
  double next_event;           /* time of the next time event; infinite where there is none */
  size_t n_steps, n_events;    /* since the beginning; events that were brought from outside included */
  Report report;
  const atomic_int *cancel; /* NULL where nobody can wish so */

  Calls call;
  const Extension *extension; /* NULL where states alone are integrated */
  Solver *solver;
  size_t n_total;          /* the states, and what is integrated with them */
  double held;             /* the time of which the FMU holds time and inputs by the present curves; NAN if of none */
  double error, old_error; /* of the last attempt and of the last accepted step, 1 being just acceptable */
  double powered_error, power; /* an old error, and the power of it that control takes */
  size_t steps_before;         /* the present advance */
  double wanted;               /* time of the present advance */
  int32_t stiff_hits, stiff_misses;
  bool has_directional; /* derivatives, as far as is known */
  bool in_event_mode;
  bool starting;      /* the event that is to be left is the first */
  bool inside;        /* the event that was entered was found here, not brought from outside */
  bool fmu_is_at_end; /* the FMU holds time, inputs and states of the step's end */
  bool can_go_on;     /* from where it is: derivatives of the step's end, history of CVODE */
  bool nominals_known;
  bool small; /* a state has been zero or far below 1 so far */
  bool bent;  /* `bend` is that of the present step */
  Pending pending;

  /* The arrays lie in one block of memory, which `memory` owns. */
  double *memory;
  double *x_start, *x_end, *x_stage, *x_at; /* states; x_at: interpolated */
  double *absolute;                         /* tolerances */
  double *own_absolute;                     /* the same where states far below 1 are measured by their own size */
  double *x_sizes;                          /* largest magnitudes of the states so far */
  double *slopes[MOST_STAGES];
  double *bend, *x_whole; /* dense output: its term of fourth order; states at the end of the uncut step */
  double *zeros;
  double *z_start, *z_end, *z_at;     /* event indicators */
  double *input_values, *input_sizes; /* that the FMU holds, NAN where unknown; largest magnitudes so far */
  /* of sensitivities */
  double *seeds, *x_before, *slopes_before, *slopes_after, *x_work, *shifts; /* shifts: of the time of an event */
  double *z_event, *z_early, *z_late;
};

#endif
