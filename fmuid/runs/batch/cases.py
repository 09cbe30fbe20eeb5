"""The cases of a batch, one by one: what each varies, computed from its number alone.

The axes of a batch are, in this order: data, each variable of sweep, space_filling, free_parameters, starting_points,
monte_carlo. In a product the last axis varies fastest; in a list the n-th case has the n-th entry of every axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from fmuid.data import ParameterSet
from fmuid.errors import InputError
from fmuid.files import full, is_file
from fmuid.runs.batch.case_problem import check_model, flat_names, truth_values
from fmuid.runs.batch.random_draws import StartRanges, design
from fmuid.studies import SpaceFillingSection, Study, Value

# More cases than a float64 counts are a mistake of the study.
MOST_CASES = 2**53


@dataclass(frozen=True)
class Case:
    """One identification of a batch.

    Attributes
    ----------
    index : int
    settings : mapping
        What the case is, in the columns `CaseList.columns`.
    record : str or None
        Name of the record whose table it is about; None for the study's own tables.
    table : Path or None
        That table.
    starts : mapping of str to float
        Starts in place of the study's.
    held : mapping of str to value
        The variables that the batch holds at values.
    free : tuple of str
        The parameters to identify; the others of the study that are not held by the batch are held at their starts.
    draw : int or None
        Which draw of the noise; None where measurements are identified.
    """

    index: int
    settings: Mapping[str, Value]
    record: str | None
    table: Path | None
    starts: Mapping[str, float]
    held: Mapping[str, Value]
    free: tuple[str, ...]
    draw: int | None


@dataclass
class _Draft:
    """A case in the making; the fields are those of `Case`."""

    free: tuple[str, ...]
    record: str | None = None
    table: Path | None = None
    starts: Mapping[str, float] = field(default_factory=dict)
    held: dict[str, Value] = field(default_factory=dict)
    draw: int | None = None


@dataclass(frozen=True)
class _Axis:
    """What a batch varies: its word in ``[batch]``, how many entries there are, and what puts one into a case."""

    word: str
    count: int
    put: Callable[[_Draft, int], None]


class CaseList:
    """The cases of a study's ``[batch]``, each made when it is asked for.

    Tables need not be here: a worker that knows all cases may have the tables of some of them (`CaseList.of` checks).

    Attributes
    ----------
    study : Study
    settings : BatchSettings
    names : tuple of str
        All parameters of the study, those per experiment one by one.
    columns : tuple of str
        What `Case.settings` has: ``table``, ``start.<parameter>``, ``set.<variable>``, ``free``, ``draw``, as far as
        the batch varies it.

    Raises
    ------
    InputError
        If the study has no ``[batch]`` or no parameters, a pattern of tables matches no file, the axes of a list are
        of different lengths, or starts lie outside the bounds.
    """

    def __init__(self, study: Study) -> None:
        if study.batch is None:
            raise InputError(
                f"{study.path} has no [batch]: give it, with what varies from case to case, such as tables, starts, "
                "values or noise"
            )
        study.check_parameters()
        self.study, self.settings = study, study.batch
        self.names = tuple(flat_names(study))
        self._records = list(self.settings.records().items())
        self._free = tuple(name for name in study.parameters if name not in self.settings.swept)
        self._axes = self._all_axes()
        self._count = self._length()
        self._check_starts()
        self.columns = tuple(self._all_columns())

    @classmethod
    def of(cls, study: Study) -> CaseList:
        """Return the cases of a study whose files are all here, checked against its model.

        Raises
        ------
        InputError
            As the class, and if a table is missing, or a name, a value or a prior does not fit the model.
        """
        cases = cls(study)
        for name, path in cases._records:
            if not is_file(path):
                raise cases.settings.error(f"data: there is no file {full(path)}, the record {name!r}")
        _ = study.notes  # checks that results which priors are taken from are of this model
        subsets = [cases._subset(entry) for entry in range(len(cases.settings.free_parameters))] or [cases._free]
        check_model(study, cases.settings, subsets, cases[0].held)
        return cases

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Case:
        """Return the case of a number; negative ones count from the end."""
        number = range(self._count)[index]
        draft = _Draft(self._free)
        for axis, entry in zip(self._axes, self._entries(number), strict=True):
            axis.put(draft, entry)
        settings = self._settings_of(draft)
        return Case(number, settings, draft.record, draft.table, draft.starts, draft.held, draft.free, draft.draw)

    def __iter__(self) -> Iterator[Case]:
        return map(self.__getitem__, range(self._count))

    def table_of(self, index: int) -> Path | None:
        """Return the table of a case, None where it is about the study's own."""
        if not self._records:
            return None
        return self._records[self._entries(range(self._count)[index])[0]][1]

    # --- axes

    def _entries(self, number: int) -> list[int]:
        """Return the entry of every axis that a case has."""
        if self.settings.combine == "zip":
            return [number] * len(self._axes)
        found = []
        for axis in reversed(self._axes):
            number, entry = divmod(number, axis.count)
            found.append(entry)
        return found[::-1]

    def _all_axes(self) -> list[_Axis]:
        settings, starts = self.settings, self.settings.starting_points
        axes = [_Axis("data", len(self._records), self._put_table)]
        axes += [_Axis(f"sweep.{name}", len(some), _putting(name, some)) for name, some in settings.sweep.items()]
        if settings.space_filling is not None:
            axes.append(
                _Axis("space_filling", settings.space_filling.points, self._putting_sample(settings.space_filling))
            )
        axes.append(_Axis("free_parameters", len(settings.free_parameters), self._put_subset))
        if starts is not None:
            axes.append(_Axis("starting_points", starts if isinstance(starts, int) else len(starts), self._put_starts))
        if settings.monte_carlo is not None:
            axes.append(_Axis("monte_carlo", settings.monte_carlo.realizations, self._put_draw))
        return [axis for axis in axes if axis.count]

    def _length(self) -> int:
        counts = {axis.word: axis.count for axis in self._axes}
        if self.settings.combine == "zip":
            if len(set(counts.values())) > 1:
                said = ", ".join(f"{count} of {word}" for word, count in counts.items())
                raise self.settings.error(
                    f'has combine = "zip" and axes of different lengths ({said}): make them equally long, or combine '
                    'them as a "product"'
                )
            return next(iter(counts.values()))
        length = math.prod(counts.values())
        if length > MOST_CASES:
            raise self.settings.error(f"spans {length} cases, more than can be run: take fewer of each axis")
        return length

    def _put_table(self, draft: _Draft, entry: int) -> None:
        draft.record, draft.table = self._records[entry]

    def _putting_sample(self, sample: SpaceFillingSection) -> Callable[[_Draft, int], None]:
        def put(draft: _Draft, entry: int) -> None:
            draft.held |= dict(zip(sample.ranges, self._design[entry], strict=True))

        return put

    def _put_subset(self, draft: _Draft, entry: int) -> None:
        draft.free = self._subset(entry)

    def _put_starts(self, draft: _Draft, entry: int) -> None:
        given = self.settings.starting_points
        draft.starts = given[entry] if isinstance(given, list) else self._start_ranges.draw(self.settings.seed, entry)

    def _put_draw(self, draft: _Draft, entry: int) -> None:
        draft.draw = entry

    def _subset(self, entry: int) -> tuple[str, ...]:
        return tuple(name for name in self._free if name in self.settings.free_parameters[entry])

    @cached_property
    def _design(self) -> list[list[float]]:
        """The points of the space-filling design."""
        sample = self.settings.space_filling
        return [] if sample is None else design(sample, self.settings.seed).tolist()

    @cached_property
    def _start_ranges(self) -> StartRanges:
        study = self.study
        known = ParameterSet(study.parameters, [given.name for given in study.experiments], study.joint_prior)
        return StartRanges(study.parameters, known)

    # --- columns

    @cached_property
    def _started(self) -> tuple[str, ...]:
        """The parameters whose start varies."""
        given = self.settings.starting_points
        named = self._free if isinstance(given, int) else {name for start in given or () for name in start}
        return tuple(name for name in self._free if name in named)

    def _all_columns(self) -> list[str]:
        settings = self.settings
        return [
            *(["table"] if self._records else []),
            *(f"start.{name}" for name in self._started),
            *(f"set.{name}" for name in settings.swept),
            *(["free"] if settings.free_parameters else []),
            *(["draw"] if settings.monte_carlo is not None else []),
        ]

    def _settings_of(self, draft: _Draft) -> dict[str, Value]:
        """Return what a case is, by column; a parameter that is not free has no start (NaN)."""
        found: dict[str, Value] = {} if draft.record is None else {"table": draft.record}
        for name in self._started:
            start = draft.starts.get(name, self.study.parameters[name].start)
            found[f"start.{name}"] = start if name in draft.free else math.nan
        found |= {f"set.{name}": value for name, value in draft.held.items()}
        found |= {"free": " ".join(draft.free)} if self.settings.free_parameters else {}
        return found | ({} if draft.draw is None else {"draw": draft.draw})

    def _check_starts(self) -> None:
        given = self.settings.starting_points
        for number, start in enumerate(given if isinstance(given, list) else ()):
            for name, value in start.items():
                try:
                    replace(self.study.parameters[name], start=value)
                except InputError as error:
                    raise self.settings.error(f"starting_points[{number}].{name}: {error}") from None


def _putting(name: str, values: Sequence[Value]) -> Callable[[_Draft, int], None]:
    def put(draft: _Draft, entry: int) -> None:
        draft.held[name] = values[entry]

    return put


def truth_of(study: Study) -> dict[str, float]:
    """Return the parameters that the measurements of a study's batch are simulated at, where the noise is drawn.

    Those per experiment one by one. A parameter that the batch holds at values is there only if the truth has a value
    of its own for it.
    """
    batch = study.batch
    if batch is None or batch.monte_carlo is None:
        return {}
    truth = truth_values(study, {})
    return {
        flat: float(truth[flat])
        for flat, name in flat_names(study).items()
        if name not in batch.swept or {flat, name} & set(batch.monte_carlo.true_values)
    }
