"""A table that a study is begun with: what its columns are taken for, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.data import dropouts, read_data, time_name
from fmuid.errors import InputError
from fmuid.studies.init.column_matching import ColumnMatch, guess
from fmuid.units import unit_in_name

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.data import Experiment
    from fmuid.models import Description
    from fmuid.studies.model import ExperimentSettings


HELD_SHARE = 0.5
"""An input that is the same as before in more than this share of the samples is a command that is held."""

FAR = 10.0
"""A value that is so many times the range of all others away from them is no sample, but a mark."""


def parse_column(name: str) -> str | int:
    """Return a place where that is given and not a name."""
    return int(name) if name.isdecimal() and int(name) > 0 else name


@dataclass(frozen=True)
class InitOptions:
    """What who begins a study knows of its tables; the words are those of ``[[experiments]]``.

    Attributes
    ----------
    time : str or int
        The column of time, by its name or its place from 1.
    time_unit : str or None
    sample_rate : float or None
    sheet : str, int or None
    columns : mapping of str to str
        Variables of the FMU whose columns are known; an empty text for none.
    prepare : mapping
        What is done with the tables first, the words of ``[experiments.preprocess]``.
    units : mapping of str to str
        Of columns, by the variables, where neither the table nor the FMU says them, or the table says another.
    """

    time: str | int = "time"
    time_unit: str | None = None
    sample_rate: float | None = None
    sheet: str | int | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    prepare: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MatchedDataFile:
    """A table as it was read, and which column is which variable.

    Attributes
    ----------
    path : Path
    asked : InitOptions
    description : Description
        Of the FMU.
    frame : pandas.DataFrame
    """

    path: Path
    asked: InitOptions
    description: Description = field(repr=False)
    frame: pd.DataFrame = field(repr=False)

    @classmethod
    def read(cls, path: Path, description: Description, asked: InitOptions) -> MatchedDataFile:
        """Read a table.

        Raises
        ------
        InputError
            If it cannot be read, or has no times.
        """
        how = {word: getattr(asked, word) for word in ("time_unit", "sample_rate", "sheet")}
        return cls(path, asked, description, read_data(path, asked.time, **how))

    def with_columns(self, columns: Mapping[str, str]) -> MatchedDataFile:
        """Return the same where more is known of the columns."""
        return replace(self, asked=replace(self.asked, columns={**self.asked.columns, **columns}))

    @property
    def time(self) -> str:
        """Name of the time column."""
        return time_name(self.asked.time)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """All columns but that of time."""
        return tuple(str(column) for column in self.frame.columns if column != self.time)

    @cached_property
    def links(self) -> tuple[ColumnMatch, ...]:
        """What the columns are taken for.

        Raises
        ------
        InputError
            If a variable or column that is given is not there.
        """
        in_names = {column: unit for column in self.columns if (unit := unit_in_name(column))}
        units = in_names | self.frame.attrs.get("units", {})
        return guess(self.description, self.columns, units, self.asked.columns)

    def roles(self, role: str) -> dict[str, str]:
        """Return variables and their columns of one role."""
        return {link.variable: link.column for link in self.links if link.role == role and link.column is not None}

    def lacking(self, role: str) -> tuple[str, ...]:
        """Return the variables of one role that are no column, but for inputs that are said to be none."""
        none = self.asked.columns if role == "input" else ()
        links = (link for link in self.links if link.role == role and link.column is None)
        return tuple(link.variable for link in links if link.variable not in none)

    @property
    def unused(self) -> tuple[str, ...]:
        """The columns that are taken for nothing."""
        used = {link.column for link in self.links}
        return tuple(column for column in self.columns if column not in used)

    @cached_property
    def held(self) -> tuple[str, ...]:
        """The inputs that stay where they are over most samples and then jump: commands that are held in between."""
        from pandas.api.types import is_numeric_dtype

        found, inputs = [], self.roles("input")
        for variable, column in inputs.items():
            series = self.frame[column]
            if is_numeric_dtype(series.dtype):
                same = np.diff(series.to_numpy(dtype=np.float64, na_value=np.nan)) == 0
                found += [variable] if HELD_SHARE * same.size < same.sum() < same.size else []
        # elements of one array are set at once: they hold together or not at all
        arrays = ({*self.description.variables[name].array} & inputs.keys() for name in found)
        return tuple(name for name, array in zip(found, arrays, strict=True) if array <= {*found})

    @property
    def interpolation(self) -> str | dict[str, str]:
        """The interpolation of the inputs, as far as they show it; what is low-passed does not hold."""
        if not self.held or "lowpass_frequency" in self.asked.prepare:
            return "linear"
        return "zoh" if len(self.held) == len(self.roles("input")) else dict.fromkeys(self.held, "zoh")

    @cached_property
    def experiment(self) -> Experiment | None:
        """The experiment that the table is; None where something is wrong with it (`refusal`)."""
        return self._made[0]

    @property
    def refusal(self) -> str:
        """What is wrong with the table, empty where nothing is."""
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
        """The words of ``[[experiments]]`` that the table is an experiment by.

        Raises
        ------
        InputError
            If `InitOptions.prepare` has others than ``[experiments.preprocess]``.
        """
        from fmuid.studies.model import ExperimentSettings
        from fmuid.studies.renamed_keys import refuse_renamed
        from fmuid.studies.section import SectionLocation

        words: dict[str, Any] = {"data": str(self.path.absolute()), "name": self.path.stem, "time": self.asked.time}
        words |= {"inputs": self.roles("input"), "outputs": self.roles("output")}
        words |= {"interpolation": self.interpolation, "preprocess": dict(self.asked.prepare)}
        words |= {"units": dict(self.asked.units)}
        place = SectionLocation(str(self.path), Path())
        refuse_renamed(words, place, "experiments")
        return ExperimentSettings.read(words, place)

    @property
    def missing(self) -> dict[str, int]:
        """How many samples are missing of the outputs that lack some."""
        if self.experiment is None:
            return {}
        values = self.experiment.output_values
        counts = zip(self.roles("output").values(), np.isnan(values).sum(axis=0).tolist(), strict=True)
        return {column: count for column, count in counts if count}

    @property
    def dropouts(self) -> tuple[float, ...]:
        """Where rows are missing that the inputs go on over as between any two samples: the times before, s."""
        return dropouts(self.experiment.times) if self.experiment and self.experiment.input_names else ()

    @property
    def constant(self) -> dict[str, float]:
        """The outputs that never change, with the one value that they have."""
        if self.experiment is None:
            return {}
        spans = zip(self.experiment.output_names, self.experiment.output_values.T, strict=True)
        return {self.experiment.columns[name]: float(np.nanmin(y)) for name, y in spans if np.nanmin(y) == np.nanmax(y)}

    @property
    def marks(self) -> dict[str, tuple[float, int]]:
        """A value far from all others that is there more than once, and how often, of the outputs that have one."""
        found: dict[str, tuple[float, int]] = {}
        if self.experiment is None:
            return found
        for name, column in zip(self.experiment.output_names, self.experiment.output_values.T, strict=True):
            values = column[np.isfinite(column)]
            for odd in (values.min(), values.max()):
                rest = values[values != odd]
                far = rest.size > 1 and min(abs(odd - rest.min()), abs(odd - rest.max())) > FAR * np.ptp(rest) > 0
                if far and values.size - rest.size > 1:
                    found[self.experiment.columns[name]] = float(odd), int(values.size - rest.size)
        return found
