"""The tables ``[isolation]``, ``[noise]``, ``[estimator]``, ``[uncertainty]`` and ``[monitoring]`` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Tag

from fmuid.data import LOSSES, Noise
from fmuid.diagnosis import Rule
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, Marquardt
from fmuid.formatting import nearest
from fmuid.identification import ACCURACIES, CONFIDENCE_LEVEL, AssessmentSettings, Problem, with_observer
from fmuid.models import Isolation
from fmuid.studies.section import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Count,
    Entries,
    Flag,
    Names,
    Natural,
    NotNegative,
    Number,
    Positive,
    PositiveOrEach,
    Positives,
    SectionLocation,
    Share,
    StudySection,
    Text,
    ValueKind,
    must_be,
    one_of,
    word,
)

if TYPE_CHECKING:
    from fmuid.estimation import GlobalSearch, Method
    from fmuid.identification import SamplerSettings

SEARCH = Marquardt()
"""What is not said of Marquardt's search."""

Command = Annotated[list[Text], ValueKind('a list of a program and its arguments, ["python", "tell.py"]')]
Limits = Annotated[dict[str, Number], Entries("a table { fault.size = number }")]


# --- [isolation], [noise], [estimator] --------------------------------------------------


class IsolationSection(StudySection):
    """What FMUs in a process of their own may do."""

    time_limit: Positive | None = word(None, "s for one simulation; default: by how long earlier ones took")
    memory: Positive | None = word(None, "MB; default: an equal share of half the machine's for each core")
    recycle: Count | None = word(None, "simulations after which a process is replaced; default: only for its memory")

    def settings(self) -> Isolation:
        """Return the words as an object."""
        return Isolation(self.time_limit, self.memory, self.recycle)


VARIANCES = '"estimate", a number above 0 or a table { output = number }'
Variance = Annotated[
    Literal["estimate"] | Annotated[float, Field(gt=0, allow_inf_nan=False)],
    ValueKind(VARIANCES, lambda value: VARIANCES if isinstance(value, str) else "a number above 0"),
]


NumberOrColumn = Annotated[
    Annotated[float, Field(gt=0, allow_inf_nan=False)] | Annotated[str, Field(min_length=1)],
    ValueKind("a number above 0 or the name of a column"),
]
Levels = Annotated[
    Annotated[NumberOrColumn, Tag(VALUE_TAG)]
    | Annotated[
        dict[str, NumberOrColumn], Entries("a table { output = number } or { output = column }"), Tag(TABLE_TAG)
    ],
    BY_SHAPE,
]


class ExperimentNoiseSection(StudySection):
    """The noise of the measurements of one experiment, where it is not that of all."""

    variance: Annotated[Annotated[Variance, Tag(VALUE_TAG)] | Annotated[Positives, Tag(TABLE_TAG)], BY_SHAPE] = word(
        "estimate", "of the outputs; or a number for all, or one for each: { output = number }", "estimate"
    )
    std: Levels | None = word(
        None, "standard deviation: a number, a column of the table with one for each sample, or { output = either }"
    )
    relative: PositiveOrEach | None = word(
        None, "standard deviation as a share of the output's spread (the standard deviation of its counted samples)"
    )
    weights: Levels | None = word(
        None, "a sample of weight w has the variance σ²/w, with one σ², estimated, for all outputs that have weights"
    )

    period: Positive | None = word(
        None, "s after which the excitation repeats, as errors of the model then do; default: what the inputs show", 4.0
    )

    def forms(self) -> Noise:
        """Return these words as an object."""
        return Noise(self.variance, std=self.std, relative=self.relative, weights=self.weights, period=self.period)


class NoiseSection(ExperimentNoiseSection):
    """The noise of the measurements."""

    retired: ClassVar[Mapping[str, str]] = {
        "coloured": "leave it out, confidence intervals allow for colored noise without it"
    }
    start: PositiveOrEach | None = word(
        None, "where the estimation of the variance starts; default: from the residual", 0.01
    )
    common: Flag | Names = word(False, "outputs that share one estimated variance, a list of names; true: all of them")

    def settings(self, experiments: Mapping[str, ExperimentNoiseSection]) -> Noise:
        """Return the words as an object, with those of single experiments."""
        own = {name: each.forms() for name, each in experiments.items() if each.model_fields_set}
        return replace(self.forms(), start=self.start, common=self.common, experiments=own)


GLOBAL_WORDS = ("starts", "search", "seed")


