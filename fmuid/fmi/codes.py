"""The numbers that the compiled loops and those who lay down what they do agree on: codes, columns, places in memory.

Nothing is compiled here: who only plans a simulation that another process runs needs no more than this.
"""

from __future__ import annotations

# How a binary takes the values of a variable. In FMI 2.0 a Real is a Float64, an Integer or enumeration an Int32.
WIRES = (
    *("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    *("Boolean", "String"),
)
FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN, STRING = range(len(WIRES))

# Places in a component's row of addresses: a setting function for each way of passing values, then the getting ones,
# then the rest.
N_WIRES = len(WIRES)
(
    SET_DERIVATIVES,
    DO_STEP,
    RESET,
    SETUP,
    ENTER_INITIALIZATION,
    EXIT_INITIALIZATION,
    GET_REAL_STATUS,
    GET_BOOLEAN_STATUS,
) = range(2 * N_WIRES, 2 * N_WIRES + 8)
N_FUNCTIONS = 2 * N_WIRES + 8
COPY = N_FUNCTIONS  # not a call: one signal to another
LOOP = N_FUNCTIONS + 1  # in a report: a loop of direct feed-through that was not solved
ENDED = N_FUNCTIONS + 3  # in a report: the FMU ended the simulation
SENSITIVITIES = N_FUNCTIONS + 2  # not a call of the FMU but of its stepper: sensitivities of outputs
PROCESS = N_FUNCTIONS + 4  # in a report: the process that ran the FMU came to an end, or was ended
STEPPER = 100  # in a report: this and above, what a stepper calls its failures
UNDONE = -2  # the status in a report of a simulation that is not over

# What a worker is doing: nothing; making instances and compiled code; simulating; trying whether a reset works;
# freeing its instances.
IDLE, PREPARING, SIMULATING, REPEATING, CLOSING = range(5)

HELD, BY_DERIVATIVE, BY_STEPPER, BY_MIDPOINT = range(4)  # what an input does between two samples
WARNING, DISCARD, ERROR = 1, 2, 3  # the last status that counts as success; the last after which a reset is allowed

# When a value is set (bits): always; only where it changed, then in event mode; the same, but only after a step of the
# inputs; with a restart of the integrator where it changed; only at the communication points of its component.
ALWAYS, AS_EVENT, AT_STEPS, WITH_RESTART, LATCHED = 0, 1, 2, 4, 8

# Columns of the table of calls: one row an operation, with the addresses that the operation needs.
COLUMNS = 15
(
    ADDRESS,
    HANDLE,
    REFERENCES,
    COUNT,  # of value references
    VALUES,
    N_VALUES,
    WIRE,
    MORE,  # 1: the function wants the number of values too (FMI 3.0)
    ORDERS,
    FUNCTION,
    COMPONENT,
    SIGNAL,
    WHEN,
    LAST,
    KIND,  # of the call, so that the usual ones are told at one glance
) = range(COLUMNS)
PLAIN, SLOPES, OTHER = range(3)  # four arguments, at once; with the orders of derivatives, at once; anything else

# Columns of the table of steppers, one row a component; all zero but the version for co-simulation by FMI 2.0.
STEPPER_COLUMNS = 9
VERSION, BLOCK, BEGIN, ENTER_EVENTS, LEAVE_EVENTS, ADVANCE, ORIGIN, FRESH, FAILURE = range(STEPPER_COLUMNS)

# Columns of the table of loops of direct feed-through: operations that get and copy, and that set; the unknowns'
# number, their signals, and work memory.
LOOP_COLUMNS = 6
LOOP_GET, LOOP_SET, LOOP_END, LOOP_COUNT, LOOP_SIGNALS, LOOP_WORK = range(LOOP_COLUMNS)

# The memory of one simulation: sizes and addresses of all that the loop touches, in one array whose address is `m`.
FIELDS = 61
(
    N_COMPONENTS,
    N_INPUTS,
    N_OUTPUTS,
    N_TIMES,
    N_SIGNALS,
    N_PARAMETERS,
    N_STEPPERS,
    STAGES,
    CALLS,
    SIGNALS,
    START_SIGNALS,
    CONVERSIONS,
    HANDLES,
    ADDRESSES,
    USED,
    TOLERANCES,
    TIMES,
    SUBSTEPS,
    STRIDES,
    OWN_TIMES,
    INPUTS,
    INPUT_SIGNALS,
    INPUT_MODES,
    INPUT_SLOPES,
    CURVES,
    DERIVATIVE_SIGNALS,
    OUTPUT_SIGNALS,
    OUTPUT_TERMS,
    OUTPUTS,
    REPORT,
    DIRECT_INPUTS,
    DIRECT_OUTPUTS,
    THETAS,
    PARAMETER_SIGNALS,
    STEPPERS,
    IN_EVENT,
    NOW,
    STEPPED,
    SUBSTEP,
    LOOPS,
    GROUPS,
    N_GROUPS,
    GAUSS_SEIDEL,
    SCRATCH,
    RESTORING,  # the address of fesetenv, and the floating-point environment that it puts back
    FLOATS,
    FROM,  # reals: the component's step that is to be taken, and the substep in the interval between the samples
    UNTIL,
    AFTER,
    LENGTH,
    BEFORE_SETTING,  # from here on hooks: compiled functions int32(m, row or number); 0 where they have no use
    TO_WIRE,
    FROM_WIRE,
    SETTLE,
    EXCHANGE,
    BEGIN_STEPPER,
    ADVANCE_STEPPER,
    TELL_ORIGIN,
    BEND,
    CHORDS,
    AFTER_DISCARD,
) = range(FIELDS)
RUNNING, IN_EVENTS, INITIALIZING = range(3)  # what IN_EVENT says of a component with a stepper
GO, SKIP, FAILED = 0, 1, 2  # what a hook returns
