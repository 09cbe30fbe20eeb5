"""A model at points of its states and inputs: derivatives, outputs, and their matrices A, B, C, D."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.data import Experiment
from fmuid.models import System
from fmuid.simulation.forward_simulation import gives_derivatives
from fmuid.simulation.right_hand_side import RightHandSide
from fmuid.simulation.simulation_task import Value
from fmuid.simulation.simulator import Simulator


@dataclass(frozen=True)
class PointSettings:
    """Numbers of differences at points."""

    step: float = 1e-4  # relative to state or nominal value: curvature leaves 1e-8 of a derivative, rounding less
    input_step: float = 1e-4  # relative to the input, or absolute at zero
    kink: float = 1e-2  # relative difference of the derivatives of both sides of an event, ...
    shorter: float = 0.25  # ... which stays at so much of the step; that of a curve shrinks with it
    rounding: float = 1e-9
    allowed: float = 1e-3  # relative difference of directional derivatives from differences


SETTINGS = PointSettings()


@dataclass(frozen=True)
class ModelOfPoints:
    """System with parameters and held values, to be evaluated at points."""

    system: System
    parameters: tuple[str, ...]
    values: Mapping[str, Value]
    source: str

    def simulator(
        self,
        inputs: Mapping[str, Floats],
        outputs: Sequence[str],
        units: Mapping[str, str],
        times: Floats | None = None,
    ) -> Simulator:
        """Return the simulator of rows (P,), by default 1 s apart."""
        count = len(next(iter(inputs.values()), np.zeros(2)))
        frame = pd.DataFrame({"time": np.arange(float(count)) if times is None else times, **inputs})
        names = list(inputs), list(outputs)
        made = Experiment(frame, *names, interpolation="zoh", units=units, measured=False, source=self.source)
        return Simulator(self.system, made, self.parameters, values=self.values)


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Linear models of operating points, for thetas: ẋ = A x + B u, y = C x + D u."""

    a: Floats  # (m, K, n_x, n_x)
    b: Floats  # (m, K, n_x, n_u)
    c: Floats  # (m, K, n_y, n_x)
    d: Floats  # (m, K, n_y, n_u)
    rates: Floats  # (m, K, n_x), ẋ at the points
    outputs: Floats  # (m, K, n_y)

    def of(self, which: Any) -> StateSpace:
        """Return the models of some thetas, or of thetas and rows."""
        return StateSpace(*(each[which] for each in vars(self).values()))

    def replaced(self, which: Flags, other: StateSpace) -> StateSpace:
        """Return them with other models of some thetas, or of rows."""
        parts = [each.copy() for each in vars(self).values()]
        for part, new in zip(parts, vars(other).values(), strict=True):
            part[which] = new
        return StateSpace(*parts)


