"""Cases and random draws of a batch, each computed from its number.

The axes of a batch are, in this order: data, each variable of sweep, space_filling, free_parameters, starting_points,
monte_carlo. In a product the last axis varies fastest; in a list the n-th case has the n-th entry of every axis.

A generator of random numbers is seeded by the batch's seed, a number of the purpose, and the entry. An entry has the
same numbers with any other axes, in any order and process.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import spans_decades
from fmuid.files import full, is_file
from fmuid.runs.batch.case_problem import check_model, truth_values
from fmuid.studies import SpaceFillingSection, Study, Value

# Purposes of random numbers.
FOR_STARTS, FOR_SAMPLE, FOR_NOISE = 1, 2, 3


@dataclass(frozen=True)
class Case:
    """One identification of a batch; `starts` and `held` replace values of the study."""

    index: int
    free: tuple[str, ...]  # parameters neither free nor held stay at their starts
    settings: Mapping[str, Value] = field(default_factory=dict)  # by `CaseList.columns`
    record: str | None = None  # None for the study's own tables, like `table`
    table: Path | None = None
    starts: Mapping[str, float] = field(default_factory=dict)
    held: Mapping[str, Value] = field(default_factory=dict)
    draw: int | None = None  # number of the noise realization, None where measurements are identified


# Of each key in ``[batch]``: number of entries, and the fields of `Case` that an entry sets.
_Axes = dict[str, tuple[int, Callable[[int], dict[str, Any]]]]


class CaseList:
    """The cases of a study's ``[batch]``, made on request, without data."""

    def __init__(self, study: Study) -> None:
        if study.batch is None:
            raise InputError(f"{study.path}: no [batch]. Add it, with data, starting_points, sweep or monte_carlo.")
        study.check_parameters()
        self.study, self.settings = study, study.batch
        self.names = tuple(study.flat_names)  # all parameters, those per experiment one by one
        self._records = list(self.settings.records().items())
        self._free = tuple(name for name in study.parameters if name not in self.settings.swept)
        self._axes = {word: axis for word, axis in self._all_axes().items() if axis[0]}
        self._count = self._length()
        self._check_starts()
        self.columns = tuple(self._all_columns())

    @classmethod
    def of(cls, study: Study) -> CaseList:
        """Return the cases of a study, checked against its files and model."""
        cases = cls(study)
        for name, path in cases._records:
            if not is_file(path):
                raise cases.settings.error(f"file {full(path)} of {name!r} not found.", "data")
        _ = study.notes  # checks that results with priors are of this model
        subsets = [cases._subset(entry) for entry in range(len(cases.settings.free_parameters))] or [cases._free]
        check_model(study, cases.settings, subsets, cases[0].held)
        return cases

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Case:
        """Return the case of a number; negative ones count from the end."""
        number = range(self._count)[index]
        found: dict[str, Any] = {"free": self._free}
        held: dict[str, Value] = {}
        for (_, fields_of), entry in zip(self._axes.values(), self._entries(number), strict=True):
            found |= fields_of(entry)
            held |= found.pop("held", {})
        case = Case(number, held=held, **found)
        return replace(case, settings=self._settings_of(case))

    def __iter__(self) -> Iterator[Case]:
        return map(self.__getitem__, range(self._count))

    def table_of(self, index: int) -> Path | None:
        """Return the table of a case, None for the study's own."""
        if not self._records:
            return None
        return self._records[self._entries(range(self._count)[index])[0]][1]

    def _entries(self, number: int) -> list[int]:
        """Return the entry of every axis for a case."""
        if self.settings.combine == "zip":
            return [number] * len(self._axes)
        found = []
        for count, _ in reversed(self._axes.values()):
            number, entry = divmod(number, count)
            found.append(entry)
        return found[::-1]

    def _all_axes(self) -> _Axes:
        settings, records, starts = self.settings, self._records, self.settings.starting_points
        axes: _Axes = {"data": (len(records), lambda k: {"record": records[k][0], "table": records[k][1]})}
        for name, values in settings.sweep.items():
            axes[f"sweep.{name}"] = len(values), partial(_held_at, name, values)
        if (space := settings.space_filling) is not None:
            axes["space_filling"] = (
                space.points,
                lambda k: {"held": dict(zip(space.ranges, self._design[k], strict=True))},
            )
        axes["free_parameters"] = len(settings.free_parameters), lambda k: {"free": self._subset(k)}
        if isinstance(starts, list):
            axes["starting_points"] = len(starts), lambda k: {"starts": starts[k]}
        elif starts is not None:
            axes["starting_points"] = starts, lambda k: {"starts": self._drawn_starts(k)}
        if settings.monte_carlo is not None:
            axes["monte_carlo"] = settings.monte_carlo.realizations, lambda k: {"draw": k}
        return axes

    def _length(self) -> int:
        counts = {word: count for word, (count, _) in self._axes.items()}
        if self.settings.combine == "zip":
            if len(set(counts.values())) > 1:
                said = ", ".join(f"{count} of {word}" for word, count in counts.items())
                wrong = f'combine = "zip" needs axes of one length, not {said}'
                raise self.settings.error(f'{wrong}. Change them, or choose "product".')
            return next(iter(counts.values()))
        length = math.prod(counts.values())
        if length > 2**53:  # more than a float64 counts
            raise self.settings.error(f"{length} cases are too many. Shorten the axes.")
        return length

    def _subset(self, entry: int) -> tuple[str, ...]:
        return tuple(name for name in self._free if name in self.settings.free_parameters[entry])

    @cached_property
    def _design(self) -> list[list[float]]:
        sample = self.settings.space_filling
        return [] if sample is None else design(sample, self.settings.seed).tolist()

    @cached_property
    def _start_ranges(self) -> tuple[Floats, Floats]:
        """Ends of the ranges of random starts: bounds, else around the prior's mean or the start."""
        study, found = self.study, []
        known = ParameterSet(study.parameters, [given.name for given in study.experiments], study.joint_prior)
        _, columns = known.for_experiment(0)
        for each, i in zip(study.parameters.values(), columns, strict=True):
            middle, reach = float(known.prior_mean[i]), 3.0 * float(known.prior_std[i])
            if math.isnan(middle):
                middle, reach = each.start, 0.5 * (each.nominal or abs(each.start))
            bounded = math.isfinite(each.max - each.min)
            around = max(each.min, middle - reach), min(each.max, middle + reach)
            found.append((each.min, each.max) if bounded else around)
        low, high = np.array(found).T
        return low, high

    def _drawn_starts(self, entry: int) -> dict[str, float]:
        """Return random starts of all parameters, free or not: logarithmic over a decade or more."""
        low, high = self._start_ranges
        decades = np.array(list(map(spans_decades, low, high)))
        ends = [np.log(end, out=end.copy(), where=decades) for end in (low, high)]
        drawn = generator(self.settings.seed, FOR_STARTS, entry).uniform(*ends)
        drawn = np.exp(drawn, out=drawn, where=decades).clip(low, high)  # exp(log(x)) is not always x
        return dict(zip(self.study.parameters, drawn.tolist(), strict=True))

    @cached_property
    def _started(self) -> tuple[str, ...]:
        given = self.settings.starting_points
        named = self._free if isinstance(given, int) else {name for start in given or () for name in start}
        return tuple(name for name in self._free if name in named)

    def _all_columns(self) -> list[str]:
        """Return the keys of `Case.settings`."""
        settings = self.settings
        return [
            *(["table"] if self._records else []),
            *(f"start.{name}" for name in self._started),
            *(f"set.{name}" for name in settings.swept),
            *(["free"] if settings.free_parameters else []),
            *(["draw"] if settings.monte_carlo is not None else []),
        ]

    def _settings_of(self, case: Case) -> dict[str, Value]:
        """Return the settings of a case by column; NaN for starts of fixed parameters."""
        found: dict[str, Value] = {} if case.record is None else {"table": case.record}
        for name in self._started:
            start = case.starts.get(name, self.study.parameters[name].start)
            found[f"start.{name}"] = start if name in case.free else math.nan
        found |= {f"set.{name}": value for name, value in case.held.items()}
        found |= {"free": " ".join(case.free)} if self.settings.free_parameters else {}
        return found | ({} if case.draw is None else {"draw": case.draw})

    def _check_starts(self) -> None:
        given = self.settings.starting_points
        for number, start in enumerate(given if isinstance(given, list) else ()):
            for name, value in start.items():
                with self.settings.place.below("starting_points", number, name).located():
                    replace(self.study.parameters[name], start=value)


