"""The table ``[batch]`` of a study file: the many identifications, called cases, that the study spans."""

from __future__ import annotations

import glob
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data import Noise, Parameter
from fmuid.errors import InputError
from fmuid.files import full, is_file
from fmuid.studies import toml as toml
from fmuid.studies.parameters import Knowns
from fmuid.studies.settings import ExperimentSettings
from fmuid.studies.toml import Section
from fmuid.text import nearest

Value = float | int | bool | str

BATCH_KEYS = ("combine", "tables", "starts", "subsets", "values", "sample", "noise", "seed")
SAMPLE_KEYS, RANGE_KEYS = ("method", "count", "ranges"), ("from", "to", "count")
DRAWS_KEYS = ("draws", "std", "truth")
METHODS = ("sobol", "latin-hypercube")
# Beyond these a space-filling design fills the memory, and a Sobol sequence of 30 bits ends.
MOST_POINTS = 2**24
LARGEST_WHOLE = 2**63  # what a column of whole numbers holds


@dataclass(frozen=True)
class Sample:
    """The table ``[batch.sample]``: values held that fill a box.

    Attributes
    ----------
    method : "sobol" or "latin-hypercube"
    count : int
        Points.
    ranges : mapping of str to (float, float)
        The variables held, and from where to where.
    """

    method: str
    count: int
    ranges: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class NoiseDraws:
    """The word ``noise`` of ``[batch]``: simulate the truth, disturb it, identify.

    Attributes
    ----------
    draws : int
    std : mapping of str to float
        Standard deviation of the white normal noise of each output, in the unit of the table.
    truth : mapping of str to float
        Values of parameters or other variables in the simulation of the truth, where they are not those of the case:
        a parameter's start, the value that a variable is held at.
    """

    draws: int
    std: Mapping[str, float]
    truth: Mapping[str, float]


@dataclass(frozen=True)
class BatchSettings:
    """The table ``[batch]``.

    Attributes
    ----------
    where : str
        The study file and the table, for messages.
    folder : Path
        Tables are named relative to it.
    combine : "product" or "list"
        Whether each entry of an axis goes with every entry of the others, or the n-th ones of all go together.
    tables : tuple of str, or mapping of str to str
        Files and patterns of files, or record names and files; empty for the study's own tables.
    starts : int, tuple of mappings of str to float, or None
        How many starts are drawn, or the starts themselves by parameter.
    subsets : tuple of tuple of str
        The parameters that are free; empty for all.
    values : mapping of str to tuple of values
        Variables, and the values at which they are held one after the other.
    sample : Sample or None
    noise : NoiseDraws or None
    seed : int
        Of all that is drawn.
    """

    where: str = field(compare=False)
    folder: Path
    combine: str = "product"
    tables: tuple[str, ...] | Mapping[str, str] = ()
    starts: int | tuple[Mapping[str, float], ...] | None = None
    subsets: tuple[tuple[str, ...], ...] = ()
    values: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    sample: Sample | None = None
    noise: NoiseDraws | None = None
    seed: int = 0

    @property
    def swept(self) -> tuple[str, ...]:
        """The variables that the batch holds at values: those of ``values``, then those of ``sample``."""
        return (*self.values, *(self.sample.ranges if self.sample is not None else ()))

    def error(self, text: str) -> InputError:
        """Return an error whose sentence is this table followed by `text`."""
        return InputError(f"{self.where} {text}")

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
        if isinstance(self.tables, Mapping):
            return {name: self.folder / given for name, given in self.tables.items()}
        found: dict[str, None] = {}
        for given in self.tables:
            found |= dict.fromkeys(self._matches(given))
        names: list[str] = []
        for name in _NAMES:
            names = [name(each) for each in found]
            if len(set(names)) == len(names):
                break
        return {name: self.folder / given for name, given in zip(names, found, strict=True)}

    def _matches(self, given: str) -> list[str]:
        """Return the files that a word of ``tables`` means."""
        if not glob.has_magic(given) or is_file(self.folder / given):
            return [Path(given).as_posix()]
        matches = glob.glob(given, root_dir=self.folder, recursive=True)  # noqa: PTH207  # of Path's none is absolute
        files = sorted((Path(each) for each in matches if is_file(self.folder / each)), key=lambda path: path.parts)
        if not files:
            raise self.error(f"tables: {toml.show(given)} matches no file in {full(self.folder)}")
        return [path.as_posix() for path in files]


