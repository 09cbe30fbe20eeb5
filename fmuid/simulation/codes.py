"""Numbers shared with the core, which are checked when it is loaded; FMI functions and failures as words."""

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

STATUS_WORDS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

_SAME = {
    DO_STEP: "DoStep",
    RESET: "Reset",
    ENTER_INITIALIZATION: "EnterInitializationMode",
    EXIT_INITIALIZATION: "ExitInitializationMode",
    ENTER_EVENT_MODE: "EnterEventMode",
    SET_TIME: "SetTime",
    SET_STATES: "SetContinuousStates",
    GET_STATES: "GetContinuousStates",
    GET_NOMINALS: "GetNominalsOfContinuousStates",
    GET_INDICATORS: "GetEventIndicators",
    ENTER_CONTINUOUS_TIME_MODE: "EnterContinuousTimeMode",
    COMPLETED_STEP: "CompletedIntegratorStep",
    DIRECTIONAL_DERIVATIVE: "GetDirectionalDerivative",
}
_OWN = {
    2: {
        SET_DERIVATIVES: "SetRealInputDerivatives",
        SETUP: "SetupExperiment",
        UPDATE_DISCRETE_STATES: "NewDiscreteStates",
        GET_DERIVATIVES: "GetDerivatives",
    },
    3: {
        UPDATE_DISCRETE_STATES: "UpdateDiscreteStates",
        ENTER_STEP_MODE: "EnterStepMode",
        GET_DERIVATIVES: "GetContinuousStateDerivatives",
    },
}
_TYPES = {2: {FLOAT64: "Real", INT32: "Integer", BOOLEAN: "Boolean", STRING: "String"}, 3: dict(enumerate(WIRES))}

# The flags of cvode/cvode.h that an FMU can cause.
_CVODE_WORDS = {
    -1: " (too many steps)",
    -2: " (tolerance below rounding)",
    -3: " (repeated error test failures)",
    -4: " (corrector does not converge)",
    -6: " (no Jacobian)",
    -7: " (the Jacobian is singular)",
}


def function_name(version: int, code: int) -> str | None:
    """Return the FMI function of a code, without prefix; None without one."""
    if 0 <= code < 2 * N_WIRES:
        name = _TYPES[version].get(code % N_WIRES)
        return name and ("Set" if code < N_WIRES else "Get") + name
    return _OWN[version].get(code) or _SAME.get(code)


def describe(
    failure: int, status: int, version: int, integrator: str = "", state: str = "", at: tuple[float, float] = (0, 0)
) -> str:
    """Describe a failure, with its remedy if known.

    `failure` and `status` are from the report; `integrator` is empty for Co-Simulation.
    `state` is to blame; `at` is the time and the last solver step, s.
    """
    name = function_name(version, failure)
    if name is not None:
        known = 0 <= status < len(STATUS_WORDS)
        said = f"fmi{version}{STATUS_WORDS[status]}" if known else f"the illegal status {status}"
        return f"fmi{version}{name} returned {said}{_hint(failure, status)}"
    time, step = at
    smaller = "Give a smaller step_size" if integrator == "rk4" else "Give a step_size or another tolerance"
    return {
        SENSITIVITIES: "the FMU has no directional derivatives of its outputs",
        ENDED: "the FMU ended the simulation",
        OUT_OF_RANGE: "a value is out of range for the type of its variable",
        STUCK: f"fmi{version}DoStep returns early repeatedly, without progress",
        ENDLESS_EVENT: "an event does not settle in 100 iterations of its discrete states. Correct the model",
        ENDLESS_ROUNDS: "events of connected components trigger each other endlessly (20 rounds at one time). "
        "Add a hysteresis or a delay to one of them",
        TOO_MANY_EVENTS: "more than 10000 events between two samples: the model chatters. Add a hysteresis",
        TOO_MANY_STEPS: f"solver {integrator} needs more than max_solver_steps between two samples (at "
        f't = {time:.9g} s, steps of {step:.2g} s). Choose solver = "cvode" or a larger tolerance',
        STEP_TOO_SMALL: f"solver {integrator} cannot meet its tolerance at t = {time:.9g} s "
        f"(state {state}, step {step:.2g} s). The model is stiff or has a discontinuity without event: "
        'choose solver = "cvode" or a larger tolerance',
        STATE_NOT_FINITE: f"state {state} or its derivative is not finite. {smaller}, or add bounds to the parameters",
        STIFF: f'the model is stiff for solver rk45 at t = {time:.9g} s. Choose solver = "cvode"',
        CVODE_FAILED: f"CVODE fails at t = {time:.9g} s with flag {status}{_CVODE_WORDS.get(status, '')}. "
        f'{smaller}, or choose solver = "rk45"',
        JUMP_UNKNOWN: "an event changes states or their derivatives; directional derivatives do not show the "
        "change of sensitivities",
        JUMP_REFUSED: "sensitivities are undefined at an event: the states only touch its threshold",
        CANCELLED: "it was cancelled",
    }[failure]


def _hint(failure: int, status: int) -> str:
    if status != DISCARD:
        return ""
    if failure in (SET_STATES, GET_DERIVATIVES, GET_INDICATORS):
        return ", also with the smallest steps"
    return " (the FMU cannot go on from here)" if failure == DO_STEP else ""
