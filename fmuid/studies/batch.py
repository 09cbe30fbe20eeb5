"""The table ``[batch]``: the cases of a study."""

from __future__ import annotations

import glob
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, PlainValidator, TypeAdapter, ValidationError

from fmuid.data import Noise, Parameter
from fmuid.files import full, is_file
from fmuid.formatting import nearest
from fmuid.studies import value_kinds as kinds
from fmuid.studies.model import ExperimentSettings
from fmuid.studies.section import StudySection, entry
from fmuid.studies.toml import show

Value = float | int | bool | str

METHODS = ("sobol", "latin-hypercube")
# Beyond these a space-filling design fills the memory, and a Sobol sequence of 30 bits ends.
MOST_POINTS = 2**24
LARGEST_WHOLE = 2**63  # what a column of whole numbers holds


# --- kinds of values --------------------------------------------------------------------


WHOLE, UP_TO = "a whole number above 0", f"a whole number up to {MOST_POINTS}"
Points = Annotated[
    int,
    Field(gt=0, le=MOST_POINTS),
    kinds.ValueKind(WHOLE, lambda value: UP_TO if type(value) is int and value > 0 else WHOLE),
]


class RangeSection(StudySection):
    """Equally spaced numbers, both ends included."""

    first: kinds.Finite = entry(..., "the first", alias="from")
    last: kinds.Finite = entry(..., "the last", alias="to")
    count: Points = entry(..., "how many")


TABLES = 'a pattern of files, "records/*.csv", a list of files and patterns, or { name = "file" }'
Tables = Annotated[
    Annotated[list[kinds.Text], Field(min_length=1)] | Annotated[dict[str, kinds.Text], Field(min_length=1)],
    kinds.BY_SHAPE,
    BeforeValidator(kinds.as_list, json_schema_input_type=str | list[str] | dict[str, str]),
    kinds.ValueKind(TABLES),
]


def _wrong_starts(value: Any) -> str:
    if isinstance(value, list) and value and all(isinstance(item, dict) and item for item in value):
        for name, item in ((name, item) for each in value for name, item in each.items()):
            try:
                _FINITE.validate_python(item)
            except ValidationError as error:
                return f"a table of which each entry is {_text(error)} ({name} is {show(item)})"
    return "a whole number above 0, or a list of starts, [{ Rs = 9.0, Rr = 3.0 }]"


def _text(error: ValidationError) -> str:
    return str(error.errors(include_url=False)[0]["ctx"]["text"])


_FINITE, _POINTS = TypeAdapter[float](kinds.Finite), TypeAdapter[int](Points)
Starts = Annotated[
    kinds.Count | Annotated[list[Annotated[dict[str, kinds.Finite], Field(min_length=1)]], Field(min_length=1)],
    kinds.ValueKind(_wrong_starts(None), _wrong_starts),
]


SUBSETS = 'a list of different lists of parameters, [["Rs", "Rr"], ["Rs", "Rr", "Lm"]]'
Subsets = Annotated[
    list[kinds.Names],
    Field(min_length=1),
    kinds.required(lambda subsets: len({frozenset(each) for each in subsets}) == len(subsets), SUBSETS),
    kinds.ValueKind(SUBSETS),
]

AXIS = "a list of values of one type, [0.40, 0.47], or { from = 0.4, to = 0.5, count = 5 }"


def _axis(value: object) -> tuple[Value, ...]:
    """Return the values of one type, or those of a range."""
    try:
        if isinstance(value, dict):
            return _range(value)
        types: tuple[tuple[type, ...], ...] = ((bool,), (int,), (int, float), (str,))
        if isinstance(value, list) and value:
            fits = all(-LARGEST_WHOLE <= item < LARGEST_WHOLE for item in value if isinstance(item, int))
            for kind in types if fits else ():
                if all(isinstance(item, kind) and (isinstance(item, bool) == (kind == (bool,))) for item in value):
                    return tuple(value if kind != (int, float) else map(_FINITE.validate_python, value))
    except ValidationError as error:
        raise kinds.must_be(_text(error)) from None
    raise kinds.must_be(AXIS)


def _range(value: dict[str, Any]) -> tuple[float, ...]:
    """Return equally spaced numbers, both ends included."""
    if set(value) != {"from", "to", "count"}:
        raise kinds.must_be("a list of values, or { from = 0.4, to = 0.5, count = 5 } with just these three")
    first, last = (_FINITE.validate_python(value[key]) for key in ("from", "to"))
    count = _POINTS.validate_python(value["count"])
    if count == 1 or first == last:
        raise kinds.must_be("a range of at least two values, whose from and to differ")
    return tuple(np.linspace(first, last, count).tolist())


Axis = Annotated[
    tuple[Value, ...],
    PlainValidator(_axis, json_schema_input_type=list[kinds.Scalar] | RangeSection),
    kinds.ValueKind(AXIS),
]