_NAMES: tuple[Callable[[str], str], ...] = (
    lambda path: Path(path).stem,
    lambda path: Path(path).with_suffix("").as_posix(),
    lambda path: path,
)


def read_batch(
    top: Section, folder: Path, known: Knowns, experiments: Sequence[ExperimentSettings], noise: Noise
) -> BatchSettings:
    """Read the table ``[batch]``.

    Parameters
    ----------
    top : Section
        The study file.
    folder : Path
        Tables are named relative to it.
    known : Knowns
        The study's parameters.
    experiments : sequence of ExperimentSettings
    noise : Noise
        Of the study.

    Raises
    ------
    InputError
        If a key is unknown, missing or of the wrong kind, a word does not fit the study's parameters and outputs, or
        nothing is varied.
    """
    section = top.table("batch", BATCH_KEYS)
    settings = BatchSettings(
        f"{section.file}: {section.where}",
        folder,
        section.get("combine", toml.one_of("product", "list"), "product"),
        section.get("tables", _tables, ()),
        section.get("starts", _starts, None),
        section.get("subsets", _subsets, ()),
        section.get("values", toml.named(_axis), {}),
        _read_sample(section),
        _read_noise(section, experiments, noise),
        section.get("seed", toml.natural, 0),
    )
    if not set(section.data) - {"combine", "seed"}:
        raise section.error("varies nothing: give at least one of tables, starts, subsets, values, sample and noise")
    if settings.tables and len(experiments) > 1:
        raise section.error(
            f"has tables, each in place of the study's own, and the study has {len(experiments)} [[experiments]]: "
            "keep one of them, whose words are those of all tables"
        )
    _check_names(settings, known.parameters)
    return settings


def _read_sample(section: Section) -> Sample | None:
    if "sample" not in section.data:
        return None
    table = section.table("sample", SAMPLE_KEYS)
    return Sample(
        table.get("method", toml.one_of(*METHODS), "sobol"),
        table.need("count", _points, "how many points"),
        table.need("ranges", _ranges, "the variables that are held at values, as ranges = { Lm = [0.4, 0.5] }"),
    )


def _read_noise(section: Section, experiments: Sequence[ExperimentSettings], noise: Noise) -> NoiseDraws | None:
    if "noise" not in section.data:
        return None
    table = section.table("noise", DRAWS_KEYS)
    outputs = tuple(dict.fromkeys(name for given in experiments for name in given.outputs))
    given: Mapping[str, float] | float | None = table.get("std", _stds, None)
    if isinstance(given, Mapping):
        for name in given:
            if name not in outputs:
                raise table.error(f"std names {name!r}, which is no measured output{nearest(name, outputs)}")
    variances = dict(zip(outputs, noise.known(outputs).tolist(), strict=True))
    stds = {}
    for name in outputs:
        std = given.get(name) if isinstance(given, Mapping) else given
        stds[name] = math.sqrt(variances[name]) if std is None else std
        if math.isnan(stds[name]):
            raise table.error(
                f"needs the standard deviation of the noise of {name!r}: give std = {{ {name} = ... }}, or its "
                "variance in [noise]"
            )
    return NoiseDraws(
        table.need("draws", toml.count, "how many draws of the noise"),
        stds,
        table.get("truth", toml.named(_finite), {}),
    )


def _check_names(settings: BatchSettings, parameters: Mapping[str, Parameter]) -> None:
    """Check all names of parameters, and that some are left to identify."""
    for name, values in settings.values.items():
        if name in parameters and any(isinstance(value, bool | str) for value in values):
            raise settings.error(f"values.{name}: a parameter is held at numbers, not at {toml.show(values[0])}")
        if settings.sample is not None and name in settings.sample.ranges:
            raise settings.error(f"holds {name!r} both by values and by sample: keep one of the two")
    if parameters and not set(parameters) - set(settings.swept):
        raise settings.error(
            "holds all parameters of the study at values, so that none is left to identify: leave one of "
            f"{', '.join(parameters)} out of values and sample"
        )
    for subset in settings.subsets:
        _check_parameters(settings, "subsets", subset, parameters)
    for start in settings.starts if isinstance(settings.starts, tuple) else ():
        _check_parameters(settings, "starts", start, parameters)


