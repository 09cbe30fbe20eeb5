"""The numbers that the core and those who lay down what it does agree on; the core's are checked when it is loaded."""

from __future__ import annotations

# How a binary takes the values of a variable. In FMI 2.0 a Real is a Float64, an Integer or enumeration an Int32.
WIRES = (
    *("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    *("Boolean", "String"),
)
FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN, STRING = range(len(WIRES))
N_WIRES = len(WIRES)

# What an operation does and what a report names: a setting function for each wire, a getting one for each, and these.
FAILURES = (
    *("SET_DERIVATIVES", "DO_STEP", "RESET", "SETUP", "ENTER_INITIALIZATION", "EXIT_INITIALIZATION"),
    *("ENTER_EVENT_MODE", "UPDATE_DISCRETE_STATES", "ENTER_STEP_MODE", "SET_TIME", "SET_STATES", "GET_STATES"),
    *("GET_NOMINALS", "GET_DERIVATIVES", "GET_INDICATORS", "ENTER_CONTINUOUS_TIME_MODE", "COMPLETED_STEP"),
    *("DIRECTIONAL_DERIVATIVE", "COPY", "SENSITIVITIES", "LOOP", "ENDED", "OUT_OF_RANGE", "STUCK", "ENDLESS_EVENT"),
    *("TOO_MANY_EVENTS", "TOO_MANY_STEPS", "STEP_TOO_SMALL", "STATE_NOT_FINITE", "STIFF", "CVODE_FAILED"),
    *("JUMP_UNKNOWN", "JUMP_REFUSED", "CANCELLED"),
)
(
    SET_DERIVATIVES,
    DO_STEP,
    RESET,
    SETUP,
    ENTER_INITIALIZATION,
    EXIT_INITIALIZATION,
    ENTER_EVENT_MODE,
    UPDATE_DISCRETE_STATES,
    ENTER_STEP_MODE,
    SET_TIME,
    SET_STATES,
    GET_STATES,
    GET_NOMINALS,
    GET_DERIVATIVES,
    GET_INDICATORS,
    ENTER_CONTINUOUS_TIME_MODE,
    COMPLETED_STEP,
    DIRECTIONAL_DERIVATIVE,
    COPY,  # not a call: one signal to another
    SENSITIVITIES,  # not a call but of the integrator's memory: sensitivities of outputs
    LOOP,  # of direct feed-through, not solved; the component is its number
    ENDED,  # by the FMU
    OUT_OF_RANGE,  # a value that the type of its variable cannot hold
    STUCK,  # steps return early again and again
    ENDLESS_EVENT,
    TOO_MANY_EVENTS,
    TOO_MANY_STEPS,
    STEP_TOO_SMALL,
    STATE_NOT_FINITE,
    STIFF,
    CVODE_FAILED,
    JUMP_UNKNOWN,
    JUMP_REFUSED,
    CANCELLED,
) = range(2 * N_WIRES, 2 * N_WIRES + len(FAILURES))
PROCESS = CANCELLED + 1  # the process that ran the FMU came to an end, or was ended

REPORT = 7
"""Words of the report of a simulation: failure (-1 without), component, status, sample, state; time and step as reals.

What a failure leaves open is -1, or not a number.
"""
UNDONE, DONE_WELL = -2, -1  # the status in a report of a simulation that is not over, or that nothing ended early
OK, WARNING, DISCARD, ERROR = range(4)  # statuses of the FMI; after an ERROR a reset is allowed

# What a thread is doing: nothing; making instances; simulating; trying whether a reset works; freeing its instances.
IDLE, PREPARING, SIMULATING, REPEATING, CLOSING = range(5)

HELD, BY_DERIVATIVE, BY_STEPPER, BY_MIDPOINT = range(4)  # what an input does between two samples

# When a value is set (bits): always; only where it changed, then in event mode; the same, but only after a step of the
# inputs; with a restart of the integrator where it changed; only at the communication points of its component.
ALWAYS, AS_EVENT, AT_STEPS, WITH_RESTART, LATCHED = 0, 1, 2, 4, 8
