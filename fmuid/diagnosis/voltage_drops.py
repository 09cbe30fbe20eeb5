"""Voltages that lines lose by the currents, in derivatives of a machine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.simulation import AndersonMixing, ObservedModel


@dataclass(frozen=True)
class VoltageDropSettings:
    """Numbers of the drops' feedback in derivatives."""

    settled: float = 1e-5  # of the derivative; its square is below the least difference of two signatures
    most: int = 60  # simulations; a drop that settles needs fewer
    step: float = 1e-3  # of a difference, of the largest input
    current_step: float = 1e-4  # of the largest current: small beside the width of its sign


SETTINGS = VoltageDropSettings()


@dataclass(frozen=True, eq=False)
class VoltageDrops:
    """Feedback of a derivative through the voltages that lines lose: the fixed point of slope + response."""

    observed: ObservedModel
    theta: Floats  # of the model
    values: Floats  # of the map
    outputs: Floats  # (K, n_model)
    inputs: Floats  # (K, n_inputs) at them

    def closed(self, slope: Floats) -> Floats:
        """Return a derivative (K, n_model) with the drops' own change."""
        whole, mixing, last = slope, AndersonMixing(), np.abs(slope).max()
        for _ in range(SETTINGS.most):
            change = self._change(self.observed.currents(whole))
            largest = np.abs(change).max()
            if largest == 0.0:
                break
            step = SETTINGS.step * np.abs(self.inputs).max() / largest
            moved = self.observed.simulate(self.theta[None], self.inputs + step * change).checked()[0]
            closed = slope + (moved - self.outputs) / step
            off = np.abs(closed - whole).max()
            # the next one is off by as much less again
            if off**2 <= SETTINGS.settled * last * np.abs(closed).max():
                return np.asarray(closed)
            whole, last = mixing.next(whole, closed), off
        return whole

    def _change(self, currents: Floats) -> Floats:
        """Return the derivative of inputs along a change of currents."""
        made, at = self.observed.map, self.observed.currents(self.outputs)
        largest = np.abs(currents).max()
        if largest == 0.0:
            return np.zeros_like(self.inputs)
        step = SETTINGS.current_step * np.abs(at).max() / largest
        lines = (made.drop(self.values, at - step * currents) - made.drop(self.values, at + step * currents)) / step / 2
        return self.observed.inputs(lines) * self._of_voltages

    @cached_property
    def _of_voltages(self) -> Floats:
        names = self.observed.map.given.voltages
        return np.array([float(name in names) for name in self.observed.experiment.input_names])
