"""What is found, in words: every kind of value has them, and the same way in Python, on the terminal and in files."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import cast

import numpy as np
import pytest

import fmuid
from fmuid.codec import as_json, from_json
from fmuid.estimation import AccuracyOutcome, RunFields, SolverCheck
from fmuid.estimation.covariance import IdentifiabilityLevel, WeakDirection
from fmuid.estimation.search.loop import TerminationReason
from fmuid.identification.prior_and_data import ExtrapolationReason
from fmuid.models import SolverConfiguration
from fmuid.reports.document import capitalized
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.prior_and_data import obstacle_words
from fmuid.reports.topics.solver_check import passed_words
from fmuid.reports.topics.termination import ENDS, ending, remarks
from tests.support.results import changed

TIMES = np.linspace(0.0, 1.0, 60)


def line() -> tuple[fmuid.estimation.LeastSquares, fmuid.Result]:
    y = 2.0 * TIMES + 0.1 * np.random.default_rng(0).standard_normal(60)
    parameters = {"slope": fmuid.Parameter(1.0, prior=fmuid.Normal(2.0, 0.5))}
    problem = fmuid.estimation.LeastSquares.from_function(lambda theta: theta[0] * TIMES, y, parameters)
    return problem, fmuid.identify(problem)


def test_whatever_is_found_is_described() -> None:
    problem, result = line()
    diagnostics = fmuid.analyze_residuals(problem, result)
    assert str(fmuid.Document.of(result)) == "Converged"
    assert str(fmuid.Document.of(diagnostics)).startswith("Neighbouring samples of the residual look correlated")
    assert str(fmuid.Document.of(fmuid.compare_prior_and_data(problem, result))).startswith("Prior and data agree")
    assert "raise steps" in str(
        fmuid.Document.of(fmuid.sample_posterior(problem, result, fmuid.identification.SamplerSettings(max_steps=20)))
    )


@pytest.mark.parametrize("outcome", TerminationReason)
def test_every_outcome_has_words(outcome: TerminationReason) -> None:
    _, result = line()
    assert str(fmuid.Document.of(replace(result, outcome=outcome))).startswith(
        ENDS[outcome][0].upper() + ENDS[outcome][1:]
    )


def test_an_end_names_directions_and_bounds() -> None:
    _, result = line()
    direction = WeakDirection(IdentifiabilityLevel.NOT, ("a", "b"), (1.0, -2.0), math.inf, (1.0, 1.0), (1.0, 1.0))
    assert direction_words(direction) == "a and b cannot be told apart: only a + 0.5 b is determined"
    open_ = changed(result, outcome=TerminationReason.UNDETERMINED, non_identifiable=(direction,))
    assert ending(open_) == f"undetermined: {direction_words(direction)}: " + (
        "give a prior, hold one of them at a value, or measure more"
    )
    hidden = replace(direction, level=IdentifiabilityLevel.HIDDEN)
    assert ending(changed(open_, non_identifiable=(hidden,))).endswith(
        "or make the simulation more accurate " + ("(step_size, tolerance, interface)")
    )
    # where the search did not even end, that comes first
    assert ending(changed(open_, outcome=TerminationReason.STALLED)).startswith(
        f"{ENDS[TerminationReason.STALLED]}; a and b"
    )


def test_a_sign_that_changed_is_told_where_the_search_came_to_nothing() -> None:
    _, result = line()
    crossed = changed(result, outcome=TerminationReason.STALLED, start=-result.values)
    assert any("give it a bound if the model holds on one side of zero only" in said for said in remarks(crossed))
    assert not any("side of zero" in said for said in remarks(replace(crossed, outcome=TerminationReason.CONVERGED)))


@pytest.mark.parametrize(
    ("direction", "said"),
    [
        (
            WeakDirection(IdentifiabilityLevel.NOT, ("c",), (1.0,), math.inf, (1.0,), (1.0,)),
            "c is not determined: changing it changes no output",
        ),
        (
            WeakDirection(IdentifiabilityLevel.NOT_IN_EFFECT, ("a", "b"), (1.0, 1.0), 25.0, (1.0, 1.0), (1.0, 1.0)),
            "a and b cannot be told apart in effect: only a - b is determined, and their standard deviation together "
            "is 25 times their magnitude",
        ),
        (
            WeakDirection(IdentifiabilityLevel.HARDLY, ("a", "b", "c"), (1.0, 1.0, -1.0), 3.0, (1.0,) * 3, (1.0,) * 3),
            "a, b and c can hardly be told apart: a + c and b + c are determined better than each of them, whose "
            "standard deviation together is 300% of their magnitude",
        ),
    ],
)
def test_directions(direction: WeakDirection, said: str) -> None:
    assert direction_words(direction) == said
    assert from_json(WeakDirection, as_json(direction)) == direction


@pytest.mark.parametrize(
    ("obstacle", "said"),
    [
        (
            ExtrapolationReason(outcome=TerminationReason.STALLED),
            "did not converge, so it is extrapolated: stalled: no step lowers",
        ),
        (
            ExtrapolationReason(outcome=TerminationReason.INTERRUPTED),
            "did not converge, so it is extrapolated: interrupted",
        ),
        (
            ExtrapolationReason(
                undetermined=(WeakDirection(IdentifiabilityLevel.NOT, ("c",), (1.0,), math.inf, (1.0,), (1.0,)),)
            ),
            "optimum of the data alone c is not determined: changing it changes no output, so it is extrapolated",
        ),
    ],
)
def test_why_the_data_alone_are_extrapolated(obstacle: ExtrapolationReason, said: str) -> None:
    assert said in obstacle_words(obstacle)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("id_start and R can hardly be told apart", "id_start and R can hardly be told apart"),
        ("id_starting from nowhere", "Id_starting from nowhere"),
        ("id_start[cold] is not determined", "id_start[cold] is not determined"),
        ("without the prior, id_start is lost", "Without the prior, id_start is lost"),
    ],
)
def test_a_name_at_the_beginning_of_a_sentence_is_kept_as_it_is(words: str, said: str) -> None:
    assert capitalized(words, ("R", "id_start")) == said


@pytest.mark.parametrize(
    ("shift", "said"),
    [
        ([7e-8, 0.0], "it moves the estimates by 0.005 std at most"),
        ([0.01, math.nan], "it moves the estimates by 0.01 std at most"),
        ([math.nan, math.nan], "it changes the outputs by 0.02 standard deviations in all"),
    ],
)
def test_a_check_without_standard_deviations_tells_what_it_changes(shift: list[float], said: str) -> None:
    finer = {"": cast(RunFields, asdict(SolverConfiguration("2.0", "co-simulation", None, False, None, None, 4)))}
    found = SolverCheck(AccuracyOutcome.PASSED, np.array(shift), finer, finer, change=0.02)
    assert passed_words(found) == f"simulation checked by FMI 2.0 co-simulation, each step divided by 4: {said}"
