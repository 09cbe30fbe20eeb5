"""The section ``[batch]``: the cases of a study."""

from __future__ import annotations

import glob
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, PlainValidator

from fmuid.array_types import Floats
from fmuid.data import Experiment, Noise, Parameter, response_of
from fmuid.files import full, is_file
from fmuid.formatting import nearest
from fmuid.studies import value_kinds as kinds
from fmuid.studies.model import ExperimentSettings
from fmuid.studies.section import StudySection, entry
from fmuid.studies.toml import show

Value = float | int | bool | str

METHODS = ("sobol", "latin-hypercube")
MAX_POINTS = 2**24  # points of a space-filling design; SciPy's Sobol sequence ends at 2**30, memory before
INTEGERS = range(-(2**63), 2**63)  # whole numbers that a column of integers holds

# --- kinds of values --------------------------------------------------------------------

WHOLE, UP_TO = "a whole number above 0", f"a whole number up to {MAX_POINTS}"
Points = Annotated[
    int,
    Field(gt=0, le=MAX_POINTS),
    kinds.ValueKind(WHOLE, lambda value: UP_TO if type(value) is int and value > 0 else WHOLE),
]


class RangeSection(StudySection):
    """Equally spaced numbers, both ends included."""

    first: kinds.Finite = entry(..., "first value", alias="from")
    last: kinds.Finite = entry(..., "last value", alias="to")
    count: Points = entry(..., "number of values")

    def values(self) -> tuple[Value, ...]:
        """Return the numbers, at least two different ones."""
        if self.count == 1 or self.first == self.last:
            raise kinds.must_be("a range of at least two different values")
        return tuple(np.linspace(self.first, self.last, self.count).tolist())


TABLES = 'a pattern of files, "records/*.csv", a list of files and patterns, or { name = "file" }'
Tables = Annotated[
    Annotated[list[kinds.Text], Field(min_length=1)] | Annotated[dict[str, kinds.Text], Field(min_length=1)],
    kinds.BY_SHAPE,
    BeforeValidator(kinds.as_list, json_schema_input_type=str | list[str] | dict[str, str]),
    kinds.ValueKind(TABLES),
]


STARTS = "a list of starting points, [{ Rs = 9.0, Rr = 3.0 }]"
Start = Annotated[dict[str, kinds.Finite], Field(min_length=1), kinds.Entries("{ parameter = number }")]
Starts = Annotated[
    Annotated[int, Field(gt=0), kinds.ValueKind(f"{WHOLE} or {STARTS}")]
    | Annotated[list[Start], Field(min_length=1), kinds.Entries(STARTS)],
    kinds.ByShape(list),
    kinds.Entries(f"{WHOLE} or {STARTS}"),
]
SUBSETS = 'a list of different lists of parameters, [["Rs", "Rr"], ["Rs", "Rr", "Lm"]]'
Subsets = Annotated[
    list[kinds.Names],
    Field(min_length=1),
    kinds.required(lambda subsets: len({frozenset(each) for each in subsets}) == len(subsets), SUBSETS),
    kinds.ValueKind(SUBSETS),
]

AXIS = "a list of finite values of one type, [0.40, 0.47], or { from = 0.4, to = 0.5, count = 5 }"


def _axis(value: object) -> tuple[Value, ...]:
    """Return the values of one type, or those of a range."""
    if isinstance(value, dict):
        return RangeSection.model_validate(value).values()
    items = value if isinstance(value, list) else []
    found = set(map(type, items))
    known = found in ({bool}, {int}, {float}, {int, float}, {str})
    if not known or not all(isinstance(item, str) or _is_storable(item) for item in items):
        raise kinds.must_be(AXIS)
    return tuple(map(float, items)) if float in found else tuple(items)


def _is_storable(number: float) -> bool:
    return number in INTEGERS if isinstance(number, int) else math.isfinite(number)


Axis = Annotated[
    tuple[Value, ...],
    PlainValidator(_axis, json_schema_input_type=list[kinds.Scalar] | RangeSection),
    kinds.Entries(AXIS),
]


LIMITS = "[lowest, highest]"
Limits = Annotated[
    list[kinds.Finite],
    Field(min_length=2, max_length=2),
    kinds.required(lambda limits: limits[0] < limits[1], LIMITS),
    kinds.ValueKind(LIMITS),
]
Ranges = Annotated[dict[str, Limits], Field(min_length=1), kinds.Entries("{ variable = [lowest, highest] }")]


# --- sections ---------------------------------------------------------------------------


class SpaceFillingSection(StudySection):
    """Fixed values that fill a box."""

    method: Annotated[str, kinds.one_of(METHODS)] = entry("sobol", "sampling method")
    points: Points = entry(..., "number of points")
    ranges: Ranges = entry(..., "variables with their limits, { Lm = [0.4, 0.5] }")


