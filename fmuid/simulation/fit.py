"""Measured against simulated outputs of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from fmuid.arrays import Flags, Floats

if TYPE_CHECKING:
    from fmuid.data import Experiment
    from fmuid.models import System


@dataclass(frozen=True, eq=False)
class Fit:
    """Measured against simulated outputs of one experiment.

    Attributes
    ----------
    experiment : str
        Its name.
    times : ndarray (K,)
        Time, s.
    outputs, units : tuple of str
        Output variables and the units of what is compared, those of the table.
    measured, simulated : ndarray (K, n_outputs)
        NaN where an output was not measured.
    counted : ndarray of bool (K, n_outputs)
        The samples that take part in the criterion.
    """

    experiment: str
    times: Floats
    outputs: tuple[str, ...]
    units: tuple[str | None, ...]
    measured: Floats
    simulated: Floats
    counted: Flags

    @property
    def misfit(self) -> tuple[float, ...]:
        """‖measured − simulated‖ / ‖measured‖ of each output over the counted samples; NaN without any."""
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable simulation: infinite
            error = np.where(self.counted, self.measured - self.simulated, 0.0)
            size = np.linalg.norm(np.where(self.counted, self.measured, 0.0), axis=0)
            ratios = np.linalg.norm(error, axis=0) / np.where(size > 0, size, np.nan)
        return tuple(float(ratio) for ratio in ratios)

    def simulated_frame(self) -> pd.DataFrame:
        """Return the columns ``time`` and each output."""
        return pd.DataFrame({"time": self.times, **dict(zip(self.outputs, self.simulated.T, strict=True))})


def fit_of(system: System, experiment: Experiment, simulated: Floats) -> Fit:
    """Set the outputs (K, n_outputs) that a system gives in an experiment beside the measured ones."""
    names = experiment.output_names
    units = tuple(experiment.units.get(name, system.unit(name)) for name in names)
    return Fit(experiment.name, experiment.times, names, units, experiment.output_values, simulated, experiment.counted)


def parameter_units(system: System, names: Sequence[str]) -> tuple[str | None, ...]:
    """Return the unit of each parameter; one per experiment is named ``variable[experiment]``."""
    variables = system.variables
    return tuple(variables[name if name in variables else name.rpartition("[")[0]].unit for name in names)
