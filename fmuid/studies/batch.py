"""The table ``[batch]`` of a study file: the many identifications, called cases, that the study spans."""

from __future__ import annotations

import glob
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator, Tag, TypeAdapter, ValidationError

from fmuid.data import Noise, Parameter
from fmuid.files import full, is_file
from fmuid.formatting import nearest
from fmuid.studies.model import ExperimentSettings
from fmuid.studies.section import StudySection, word
from fmuid.studies.toml import show
from fmuid.studies.value_kinds import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Count,
    Entries,
    Finite,
    Finites,
    Names,
    Natural,
    PositiveOrEach,
    Scalar,
    Text,
    ValueKind,
    as_list,
    must_be,
    one_of,
)

Value = float | int | bool | str

METHODS = ("sobol", "latin-hypercube")
# Beyond these a space-filling design fills the memory, and a Sobol sequence of 30 bits ends.
MOST_POINTS = 2**24
LARGEST_WHOLE = 2**63  # what a column of whole numbers holds


# --- kinds of values --------------------------------------------------------------------


def _wrong_points(value: Any) -> str:
    whole = isinstance(value, int) and not isinstance(value, bool) and value > 0
    return f"a whole number up to {MOST_POINTS}" if whole else "a whole number above 0"


Points = Annotated[int, Field(gt=0, le=MOST_POINTS), ValueKind("a whole number above 0", _wrong_points)]


class RangeSection(StudySection):
    """Equally spaced numbers, both ends included."""

    first: Finite = word(..., "the first", alias="from")
    last: Finite = word(..., "the last", alias="to")
    count: Points = word(..., "how many")


