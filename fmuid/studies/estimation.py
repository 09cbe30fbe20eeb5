"""The sections ``[estimation]``, ``[uncertainty]`` and ``[monitoring]`` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from fmuid.data import LOSSES
from fmuid.diagnosis import Rule
from fmuid.estimation import SENSITIVITIES, GlobalSearch, Marquardt, Method
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

DEFAULTS = Marquardt()
Command = Annotated[list[kinds.Text], kinds.ValueKind('a list of a program and its arguments, ["python", "tell.py"]')]
Limits = Annotated[dict[str, kinds.Number], kinds.Entries("{ fault.size = number }")]
METHODS = ("levenberg-marquardt", "multi-start", "differential-evolution")


MODEL_ERROR = ("refit", "report", "off")


class EstimationSection(StudySection):
    """Optimization of the parameters."""

    method: Annotated[str, kinds.one_of(METHODS)] = entry(
        METHODS[0], 'default with n_starts: "multi-start"', METHODS[0]
    )
    n_starts: kinds.Count | None = entry(None, "starting points of multi-start, or members of the evolution", 50)
    seed: kinds.Natural = entry(0, "seed of a global search")
    loss: Annotated[str, kinds.one_of(tuple(LOSSES))] = entry(
        "linear", 'all but "linear" reduce the effect of outliers', "soft_l1"
    )
    jacobian: Annotated[str, kinds.one_of(SENSITIVITIES)] = entry(
        "finite-difference", '"forward": sensitivity equations; "fmu": by the FMU', "finite-difference"
    )
    solver_check: Annotated[str, kinds.one_of(ACCURACIES)] = entry("refine", "for solver errors above 0.1 σ", "refine")
    model_error: Annotated[str, kinds.one_of(MODEL_ERROR)] = entry(
        "refit", "for model errors that directed tests name", "refit"
    )
    restarts: bool = entry(True, "try other starting points after a failure or a large residual; not in batches")
    observer_memory: kinds.Positive | None = entry(None, "memory of a state observer, in samples", 3.0)
    max_iterations: kinds.Count = entry(DEFAULTS.max_iterations, "trial steps, accepted or not")
    relative_step_tolerance: kinds.Positive = entry(
        DEFAULTS.tolerance, "largest relative change of a parameter at convergence"
    )
    initial_trust_radius: kinds.Positive = entry(DEFAULTS.first_radius, "relative length of the first step")

    def settings(self) -> Marquardt | GlobalSearch:
        """Return Marquardt or a global search; ``n_starts`` alone means multi-start."""
        marquardt = Marquardt(self.max_iterations, self.relative_step_tolerance, self.initial_trust_radius)
        several = self.n_starts is not None and "method" not in self.model_fields_set
        method = "multi-start" if several else self.method
        if method == METHODS[0]:
            for key in ("n_starts", "seed"):
                if key in self.model_fields_set:
                    raise self.error(f'needs method = "multi-start". Set it or remove {key}.', key)
            return marquardt

        words: dict[str, Any] = {} if self.n_starts is None else {"starts": self.n_starts}
        with self.place.located():
            return GlobalSearch(method, seed=self.seed, **words, marquardt=marquardt)  # type: ignore[arg-type]

    def observed(self, problem: Problem) -> Problem:
        """Return a problem with the observer, if any."""
        with self.place.below("observer_memory").located():
            return problem if self.observer_memory is None else with_observer(problem, self.observer_memory)

    def check_loss(self, method: Method, asked: AssessmentSettings, top: SectionLocation) -> None:
        """Check the loss against method and cost maps."""
        for other, there in ((f'method = "{self.method}"', method.whole_box), ("cost_map", bool(asked.maps))):
            if there and self.loss != "linear":
                raise top.error(f'loss = "{self.loss}" and {other} cannot be combined. Keep one of the two.')

    def check_observer(self, tables: Mapping[str, bool], top: SectionLocation) -> None:
        """Check the other sections of the study against an observer."""
        if self.observer_memory is None:
            return
        if self.jacobian != "finite-difference":
            raise self.error(f'jacobian = "{self.jacobian}" and observer_memory cannot be combined. Remove one.')
        for name in (name for name, there in tables.items() if there):
            raise top.error(f"[{name}] and estimation.observer_memory cannot be combined. Remove one.")


# --- [uncertainty] ----------------------------------------------------------------------


Pair = Annotated[list[kinds.Text], Field(min_length=2, max_length=2)]
PAIRS = 'a list of pairs of parameters, [["Rs", "Lf"]]'


def _pairs(value: Any) -> Any:
    return [value] if isinstance(value, list) and value and all(isinstance(item, str) for item in value) else value


def _different(value: list[list[str]]) -> list[list[str]]:
    for first, second in value:
        if first == second:
            raise kinds.must_be(f"a list of pairs of different parameters ({first!r} is paired with itself)")
    return value


class UncertaintySection(StudySection):
    """Intervals beyond the local standard deviations."""

    confidence_level: kinds.Share = entry(CONFIDENCE_LEVEL, "level of all intervals", CONFIDENCE_LEVEL)
    profile_likelihood: Annotated[
        kinds.Flag | list[kinds.Text],
        kinds.ValueKind('true (all parameters), false or a list of parameters, ["Rs", "Rr"]'),
    ] = entry(False, "profile likelihood of parameters", True)
    posterior: Annotated[SamplerSettings | None, Settings()] = entry(
        None, "posterior samples; true, or { max_steps = 20000, walkers = 32, seed = 0 }", True
    )
    cost_map: Annotated[
        list[Pair],
        BeforeValidator(_pairs, json_schema_input_type=Pair | list[Pair]),
        kinds.ValueKind(PAIRS),
        AfterValidator(_different),
    ] = entry([], "maps of the cost over two parameters", [["a", "b"]])

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
                    raise self.error(f"unknown parameter {name!r}{nearest(name, names)}", key)
        pairs = tuple((first, second) for first, second in self.cost_map)
        return AssessmentSettings(self.confidence_level, tuple(dict.fromkeys(listed)), self.posterior, pairs)


# --- [monitoring] -----------------------------------------------------------------------


class MonitoringSection(StudySection):
    """Diagnosis of long recordings, window by window."""

    window_length: kinds.Positive | None = entry(None, "length of a window, s; default: the whole recording")
    warmup: kinds.NotNegative | None = entry(None, "warm-up before each window, s; default: that of the study")
    false_alarm_rate: kinds.Share | None = entry(None, "per recording, or per horizon; default: that of [diagnosis]")
    false_alarm_horizon: kinds.Positive | None = entry(None, "time of false_alarm_rate, s; default: the recording")
    alarm_command: Command = entry([], "program for each alarm with --follow", [])
    size_limits: Limits = entry({}, 'fault sizes not to be reached, { "turns.dR" = 0.5 }')

    def rule(self, warmup: float, level: float) -> Rule:
        """Return the rule of a study with this warmup and diagnosis level."""
        if self.warmup is None and self.window_length is not None and not warmup:
            raise self.error("missing key 'warmup': time until the initial state has no effect, s. Without states, 0.")
        transient = warmup if self.warmup is None else self.warmup
        rate = self.false_alarm_rate or level
        with self.place.located():
            return Rule(self.window_length, transient, rate, self.false_alarm_horizon, self.size_limits)
