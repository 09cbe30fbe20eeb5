"""Data file of a new study: its columns and its defects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.data import CLOCKS, COMMON_MARKS, LEFT_OUT, dropouts, far_values, read_data, time_name, with_missing
from fmuid.errors import InputError
from fmuid.studies.init.column_matching import ColumnMatch, guess
from fmuid.units import unit_in_name

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.array_types import Floats
    from fmuid.data import Experiment
    from fmuid.models import Description
    from fmuid.studies.model import ExperimentSettings


def parse_column(name: str) -> str | int:
    """Return a column number from 1, or a name."""
    return int(name) if name.isdecimal() and int(name) > 0 else name


@dataclass(frozen=True)
class InitOptions:
    """Given keys of ``[[experiments]]``; `columns` and `units` go by FMU variable, an empty column is none."""

    time: str | int = "time"
    time_unit: str | None = None
    sample_rate: float | None = None
    sheet: str | int | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    prepare: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class MatchedDataFile:
    """Data file with its columns matched; `marks` are numbers taken as missing, with their count, by column."""

    path: Path
    asked: InitOptions
    description: Description = field(repr=False)
    frame: pd.DataFrame = field(repr=False)
    marks: Mapping[str, Mapping[float, int]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, description: Description, asked: InitOptions) -> MatchedDataFile:
        """Read a data file."""
        how = {word: getattr(asked, word) for word in ("time_unit", "sample_rate", "sheet")}
        frame = read_data(path, asked.time, **how)
        numbers = {str(name): column for name, column in frame.select_dtypes("number").items() if name != asked.time}
        found = {name: far_values(np.asarray(column, dtype=np.float64)) for name, column in numbers.items()}
        marks = {name: own for name, own in found.items() if own and set(own) <= set(COMMON_MARKS)}
        if not marks:
            return cls(path, asked, description, frame)
        missing = tuple(sorted({value for own in marks.values() for value in own}))
        return cls(path, replace(asked, missing=missing), description, with_missing(frame, missing), marks)

    def with_columns(self, columns: Mapping[str, str]) -> MatchedDataFile:
        """Return the same with more known columns."""
        return replace(self, asked=replace(self.asked, columns={**self.asked.columns, **columns}))

    @property
    def time(self) -> str:
        """Name of the time column."""
        return time_name(self.asked.time)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """All columns but time."""
        return tuple(str(column) for column in self.frame.columns if column != self.time)

    @cached_property
    def links(self) -> tuple[ColumnMatch, ...]:
        """Matches of the columns."""
        in_names = {column: unit for column in self.columns if (unit := unit_in_name(column))}
        units = in_names | self.frame.attrs.get("units", {})
        return guess(self.description, self.columns, units, self.asked.columns)

    @cached_property
    def foreign_units(self) -> tuple[ColumnMatch, ...]:
        """Matches whose units do not convert."""
        return tuple(link for link in self.links if not self._converts(link))

    def _converts(self, link: ColumnMatch) -> bool:
        unit = self.asked.units.get(link.variable, link.column_unit)
        if link.column is None or not unit:
            return True
        try:
            return bool(self.description.conversion(self.description.variables[link.variable], unit))
        except InputError:
            return False

    def roles(self, role: str) -> dict[str, str]:
        """Return variables and columns of one role."""
        return {link.variable: link.column for link in self.links if link.role == role and link.column is not None}

    def lacking(self, role: str) -> tuple[str, ...]:
        """Return variables without column, except inputs given as none."""
        none = self.asked.columns if role == "input" else ()
        links = (link for link in self.links if link.role == role and link.column is None)
        return tuple(link.variable for link in links if link.variable not in none)

    @property
    def unused(self) -> tuple[str, ...]:
        """Columns without a role."""
        used = {link.column for link in self.links} | {*self.clocks.values()}
        return tuple(column for column in self.columns if column not in used)

    @property
    def notes(self) -> Mapping[str, str]:
        """Columns that were left out or changed, with the reason."""
        return dict(self.frame.attrs.get(LEFT_OUT, {}))

    @property
    def clocks(self) -> Mapping[str, str]:
        """Time column of each column; none of a single clock."""
        return dict(self.frame.attrs.get(CLOCKS, {}))

    @cached_property
    def held(self) -> tuple[str, ...]:
        """Inputs that are constant over more than half of the samples."""
        from pandas.api.types import is_numeric_dtype

        found, inputs = [], self.roles("input")
        for variable, column in inputs.items():
            series = self.frame[column]
            if is_numeric_dtype(series.dtype):
                same = np.diff(series.to_numpy(dtype=np.float64, na_value=np.nan)) == 0
                found += [variable] if same.size < 2 * same.sum() < 2 * same.size else []
        # elements of an array share their interpolation
        arrays = ({*self.description.variables[name].array} & inputs.keys() for name in found)
        return tuple(name for name, array in zip(found, arrays, strict=True) if array <= {*found})

    @property
    def interpolation(self) -> str | dict[str, str]:
        """Interpolation of the inputs, as far as the data show it."""
        if not self.held or "lowpass_frequency" in self.asked.prepare:
            return "linear"
        return "zoh" if len(self.held) == len(self.roles("input")) else dict.fromkeys(self.held, "zoh")

    @cached_property
    def experiment(self) -> Experiment | None:
        """Experiment, None if it is refused."""
        return self._made[0]

    @property
    def is_ready(self) -> bool:
        """Whether it can be simulated."""
        return self.experiment is not None and not self.lacking("input") and not self.foreign_units

    @property
    def refusal(self) -> str:
        """Error of the experiment, empty if none."""
        return self._made[1]

    @cached_property
    def _made(self) -> tuple[Experiment | None, str]:
        if not self.roles("output"):
            return None, ""
        try:
            return self.settings.experiment(self.frame, str(self.path)), ""
        except InputError as error:
            return None, str(error)

    @property
    def settings(self) -> ExperimentSettings:
        """Entry of ``[[experiments]]``."""
        from fmuid.studies.model import ExperimentSettings
        from fmuid.studies.section import SectionLocation

        words: dict[str, Any] = {"data": str(self.path.absolute()), "name": self.path.stem, "time": self.asked.time}
        words |= {"inputs": self.roles("input"), "outputs": self.roles("output")}
        words |= {"interpolation": self.interpolation, "preprocess": dict(self.asked.prepare)}
        words |= {"units": dict(self.asked.units)} | ({"missing": [*self.asked.missing]} if self.marks else {})
        return ExperimentSettings.read(words, SectionLocation(str(self.path), Path()))

    def _measured(self) -> Iterator[tuple[str, Floats]]:
        """Yield column and samples of each output."""
        if self.experiment is not None:
            for name, values in zip(self.experiment.output_names, self.experiment.output_values.T, strict=True):
                yield self.experiment.columns[name], values

    @property
    def missing(self) -> dict[str, int]:
        """Number of missing samples of each incomplete output."""
        return {column: int(np.isnan(y).sum()) for column, y in self._measured() if np.isnan(y).any()}

    @property
    def dropouts(self) -> tuple[float, ...]:
        """Times, s, after which rows are missing."""
        return dropouts(self.experiment.times) if self.experiment and self.experiment.input_names else ()

    @property
    def constant(self) -> dict[str, float]:
        """Outputs that never change, with their value."""
        return {column: float(np.nanmin(y)) for column, y in self._measured() if np.nanmin(y) == np.nanmax(y)}