class PointModel:
    """Derivatives and outputs of a system about K operating points.

    Matrices are the directional derivatives where it has them and differences agree at first; else differences.
    They are by the inputs `seeds`. Inputs (K,) are in `units`, or those of the FMU.
    """

    def __init__(
        self,
        model: ModelOfPoints,
        inputs: Mapping[str, Floats],
        seeds: Sequence[str],
        outputs: Sequence[str],
        units: Mapping[str, str],
    ) -> None:
        self.seeds, self.outputs = tuple(seeds), tuple(outputs)
        columns = {name: np.zeros(1) for name in seeds} | dict(inputs)
        self.count = max((len(each) for each in columns.values()), default=1)
        columns = {name: np.broadcast_to(each, self.count) for name, each in columns.items()}
        self._copies = 2 if self.count == 1 else 1  # one row is no experiment
        repeated = {name: np.repeat(each, self._copies) for name, each in columns.items()}
        first = model.simulator(repeated, self.outputs, units)
        self.states = model.system.states
        is_exact = gives_derivatives(model.system, self.outputs, self.seeds)
        probe = RightHandSide.of(first, by_rows=True, seeds=(*self.states, *self.seeds) if is_exact else ())
        self.is_open = probe is not None and bool(self.states)
        if probe is None or not self.states:
            return
        self.nominals, self._model, self._units = probe.nominals, model, units
        self._columns = {name: np.array(each, dtype=np.float64) for name, each in columns.items()}
        # rows of a point: itself, each state up and down, each seed up and down
        self.rows = 1 + 2 * (len(self.states) + len(self.seeds))
        self.input_steps = {
            name: SETTINGS.input_step * np.where(columns[name] == 0.0, 1.0, np.abs(columns[name])) for name in seeds
        }
        self._initial, self._exact, self._is_checked = probe.initial, probe if is_exact else None, False

    @cached_property
    def _side(self) -> RightHandSide:
        """The model at all rows of its points."""
        spread = {name: np.repeat(each[:, None], self.rows, axis=1) for name, each in self._columns.items()}
        begin = 1 + 2 * len(self.states)
        for j, name in enumerate(self.seeds):
            spread[name][:, begin + 2 * j] += self.input_steps[name]
            spread[name][:, begin + 2 * j + 1] -= self.input_steps[name]
        rows = self._model.simulator({name: each.ravel() for name, each in spread.items()}, self.outputs, self._units)
        side = RightHandSide.of(rows, by_rows=True)
        assert side is not None, "as the probe"
        return side

    def initial(self, thetas: Floats) -> Floats | None:
        """Return the initial states (m, n_x); None if hidden or failed."""
        return self._initial(thetas)

    def at(self, states: Floats, thetas: Floats) -> StateSpace:
        """Return the linear models about states of thetas (m, N).

        States are (K, n_x) or (m, K, n_x). NaN after a failure.
        """
        if self._exact is None:
            return self._by_differences(states, thetas)
        n = len(self.states)
        values, slopes = self._exact.linear(np.repeat(states, self._copies, axis=-2), thetas)
        values, slopes = values[:, :: self._copies], slopes[:, :: self._copies]
        parts = slopes[:, :, :n, :n], slopes[:, :, :n, n:], slopes[:, :, n:, :n], slopes[:, :, n:, n:]
        found = StateSpace(*parts, values[..., :n], values[..., n:])
        if not self._is_checked:
            self._is_checked = True
            other = self._by_differences(states, thetas)
            if not _agree(found, other, self._steps(states) / SETTINGS.step):
                self._exact = None
                return other
        return found

    def _by_differences(self, states: Floats, thetas: Floats) -> StateSpace:
        n = len(self.states)
        rates, outputs = self._around(states, thetas, SETTINGS.step)
        steps = self._steps(states)
        by_rates, by_outputs = (_slopes(each, steps) for each in (rates, outputs))
        parts = by_rates[..., :n], by_rates[..., n:], by_outputs[..., :n], by_outputs[..., n:]
        return StateSpace(*parts, rates[:, :, 0], outputs[:, :, 0])

    def events(self, states: Floats, theta: Floats) -> Flags:
        """Return whether there is an event at each point (K,)."""
        found = []
        for step in (SETTINGS.step, SETTINGS.step * SETTINGS.shorter):
            rates, _ = self._around(states, theta[None], step)
            base, up, down = (rates[0][:, where] for where in np.s_[:1, 1 : 2 * len(self.states) + 1 : 2, 2::2])
            down = down[:, : len(self.states)]
            found.append((np.abs(up + down - 2.0 * base).max(axis=1), np.abs(up - down).max(axis=1), base[:, 0]))
        (bend, change, base), (shorter, _, _) = found
        kinked = (bend > SETTINGS.kink * change) & (bend > SETTINGS.rounding * np.abs(base))
        return np.asarray((kinked & (shorter > 0.5 * SETTINGS.shorter * bend)).any(axis=1))

    def _around(self, states: Floats, thetas: Floats, step: float) -> tuple[Floats, Floats]:
        """Return rates and outputs (m, K, rows, n)."""
        n = len(self.states)
        sizes = step * np.maximum(np.abs(states), self.nominals)
        points = np.repeat(states[..., None, :], self.rows, axis=-2)
        for i in range(n):
            points[..., 1 + 2 * i, i] += sizes[..., i]
            points[..., 2 + 2 * i, i] -= sizes[..., i]
        found = self._side(points.reshape(*states.shape[:-2], -1, n), np.ascontiguousarray(thetas))
        rates, outputs = (each.reshape(len(thetas), self.count, self.rows, -1) for each in found)
        return rates, outputs

    def _steps(self, states: Floats) -> Floats:
        """Return the steps (..., K, n_x + n_seeds) of differences."""
        sizes = SETTINGS.step * np.maximum(np.abs(states), self.nominals)
        inputs = [np.broadcast_to(self.input_steps[name], sizes.shape[:-1])[..., None] for name in self.seeds]
        return np.concatenate([sizes, *inputs], axis=-1)


def _agree(one: StateSpace, other: StateSpace, sizes: Floats) -> bool:
    """Return whether derivatives agree where the other ones are finite; `sizes` (..., K, n) are of states and seeds."""
    for names, values in (("ab", other.rates), ("cd", other.outputs)):
        first, second = (
            np.concatenate([getattr(each, name) for name in names], axis=3) * sizes[..., None, :]
            for each in (one, other)
        )
        most = np.abs(second).max(axis=3, initial=0.0, keepdims=True)
        bound = SETTINGS.allowed * most + SETTINGS.rounding * np.abs(values)[..., None]
        if (np.isfinite(second) & ~(np.abs(first - second) <= bound)).any():
            return False
    return True


def _slopes(values: Floats, steps: Floats) -> Floats:
    """Return derivatives (m, K, n, n_s) of the rows of points."""
    found = (values[:, :, 1::2] - values[:, :, 2::2]) / (2.0 * steps[..., None])
    return np.asarray(np.swapaxes(found, 2, 3))