def _held_at(name: str, values: Sequence[Value], entry: int) -> dict[str, Any]:
    return {"held": {name: values[entry]}}


def truth_of(study: Study) -> dict[str, float]:
    """Return true values of parameters; a swept one only if ``true_values`` has it."""
    batch = study.batch
    if batch is None or batch.monte_carlo is None:
        return {}
    truth = truth_values(study, {})
    return {
        flat: float(truth[flat])
        for flat, name in study.flat_names.items()
        if name not in batch.swept or {flat, name} & set(batch.monte_carlo.true_values)
    }


def generator(seed: int, purpose: int, *numbers: int) -> np.random.Generator:
    """Return the generator of random numbers for an entry of a purpose."""
    return np.random.default_rng(np.random.SeedSequence([seed, purpose, *numbers]))


def noise(seed: int, record: str | None, draw: int, experiment: int, shape: tuple[int, ...]) -> Floats:
    """Return standard normal white noise by record, draw and experiment."""
    words = [] if record is None else np.frombuffer(hashlib.sha256(record.encode()).digest()[:16], "<u4").tolist()
    return generator(seed, FOR_NOISE, draw, experiment, *words).standard_normal(shape)


def design(sample: SpaceFillingSection, seed: int) -> Floats:
    """Return the points (count, n) of a space-filling design (`scipy.stats.qmc`)."""
    from scipy.stats import qmc  # slow to import

    rng, n = generator(seed, FOR_SAMPLE), len(sample.ranges)
    if sample.method == "sobol":  # balanced only for a power of two: the first points of the next one
        units = qmc.Sobol(n, rng=rng).random_base2(math.ceil(math.log2(sample.points)))[: sample.points]
    else:
        units = qmc.LatinHypercube(n, rng=rng).random(sample.points)
    low, high = np.array(list(sample.ranges.values())).T
    return np.asarray(qmc.scale(units, low, high), dtype=np.float64)
