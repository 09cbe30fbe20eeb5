"""Simulation of constant inputs until the outputs are still."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.simulation.point_model import ModelOfPoints
from fmuid.simulation.simulator import Simulator


@dataclass(frozen=True)
class SettlingSettings:
    """Numbers of the wait for rest."""

    first: float = 1.0  # s: duration of the first simulation; each later one is four times as long
    most: float = 1e5  # s
    samples: int = 41
    last_share: float = 0.25  # of the simulation, in which outputs are still
    still: float = 1e-7  # change, relative to the largest value


SETTINGS = SettlingSettings()


class SettledSimulation:
    """Outputs after constant inputs, a row each.

    Parameters
    ----------
    model : ModelOfPoints
    inputs : mapping of str to (K,) array
    outputs : sequence of str
    units : mapping of str to str
        Of the inputs.
    """

    def __init__(
        self, model: ModelOfPoints, inputs: Mapping[str, Floats], outputs: Sequence[str], units: Mapping[str, str]
    ) -> None:
        self.model, self.inputs, self.outputs, self.units = model, inputs, tuple(outputs), units

    def check(self) -> None:
        """Check all names (`InputError`)."""
        self._simulator(0, SETTINGS.first)

    def rest(self, row: int, theta: Floats) -> Floats | None:
        """Return the outputs (n_outputs,) of a row at rest; None if they do not come to rest."""
        duration = SETTINGS.first
        while duration <= SETTINGS.most:
            found = self._simulator(row, duration).many(theta[None])
            if found.errors[0] is not None:
                return None
            values = found.outputs[0]
            late = values[int((1.0 - SETTINGS.last_share) * len(values)) :]
            if (np.ptp(late, axis=0) <= SETTINGS.still * np.abs(values).max(axis=0) + 1e-300).all():
                return np.asarray(values[-1])
            duration *= 4.0
        return None

    def _simulator(self, row: int, duration: float) -> Simulator:
        times = np.linspace(0.0, duration, SETTINGS.samples)
        columns = {name: np.full(times.size, each[row]) for name, each in self.inputs.items()}
        frame = pd.DataFrame({"time": times, **columns})
        made = Experiment(
            frame,
            list(self.inputs),
            list(self.outputs),
            interpolation="zoh",
            units=self.units,
            measured=False,
            source=self.model.source,
        )
        return Simulator(self.model.system, made, self.model.parameters, values=self.model.values)