def _check_parameters(
    settings: BatchSettings, word: str, names: Iterable[str], parameters: Mapping[str, Parameter]
) -> None:
    for name in names:
        if name not in parameters:
            raise settings.error(
                f"{word} names {name!r}, which is no parameter of this study{nearest(name, parameters)}"
            )
        if name in settings.swept:
            raise settings.error(
                f"{word} names {name!r}, which values or sample hold, so that it is not identified: keep one of the two"
            )


# --- kinds of values --------------------------------------------------------------------


def _finite(value: object) -> float:
    found = toml.number(value)
    if not math.isfinite(found):
        raise toml.MismatchError("a finite number")
    return found


def _points(value: object) -> int:
    found = toml.count(value)
    if found > MOST_POINTS:
        raise toml.MismatchError(f"a whole number up to {MOST_POINTS}")
    return found


def _tables(value: object) -> Any:
    """Check for files or patterns of them, or for names and files."""
    if isinstance(value, str) and value:
        return (value,)
    if isinstance(value, list) and value and all(isinstance(item, str) and item for item in value):
        return tuple(value)
    if isinstance(value, dict) and value and all(isinstance(item, str) and item for item in value.values()):
        return dict(value)
    raise toml.MismatchError('a pattern of files, "records/*.csv", a list of files and patterns, or { name = "file" }')


def _starts(value: object) -> Any:
    if isinstance(value, list) and value and all(isinstance(item, dict) and item for item in value):
        return tuple(toml.named(_finite)(item) for item in value)
    try:
        return toml.count(value)
    except toml.MismatchError:
        raise toml.MismatchError("a whole number above 0, or a list of starts, [{ Rs = 9.0, Rr = 3.0 }]") from None


def _subsets(value: object) -> tuple[tuple[str, ...], ...]:
    if isinstance(value, list) and value:
        try:
            found = tuple(tuple(toml.names(item)) for item in value)
        except toml.MismatchError:
            found = ()
        if found and len({frozenset(subset) for subset in found}) == len(found):
            return found
    raise toml.MismatchError('a list of different lists of parameters, [["Rs", "Rr"], ["Rs", "Rr", "Lm"]]')


def _axis(value: object) -> tuple[Value, ...]:
    """Check for values of one type, or for a range of numbers."""
    if isinstance(value, dict):
        return _range(value)
    kinds: tuple[tuple[type, ...], ...] = ((bool,), (int,), (int, float), (str,))
    if isinstance(value, list) and value:
        whole = [item for item in value if isinstance(item, bool) or not isinstance(item, int) or _fits(item)]
        for kind in kinds if len(whole) == len(value) else ():
            if all(isinstance(item, kind) and (isinstance(item, bool) == (kind == (bool,))) for item in value):
                return tuple(value) if kind != (int, float) else tuple(_finite(item) for item in value)
    raise toml.MismatchError("a list of values of one type, [0.40, 0.47], or { from = 0.4, to = 0.5, count = 5 }")


def _fits(number: int) -> bool:
    return -LARGEST_WHOLE <= number < LARGEST_WHOLE


def _range(value: dict[str, Any]) -> tuple[float, ...]:
    """Return equally spaced numbers, both ends included."""
    if set(value) != set(RANGE_KEYS):
        raise toml.MismatchError("a list of values, or { from = 0.4, to = 0.5, count = 5 } with just these three")
    first, last, count = _finite(value["from"]), _finite(value["to"]), _points(value["count"])
    if count == 1 or first == last:
        raise toml.MismatchError("a range of at least two values, whose from and to differ")
    return tuple(np.linspace(first, last, count).tolist())


def _ranges(value: object) -> dict[str, tuple[float, float]]:
    if not isinstance(value, dict) or not value:
        raise toml.MismatchError("a table { variable = [lowest, highest] }")
    return toml.named(_limits)(value)


def _limits(value: object) -> tuple[float, float]:
    found = toml.numbers(value) if isinstance(value, list) else []
    if len(found) != 2 or not found[0] < found[1]:
        raise toml.MismatchError("[lowest, highest]")
    return found[0], found[1]


def _stds(value: object) -> Any:
    return toml.named(toml.positive)(value) if isinstance(value, dict) else toml.positive(value)
