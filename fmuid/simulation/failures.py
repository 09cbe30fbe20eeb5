"""Reports of the core as sentences; FMI functions of codes."""

from __future__ import annotations

from fmuid.simulation import codes

STATUS_WORDS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

_SAME = {
    codes.DO_STEP: "DoStep",
    codes.RESET: "Reset",
    codes.ENTER_INITIALIZATION: "EnterInitializationMode",
    codes.EXIT_INITIALIZATION: "ExitInitializationMode",
    codes.ENTER_EVENT_MODE: "EnterEventMode",
    codes.SET_TIME: "SetTime",
    codes.SET_STATES: "SetContinuousStates",
    codes.GET_STATES: "GetContinuousStates",
    codes.GET_NOMINALS: "GetNominalsOfContinuousStates",
    codes.GET_INDICATORS: "GetEventIndicators",
    codes.ENTER_CONTINUOUS_TIME_MODE: "EnterContinuousTimeMode",
    codes.COMPLETED_STEP: "CompletedIntegratorStep",
    codes.DIRECTIONAL_DERIVATIVE: "GetDirectionalDerivative",
}
_OWN = {
    2: {
        codes.SET_DERIVATIVES: "SetRealInputDerivatives",
        codes.SETUP: "SetupExperiment",
        codes.UPDATE_DISCRETE_STATES: "NewDiscreteStates",
        codes.GET_DERIVATIVES: "GetDerivatives",
    },
    3: {
        codes.UPDATE_DISCRETE_STATES: "UpdateDiscreteStates",
        codes.ENTER_STEP_MODE: "EnterStepMode",
        codes.GET_DERIVATIVES: "GetContinuousStateDerivatives",
    },
}
_TYPES = {
    2: {codes.FLOAT64: "Real", codes.INT32: "Integer", codes.BOOLEAN: "Boolean", codes.STRING: "String"},
    3: dict(enumerate(codes.WIRES)),
}

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
    if 0 <= code < 2 * codes.N_WIRES:
        name = _TYPES[version].get(code % codes.N_WIRES)
        return name and ("Set" if code < codes.N_WIRES else "Get") + name
    return _OWN[version].get(code) or _SAME.get(code)


def describe(
    failure: int,
    status: int,
    version: int,
    integrator: str = "",
    state: str = "",
    at: tuple[float, float] = (0, 0),
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
        codes.SENSITIVITIES: "the FMU has no directional derivatives of its outputs",
        codes.ENDED: "the FMU ended the simulation",
        codes.OUT_OF_RANGE: "a value is out of range for the type of its variable",
        codes.STUCK: f"fmi{version}DoStep returns early repeatedly, without progress",
        codes.ENDLESS_EVENT: "an event does not settle in 100 iterations of its discrete states. Correct the model",
        codes.ENDLESS_ROUNDS: "events of connected components trigger each other endlessly (20 rounds at one time). "
        "Add a hysteresis or a delay to one of them",
        codes.TOO_MANY_EVENTS: "more than 10000 events between two samples: the model chatters. Add a hysteresis",
        codes.TOO_MANY_STEPS: f"solver {integrator} needs more than max_solver_steps between two samples (at "
        f't = {time:.9g} s, steps of {step:.2g} s). Choose solver = "cvode" or a larger tolerance',
        codes.STEP_TOO_SMALL: f"solver {integrator} cannot meet its tolerance at t = {time:.9g} s "
        f"(state {state}, step {step:.2g} s). The model is stiff or has a discontinuity without event: "
        'choose solver = "cvode" or a larger tolerance',
        codes.STATE_NOT_FINITE: f"state {state} or its derivative is not finite. {smaller}, or add bounds to the "
        "parameters",
        codes.STIFF: f'the model is stiff for solver rk45 at t = {time:.9g} s. Choose solver = "cvode"',
        codes.CVODE_FAILED: f"CVODE fails at t = {time:.9g} s with flag {status}{_CVODE_WORDS.get(status, '')}. "
        f'{smaller}, or choose solver = "rk45"',
        codes.JUMP_UNKNOWN: "an event changes states or their derivatives; directional derivatives do not show the "
        "change of sensitivities",
        codes.JUMP_REFUSED: "sensitivities are undefined at an event: the states only touch its threshold",
        codes.CANCELLED: "it was cancelled",
    }[failure]


def _hint(failure: int, status: int) -> str:
    if status != codes.DISCARD:
        return ""
    if failure in (codes.SET_STATES, codes.GET_DERIVATIVES, codes.GET_INDICATORS):
        return ", also with the smallest steps"
    return " (the FMU cannot go on from here)" if failure == codes.DO_STEP else ""
