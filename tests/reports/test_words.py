"""Messages on results, comparisons and predictions, and the conditions that give them."""

import math
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import fmuid
from fmuid import Result
from fmuid.codec import as_json, from_json
from fmuid.estimation import (
    AccuracyOutcome,
    ActiveBound,
    IdentifiabilityLevel,
    RefinementRefusal,
    RefinementStep,
    RunFields,
    SolverCheck,
    SwitchCause,
    TerminationReason,
    WeakDirection,
)
from fmuid.formatting import with_std
from fmuid.identification import ErrorKind, ExtrapolationReason, ModelErrors, OutputScore, ResidualDefect
from fmuid.identification.model_comparison import LikelihoodRatioTest
from fmuid.identification.model_errors import DirectedTest, Direction
from fmuid.models import SolverConfiguration
from fmuid.reports.document import Message, Remark, doubt
from fmuid.reports.topics import uncertainty
from fmuid.reports.topics.assumptions import hidden_remarks
from fmuid.reports.topics.model_comparison import comparison_remarks
from fmuid.reports.topics.prediction import fold_remark, prediction_remarks
from fmuid.reports.topics.prior_and_data import obstacle_remark
from fmuid.reports.topics.residual_analysis import residual_phrases
from fmuid.reports.topics.termination import state_and_reason
from fmuid.runs import at_minimum
from tests.support.results import changed
from tests.support.said import direction_words, ending, result_words, solver_words

TIMES = np.linspace(0.0, 1.0, 60)
END, LEVEL = TerminationReason, IdentifiabilityLevel


@pytest.fixture(scope="module")
def problem() -> fmuid.estimation.LeastSquares:
    y = 2.0 * TIMES + 0.1 * np.random.default_rng(0).standard_normal(60)
    parameters = {"slope": fmuid.Parameter(1.0, prior=fmuid.Normal(2.0, 0.5))}
    return fmuid.estimation.LeastSquares.from_function(lambda theta: theta[0] * TIMES, y, parameters)


@pytest.fixture(scope="module")
def result(problem: fmuid.estimation.LeastSquares) -> Result:
    return fmuid.identify(problem)


def direction(level: IdentifiabilityLevel, names: str, values: list[float], std: float = math.inf) -> WeakDirection:
    ones = (1.0,) * len(names)
    return WeakDirection(level, tuple(names), tuple(values), std, ones, ones)


def test_documents_of_findings(problem: fmuid.estimation.LeastSquares, result: Result) -> None:
    found = str(fmuid.Document.of(fmuid.analyze_residuals(problem, result)))
    assert found.startswith("σ is ")
    assert "may be colored" in found
    assert str(fmuid.Document.of(fmuid.compare_prior_and_data(problem, result))).startswith("Prior and data agree")
    settings = fmuid.identification.SamplerSettings(max_steps=20)
    assert "→ Raise `max_steps`" in str(fmuid.Document.of(fmuid.sample_posterior(problem, result, settings)))


@pytest.mark.parametrize("outcome", END)
def test_termination_reasons(result: Result, outcome: TerminationReason) -> None:
    ended = replace(result, outcome=outcome)
    state, reason = state_and_reason(ended)
    assert (state == "converged") == ended.converged
    assert reason.startswith("after") == ended.converged
    assert at_minimum(ended) == (ended.converged or outcome is END.UNDETERMINED)
    assert str(fmuid.Document.of(ended)).startswith("Not " if state.startswith("not") else state.capitalize())


