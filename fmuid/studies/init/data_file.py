"""Data file of a new study: its columns and its defects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from fmuid.array_types import Floats
from fmuid.data import (
    CLOCKS,
    COMMON_MARKS,
    LEFT_OUT,
    Experiment,
    dropouts,
    far_values,
    in_time_of_model,
    read_data,
    time_name,
    with_missing,
)
from fmuid.errors import InputError
from fmuid.models import Description
from fmuid.studies.init.column_matching import ColumnMatch, MatchReason, guess
from fmuid.studies.init.row_columns import SUPPLY_FREQUENCY, ratio_of, response_columns, supply_columns
from fmuid.studies.model import ExperimentSettings
from fmuid.studies.section import SectionLocation
from fmuid.units import unit_in_name


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
    kind: str = "time"
    model_time_unit: str = "s"


@dataclass(frozen=True, eq=False)
class MatchedDataFile:
    """Data file with its columns matched.

    `marks` are numbers taken as missing, with their count, by column; the FMU may declare `terminals` of a machine.
    """

    path: Path
    asked: InitOptions
    description: Description = field(repr=False)
    frame: pd.DataFrame = field(repr=False)
    marks: Mapping[str, Mapping[float, int]] = field(default_factory=dict)
    terminals: bool = False

    @classmethod
    def read(cls, path: Path, description: Description, asked: InitOptions, *, terminals: bool) -> MatchedDataFile:
        """Read a data file."""
        how = {word: getattr(asked, word) for word in ("time_unit", "sample_rate", "sheet")}
        frame = read_data(path, asked.time if asked.kind == "time" else None, **how)
        if asked.kind == "time":
            frame = in_time_of_model(frame, asked.time, asked.model_time_unit)
        numbers = {str(name): column for name, column in frame.select_dtypes("number").items() if name != asked.time}
        found = {name: far_values(np.asarray(column, dtype=np.float64)) for name, column in numbers.items()}
        marks = {name: own for name, own in found.items() if own and set(own) <= set(COMMON_MARKS)}
        if not marks:
            return cls(path, asked, description, frame, terminals=terminals)
        missing = tuple(sorted({value for own in marks.values() for value in own}))
        return cls(path, replace(asked, missing=missing), description, with_missing(frame, missing), marks, terminals)

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
        if self.asked.kind == "frequency":
            return self._as_given(response_columns(self.columns, units))
        if self.asked.kind == "steady" and self.terminals:
            found = list(supply_columns(self.columns))
            known = any(link.variable == "speed" for link in found)  # gives the pole pairs, which a torque needs
            return self._as_given(link for link in found if known or link.variable not in ("torque", "efficiency"))
        return guess(self.description, self.columns, units, self.asked.columns)

    @property
    def units(self) -> dict[str, str]:
        """Units that are given, or guessed from names of columns."""
        said = self.frame.attrs.get("units", {})
        found = {
            each.variable: each.column_unit
            for each in self.links
            if self.asked.kind != "steady" and each.column and each.column_unit and each.column_unit != each.unit
            if each.column not in said and not unit_in_name(each.column, each.variable)
        }
        return found | dict(self.asked.units)

    def _as_given(self, found: Iterable[ColumnMatch]) -> tuple[ColumnMatch, ...]:
        """Return matches, with the given columns in place of theirs."""
        own, given = {each.variable: each for each in found}, self.asked.columns
        for name, column in given.items():
            role = own[name].role if name in own else "response" if self.asked.kind == "frequency" else "output"
            own[name] = ColumnMatch(name, role, column or None, MatchReason.GIVEN)
        return tuple(each for each in own.values() if each.column is not None)

    @property
    def in_time(self) -> bool:
        """True if rows have a time."""
        return self.asked.kind == "time"

    @cached_property
    def foreign_units(self) -> tuple[ColumnMatch, ...]:
        """Matches whose units do not convert."""
        return tuple(link for link in self.links if not self._converts(link))

    def _converts(self, link: ColumnMatch) -> bool:
        unit = self.asked.units.get(link.variable, link.column_unit)
        if link.column is None or not unit or link.variable not in self.description.variables:
            return True
        try:
            return bool(self.description.conversion(self.description.variables[link.variable], unit))
        except InputError:
            return False

    def roles(self, role: str) -> dict[str, str]:
        """Return variables and columns of one role."""
        return {link.variable: link.column for link in self.links if link.role == role and link.column is not None}

    @property
    def measured_columns(self) -> dict[str, str]:
        """Outputs, or parts of responses, and their columns."""
        return self.roles("response" if self.asked.kind == "frequency" else "output")

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

    @property
    def of_rows(self) -> dict[str, Any]:
        """Keys of an experiment without a time that columns show."""
        own = self.roles("frame")
        if self.asked.kind == "frequency":
            responses: dict[str, dict[str, Any]] = {}
            for link in (each for each in self.links if each.role == "response"):
                name, _, part = link.variable.rpartition(".")
                unit = link.column_unit if part not in ("phase", "decibel") else None
                known = responses.setdefault(name, {"of": ratio_of(unit, self.description)})
                known[part] = link.column or ""
                if part in ("imaginary", "phase") and known[part].startswith("-"):
                    known["conjugate"] = True
            return {"frequency": own.get("frequency", "frequency"), "responses": responses}
        if not own:
            return {}
        frame: dict[str, Any] = {"frequency": SUPPLY_FREQUENCY, **own}
        if "speed" in frame:
            supply, speed = (
                np.max(self.frame[each]) if isinstance(each, str) else each
                for each in (frame["frequency"], frame["speed"])
            )
            frame["pole_pairs"] = max(1, int(60.0 * supply / speed))
        for one, other in (("slip", "speed"), ("voltage", "line_voltage")):
            if one in frame:
                frame.pop(other, None)
        return {"frame": frame}

    @cached_property
    def held(self) -> tuple[str, ...]:
        """Inputs that are constant over more than half of the samples."""
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
        if not self.measured_columns:
            return None, ""
        try:
            return self.settings.experiment(self.frame, str(self.path)), ""
        except InputError as error:
            return None, str(error)

    @property
    def settings(self) -> ExperimentSettings:
        """Entry of ``[[experiments]]``."""
        words: dict[str, Any] = {"data": str(self.path.absolute()), "name": self.path.stem}
        if self.asked.kind != "frequency":
            words |= {"inputs": self.roles("input"), "outputs": self.roles("output")}
        if self.in_time:
            words |= {"time": self.asked.time, "interpolation": self.interpolation}
        else:
            words |= {"kind": self.asked.kind, **self.of_rows}
        words |= {"preprocess": dict(self.asked.prepare)}
        words |= {"units": self.units} | ({"missing": [*self.asked.missing]} if self.marks else {})
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
        return (
            dropouts(self.experiment.times) if self.experiment and self.in_time and self.experiment.input_names else ()
        )

    @property
    def constant(self) -> dict[str, float]:
        """Outputs that never change, with their value."""
        return {column: float(np.nanmin(y)) for column, y in self._measured() if np.nanmin(y) == np.nanmax(y)}
