"""The verdict: each reason from the check that gives it."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Result
from fmuid.array_types import Floats
from fmuid.estimation import (
    AccuracyOutcome,
    ActiveBound,
    CombinationFit,
    Doubt,
    Grade,
    IdentifiabilityLevel,
    Optimum,
    Reason,
    SolverCheck,
    TerminationReason,
    Verdict,
    WeakDirection,
)
from fmuid.identification import judge
from tests.support.closed_forms import coil_response
from tests.support.paths import FMUS
from tests.support.results import made_up

PLAIN = made_up(("a", "b"), np.array([1.0, 2.0]), np.ones(2), np.eye(2))
DIRECTION = WeakDirection(IdentifiabilityLevel.NOT, ("a", "b"), (1.0, -1.0), math.inf, (1.0, 2.0), (1.0, 2.0))
CONVERGED = TerminationReason.CONVERGED


def shifted(outcome: AccuracyOutcome, shift: float) -> SolverCheck:
    return SolverCheck(outcome, np.array([0.01, shift]), change=1.0)


def optima(behind: float) -> tuple[Optimum, ...]:
    return Optimum(np.ones(2), 5.0, 1, CONVERGED), Optimum(np.zeros(2), 5.0 + behind, 1, CONVERGED)


IDENTIFIABILITY, HISTORY = PLAIN.identifiability, PLAIN.history

CASES: dict[str, tuple[Result, list[Reason]]] = {
    "nothing": (PLAIN, []),
    "stalled": (replace(PLAIN, outcome=TerminationReason.STALLED), [Reason.NOT_CONVERGED]),
    "interrupted": (replace(PLAIN, outcome=TerminationReason.INTERRUPTED), [Reason.INTERRUPTED]),
    "undetermined": (
        replace(
            PLAIN,
            outcome=TerminationReason.UNDETERMINED,
            identifiability=replace(IDENTIFIABILITY, non_identifiable=(DIRECTION,)),
        ),
        [Reason.NON_IDENTIFIABLE],
    ),
    "weak": (
        replace(PLAIN, identifiability=replace(IDENTIFIABILITY, weakly_identifiable=(DIRECTION,))),
        [Reason.WEAKLY_IDENTIFIABLE],
    ),
    "prior": (
        replace(PLAIN, identifiability=replace(IDENTIFIABILITY, prior_dominated=(DIRECTION,))),
        [Reason.PRIOR_DOMINATED],
    ),
    "bound": (
        replace(PLAIN, estimates=replace(PLAIN.estimates, at_bounds=(ActiveBound("a", 1.0),))),
        [Reason.AT_BOUND],
    ),
    "solver": (replace(PLAIN, accuracy=shifted(AccuracyOutcome.SHIFTED, 3.0)), [Reason.SOLVER_ERROR]),
    "exact": (replace(PLAIN, accuracy=shifted(AccuracyOutcome.PASSED, 0.05)), []),
    "unchecked": (replace(PLAIN, accuracy=shifted(AccuracyOutcome.UNCHECKABLE, math.nan)), [Reason.SOLVER_UNCHECKED]),
    "optimum": (replace(PLAIN, history=replace(HISTORY, optima=optima(1.2))), [Reason.SECOND_OPTIMUM]),
    "far optimum": (replace(PLAIN, history=replace(HISTORY, optima=optima(9.0))), []),
    "combination": (
        replace(
            PLAIN,
            history=replace(
                PLAIN.history,
                combinations=(
                    CombinationFit({"n": 1}, CONVERGED, 0.0, {}),
                    CombinationFit({"n": 2}, CONVERGED, 1.0, {}),
                ),
            ),
        ),
        [Reason.SECOND_OPTIMUM],
    ),
    "observer": (replace(PLAIN, setup=replace(PLAIN.setup, observer=3.0)), [Reason.OBSERVER]),
}


@pytest.mark.parametrize("name", CASES)
def test_each_reason_comes_from_its_check(name: str) -> None:
    result, reasons = CASES[name]
    assert list(judge(result).reasons) == reasons


def test_the_gravest_reason_decides() -> None:
    assert [each.grade for each in Reason].count(Grade.NOT_USABLE) == 5
    assert Verdict().grade is Grade.PASSED
    doubts = [Doubt(Reason.OFFSET), Doubt(Reason.AT_BOUND), Doubt(Reason.OFFSET)]
    assert Verdict.of(doubts).grade is Grade.DOUBTFUL
    assert Verdict.of(doubts).reasons == (Reason.OFFSET, Reason.AT_BOUND)
    assert Verdict.of([*doubts, Doubt(Reason.NOT_CONVERGED)]).grade is Grade.NOT_USABLE


def coil(shift: int = 0, offset: float = 0.0, noise: float = 2e-3) -> fmuid.Problem:
    """Return the coil under a random held voltage, its current late by samples and off by A."""
    rng = np.random.default_rng(4)
    times = np.linspace(0.0, 0.999, 1000)
    u: Floats = np.repeat(np.where(rng.uniform(size=100) < 0.5, -1.0, 1.0), 10)
    i = np.roll(coil_response(times, u, 4.0, 0.1, False), shift)
    frame = pd.DataFrame({"time": times, "u": u, "i": i + offset + noise * rng.standard_normal(1000)})
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")
    parameters = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=0.0)}
    return fmuid.Problem(FMUS / "Coil" / "Coil.fmu", experiment, parameters)


@pytest.mark.parametrize(
    ("problem", "reason"),
    [(coil(), None), (coil(shift=3), Reason.INPUT_CORRELATION), (coil(offset=1e-3), Reason.OFFSET)],
)
def test_records_of_a_coil_are_judged(problem: fmuid.Problem, reason: Reason | None) -> None:
    result = fmuid.identify(problem)
    found = judge(result, fmuid.assess(problem, result))
    assert (found.grade is Grade.PASSED) == (reason is None)
    assert reason is None or reason in found.reasons