def test_ending_names_directions_first_reason_and_sign_changes(result: Result) -> None:
    both = direction(LEVEL.NOT, "ab", [1.0, -2.0])
    lost = changed(result, outcome=END.UNDETERMINED, non_identifiable=(both,))
    assert direction_words(both) in ending(lost)
    assert state_and_reason(lost)[1] == "a and b are not identifiable; only a + 0.5 b is"
    assert ending(changed(lost, outcome=END.STALLED)).startswith("Not converged: no step reduces the cost.\n→ ")
    bound = changed(result, at_bounds=(ActiveBound("slope", 0.5),), lower=np.array([0.5]))
    assert "slope is at its lower bound 0.5.\n→ Widen the bound" in ending(bound)
    crossed = changed(result, outcome=END.STALLED, start=-result.values)
    assert any("slope changed sign" in each for each in result_words(crossed))
    assert not any("changed sign" in each for each in result_words(replace(crossed, outcome=END.CONVERGED)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (direction(LEVEL.NOT, "c", [1.0]), "c is not identifiable: it has no effect on any output."),
        (direction(LEVEL.NOT, "ab", [1.0, -2.0]), "a and b are not identifiable; only a + 0.5 b is."),
        (direction(LEVEL.HIDDEN, "ab", [1.0, 1.0]), "a and b are not identifiable within the solver error"),
        (direction(LEVEL.HIDDEN, "c", [1.0]), "c is not identifiable: its effect is below the solver error."),
        (direction(LEVEL.NOT_IN_EFFECT, "ab", [1.0, 1.0], 25.0), "a and b are practically non-identifiable (σ is 25 ×"),
        (direction(LEVEL.HARDLY, "abc", [1.0, 1.0, -1.0], 3.0), "a, b and c are weakly identifiable (σ is 300 % of"),
    ],
)
def test_directions(given: WeakDirection, said: str) -> None:
    assert direction_words(given).startswith(said)
    assert "\n→ " in direction_words(given)
    assert from_json(WeakDirection, as_json(given)) == given


def test_extrapolation_of_the_data_alone() -> None:
    unknown = ExtrapolationReason(undetermined=(direction(LEVEL.NOT, "c", [1.0]),))
    stalled, free = (obstacle_remark(each).text for each in (ExtrapolationReason(outcome=END.STALLED), unknown))
    assert stalled == "Optimum of the data alone is extrapolated: no step reduces the cost."
    assert free == "Optimum of the data alone is extrapolated: c not identifiable."


def test_message_fills_text_and_remedy() -> None:
    class Sample(Message, section="fit"):
        ONE = doubt("{name} is low: {value}.", "", "Raise {name}.")

    said = Sample.ONE.said(name="x", value=3)
    assert str(said) == "x is low: 3.\n→ Raise x."
    assert (said.tone, said.section, said.message) == ("doubt", "fit", "Sample.ONE")
    other = Sample.ONE.said("cost", "plain", name="x", value=3)
    assert (other.tone, other.section) == ("plain", "cost")
    assert str(Remark("Alone.")) == "Alone."


def test_residuals_in_one_line() -> None:
    strong = SimpleNamespace(strongest=(1, 0.7))
    series = SimpleNamespace(output="i", experiment="a", is_tested=True, samples=600, inputs=(), whiteness=strong)
    colored = SimpleNamespace(trait=ResidualDefect.COLORED, series=series, input=None, large=True)
    shifted = SimpleNamespace(trait=ResidualDefect.OFFSET, series=series, input=None, large=True)
    for findings, returning, said in (
        ((), (), "white (600 samples)"),
        ((), (1,), "white; periodic"),
        ((shifted,), (), "white; offset (i)"),
        ((colored,), (), "colored (i 0.70)"),
    ):
        found: Any = SimpleNamespace(findings=findings, returning=returning, series=(series,), widening={})
        assert residual_phrases(found) == said
    series.inputs = (SimpleNamespace(input="u"),)
    found.findings, found.returning = (), ()
    assert residual_phrases(found) == "white; not correlated with u (600 samples)"
    found.findings = (SimpleNamespace(trait=None, series=series, input=series.inputs[0], large=True),)
    assert residual_phrases(found) == "white; correlated with u"


# --- numbers


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (9.8434, 0.0418, "9.843 ± 0.042"),
        (0.0012345678, 1.2e-7, "0.00123457 ± 0.00000012"),
        (1234.5, 98.0, "1234 ± 98"),
        (1234567.0, 23456.0, "1.235e+06 ± 2.3e+04"),
        (-4.7e3, 1.6e10, "0 ± 1.6e+10"),  # nothing of the value is known
        (2.6e10, 1.6e10, "2.6e+10 ± 1.6e+10"),
        (4.0, math.inf, "4"),
        (4.0, 0.0, "4"),
    ],
)
def test_value_and_standard_deviation(value: float, std: float, shown: str) -> None:
    assert with_std(value, std) == shown


