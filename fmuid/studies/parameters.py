"""The sections ``[parameters]`` and ``[prior]``, and results that priors are taken from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator

from fmuid.data import JointPrior, Normal, Parameter, ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import Grade, Reason, Result, TerminationReason
from fmuid.formatting import nearest
from fmuid.models import FMU, System
from fmuid.simulation import Value
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import SectionLocation, StudySection, entry
from fmuid.studies.toml import show


class ResultPriorSection(StudySection):
    """Prior that may come from an earlier result."""

    result: kinds.File | None = entry(None, "result.json of an earlier identification", "healthy/result.json")
    std_factor: kinds.Positive = entry(1.0, "factor on its σ, for expected changes", 10)

    def comes_from_result(self, given: Sequence[str], needed: Sequence[str]) -> bool:
        """Return whether it is from a result; check the keys."""
        if self.result is not None:
            for key in given:
                if key in self.model_fields_set:
                    raise self.error(f"result and {key} cannot be combined. Keep one of the two.")
            return True
        if "std_factor" in self.model_fields_set:
            raise self.error("needs a result. Set result or remove std_factor.", "std_factor")
        for key in needed:
            if key not in self.model_fields_set:
                raise self.error(f"missing key {key!r}: {type(self).model_fields[key].description}.")
        return False


class PriorSection(ResultPriorSection):
    """Prior of one parameter."""

    mean: kinds.Finite | None = entry(None, "mean")
    std: kinds.Positive | None = entry(None, "standard deviation")


class JointPriorSection(ResultPriorSection):
    """Joint prior of several parameters."""

    names: kinds.Names | None = entry(None, "its parameters; default with result: all common ones", ["a", "b"])
    mean: kinds.Numbers | None = entry(None, "means of these parameters")
    covariance: kinds.Matrix | None = entry(None, "covariance of these parameters, row by row")


OR_ARRAY = {"type": ["number", "array"]}  # type of a number that an array of numbers may replace, in the JSON schema
Groups = Annotated[dict[str, kinds.Names], kinds.Entries("{ group = experiments }")]


class ParameterSection(StudySection):
    """Free parameter, by its name in the FMU."""

    start: kinds.Number | None = entry(
        None, "initial guess; for a matrix, rows of numbers, [[1.0, 0.0], [0.0, 1.0]]", json_schema_extra=OR_ARRAY
    )
    choices: Annotated[
        list[kinds.Scalar], BeforeValidator(kinds.as_list, json_schema_input_type=Literal["all"] | list[kinds.Scalar])
    ] = entry([], 'values of a discrete parameter; "all": all that the FMU declares', [1, 2, 3])
    min: kinds.Number = entry(-math.inf, "lower bound", json_schema_extra=OR_ARRAY)
    max: kinds.Number = entry(math.inf, "upper bound", json_schema_extra=OR_ARRAY)
    nominal: kinds.Positive | None = entry(None, "scale; required if start is 0", json_schema_extra=OR_ARRAY)
    per_experiment: Annotated[kinds.Flag | Groups, kinds.BY_SHAPE] = entry(
        False, "one value per experiment, or per group"
    )
    prior: PriorSection | None = entry(None, "prior of this parameter")


class ResultValueSection(StudySection):
    """Value from an earlier identification."""

    result: kinds.File = entry(..., "result.json of an earlier identification", "drive/result.json")
    name: kinds.Text | None = entry(
        None, "parameter of that result; default: the same name, with or without component", "M"
    )

    def value(self, variable: str, result: Result) -> float:
        """Return the estimate for a variable."""
        wanted = [self.name] if self.name is not None else [variable, variable.partition(".")[2]]
        found = next((name for name in wanted if name in result.names), None)
        if found is None:
            raise self.error(_missing(wanted[0], self.result, result))
        return result[found]


def _missing(name: str, path: Path, result: Result) -> str:
    return f"{path} has no parameter {name!r}{nearest(name, result.names)}. It has {', '.join(result.names)}."


class SourceIssue(Enum):
    """Issue of an earlier result."""

    DID_NOT_SUCCEED = "did_not_succeed"
    DOUBTFUL = "doubtful"
    NO_MODEL = "no_model"  # its model is unknown
    OTHER_BUILD = "other_build"  # it was made with another build of the FMU


@dataclass(frozen=True)
class SourceWarning:
    """Issue of an earlier result; `fmu` is the study's, of another build, `reasons` those of its verdict."""

    path: Path
    doubt: SourceIssue
    outcome: TerminationReason
    fmu: FMU | None = None
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, eq=False)
class PriorSource:
    """Earlier result with the parameters taken from it; `where` is for messages."""

    where: str
    path: Path
    result: Result
    names: tuple[str, ...]

    def compare(self, system: System) -> list[SourceWarning]:
        """Return issues; refuse a result of another model."""
        note = partial(SourceWarning, self.path, outcome=self.result.outcome)
        verdict = self.result.verdict
        notes = [] if self.result.converged else [note(SourceIssue.DID_NOT_SUCCEED)]
        if not notes and verdict is not None and verdict.grade is not Grade.PASSED:
            notes = [note(SourceIssue.DOUBTFUL, reasons=verdict.reasons)]
        if not self.result.setup.models:
            return [*notes, note(SourceIssue.NO_MODEL)]
        for component in dict.fromkeys(system.split(name)[0] for name in self.names):
            fmu = system.components[component].fmu
            made = self.result.setup.models
            earlier = made.get(component) or made.get("")  # of that component alone
            if earlier is None or earlier["name"] != fmu.name:
                theirs = ", ".join(model["name"] for model in made.values())
                as_ = f" as {component!r}" if component else ""
                raise InputError(
                    f"{self.where}: {self.path} is of another model, {theirs}. This study has {fmu.name}{as_}."
                )
            if earlier["digest"] != fmu.digest:
                notes.append(note(SourceIssue.OTHER_BUILD, fmu=fmu))
        return notes


