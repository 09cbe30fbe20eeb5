"""The tables ``[isolation]``, ``[noise]``, ``[estimation]``, ``[uncertainty]`` and ``[monitoring]`` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from fmuid.data import LOSSES
from fmuid.diagnosis import Rule
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, Marquardt
from fmuid.formatting import nearest
from fmuid.identification import (
    ACCURACIES,
    CONFIDENCE_LEVEL,
    AssessmentSettings,
    Problem,
    SamplerSettings,
    with_observer,
)
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import SectionLocation, Settings, StudySection, entry

if TYPE_CHECKING:
    from fmuid.estimation import GlobalSearch, Method

SEARCH = Marquardt()
"""What is not said of Marquardt's search."""

Command = Annotated[list[kinds.Text], kinds.ValueKind('a list of a program and its arguments, ["python", "tell.py"]')]
Limits = Annotated[dict[str, kinds.Number], kinds.Entries("a table { fault.size = number }")]


# --- [isolation], [noise], [estimation] --------------------------------------------------


METHODS = ("levenberg-marquardt", "multi-start", "differential-evolution")


class EstimationSection(StudySection):
    """How the parameters are estimated."""

    method: Annotated[str, kinds.one_of(METHODS)] = entry(
        METHODS[0],
        '"multi-start" begins from many points of the bounds, "differential-evolution" searches all of them first; '
        'default: "multi-start" where there is n_starts',
        METHODS[0],
    )
    n_starts: kinds.Count | None = entry(None, "starting points of multi-start, or members of an evolution", 50)
    seed: kinds.Natural = entry(0, "of the random numbers of a global search")
    loss: Annotated[str, kinds.one_of(tuple(LOSSES))] = entry(
        "linear", 'with "huber", "soft_l1", "cauchy", outliers in the table pull less than with "linear"', "soft_l1"
    )
    jacobian: Annotated[str, kinds.one_of(SENSITIVITIES)] = entry(
        "finite-difference", "how derivatives by the parameters are found", "finite-difference"
    )
    solver_check: Annotated[str, kinds.one_of(ACCURACIES)] = entry(
        "refine",
        "of the simulation: go on by a finer one where its error moves an estimate by more than 0.1 standard "
        'deviations, just say so ("report"), or do not look ("off")',
        "refine",
    )
    restarts: bool = entry(
        True,
        "other starts are tried where a search cannot begin or end, or its residual is more than three times the noise "
        "that the data show; batches search from the starts that they are given",
    )
    observer_memory: kinds.Positive | None = entry(
        None,
        "samples (its poles) in which an observer of all states forgets, that corrects them at each sample: for one "
        "FMU that integrates, with model exchange and one output; a fit of predictions then, without check of the "
        "simulation and restarts",
        3.0,
    )
    max_iterations: kinds.Count = entry(SEARCH.max_iterations, "steps tried, accepted or not")
    relative_step_tolerance: kinds.Positive = entry(
        SEARCH.tolerance, "the largest change left for any parameter, relative"
    )
    initial_trust_radius: kinds.Positive = entry(
        SEARCH.first_radius, "length of the first step, relative; smaller is more careful"
    )

    def settings(self) -> Marquardt | GlobalSearch:
        """Return Marquardt or a global search; ``n_starts`` alone means multi-start."""
        marquardt = Marquardt(self.max_iterations, self.relative_step_tolerance, self.initial_trust_radius)
        several = self.n_starts is not None and "method" not in self.model_fields_set
        method = "multi-start" if several else self.method
        if method == METHODS[0]:
            for key in ("n_starts", "seed"):
                if key in self.model_fields_set:
                    raise self.error(f'has {key}, which goes with method = "multi-start": choose that, or remove {key}')
            return marquardt
        from fmuid.estimation import GlobalSearch

        words: dict[str, Any] = {} if self.n_starts is None else {"starts": self.n_starts}
        with self.place.located(" is refused:"):
            return GlobalSearch(method, seed=self.seed, **words, marquardt=marquardt)  # type: ignore[arg-type]

    def check_loss(self, method: Method, asked: AssessmentSettings, top: SectionLocation) -> None:
        """Check the loss against method and cost maps."""
        for other, there in ((f'method = "{self.method}"', method.whole_box), ("cost_map", bool(asked.maps))):
            if there and self.loss != "linear":
                raise top.error(
                    f'has both loss = "{self.loss}" and {other}, which compares plain sums of squares in this version: '
                    "keep one of the two"
                )

    def check_observer(self, tables: Mapping[str, bool], top: SectionLocation) -> None:
        """Check the other tables of the study against an observer."""
        if self.observer_memory is None:
            return
        if self.jacobian != "finite-difference":
            raise self.error(
                f'has both observer_memory and jacobian = "{self.jacobian}", and derivatives with an observer are '
                "finite differences: remove one of the two"
            )
        for name in (name for name, there in tables.items() if there):
            raise top.error(
                f"has both observer_memory in [estimation] and [{name}], which is by output error: remove one of "
                "the two"
            )