@pytest.mark.parametrize(
    ("ends", "shown"),
    [
        ((3.608, 3.915), "3.608 to 3.915"),
        ((-math.inf, math.inf), "not identifiable"),
        ((0.0013772, math.inf), "above 0.001"),
        ((-math.inf, 0.05), "below 0.0500"),
        ((math.nan, 1.0), ""),
    ],
)
def test_interval(ends: tuple[float, float], shown: str) -> None:
    assert uncertainty._interval(*ends, value=0.04) == shown


# --- solver check -------------------------------------------------------------------------


def runs(**changes: Any) -> dict[str, RunFields]:
    fields = asdict(SolverConfiguration("2.0", "co-simulation", None, False, None, None, 1)) | changes
    return {"": cast(RunFields, fields)}


USED = runs()
FINER = runs(interface="model-exchange", integrator="rk45", tolerance=1e-9)


def solver_said(outcome: AccuracyOutcome, shift: list[float], **more: Any) -> tuple[str, ...]:
    return solver_words(("R", "L"), SolverCheck(outcome, np.array(shift), USED, FINER, change=0.02, **more))


@pytest.mark.parametrize("kept", RefinementRefusal)
def test_shifted_estimates(kept: RefinementRefusal) -> None:
    moved, why = solver_said(AccuracyOutcome.SHIFTED, [0.01, -3.21], kept=kept)
    assert moved == "Solver error moves L by -3.2 σ; σ includes it."
    assert why.startswith("The solver was kept")


@pytest.mark.parametrize("outcome", [*AccuracyOutcome][2:])
def test_unknown_solver_error(outcome: AccuracyOutcome) -> None:
    (said,) = solver_said(outcome, [math.nan, math.nan])
    assert said.startswith("Solver error ")
    (bare,) = solver_words(("R",), SolverCheck(outcome, np.full(1, math.nan)))
    assert bare.startswith("Solver error ")


@pytest.mark.parametrize(
    ("cause", "size", "said"),
    [
        (SwitchCause.START_FAILED, math.nan, "FMI 2.0 Co-Simulation fails at the initial guess"),
        (SwitchCause.START_DIFFERED, 0.25, "FMI 2.0 Co-Simulation is off by 25 % of the signal"),
        (SwitchCause.SHIFT, 0.25, "error was 0.25 σ"),
        (SwitchCause.SHIFT, math.nan, "its error may exceed σ"),
    ],
)
def test_refinements(cause: SwitchCause, size: float, said: str) -> None:
    first = solver_said(AccuracyOutcome.PASSED, [0.0, 0.0], switches=(RefinementStep(cause, size, USED, FINER, 17),))[0]
    assert first.startswith("Solver refined to FMI 2.0 Model Exchange, rk45")
    assert said in first


def keys(remarks: list[Remark]) -> list[str]:
    return [each.message.partition(".")[2] for each in remarks]


def comparison(behind: float, **more: Any) -> Any:
    ranks = [SimpleNamespace(name="a", behind=0.0, corrected_bic=1.0)]
    ranks.append(SimpleNamespace(name="b", behind=behind, corrected_bic=2.0))
    own = {"ranks": ranks, "tests": (), "dependence": 1.0, "samples": 600, "with_priors": ()}
    return SimpleNamespace(**own | more)


def test_comparison_by_likelihood() -> None:
    for behind, key in ((1.9, "ALIKE"), (2.1, "BEST"), (10.0, "CLEARLY_BEST")):
        assert keys(comparison_remarks(comparison(behind), {})) == [key]
    found = comparison(3.0, dependence=4.0, with_priors=("b",))
    found.ranks[1].corrected_bic = 0.5
    remarks = comparison_remarks(found, {})
    assert keys(remarks) == ["BEST", "BY_BIC", "COLORED", "PRIORS"]
    assert "600 samples count as 150 (log-likelihoods divided by 4)" in remarks[2].text
    for p, key, said in ((1e-9, "REJECTED", "below 1e-6"), (0.005, "REJECTED", "0.005"), (0.2, "NOT_REJECTED", "0.2")):
        test = LikelihoodRatioTest("b", "a", ("L",), 3.0, p, p)
        _, remark = comparison_remarks(comparison(5.0, tests=(test,)), {})
        assert keys([remark]) == [key]
        assert remark.text.endswith(f"(p = {said}).")