LIMITS = "[lowest, highest]"
Limits = Annotated[
    list[kinds.Finite],
    Field(min_length=2, max_length=2),
    kinds.required(lambda limits: limits[0] < limits[1], LIMITS),
    kinds.ValueKind(LIMITS),
]
Ranges = Annotated[dict[str, Limits], Field(min_length=1), kinds.Entries("a table { variable = [lowest, highest] }")]


# --- tables -----------------------------------------------------------------------------


class SpaceFillingSection(StudySection):
    """Values held that fill a box."""

    method: Annotated[str, kinds.one_of(METHODS)] = entry("sobol", "how the points are spread")
    points: Points = entry(..., "how many points")
    ranges: Ranges = entry(..., "the variables that are held at values, as ranges = { Lm = [0.4, 0.5] }")


class MonteCarloSection(StudySection):
    """Monte Carlo: simulate the truth, disturb it, identify."""

    realizations: kinds.Count = entry(..., "how many realizations of the noise")
    std: kinds.PositiveOrEach | None = entry(
        None, "standard deviation of the white normal noise, or one for each output; default: as [noise] says"
    )
    true_values: kinds.Finites = entry(
        {}, "values in the simulation of the truth, where they are not those of the case"
    )

    def std_of(self, output: str) -> float:
        """Return the standard deviation of an output, in the unit of the data."""
        assert isinstance(self.std, dict), "of a study, by `of`"
        return self.std[output]

    def of(self, experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return the table with the standard deviation of every output."""
        outputs = tuple(dict.fromkeys(name for given in experiments for name in given.outputs))
        given = self.std if isinstance(self.std, dict) else dict.fromkeys(outputs, self.std)
        for name in given:
            if name not in outputs:
                raise self.error(f"std names {name!r}, which is no measured output{nearest(name, outputs)}")
        variances = zip(outputs, noise.known(outputs).tolist(), strict=True)
        stds = {name: given.get(name) or math.sqrt(variance) for name, variance in variances}
        for name, std in stds.items():
            if math.isnan(std):
                raise self.error(
                    f"needs the standard deviation of the noise of {name!r}: give std = {{ {name} = ... }}, or its "
                    "variance in [noise]"
                )
        return self.model_copy(update={"std": stds})


class BatchSettings(StudySection):
    """Many identifications, called cases."""

    data: Tables = entry([], "one identification a record: files, patterns of files, or names and files")
    starting_points: Starts | None = entry(None, "how many starts are drawn, or the starts themselves by parameter")
    free_parameters: Subsets = entry([], "the parameters that are free, one set after the other; default: all")
    sweep: Annotated[dict[str, Axis], kinds.Entries("a table { name = values }")] = entry(
        {}, "variables, and the values at which they are held one after the other"
    )
    space_filling: SpaceFillingSection | None = entry(None, "values held that fill a box")
    monte_carlo: MonteCarloSection | None = entry(None, "Monte Carlo: simulate the truth, disturb it, identify")
    combine: Annotated[str, kinds.one_of(("product", "zip"))] = entry(
        "product", "each entry of an axis with every entry of the others, or the n-th ones of all together"
    )
    seed: kinds.Natural = entry(0, "of all that is drawn")

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
            raise self.error(f"data: {show(given)} matches no file in {full(folder)}")
        return [path.as_posix() for path in files]

    def of(self, parameters: Mapping[str, Parameter], experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return the table, checked for a study."""
        if not self.model_fields_set - {"combine", "seed"}:
            raise self.error(
                "varies nothing: give at least one of data, starting_points, free_parameters, sweep, space_filling and "
                "monte_carlo"
            )
        if self.data and len(experiments) > 1:
            raise self.error(
                f"has data, each in place of the study's own, and the study has {len(experiments)} [[experiments]]: "
                "keep one of them, whose words are those of all files"
            )
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
                raise self.error(f"sweep.{name}: a parameter is held at numbers, not at {show(values[0])}")
            if self.space_filling is not None and name in self.space_filling.ranges:
                raise self.error(f"holds {name!r} both by sweep and by space_filling: keep one of the two")
        if parameters and not set(parameters) - set(self.swept):
            raise self.error(
                "holds all parameters of the study at values, so that none is left to identify: leave one of "
                f"{', '.join(parameters)} out of sweep and space_filling"
            )
        for subset in self.free_parameters:
            self._check_parameters("free_parameters", subset, parameters)
        for start in self.starting_points if isinstance(self.starting_points, list) else ():
            self._check_parameters("starting_points", start, parameters)

    def _check_parameters(self, key: str, names: Iterable[str], parameters: Mapping[str, Parameter]) -> None:
        for name in names:
            if name not in parameters:
                raise self.error(
                    f"{key} names {name!r}, which is no parameter of this study{nearest(name, parameters)}"
                )
            if name in self.swept:
                raise self.error(
                    f"{key} names {name!r}, which sweep or space_filling hold, so that it is not identified: keep one "
                    "of the two"
                )


_NAMES: tuple[Callable[[str], str], ...] = (
    lambda path: Path(path).stem,
    lambda path: Path(path).with_suffix("").as_posix(),
    lambda path: path,
)
