"""Integrators over the hybrid probes."""

import ctypes
from collections.abc import Callable
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from fmuid.simulation.codes import describe
from fmuid.simulation.native.library import core
from fmuid.simulation.simulation_plan import Integration
from fmuid.simulation.solver import IntegratedModel, Integrator, function_table

# As in probe/hybrid.c.
BALL, TRIANGLE, ROBERTSON, VAN_DER_POL, LINEAR, CHATTER, STAIRS, DECAY, SWITCH = range(9)
X, DX, P, U = 0, 3, 6, 10
(COUNT, EVENT_TIME, TERMINATE_AT, STEP_EVENT_AT, FAIL_AT, ENDLESS, BROKEN_JACOBIAN, NOMINAL, CALLS, BACKWARDS) = range(
    13, 23
)
INTEGRATORS: list[dict[str, Any]] = [
    {"integrator": "rk4", "step_size": 1e-3},
    {"integrator": "rk45", "tolerance": 1e-10},
    {"integrator": "cvode", "tolerance": 1e-10},
]
every_integrator = pytest.mark.parametrize("settings", INTEGRATORS, ids=lambda settings: settings["integrator"])
Libraries = dict[int, ctypes.CDLL]


class Failure(Exception):  # noqa: N818  # it is no error of the test
    """What the core reported; its first argument is the failing function or condition."""


class Trial:
    """One instance of a test model under an integrator."""

    def __init__(
        self,
        library: ctypes.CDLL,
        version: int,
        model: int,
        x: ArrayLike = (),
        p: ArrayLike = (),
        *,
        n_inputs: int = 0,
        without: tuple[str, ...] = ("GetDirectionalDerivative",),
        straight: bool = False,
        **settings: Any,
    ) -> None:
        self.library = library
        self.handle = ctypes.c_void_p(library.make(model))
        self.start = np.atleast_1d(np.asarray(x, float))

        def address_of(name: str) -> int:
            found = getattr(library, f"fmi{version}{name}", None) if name not in without else None
            return 0 if found is None else ctypes.cast(found, ctypes.c_void_p).value or 0

        self.numbers = np.ctypeslib.as_array(ctypes.cast(self.handle, ctypes.POINTER(ctypes.c_double)), (23,))
        self.numbers[P : P + np.size(p)] = p
        n = library.n_states(self.handle)
        self.integrator = settings.get("integrator", "rk45")
        inputs = np.arange(U, U + n_inputs, dtype=np.uint32)
        instance = IntegratedModel(
            version,
            self.handle.value or 0,
            function_table(version, address_of),
            n,
            library.n_indicators(self.handle),
            np.arange(X, X + n, dtype=np.uint32),
            np.arange(DX, DX + n, dtype=np.uint32),
        )
        integration = Integration(inputs=inputs, input_starts=np.zeros(n_inputs), **settings)
        self.memory = Integrator(instance, integration, straight=straight)

    def begin(self, t: float = 0.0) -> Self:
        self.library.rewind_to_event_mode(self.handle)
        self.numbers[X : X + len(self.start)] = self.start
        self.call("begin", t)
        self.call("leave_events", t)
        return self

    def call(self, function: str, t: float) -> None:
        if getattr(core(), f"integrator_{function}")(self.memory.handle, t) != 0:
            report = self.memory.state.report
            raise Failure(report.failure, report.status, self.memory.state.time)

    def describe(self, states: tuple[str, ...] = ()) -> str:
        state, report = self.memory.state, self.memory.state.report
        name = states[report.state] if 0 <= report.state < len(states) else ""
        return describe(report.failure, report.status, 2, self.integrator, name, (state.step_end, state.next_step))

    def advance(self, t: float) -> NDArray[np.float64]:
        """Return the states that the FMU holds at t."""
        self.call("advance", t)
        assert self.memory.state.time == t
        return self.numbers[X : X + self.memory.state.how.n_states].copy()

    def trajectory(self, times: ArrayLike) -> NDArray[np.float64]:
        return np.array([self.advance(t) for t in np.asarray(times, float).tolist()])


Maker = Callable[..., Trial]


def van_der_pol(times: ArrayLike, mu: float, x: tuple[float, float] = (2.0, 0.0)) -> NDArray[np.float64]:
    """Return scipy's solution at the times, (len(times), 2)."""

    def slope(_t: float, x: NDArray[np.float64]) -> list[float]:
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    def jacobian(_t: float, x: NDArray[np.float64]) -> list[list[float]]:
        return [[0, 1], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]]

    times = np.asarray(times, float)
    if mu > 100:
        return solve_ivp(slope, (0, times[-1]), x, "Radau", times, rtol=1e-10, atol=1e-13, jac=jacobian).y.T
    return solve_ivp(slope, (0, times[-1]), x, "DOP853", times, rtol=1e-12, atol=1e-13).y.T
