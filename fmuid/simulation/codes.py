"""Numbers shared with the core, which are checked when it is loaded."""

from __future__ import annotations

# How a binary takes the values of a variable. In FMI 2.0 a Real is a Float64, an Integer or enumeration an Int32.
WIRES = (
    *("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    *("Boolean", "String"),
)
FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN, STRING = range(len(WIRES))
N_WIRES = len(WIRES)

# What an operation does and what a report names: a setting function for each wire, a getting one for each, other
# functions of the FMI, and what else there is to do or may go wrong. `fmuid.simulation.native.library` compares them
# with the core's.
SET_DERIVATIVES, DO_STEP, RESET, SETUP, ENTER_INITIALIZATION, EXIT_INITIALIZATION = range(24, 30)
ENTER_EVENT_MODE, UPDATE_DISCRETE_STATES, ENTER_STEP_MODE, SET_TIME, SET_STATES, GET_STATES = range(30, 36)
GET_NOMINALS, GET_DERIVATIVES, GET_INDICATORS, ENTER_CONTINUOUS_TIME_MODE, COMPLETED_STEP = range(36, 41)
# The last three are no calls: one signal to another; sensitivities of outputs, from the integrator's memory; an
# algebraic loop that was not solved, whose number is the component.
DIRECTIONAL_DERIVATIVE, COPY, SENSITIVITIES, LOOP = range(41, 45)
ENDED, OUT_OF_RANGE, STUCK = 45, 46, 47  # by the FMU; for the type of its variable; steps return early for ever
ENDLESS_EVENT, ENDLESS_ROUNDS = 48, 49  # of one component; of several that cause each other's
TOO_MANY_EVENTS, TOO_MANY_STEPS, STEP_TOO_SMALL, STATE_NOT_FINITE, STIFF, CVODE_FAILED = range(50, 56)
JUMP_UNKNOWN, JUMP_REFUSED, CANCELLED, PROCESS = range(56, 60)  # PROCESS: it ended; none of the core's

REPORT = 7
"""Words of the report of a simulation: failure (-1 without), component, status, sample, state; time and step as reals.

Unknown words are -1 or NaN.
"""
UNDONE, DONE_WELL = -2, -1  # the status in a report of a simulation that is not over, or that nothing ended early
OK, WARNING, DISCARD, ERROR, FATAL = range(5)  # statuses of the FMI; after an ERROR a reset is allowed

# What a thread is doing: nothing; making instances; simulating; trying whether a reset works; freeing its instances.
IDLE, PREPARING, SIMULATING, REPEATING, CLOSING = range(5)

HELD, BY_DERIVATIVE, BY_STEPPER, BY_MIDPOINT = range(4)  # what an input does between two samples

# When a value is set (bits): always; only where it changed, then in event mode; the same, but only after a step of the
# inputs; with a restart of the integrator where it changed; only at the communication points of its component.
ALWAYS, AS_EVENT, AT_STEPS, WITH_RESTART, LATCHED = 0, 1, 2, 4, 8