class MonteCarloSection(StudySection):
    """Monte Carlo study: simulate the true values, add noise, identify."""

    realizations: kinds.Count = entry(..., "number of noise realizations")
    std: kinds.PositiveOrEach | None = entry(
        None, "σ of the white noise, for all outputs or each; default: from [noise]"
    )
    reading_std: kinds.PositiveOrEach | None = entry(None, "σ as a fraction of each simulated reading")
    true_values: kinds.Finites = entry({}, "true values that differ from those of the case")

    def levels(self, experiment: Experiment) -> Floats:
        """Return σ (K, n_outputs) of simulated outputs, in units of the data."""
        std, fractions = self.std, self.reading_std
        assert isinstance(std, dict) and isinstance(fractions, dict), "of a study, by `of`"
        found = np.ones(experiment.output_values.shape)
        for column, name in zip(found.T, experiment.output_names, strict=True):
            column *= fractions[name] * experiment.readings(name) if name in fractions else std[name]
        return found

    def of(self, experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return the section with the noise level of every output."""
        outputs = tuple(dict.fromkeys(name for given in experiments for name in given.output_names))
        known = {*outputs, *map(response_of, outputs)}
        for key, given in (("std", self.std), ("reading_std", self.reading_std)):
            for name in given if isinstance(given, dict) else ():
                if name not in known:
                    raise self.error(f"unknown output {name!r}{nearest(name, outputs)}", key)
        alone = Noise(std=self.std, reading_std=self.reading_std)
        with self.place.located():
            forms = {name: (alone if alone.form(name)[0] else noise).form(name) for name in outputs}
        found: dict[str, dict[str, float]] = {"std": {}, "reading_std": {}}
        for name, (word, level) in forms.items():
            if word not in ("variance", "std", "reading_std") or not isinstance(level, float):
                raise self.error(f"unknown noise level of {name!r}. Set std or reading_std of it.")
            found["std" if word == "variance" else word][name] = math.sqrt(level) if word == "variance" else level
        return self.model_copy(update=found)


class BatchSettings(StudySection):
    """Many identifications, called cases."""

    data: Tables = entry([], "data files, one case each")
    starting_points: Starts | None = entry(None, "random starting points, or a list of them")
    free_parameters: Subsets = entry([], "sets of free parameters, one case each; default: all free")
    sweep: Annotated[dict[str, Axis], kinds.Entries("{ name = values }")] = entry(
        {}, "variables with their values, one case each"
    )
    space_filling: SpaceFillingSection | None = entry(None, "fixed values that fill a box")
    monte_carlo: MonteCarloSection | None = entry(None, "Monte Carlo study")
    combine: Annotated[str, kinds.one_of(("product", "zip"))] = entry(
        "product", "all combinations of the axes, or their n-th entries together"
    )
    seed: kinds.Natural = entry(0, "seed of all random numbers")

    @property
    def swept(self) -> tuple[str, ...]:
        """Variables held by ``sweep``, then those held by ``space_filling``."""
        return (*self.sweep, *(self.space_filling.ranges if self.space_filling is not None else ()))

    def records(self) -> dict[str, Path]:
        """Return data files by name; matches of a pattern are sorted."""
        if isinstance(self.data, Mapping):
            return {name: self.place.folder / given for name, given in self.data.items()}
        found: dict[str, None] = {}
        for given in self.data:
            found |= dict.fromkeys(self._matches(given))
        names: list[str] = []
        for name in _NAMES:
            names = [name(each) for each in found]
            if len(set(names)) == len(names):
                break
        return {name: self.place.folder / given for name, given in zip(names, found, strict=True)}

    def _matches(self, given: str) -> list[str]:
        """Return the files that an entry of ``data`` names."""
        folder = self.place.folder
        if not glob.has_magic(given) or is_file(folder / given):
            return [Path(given).as_posix()]
        matches = glob.glob(given, root_dir=folder, recursive=True)  # noqa: PTH207  # of Path's none is absolute
        files = sorted((Path(each) for each in matches if is_file(folder / each)), key=lambda path: path.parts)
        if not files:
            raise self.error(f"{show(given)} matches no file in {full(folder)}.", "data")
        return [path.as_posix() for path in files]

    def of(self, parameters: Mapping[str, Parameter], experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return the section, checked for a study."""
        if not self.model_fields_set - {"combine", "seed"}:
            axes = "data, starting_points, free_parameters, sweep, space_filling or monte_carlo"
            raise self.error(f"nothing varies between cases. Set {axes}.")
        if self.data and len(experiments) > 1:
            raise self.error(f"the study has {len(experiments)} experiments. Keep one, for all files.", "data")
        self._check_names(parameters)
        return (
            self
            if self.monte_carlo is None
            else self.model_copy(update={"monte_carlo": self.monte_carlo.of(experiments, noise)})
        )

    def _check_names(self, parameters: Mapping[str, Parameter]) -> None:
        """Check all names of parameters; some must be left to identify."""
        for name, values in self.sweep.items():
            if name in parameters and any(isinstance(value, bool | str) for value in values):
                raise self.error(f"a parameter takes numbers, not {show(values[0])}.", "sweep", name)
            if self.space_filling is not None and name in self.space_filling.ranges:
                raise self.error(f"{name!r} is in sweep and in space_filling. Keep one of the two.")
        if parameters and not set(parameters) - set(self.swept):
            raise self.error(
                f"no parameter is free. Remove one of {', '.join(parameters)} from sweep or space_filling."
            )
        for subset in self.free_parameters:
            self._check_parameters("free_parameters", subset, parameters)
        for start in self.starting_points if isinstance(self.starting_points, list) else ():
            self._check_parameters("starting_points", start, parameters)

    def _check_parameters(self, key: str, names: Iterable[str], parameters: Mapping[str, Parameter]) -> None:
        for name in names:
            if name not in parameters:
                raise self.error(f"unknown parameter {name!r}{nearest(name, parameters)}", key)
            if name in self.swept:
                raise self.error(f"{name!r} is also in sweep or space_filling. Keep one of the two.", key)


_NAMES: tuple[Callable[[str], str], ...] = (
    lambda path: Path(path).stem,
    lambda path: Path(path).with_suffix("").as_posix(),
    lambda path: path,
)