class EstimationSection(StudySection):
    """How the parameters are searched for."""

    method: Annotated[str, one_of(("marquardt", "global"), later=("linear",))] = word(
        "marquardt", '"global" searches all of the bounds first', "marquardt"
    )
    starts: Count | None = word(
        None, 'with method = "global": a search from each of so many starts; without it, an evolution', 50
    )
    search: Annotated[str, one_of(("multistart", "evolution"))] | None = word(
        None, 'of method = "global"; default: "multistart" with starts, else "evolution"'
    )
    seed: Natural = word(0, "of the random numbers of a global search")
    loss: Annotated[str, one_of(tuple(LOSSES))] = word(
        "linear", 'with "huber", "soft_l1", "cauchy", outliers in the table pull less than with "linear"', "soft_l1"
    )
    sensitivity: Annotated[str, one_of(SENSITIVITIES)] = word(
        "finite-difference", "how derivatives by the parameters are found", "finite-difference"
    )
    accuracy: Annotated[str, one_of(ACCURACIES)] = word(
        "switch",
        "of the simulation: go on by a finer one where its error moves an estimate by more than 0.1 standard "
        'deviations, just say so ("check"), or do not look ("off")',
        "switch",
    )
    remedies: bool = word(
        True,
        "other starts are tried where a search cannot begin or end, or its residual is more than three times the noise "
        "that the data show; batches search from the starts that they are given",
    )
    observer: Positive | None = word(
        None,
        "samples (its poles) in which an observer of all states forgets, that corrects them at each sample: for one "
        "FMU that integrates, with model exchange and one output; a fit of predictions then, without check of the "
        "simulation and remedies",
        3.0,
    )
    max_iterations: Count = word(SEARCH.max_iterations, "steps tried, accepted or not")
    tolerance: Positive = word(SEARCH.tolerance, "the largest change left for any parameter, relative")
    first_radius: Positive = word(SEARCH.first_radius, "length of the first step, relative; smaller is more careful")

    def settings(self) -> Marquardt | GlobalSearch:
        """Return Marquardt's search, or a search of the whole box that ends in it.

        Who gives ``starts`` wants a search from each of them, and need not say that the method is global and the search
        "multistart".

        Raises
        ------
        InputError
            If words of a global search are given without one, or starts are too few.
        """
        marquardt = Marquardt(self.max_iterations, self.tolerance, self.first_radius)
        if "method" not in self.model_fields_set and {"starts", "search"} & self.model_fields_set:
            method = "global"
        else:
            method = self.method
        if method == "marquardt":
            for key in GLOBAL_WORDS:
                if key in self.model_fields_set:
                    raise self.error(f'has {key}, which goes with method = "global": choose that, or remove {key}')
            return marquardt
        from fmuid.estimation import GlobalSearch

        words: dict[str, Any] = {} if self.starts is None else {"starts": self.starts}
        search = self.search or ("evolution" if self.starts is None else "multistart")
        try:
            return GlobalSearch(search, seed=self.seed, **words, marquardt=marquardt)  # type: ignore[arg-type]
        except InputError as error:
            raise self.error(f"is refused: {error}") from None

    def check_loss(self, method: Method, asked: AssessmentSettings, top: SectionLocation) -> None:
        """Check that all the rest knows what to do with the loss.

        Raises
        ------
        InputError
            If it does not.
        """
        for other, there in (('method = "global"', method.whole_box), ("map", bool(asked.maps))):
            if there and self.loss != "linear":
                raise top.error(
                    f'has both loss = "{self.loss}" and {other}, which compares plain sums of squares in this version: '
                    "keep one of the two"
                )

    def check_observer(self, tables: Mapping[str, bool], top: SectionLocation) -> None:
        """Check that all the rest goes with an observer; `tables` says which others of the study file there are.

        Raises
        ------
        InputError
            If something does not.
        """
        if self.observer is None:
            return
        if self.sensitivity != "finite-difference":
            raise self.error(
                f'has both observer and sensitivity = "{self.sensitivity}", and derivatives with an observer are '
                "finite differences: remove one of the two"
            )
        for name in (name for name, there in tables.items() if there):
            raise top.error(
                f"has both observer in [estimator] and [{name}], which is by output error: remove one of the two"
            )


def observed_by(problem: Problem, samples: float | None, path: Path) -> Problem:
    """Return a problem with the observer that a study file asks for, the problem itself where it asks for none.

    Raises
    ------
    InputError
        If the problem cannot be observed.
    """
    if samples is None:
        return problem
    try:
        return with_observer(problem, samples)
    except InputError as error:
        raise InputError(f"{path}: [estimator] has observer = {samples:g}, but {error}: remove observer") from None