def test_comparison_on_common_data() -> None:
    for fits, key, said in (
        ({"a": math.nan, "b": 98.0, "c": 97.0}, "BEST_FIT", "b is best (fit 98 %; 97 % (c) and – (a))"),
        ({"a": 97.95, "b": 98.0}, "AS_GOOD", "b and a equally good (fit 98 % for b; 97.95 % (a))"),
        ({"a": math.nan, "b": math.nan}, "NO_FIT", "fit undefined"),
    ):
        (remark,) = comparison_remarks(None, fits)
        assert keys([remark]) == [key]
        assert said in remark.text


def prediction(ratio: float, **more: Any) -> Any:
    expected = 0.2 / ratio if ratio > 0 else math.nan
    score = OutputScore("i", "A", 50, 0.2, 0.0, 93.5, expected, ratio, 0.94)
    own = {"scores": [score], "undetermined": (), "estimated": None, "errors": ()}
    fit = SimpleNamespace(experiment="run", outputs=("i",), units=("A",))
    return SimpleNamespace(fit=fit, level=0.95, residuals=None, **own | more)


def test_prediction_against_its_expected_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.reports.topics.prediction.residual_remarks", lambda *_: [])
    good, band = prediction_remarks(prediction(1.2))
    assert good.text == "run: i predicted as expected (fit 93.5 %, RMSE 0.2 A)."
    assert band.text == "run: 94 % of 50 samples of i are in the 95 % band."
    worse, _ = prediction_remarks(prediction(2.0))
    assert worse.text.startswith("run: i predicted 2 × worse than expected") and worse.tone == "doubt" and worse.remedy
    constant = prediction(math.nan)
    constant.scores = [replace(constant.scores[0], fit=math.nan)]
    (unknown,) = prediction_remarks(constant)
    assert keys([unknown]) == ["OPEN"]
    assert "RMSE 0.2 A; constant" in unknown.text
    one, end = np.array([0.1]), TerminationReason.ITERATION_LIMIT
    again = SimpleNamespace(converged=False, names=("i0",), values=one, std=one, outcome=end)
    remarks = prediction_remarks(prediction(1.0, undetermined=("R",), estimated=again))
    assert keys(remarks)[2:] == ["UNDETERMINED", "REFITTED", "REFIT_ENDED"]
    assert remarks[3].text == "run: estimated again: i0 = 0.10 ± 0.10."


def test_cross_validation_verdict() -> None:
    ends = {(math.nan,): ("FOLDS_OPEN", ""), (0.9, 1.1): ("FOLDS", "1.1"), (0.9, 3.5): ("FOLDS_WORSE", "3.5")}
    for ratios, (key, times) in ends.items():
        remark = fold_remark([prediction(each) for each in ratios])
        assert keys([remark]) == [key]
        assert times in remark.text


def test_errors_that_no_data_show_stand_together_the_graver_first() -> None:
    def directed(kind: ErrorKind, subject: str, shift: float, detectable: float) -> DirectedTest:
        direction = Direction(kind, (subject,), "", 0.01)
        return DirectedTest(direction, 0.5, 0.0, 1.0, 0.0, 0.01, detectable, np.array([shift, 10.0]))

    gains = [directed(ErrorKind.GAIN, name, shift, math.inf) for name, shift in (("i", 1400.0), ("w", 2800.0))]
    shows = directed(ErrorKind.INPUT_GAIN, "u", 2000.0, 0.03)
    both = "Not testable: gain of w (1 % moves R by 28 σ), gain of i (1 % moves R by 14 σ)."
    could = "Could hide: input gain of u of 1 % moves R by {} σ; shows from 3 %."
    said = hidden_remarks(ModelErrors(("R", "L"), (*gains, shows)))
    assert [each.text for each in said] == [both, could.format(20)]
    graver = replace(shows, shift=np.array([4000.0, 10.0]))
    assert [each.text for each in hidden_remarks(ModelErrors(("R", "L"), (*gains, graver)))] == [could.format(40), both]