def observed_by(problem: Problem, samples: float | None, path: Path) -> Problem:
    """Return a problem with the observer of a study file, if any."""
    if samples is None:
        return problem
    try:
        return with_observer(problem, samples)
    except InputError as error:
        raise InputError(
            f"{path}: [estimation] has observer_memory = {samples:g}, but {error}: remove observer_memory"
        ) from None


# --- [uncertainty] ----------------------------------------------------------------------


Pair = Annotated[list[kinds.Text], Field(min_length=2, max_length=2)]
PAIRS = 'a list of pairs of parameters, [["Rs", "Lf"]]'


def _pairs(value: Any) -> Any:
    return [value] if isinstance(value, list) and value and all(isinstance(item, str) for item in value) else value


def _different(value: list[list[str]]) -> list[list[str]]:
    for first, second in value:
        if first == second:
            raise kinds.must_be(f"a list of pairs of two different parameters ({first!r} is there with itself)")
    return value


class UncertaintySection(StudySection):
    """More than the standard deviations, which are local."""

    confidence_level: kinds.Share = entry(CONFIDENCE_LEVEL, "of all intervals", CONFIDENCE_LEVEL)
    profile_likelihood: Annotated[
        kinds.Flag | list[kinds.Text],
        kinds.ValueKind('true (all parameters), false or a list of parameters, ["Rs", "Rr"]'),
    ] = entry(False, 'profile likelihood of all parameters, or of some: ["a", "b"]', True)
    posterior: Annotated[SamplerSettings | None, Settings()] = entry(
        None, "samples of the posterior; or { max_steps = 20000, walkers = 32, seed = 0 }", True
    )
    cost_map: Annotated[
        list[Pair],
        BeforeValidator(_pairs, json_schema_input_type=Pair | list[Pair]),
        kinds.ValueKind(PAIRS),
        AfterValidator(_different),
    ] = entry([], "the cost over two parameters", [["a", "b"]])

    def settings(self, names: Sequence[str]) -> AssessmentSettings:
        """Return the settings of a study with these parameters."""
        asked = self.profile_likelihood
        listed = asked if isinstance(asked, list) else list(names) if asked else []
        for key, given in (
            ("profile_likelihood", listed),
            ("cost_map", [name for pair in self.cost_map for name in pair]),
        ):
            for name in given:
                if name not in names:
                    raise self.error(f"{key} names {name!r}, which is no parameter of this study{nearest(name, names)}")
        pairs = tuple((first, second) for first, second in self.cost_map)
        return AssessmentSettings(self.confidence_level, tuple(dict.fromkeys(listed)), self.posterior, pairs)


# --- [monitoring] -----------------------------------------------------------------------


class MonitoringSection(StudySection):
    """The same in windows of long records, one after the other."""

    window_length: kinds.Positive | None = entry(None, "length of a window, s; default: each record is one")
    warmup: kinds.NotNegative | None = entry(None, "simulated before each window, s; default: the warmup of the study")
    false_alarm_rate: kinds.Share | None = entry(
        None, "probability of a false alarm in a record, or in the horizon; default: that of [diagnosis]"
    )
    false_alarm_horizon: kinds.Positive | None = entry(
        None, "in which the false_alarm_rate holds, s; default: each record"
    )
    alarm_command: Command = entry(
        [], 'a program and its arguments, run for each line of alarms.jsonl with --follow: ["python", "tell.py"]', []
    )
    size_limits: Limits = entry({}, 'sizes that must not be reached, as in { "turns.dR" = 0.5 }')

    def rule(self, warmup: float, level: float) -> Rule:
        """Return the rule of a study with this warmup and diagnosis level."""
        if self.warmup is None and self.window_length is not None and not warmup:
            raise self.error(
                "needs the key 'warmup': the study has none, and windows begin anywhere; say how long the "
                "model takes to forget its initial state, 0 for one without states"
            )
        transient = warmup if self.warmup is None else self.warmup
        rate = self.false_alarm_rate or level
        with self.place.located():
            return Rule(self.window_length, transient, rate, self.false_alarm_horizon, self.size_limits)
