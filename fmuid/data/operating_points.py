"""Experiments of steady states: a row for each operating point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import pandas as pd
from annotated_types import Gt

from fmuid.array_types import Floats
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.data_file import LEFT_OUT, SOURCE, UNITS, numeric_column
from fmuid.data.experiment import Experiment
from fmuid.errors import InputError

ROW = "row"
"""Column of the row numbers, in place of a time."""


@dataclass(frozen=True)
class RotatingFrame:
    """Supply of an AC machine: symmetrical phasors, with columns or numbers for each row."""

    frequency: str | float
    """supply frequency, Hz"""
    voltage: str | float | None = None
    """phase voltage, V rms"""
    line_voltage: str | float | None = None
    """line voltage, V rms, in place of voltage"""
    slip: str | float | None = None
    """slip, from 0 at synchronous speed to 1 at standstill"""
    speed: str | float | None = None
    """mechanical speed in place of slip, rpm by default; needs pole_pairs"""
    pole_pairs: Annotated[int, Gt(0)] | None = None
    """pole pairs of the machine"""

    def __post_init__(self) -> None:
        for one, other in (("voltage", "line_voltage"), ("slip", "speed")):
            if (getattr(self, one) is None) == (getattr(self, other) is None):
                raise InputError(f"give either {one} or {other}.")
        if self.speed is not None and self.pole_pairs is None:
            raise InputError("speed needs pole_pairs. Give the number of pole pairs.")

    @property
    def given(self) -> dict[str, str | float]:
        """Columns or numbers by quantity."""
        names = ("frequency", "voltage", "line_voltage", "slip", "speed")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


@dataclass(frozen=True, eq=False)
class SteadyExperiment(Experiment):
    """Operating points: inputs, and outputs once the model has settled.

    Parameters are those of `Experiment`, without times. An output is an FMU variable or a formula of
    `fmuid.models.PHASOR_FORMULAS`.

    Parameters
    ----------
    supply : RotatingFrame, optional
        Supply of an AC machine; its quantities become inputs.
    guess : mapping of str to float
        States where the search for the steady state begins; no second one is then tried.

    Examples
    --------
    >>> points = pd.DataFrame({"u": [6.0, 12.0], "i": [1.5, 3.1]})
    >>> fmuid.data.SteadyExperiment(points, inputs=["u"], outputs=["i"])
    SteadyExperiment('experiment', 2 rows, u → i)
    """

    kind, least_rows = "steady", 1
    supply: RotatingFrame | None = None
    guess: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given, columns = {} if self.supply is None else self.supply.given, self._constants
        inputs = dict(self.inputs if isinstance(self.inputs, Mapping) else zip(self.inputs, self.inputs, strict=True))
        inputs |= {name: value if isinstance(value, str) else f"{name} = {value:g}" for name, value in given.items()}
        check_rows(self, {name: column for name, column in inputs.items() if column not in columns}, given)
        self._set(frame=with_rows(self.frame.assign(**columns)), inputs=inputs, time=ROW, interpolation="zoh")
        super().__post_init__()

    @property
    def _constants(self) -> dict[str, float]:
        """Columns of quantities that are numbers."""
        given = {} if self.supply is None else self.supply.given
        return {f"{name} = {value:g}": value for name, value in given.items() if not isinstance(value, str)}

    @property
    def made_columns(self) -> frozenset[str]:
        """Row numbers and constant quantities."""
        return frozenset({ROW, *self._constants})

    @property
    def design(self) -> str:
        """Supply and guess, as text."""
        return repr((self.supply, dict(self.guess)))

    @property
    def axis(self) -> dict[str, Floats]:
        """Row numbers and inputs, (K,) each."""
        return {ROW: self.times, **dict(zip(self.input_names, self.input_values.T, strict=True))}

    @property
    def smooth_over(self) -> Floats | None:
        """None: rows have no order."""
        return None

    def __repr__(self) -> str:
        return describe_rows(self)


def check_rows(experiment: Experiment, inputs: Mapping[str, str], quantities: Iterable[str]) -> None:
    """Refuse settings that need a time, and rows without an input; some are named quantities."""
    source = experiment.source or str(experiment.frame.attrs.get(SOURCE, "the table"))
    if experiment.warmup:
        raise InputError(f"{source}: warmup needs a time. Remove it.")
    for name, given in inputs.items():
        column = column_of(experiment.frame.columns, given)
        if column is None:
            role = name if name in quantities else "input"
            remedy = f"Set {name} to its column." if name in quantities else "Name the right column."
            known = experiment.frame.columns.difference([*experiment.made_columns], sort=False)
            said = missing_column(role, given, known, remedy, experiment.frame.attrs.get(LEFT_OUT))
            raise InputError(f"{source}: {said}")
        missing = np.flatnonzero(~np.isfinite(values := numeric_column(experiment.frame, column, source)))
        if missing.size:
            what = "empty" if np.isnan(values[missing[0]]) else "infinite"
            raise InputError(f"{source}: input column {column!r} is {what} in row {missing[0] + 1}. Remove the row.")


def with_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with row numbers in place of a time."""
    made = frame.assign(**{ROW: np.arange(1.0, len(frame) + 1.0)})
    made.attrs = {
        **frame.attrs,
        UNITS: {name: unit for name, unit in frame.attrs.get(UNITS, {}).items() if name != ROW},
    }
    return made


def describe_rows(experiment: Experiment) -> str:
    """Return the text of an experiment without a time."""
    roles = f"{', '.join(experiment.input_names)} → {', '.join(experiment.output_names)}"
    return f"{type(experiment).__name__}({experiment.name!r}, {len(experiment.times)} rows, {roles})"
