"""Integration of model-exchange FMUs at native speed: fixed-step, adaptive and stiff, with state, step and time events.

`ModelExchange` lays out the memory of one instance. The compiled functions `begin`, `enter_events`, `leave_events` and
`advance` take its address and a time, and return 0 or, after a failure, another number. Call them at their
addresses (`advance.address`) from compiled loops, or as `advance.ctypes(address, time)`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmuid.errors import InputError
from fmuid.fmi import block as b
from fmuid.fmi.advance import MAX_EVENTS, MAX_STEPS, advance, begin, enter_events, leave_events
from fmuid.fmi.cvode import Solver
from fmuid.fmi.events import MAX_ITERATIONS
from fmuid.fmi.instance import status_word
from fmuid.fmi.runge_kutta import CLASSICAL, DORMAND_PRINCE, Tableau

__all__ = ["FUNCTIONS", "INTEGRATORS", "ModelExchange", "advance", "begin", "describe", "enter_events", "leave_events"]

# The FMI functions in the order of the block: name in FMI 2.0, which is the key without its prefix, and in FMI 3.0.
FUNCTIONS = {
    "SetTime": ("fmi2SetTime", "fmi3SetTime"),
    "SetReal": ("fmi2SetReal", "fmi3SetFloat64"),
    "SetContinuousStates": ("fmi2SetContinuousStates", "fmi3SetContinuousStates"),
    "GetDerivatives": ("fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"),
    "GetEventIndicators": ("fmi2GetEventIndicators", "fmi3GetEventIndicators"),
    "GetContinuousStates": ("fmi2GetContinuousStates", "fmi3GetContinuousStates"),
    "GetNominalsOfContinuousStates": ("fmi2GetNominalsOfContinuousStates", "fmi3GetNominalsOfContinuousStates"),
    "EnterEventMode": ("fmi2EnterEventMode", "fmi3EnterEventMode"),
    "NewDiscreteStates": ("fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"),
    "EnterContinuousTimeMode": ("fmi2EnterContinuousTimeMode", "fmi3EnterContinuousTimeMode"),
    "CompletedIntegratorStep": ("fmi2CompletedIntegratorStep", "fmi3CompletedIntegratorStep"),
    "GetDirectionalDerivative": ("fmi2GetDirectionalDerivative", "fmi3GetDirectionalDerivative"),
}
OPTIONAL = {"CompletedIntegratorStep", "GetDirectionalDerivative"}
INTEGRATORS = {"rk4": b.RK4, "rk45": b.RK45, "cvode": b.CVODE}
NO_REFERENCES: NDArray[np.uint32] = np.zeros(0, np.uint32)


class ModelExchange:
    """The memory of one model-exchange instance under integration.

    Parameters
    ----------
    version : int
        Of the FMI standard: 2 or 3.
    handle : int
        Address of the instance.
    functions : mapping of str to int
        Addresses of the FMI functions below the keys of `FUNCTIONS`. "CompletedIntegratorStep" may be left out
        (or 0) where the FMU does not need it, "GetDirectionalDerivative" where it has none.
    n_states, n_indicators : int
    integrator : {"rk45", "rk4", "cvode"}
        Dormand and Prince's method with step-size control, the classical method with equal steps, or CVODE's BDF.
    tolerance : float
        Relative tolerance of "rk45" and "cvode"; the absolute one of a state is that times its nominal value.
    step_size : float, optional
        Largest step, s; by default there is no bound but the wanted times.
    input_references : array of uint32, optional
        Value references of the inputs that have polynomials, one for an array of FMI 3.0.
    input_starts : (n_u,) array, optional
        One value for each element of these inputs, in their order: what those keep that are given no polynomial.
        Default: zero, one element a reference.
    state_references, derivative_references : (n_states,) array of uint32, optional
        Value references of states and derivatives, in their order, for the Jacobian of "cvode".
    magnitudes : (N,) array, optional
        Of the parameters whose sensitivities are integrated with the states (`fmuid.fmi.sensitivities`): their absolute
        tolerance is that of their state over the magnitude. The array may be filled in later.

    Attributes
    ----------
    address : int
        Of the block: the first argument of the compiled functions.
    coefficients : (n_u, 4) array
        Input j at time t is the polynomial in t - reals[block.ORIGIN] with these coefficients, lowest power first.
    words : (block.N_WORDS,) array of intp
        Counts (STEPS, EVENTS) and failures (FAILED_FUNCTION, FAILED_STATUS, BAD_STATE) are read here.
    reals : (block.N_REALS,) array
        ORIGIN and LIMIT are written, TIME and NEXT_EVENT may be read; all in s.

    Raises
    ------
    InputError
        If the integrator, its tolerance or step size is not one, if a required function is missing, or if there
        is no CVODE for this platform.
    """

    def __init__(
        self,
        version: int,
        handle: int,
        functions: Mapping[str, int],
        n_states: int,
        n_indicators: int,
        *,
        integrator: str = "rk45",
        tolerance: float = 1e-6,
        step_size: float | None = None,
        input_references: NDArray[np.uint32] = NO_REFERENCES,
        input_starts: NDArray[np.float64] | None = None,
        state_references: NDArray[np.uint32] = NO_REFERENCES,
        derivative_references: NDArray[np.uint32] = NO_REFERENCES,
        magnitudes: NDArray[np.float64] | None = None,
    ) -> None:
        _check(integrator, tolerance, step_size)
        tableau = CLASSICAL if integrator == "rk4" else DORMAND_PRINCE
        self.integrator, self.version = integrator, version
        self.words: NDArray[np.intp] = np.zeros(b.N_WORDS, np.intp)
        self.reals: NDArray[np.float64] = np.zeros(b.N_REALS)
        starts = np.zeros(len(input_references)) if input_starts is None else input_starts
        self.coefficients: NDArray[np.float64] = np.zeros((len(starts), 4))
        self.coefficients[:, 0] = starts
        self.reals[[b.LIMIT, b.TOLERANCE]] = -math.inf, tolerance
        self.reals[b.LARGEST_STEP] = math.inf if step_size is None else step_size
        n_total = n_states * (1 + (0 if magnitudes is None else len(magnitudes)))
        self._owned = self._lay_out(n_total, n_indicators, tableau)
        if magnitudes is not None:
            self._owned.append(magnitudes)
            self.words[b.MAGNITUDES] = magnitudes.ctypes.data
        references = (input_references, state_references, derivative_references)
        self._references = [np.ascontiguousarray(values, np.uint32) for values in references]
        fields = (b.INPUT_REFERENCES, b.STATE_REFERENCES, b.DERIVATIVE_REFERENCES)
        for field, values in zip(fields, self._references, strict=True):
            self.words[field] = values.ctypes.data
        self.words[[b.VERSION, b.HANDLE, b.INTEGRATOR]] = version, handle, INTEGRATORS[integrator]
        self.words[[b.N_STATES, b.N_TOTAL, b.N_INDICATORS]] = n_states, n_total, n_indicators
        self.words[[b.N_INPUTS, b.N_INPUT_REFERENCES]] = len(starts), len(input_references)
        self.words[b.N_STAGES] = len(tableau.nodes)
        for i, (name, in_version) in enumerate(FUNCTIONS.items()):
            self.words[b.FUNCTIONS + i] = functions.get(name, 0)
            if not functions.get(name, 0) and name not in OPTIONAL:
                raise InputError(f"the FMU's binary lacks {in_version[version - 2]}, which model exchange requires")
        if len(state_references) != n_states or len(derivative_references) != n_states:
            self.words[b.FUNCTIONS + b.DIRECTIONAL_DERIVATIVE] = 0
        self.address = int(self.words.ctypes.data)
        self._solver = Solver(self.words, self.reals[b.LARGEST_STEP]) if integrator == "cvode" and n_states else None

    def describe(self, states: Sequence[str] = ()) -> str:
        """Return in words what failed last, with the remedy; `states` are the names of the states, in their order."""
        bad = int(self.words[b.BAD_STATE])
        return describe(
            int(self.words[b.FAILED_FUNCTION]),
            int(self.words[b.FAILED_STATUS]),
            self.version,
            self.integrator,
            states[bad] if bad < len(states) else f"number {bad + 1}",
            float(self.reals[b.STEP_END]),
            float(self.reals[b.H]),
        )

    def _lay_out(self, n_total: int, n_indicators: int, tableau: Tableau) -> list[NDArray[Any]]:
        """Allocate the work arrays and write their addresses into the block."""
        n_inputs = len(self.coefficients)
        arrays: dict[int, NDArray[Any]] = {
            b.REALS: self.reals,
            b.COEFFICIENTS: self.coefficients,
            b.NODES: tableau.nodes,
            b.WEIGHTS: tableau.weights,
            b.FLAGS: np.zeros(16, np.int32),
            b.INPUT_VALUES: np.zeros(n_inputs),
            b.INPUT_SCALES: np.zeros(n_inputs),
            b.SLOPES: np.zeros((len(tableau.nodes), n_total)),
            b.DENSE: np.zeros((2, n_total)),
        }
        arrays |= {f: np.zeros(n_total) for f in (b.X_START, b.X_END, b.X_STAGE, b.X_AT, b.ABSOLUTE)}
        arrays |= {f: np.zeros(n_indicators) for f in (b.Z_START, b.Z_END, b.Z_AT)}
        for field, array in arrays.items():
            self.words[field] = array.ctypes.data
        return list(arrays.values())


def describe(function: int, status: int, version: int, integrator: str, state: str, time: float, step: float) -> str:
    """Return a failure in words, with the remedy.

    Parameters
    ----------
    function, status : int
        The words FAILED_FUNCTION and FAILED_STATUS of the block.
    version : int
        Of the FMI standard.
    integrator : str
    state : str
        Name of the state that the word BAD_STATE numbers.
    time, step : float
        Where the integrator got, and the step that it tried last, s.
    """
    if function < b.N_FUNCTIONS:
        name = list(FUNCTIONS.values())[function][version - 2]
        again = ", however small the step" if status == b.DISCARD else ""
        return f"{name} returned {status_word(version, status)}{again}"
    smaller = "give a smaller step_size" if integrator == "rk4" else "give a step_size or another tolerance"
    return {
        b.STEP_TOO_SMALL: f"integrator {integrator} finds no step short enough for its tolerance at t = {time:.9g} s "
        f"(the last one {step:.2g} s; state {state} errs most): the model has a "
        'discontinuity without an event, or is stiff; choose integrator = "cvode" or a larger tolerance',
        b.STATE_NOT_FINITE: f"state {state} or its derivative is not a finite number; {smaller}, or keep the "
        "parameters within bounds where the model has a meaning",
        b.EVENT_ITERATION_DIVERGES: f"an event does not come to rest in {MAX_ITERATIONS} iterations of its discrete "
        "states; the model has to be mended",
        b.TERMINATED_BY_FMU: "the FMU asked to terminate the simulation",
        b.TOO_MANY_STEPS: f"integrator {integrator} needs more than {MAX_STEPS} steps between two samples (it got to "
        f"t = {time:.9g} s with steps of {step:.2g} s); choose "
        'integrator = "cvode" or a larger tolerance',
        b.TOO_MANY_EVENTS: f"there are more than {MAX_EVENTS} events between two samples: the model chatters; give it "
        "a hysteresis, or more samples",
        b.JUMP_UNKNOWN: "an event changes the states or their derivatives, and directional derivatives do not tell "
        "how the sensitivities change",
        b.JUMP_REFUSED: "the sensitivities cannot be carried through an event: the states only touch its threshold, or "
        "it is none for parameters that differ a little",
        b.STIFF: f'integrator rk45 finds the model stiff at t = {time:.9g} s; choose integrator = "cvode"',
        b.CVODE_FAILED: f"CVODE gives up at t = {time:.9g} s with flag {status}{_CVODE_WORDS.get(status, '')}; "
        f'{smaller}, or choose integrator = "rk45"',
    }[function]


# The flags of cvode/cvode.h that an FMU can cause.
_CVODE_WORDS = {
    -1: " (too many steps)",
    -2: " (more accuracy asked for than the numbers have)",
    -3: " (the error test fails again and again)",
    -4: " (its corrector does not converge)",
    -6: " (no Jacobian)",
    -7: " (the Jacobian is singular)",
}


def _check(integrator: str, tolerance: float, step_size: float | None) -> None:
    if integrator not in INTEGRATORS:
        raise InputError(f'integrator = "{integrator}" is none; choose one of {", ".join(INTEGRATORS)}')
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"tolerance = {tolerance:g} must lie between 0 and 1")
    if step_size is not None and not 0.0 < step_size < math.inf:
        raise InputError(f"step_size = {step_size:g} must be a positive number of seconds")
