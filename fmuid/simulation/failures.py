"""What a report of the core says, in words; and which FMI function each of its codes stands for."""

from __future__ import annotations

from fmuid.simulation import core_constants as k

STATUS_WORDS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

_SAME = {
    k.DO_STEP: "DoStep",
    k.RESET: "Reset",
    k.ENTER_INITIALIZATION: "EnterInitializationMode",
    k.EXIT_INITIALIZATION: "ExitInitializationMode",
    k.ENTER_EVENT_MODE: "EnterEventMode",
    k.SET_TIME: "SetTime",
    k.SET_STATES: "SetContinuousStates",
    k.GET_STATES: "GetContinuousStates",
    k.GET_NOMINALS: "GetNominalsOfContinuousStates",
    k.GET_INDICATORS: "GetEventIndicators",
    k.ENTER_CONTINUOUS_TIME_MODE: "EnterContinuousTimeMode",
    k.COMPLETED_STEP: "CompletedIntegratorStep",
    k.DIRECTIONAL_DERIVATIVE: "GetDirectionalDerivative",
}
_OWN = {
    2: {
        k.SET_DERIVATIVES: "SetRealInputDerivatives",
        k.SETUP: "SetupExperiment",
        k.UPDATE_DISCRETE_STATES: "NewDiscreteStates",
        k.GET_DERIVATIVES: "GetDerivatives",
    },
    3: {
        k.UPDATE_DISCRETE_STATES: "UpdateDiscreteStates",
        k.ENTER_STEP_MODE: "EnterStepMode",
        k.GET_DERIVATIVES: "GetContinuousStateDerivatives",
    },
}
_TYPES = {
    2: {k.FLOAT64: "Real", k.INT32: "Integer", k.BOOLEAN: "Boolean", k.STRING: "String"},
    3: dict(enumerate(k.WIRES)),
}

# The flags of cvode/cvode.h that an FMU can cause.
_CVODE_WORDS = {
    -1: " (too many steps)",
    -2: " (more accuracy asked for than the numbers have)",
    -3: " (the error test fails again and again)",
    -4: " (its corrector does not converge)",
    -6: " (no Jacobian)",
    -7: " (the Jacobian is singular)",
}


def function_name(version: int, code: int) -> str | None:
    """Return the FMI function, without prefix, that a code stands for; None if the version has none."""
    if 0 <= code < 2 * k.N_WIRES:
        name = _TYPES[version].get(code % k.N_WIRES)
        return name and ("Set" if code < k.N_WIRES else "Get") + name
    return _OWN[version].get(code) or _SAME.get(code)


def status_word(version: int, status: int) -> str:
    """Return a status as the standard calls it."""
    if 0 <= status < len(STATUS_WORDS):
        return f"fmi{version}{STATUS_WORDS[status]}"
    return f"the illegal status {status}"


def describe(
    failure: int, status: int, version: int, integrator: str = "", state: str = "", time: float = 0.0, step: float = 0.0
) -> str:
    """Return a failure in words, with the remedy where there is one.

    Parameters
    ----------
    failure, status : int
        From the report; `failure` is none of `codes.LOOP` and `codes.PROCESS`, which are not of one component.
    version : int
        Of FMI.
    integrator : str
        Of model exchange; empty for co-simulation.
    state : str
        Name of the state to blame.
    time, step : float
        That the integrator had reached, and the step that it tried last, s.
    """
    name = function_name(version, failure)
    if name is not None:
        return f"fmi{version}{name} returned {status_word(version, status)}{_hint(failure, status)}"
    smaller = "give a smaller step_size" if integrator == "rk4" else "give a step_size or another tolerance"
    return {
        k.SENSITIVITIES: "the FMU gives no directional derivatives of its outputs",
        k.ENDED: "the FMU ended the simulation",
        k.OUT_OF_RANGE: "a value is not within the range of the type of its variable",
        k.STUCK: f"fmi{version}DoStep returns early again and again without getting on",
        k.ENDLESS_EVENT: "an event does not come to rest in 100 iterations of its discrete states; the model has to be "
        "mended",
        k.ENDLESS_ROUNDS: "events of connected components cause one another without end (20 rounds at one time); give "
        "one of them a hysteresis or a delay",
        k.TOO_MANY_EVENTS: "there are more than 10000 events between two samples: the model chatters; give it a "
        "hysteresis, or more samples",
        k.TOO_MANY_STEPS: f"integrator {integrator} needs more than most_steps between two samples (it got to "
        f't = {time:.9g} s with steps of {step:.2g} s); choose solver = "cvode" or a larger tolerance',
        k.STEP_TOO_SMALL: f"integrator {integrator} finds no step short enough for its tolerance at t = {time:.9g} s "
        f"(the last one {step:.2g} s; state {state} errs most): the model has a "
        'discontinuity without an event, or is stiff; choose solver = "cvode" or a larger tolerance',
        k.STATE_NOT_FINITE: f"state {state} or its derivative is not a finite number; {smaller}, or keep the "
        "parameters within bounds where the model has a meaning",
        k.STIFF: f'integrator rk45 finds the model stiff at t = {time:.9g} s; choose solver = "cvode"',
        k.CVODE_FAILED: f"CVODE gives up at t = {time:.9g} s with flag {status}{_CVODE_WORDS.get(status, '')}; "
        f'{smaller}, or choose solver = "rk45"',
        k.JUMP_UNKNOWN: "an event changes the states or their derivatives, and directional derivatives do not tell "
        "how the sensitivities change",
        k.JUMP_REFUSED: "the sensitivities cannot be carried through an event: the states only touch its threshold, or "
        "it is none for parameters that differ a little",
        k.CANCELLED: "it was cancelled",
    }[failure]


def _hint(failure: int, status: int) -> str:
    if status != k.DISCARD:
        return ""
    if failure in (k.SET_STATES, k.GET_DERIVATIVES, k.GET_INDICATORS):
        return ", however small the step"
    return " (the FMU cannot go on from here)" if failure == k.DO_STEP else ""