# --- [uncertainty] ----------------------------------------------------------------------


class PosteriorSection(StudySection):
    """How the posterior is sampled."""

    walkers: Count | None = word(None, "an even number; default: four a parameter, 16 at least")
    steps: Count | None = word(None, "the longest chain; it ends as soon as it is long enough")
    burn: NotNegative | None = word(None, "share of the chain that is left out at its start")
    seed: Natural | None = word(None, "of the random numbers")


def _switched(value: Any) -> Any:
    return value if not isinstance(value, bool) else {} if value else None


Pair = Annotated[list[Text], Field(min_length=2, max_length=2)]
PAIRS = 'a list of pairs of parameters, [["Rs", "Lf"]]'


def _pairs(value: Any) -> Any:
    return [value] if isinstance(value, list) and value and all(isinstance(item, str) for item in value) else value


def _different(value: list[list[str]]) -> list[list[str]]:
    for first, second in value:
        if first == second:
            raise must_be(f"a list of pairs of two different parameters ({first!r} is there with itself)")
    return value


class UncertaintySection(StudySection):
    """More than the standard deviations, which are local."""

    level: Share = word(CONFIDENCE_LEVEL, "of all intervals", CONFIDENCE_LEVEL)
    profile: Annotated[
        Flag | list[Text], ValueKind('true (all parameters), false or a list of parameters, ["Rs", "Rr"]')
    ] = word(False, 'profile likelihood of all parameters, or of some: ["a", "b"]', True)
    posterior: Annotated[
        PosteriorSection | None, BeforeValidator(_switched, json_schema_input_type=bool | PosteriorSection)
    ] = word(None, "samples of the posterior; or { steps = 20000, walkers = 32, seed = 0 }", True)
    map: Annotated[
        list[Pair],
        BeforeValidator(_pairs, json_schema_input_type=Pair | list[Pair]),
        ValueKind(PAIRS),
        AfterValidator(_different),
    ] = word([], "the criterion over two parameters", [["a", "b"]])

    def settings(self, names: Sequence[str]) -> AssessmentSettings:
        """Return what is asked of a study with these parameters.

        Raises
        ------
        InputError
            If a parameter is none of them, or the sampler refuses its words.
        """
        listed = self.profile if isinstance(self.profile, list) else list(names) if self.profile else []
        for key, given in (("profile", listed), ("map", [name for pair in self.map for name in pair])):
            for name in given:
                if name not in names:
                    raise self.error(f"{key} names {name!r}, which is no parameter of this study{nearest(name, names)}")
        pairs = tuple((first, second) for first, second in self.map)
        return AssessmentSettings(self.level, tuple(dict.fromkeys(listed)), self._sampling(), pairs)

    def _sampling(self) -> SamplerSettings | None:
        if self.posterior is None:
            return None
        from fmuid.identification import SamplerSettings

        try:
            return SamplerSettings(**self.posterior.model_dump(exclude_unset=True))
        except InputError as error:
            raise self.posterior.error(f"is refused: {error}") from None


# --- [monitoring] -----------------------------------------------------------------------


class MonitoringSection(StudySection):
    """The same in windows of long records, one after the other."""

    window: Positive | None = word(None, "length of a window, s; default: each record is one")
    transient: NotNegative | None = word(None, "simulated before each window, s; default: what the study discards")
    level: Share | None = word(
        None, "probability of a false alarm in a record, or in the horizon; default: that of [diagnosis]"
    )
    horizon: Positive | None = word(None, "in which the level holds, s; default: each record")
    command: Command = word(
        [], 'a program and its arguments, run for each line of alarms.jsonl with --follow: ["python", "tell.py"]', []
    )
    limits: Limits = word({}, 'sizes that must not be reached, as in { "turns.dR" = 0.5 }')

    def rule(self, discard: float, level: float) -> Rule:
        """Return the rule of a study with a transient that it discards and a level of its diagnosis.

        Raises
        ------
        InputError
            If a record is to be cut and nothing says how long the transient is, or the words do not fit together.
        """
        if self.transient is None and self.window is not None and not discard:
            raise self.error(
                "needs the key 'transient': the study discards nothing, and windows begin anywhere; say how long the "
                "model takes to forget its initial state, 0 for one without states"
            )
        transient = discard if self.transient is None else self.transient
        try:
            return Rule(self.window, transient, self.level or level, self.horizon, self.limits)
        except InputError as error:
            raise InputError(f"{self.place}: {error}") from None