@dataclass(frozen=True, eq=False)
class ParsedParameters:
    """Parameters of a study; `names` are the continuous ones, per experiment."""

    parameters: dict[str, Parameter]
    joint_prior: JointPrior | None
    sources: tuple[PriorSource, ...]
    names: tuple[str, ...]
    choices: dict[str, tuple[Value, ...] | str]


class ParameterReader:
    """Reader of parameters and priors; each result file is read once."""

    def __init__(self, top: SectionLocation, held: Mapping[str, float | int | bool | str]) -> None:
        self.top, self.held = top, held
        self.results: dict[Path, Result] = {}
        self.sources: list[PriorSource] = []

    def read(
        self, words: Mapping[str, ParameterSection], prior: JointPriorSection | None, experiments: Sequence[str]
    ) -> ParsedParameters:
        """Return the parameters of a study with these experiments."""
        if not words:
            if prior is not None:
                raise self.top.below("prior").error("no free parameters. Add them under [parameters].")
            return ParsedParameters({}, None, (), (), {})
        choices = {name: self._values(name, each) for name, each in words.items() if each.choices}
        parameters = {name: self._parameter(name, each) for name, each in words.items() if not each.choices}
        alone = self._set(parameters, experiments, None, "parameters")
        joint = None if prior is None else self._joint(prior, alone.names)
        if joint is not None:
            self._set(parameters, experiments, joint, "prior")
        return ParsedParameters(parameters, joint, tuple(self.sources), alone.names, choices)

    def _set(
        self, parameters: Mapping[str, Parameter], experiments: Sequence[str], joint: JointPrior | None, table: str
    ) -> ParameterSet:
        with self.top.below(table).located():
            return ParameterSet(parameters, experiments, joint)

    def _values(self, name: str, words: ParameterSection) -> tuple[Value, ...] | str:
        for key in sorted(words.model_fields_set - {"choices"}):
            raise words.error(f"choices and {key} cannot be combined. Remove {key}.")
        if name in self.held:
            raise words.error(f"also fixed at {show(self.held[name])} in [model.fixed]. Keep one of the two.")
        return "all" if words.choices == ["all"] else tuple(words.choices)

    def _parameter(self, name: str, words: ParameterSection) -> Parameter:
        if words.start is None:
            raise words.error(f"missing key 'start': {type(words).model_fields['start'].description}.")
        prior = None if words.prior is None else self._normal(name, words.prior)
        with words.place.located():  # a Parameter does not know its name
            return Parameter(words.start, words.min, words.max, words.nominal, prior, words.per_experiment)

    def _normal(self, name: str, words: PriorSection) -> Normal:
        if not words.comes_from_result(("mean", "std"), ("mean", "std")):
            assert words.mean is not None and words.std is not None
            return Normal(words.mean, words.std)
        path, result = self._result(words)
        self._take(words, path, result, [name])
        with words.place.located(path):
            return result.normal(name, inflate=words.std_factor)

    def _joint(self, words: JointPriorSection, names: Sequence[str]) -> JointPrior:
        for name in words.names or ():
            if name in self.held:
                fixed = f"{name!r} is fixed at {show(self.held[name])} in [model.fixed]"
                raise words.error(f"{fixed}. Move it to [parameters] or remove it here.", "names")
            if name not in names:
                raise words.error(f"unknown parameter {name!r}{nearest(name, names)}", "names")
        if words.comes_from_result(("mean", "covariance"), ("names", "mean", "covariance")):
            return self._joint_from_result(words, names)
        assert words.names is not None and words.mean is not None and words.covariance is not None
        with words.place.located():
            return JointPrior(words.names, words.mean, words.covariance)

    def _joint_from_result(self, words: JointPriorSection, names: Sequence[str]) -> JointPrior:
        path, result = self._result(words)
        shared = words.names or [name for name in names if name in result.names]
        if not shared:
            theirs, ours = ", ".join(result.names), ", ".join(names)
            raise words.error(f"{path} has {theirs}; this study has {ours}. Give a result of the same model.")
        self._take(words, path, result, shared)
        with words.place.located(path):
            return result.prior(shared, inflate=words.std_factor)

    def _result(self, words: ResultPriorSection) -> tuple[Path, Result]:
        assert words.result is not None
        path = words.result
        with words.place.located():
            return path, self.results.setdefault(path, self.results.get(path) or Result.from_json(path))

    def _take(self, words: ResultPriorSection, path: Path, result: Result, names: Sequence[str]) -> None:
        """Note parameters taken from a result that must have them."""
        for name in names:
            if name not in result.names:
                raise words.error(_missing(name, path, result))
        self.sources.append(PriorSource(str(words.place), path, result, tuple(names)))


def conditional_prior(prior: JointPrior, known: Mapping[str, float]) -> JointPrior | None:
    """Return the conditional normal distribution of unknown parameters (1.37)."""
    there = np.array([name in known for name in prior.names])
    if not there.any():
        return prior
    if there.all():
        return None
    left = ~there
    std = np.sqrt(np.diag(prior.covariance))
    correlation = prior.covariance / np.outer(std, std)
    gain = np.linalg.solve(correlation[np.ix_(there, there)], correlation[np.ix_(there, left)]).T
    away = (np.array([known[name] for name in prior.names if name in known]) - prior.mean[there]) / std[there]
    matrix = correlation[np.ix_(left, left)] - gain @ correlation[np.ix_(there, left)]
    return JointPrior(
        [name for name in prior.names if name not in known],
        prior.mean[left] + std[left] * (gain @ away),
        (matrix + matrix.T) / 2.0 * np.outer(std[left], std[left]),
    )
