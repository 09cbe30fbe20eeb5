"""The tables ``[parameters]`` and ``[prior]``, and results that priors are taken from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator

from fmuid.data import JointPrior, Normal, Parameter, ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import Result, TerminationReason
from fmuid.formatting import nearest
from fmuid.models import FMU, System
from fmuid.simulation import Value
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import SectionLocation, StudySection, entry
from fmuid.studies.toml import show


class ResultPriorSection(StudySection):
    """A prior that may come from an earlier result."""

    result: kinds.File | None = entry(None, "the result.json of an earlier identification", "healthy/result.json")
    std_factor: kinds.Positive = entry(1.0, "factor on its standard deviations, for changes to be expected", 10)

    def comes_from_result(self, given: Sequence[str], needed: Sequence[str]) -> bool:
        """Return whether it is from a result; refuse missing and conflicting keys."""
        if self.result is not None:
            for key in given:
                if key in self.model_fields_set:
                    raise self.error(f"has both result and {key}: keep one of the two")
            return True
        if "std_factor" in self.model_fields_set:
            raise self.error("has std_factor, which goes with result: name the result.json, or remove it")
        for key in needed:
            if key not in self.model_fields_set:
                raise self.error(f"needs the key {key!r}: {type(self).model_fields[key].description}")
        return False


class PriorSection(ResultPriorSection):
    """What is known of one parameter."""

    mean: kinds.Finite | None = entry(None, "its mean")
    std: kinds.Positive | None = entry(None, "its standard deviation")


class JointPriorSection(ResultPriorSection):
    """What is known of several parameters together."""

    names: kinds.Names | None = entry(
        None, "the parameters that it is about; with result, by default all that both have", ["a", "b"]
    )
    mean: kinds.Numbers | None = entry(None, "the means of the parameters that it names")
    covariance: kinds.Matrix | None = entry(None, "the covariance of the parameters that it names, row by row")


Groups = Annotated[dict[str, kinds.Names], kinds.Entries("a table { group = experiments }")]


class ParameterSection(StudySection):
    """A parameter to identify, by its name in the FMU."""

    start: kinds.Number | None = entry(
        None,
        "where the search begins; of a vector or a matrix, rows of numbers: [[1.0, 0.0], [0.0, 1.0]]",
        json_schema_extra={"type": ["number", "array"]},
    )
    choices: Annotated[list[kinds.Scalar], BeforeValidator(kinds.as_list)] = entry(
        [],
        "in place of all else, of an Integer, a Boolean or an enumeration: its values, of which each is tried; "
        '"all" that the FMU declares',
        [1, 2, 3],
    )
    min: kinds.Number = entry(-math.inf, "lower bound")
    max: kinds.Number = entry(math.inf, "upper bound")
    nominal: kinds.Positive | None = entry(None, "size, needed where the start is 0")
    per_experiment: Annotated[kinds.Flag | Groups, kinds.BY_SHAPE] = entry(
        False, 'one value for each experiment, or for each group of them: { cold = ["run1", "run2"], warm = ["run3"] }'
    )
    prior: PriorSection | None = entry(None, "what is known of it")


class ResultValueSection(StudySection):
    """A value that is an estimate of an earlier identification."""

    result: kinds.File = entry(..., "the result.json of an earlier identification", "drive/result.json")
    name: kinds.Text | None = entry(
        None, "the parameter of that result; default: that of the same name, with or without its component", "M"
    )

    def value(self, variable: str, result: Result) -> float:
        """Return the estimate for a variable."""
        wanted = [self.name] if self.name is not None else [variable, variable.partition(".")[2]]
        found = next((name for name in wanted if name in result.names), None)
        if found is None:
            raise self.error(
                f"takes {wanted[0]!r} from {self.result}, which has no such parameter"
                f"{nearest(wanted[0], result.names)}; it has {', '.join(result.names)}"
            )
        return result[found]


class SourceIssue(Enum):
    """Doubt about an earlier result."""

    DID_NOT_SUCCEED = "did_not_succeed"
    NO_MODEL = "no_model"
    """It does not say of which model it is."""
    OTHER_BUILD = "other_build"
    """It was made with another build of the FMU."""


@dataclass(frozen=True)
class SourceWarning:
    """Doubt about an earlier result; `fmu` is the study's, of another build."""

    path: Path
    doubt: SourceIssue
    outcome: TerminationReason
    fmu: FMU | None = None


@dataclass(frozen=True, eq=False)
class PriorSource:
    """Earlier result with the parameters taken from it; `where` is for messages."""

    where: str
    path: Path
    result: Result
    names: tuple[str, ...]

    def compare(self, system: System) -> list[SourceWarning]:
        """Return doubts; refuse a result of another model."""
        note = partial(SourceWarning, self.path, outcome=self.result.outcome)
        notes = [] if self.result.converged else [note(SourceIssue.DID_NOT_SUCCEED)]
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
                    f"{self.where}: {self.path} is a result of another model, {theirs}, and this study has "
                    f"{fmu.name}{as_}: give the result of an identification of {fmu.name}"
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
                raise self.top.error("has a [prior] and no parameters: name those to identify under [parameters]")
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
            raise words.error(f"has both choices and {key}: a parameter that takes few values has nothing else")
        if name in self.held:
            raise words.error(f"is also held at {show(self.held[name])} by [model.fixed]: keep one of the two")
        return "all" if words.choices == ["all"] else tuple(words.choices)

    def _parameter(self, name: str, words: ParameterSection) -> Parameter:
        if words.start is None:
            raise words.error(f"needs the key 'start': {type(words).model_fields['start'].description}")
        prior = None if words.prior is None else self._normal(name, words.prior)
        with words.place.located():  # a Parameter does not know its name
            return Parameter(words.start, words.min, words.max, words.nominal, prior, words.per_experiment)

    def _normal(self, name: str, words: PriorSection) -> Normal:
        if not words.comes_from_result(("mean", "std"), ("mean", "std")):
            assert words.mean is not None and words.std is not None
            return Normal(words.mean, words.std)
        path, result = self._result(words)
        self._take(words, path, result, [name])
        with words.place.located(f": {path}:"):
            return result.normal(name, inflate=words.std_factor)

    def _joint(self, words: JointPriorSection, names: Sequence[str]) -> JointPrior:
        for name in words.names or ():
            if name in self.held:
                raise words.error(
                    f"names {name!r}, which [model.fixed] holds at {show(self.held[name])}: a prior is for "
                    "parameters to identify, so move it to [parameters] or leave it out here"
                )
            if name not in names:
                raise words.error(f"names {name!r}, which is no parameter of this study{nearest(name, names)}")
        if words.comes_from_result(("mean", "covariance"), ("names", "mean", "covariance")):
            return self._joint_from_result(words, names)
        assert words.names is not None and words.mean is not None and words.covariance is not None
        with words.place.located():
            return JointPrior(words.names, words.mean, words.covariance)

    def _joint_from_result(self, words: JointPriorSection, names: Sequence[str]) -> JointPrior:
        path, result = self._result(words)
        shared = words.names or [name for name in names if name in result.names]
        if not shared:
            raise words.error(
                f"takes nothing from {path}: it has {', '.join(result.names)}, and this study {', '.join(names)}; "
                "give the result of an identification of the same model"
            )
        self._take(words, path, result, shared)
        with words.place.located(f" cannot be taken from {path}:"):
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
                raise words.error(
                    f"takes {name!r} from {path}, which has no such parameter{nearest(name, result.names)}; "
                    f"it has {', '.join(result.names)}"
                )
        self.sources.append(PriorSource(str(words.place), path, result, tuple(names)))