TABLES = 'a pattern of files, "records/*.csv", a list of files and patterns, or { name = "file" }'
Tables = Annotated[
    Annotated[list[Text], Field(min_length=1), Tag(VALUE_TAG)]
    | Annotated[dict[str, Text], Field(min_length=1), Tag(TABLE_TAG)],
    BY_SHAPE,
    BeforeValidator(as_list, json_schema_input_type=str | list[str] | dict[str, str]),
    ValueKind(TABLES),
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


_FINITE, _POINTS = TypeAdapter[float](Finite), TypeAdapter[int](Points)
Starts = Annotated[
    Count | Annotated[list[Annotated[dict[str, Finite], Field(min_length=1)]], Field(min_length=1)],
    ValueKind(_wrong_starts(None), _wrong_starts),
]


def _different(value: list[list[str]]) -> list[list[str]]:
    if len({frozenset(subset) for subset in value}) != len(value):
        raise ValueError
    return value


Subsets = Annotated[
    list[Names],
    Field(min_length=1),
    AfterValidator(_different),
    ValueKind('a list of different lists of parameters, [["Rs", "Rr"], ["Rs", "Rr", "Lm"]]'),
]

AXIS = "a list of values of one type, [0.40, 0.47], or { from = 0.4, to = 0.5, count = 5 }"


def _axis(value: object) -> tuple[Value, ...]:
    """Check for values of one type, or for a range of numbers."""
    try:
        if isinstance(value, dict):
            return _range(value)
        kinds: tuple[tuple[type, ...], ...] = ((bool,), (int,), (int, float), (str,))
        if isinstance(value, list) and value:
            whole = [item for item in value if isinstance(item, bool) or not isinstance(item, int) or _fits(item)]
            for kind in kinds if len(whole) == len(value) else ():
                if all(isinstance(item, kind) and (isinstance(item, bool) == (kind == (bool,))) for item in value):
                    return tuple(value if kind != (int, float) else map(_FINITE.validate_python, value))
    except ValidationError as error:
        raise must_be(_text(error)) from None
    raise must_be(AXIS)


def _fits(number: int) -> bool:
    return -LARGEST_WHOLE <= number < LARGEST_WHOLE


def _range(value: dict[str, Any]) -> tuple[float, ...]:
    """Return equally spaced numbers, both ends included."""
    if set(value) != {"from", "to", "count"}:
        raise must_be("a list of values, or { from = 0.4, to = 0.5, count = 5 } with just these three")
    first, last = (_FINITE.validate_python(value[key]) for key in ("from", "to"))
    count = _POINTS.validate_python(value["count"])
    if count == 1 or first == last:
        raise must_be("a range of at least two values, whose from and to differ")
    return tuple(np.linspace(first, last, count).tolist())


Axis = Annotated[
    tuple[Value, ...], PlainValidator(_axis, json_schema_input_type=list[Scalar] | RangeSection), ValueKind(AXIS)
]


def _rising(value: list[float]) -> list[float]:
    if not value[0] < value[1]:
        raise ValueError
    return value


Limits = Annotated[
    list[Finite], Field(min_length=2, max_length=2), AfterValidator(_rising), ValueKind("[lowest, highest]")
]
Ranges = Annotated[dict[str, Limits], Field(min_length=1), Entries("a table { variable = [lowest, highest] }")]


# --- tables -----------------------------------------------------------------------------


class SpaceFillingSection(StudySection):
    """Values held that fill a box."""

    method: Annotated[str, one_of(METHODS)] = word("sobol", "how the points are spread")
    points: Points = word(..., "how many points")
    ranges: Ranges = word(..., "the variables that are held at values, as ranges = { Lm = [0.4, 0.5] }")


class MonteCarloSection(StudySection):
    """Monte Carlo: simulate the truth, disturb it, identify."""

    realizations: Count = word(..., "how many realizations of the noise")
    std: PositiveOrEach | None = word(
        None, "standard deviation of the white normal noise, or one for each output; default: as [noise] says"
    )
    true_values: Finites = word({}, "values in the simulation of the truth, where they are not those of the case")

    def std_of(self, output: str) -> float:
        """Return the standard deviation of an output, in the unit of the table."""
        assert isinstance(self.std, dict), "of a study, by `of`"
        return self.std[output]

    def of(self, experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return these words with the standard deviation of every output.

        Raises
        ------
        InputError
            If that of an output is not known, or one is given of what is no output.
        """
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

    data: Tables = word([], "one identification a record: files, patterns of files, or names and files")
    starting_points: Starts | None = word(None, "how many starts are drawn, or the starts themselves by parameter")
    free_parameters: Subsets = word([], "the parameters that are free, one set after the other; default: all")
    sweep: Annotated[dict[str, Axis], Entries("a table { name = values }")] = word(
        {}, "variables, and the values at which they are held one after the other"
    )
    space_filling: SpaceFillingSection | None = word(None, "values held that fill a box")
    monte_carlo: MonteCarloSection | None = word(None, "Monte Carlo: simulate the truth, disturb it, identify")
    combine: Annotated[str, one_of(("product", "zip"))] = word(
        "product", "each entry of an axis with every entry of the others, or the n-th ones of all together"
    )
    seed: Natural = word(0, "of all that is drawn")

    @property
    def swept(self) -> tuple[str, ...]:
        """The variables that the batch holds at values: those of ``sweep``, then those of ``space_filling``."""
        return (*self.sweep, *(self.space_filling.ranges if self.space_filling is not None else ()))

    def records(self) -> dict[str, Path]:
        """Return the tables by the names of their records, in order; none where the study's own serve.

        The files of a pattern are sorted by their names, and each counts where it is matched first. A record is called
        by its file's name without suffix; where two would be called the same, all are called by their paths, and if
        that is not enough, with suffix. A file that is named, and not matched, need not be there.

        Raises
        ------
        InputError
            If a pattern matches no file.
        """
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
        """Return the files that a word of ``data`` means."""
        folder = self.place.folder
        if not glob.has_magic(given) or is_file(folder / given):
            return [Path(given).as_posix()]
        matches = glob.glob(given, root_dir=folder, recursive=True)  # noqa: PTH207  # of Path's none is absolute
        files = sorted((Path(each) for each in matches if is_file(folder / each)), key=lambda path: path.parts)
        if not files:
            raise self.error(f"data: {show(given)} matches no file in {full(folder)}")
        return [path.as_posix() for path in files]

    def of(self, parameters: Mapping[str, Parameter], experiments: Sequence[ExperimentSettings], noise: Noise) -> Self:
        """Return these words as those of a study with these parameters, experiments and noise.

        Raises
        ------
        InputError
            If a word does not fit them, or nothing is varied.
        """
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
        """Check all names of parameters, and that some are left to identify."""
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
