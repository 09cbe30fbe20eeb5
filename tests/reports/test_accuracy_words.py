"""What is said of the error of the simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fmuid
from fmuid.estimation import AccuracyOutcome, RefinementRefusal, RefinementStep, SolverCheck, SwitchCause
from fmuid.reports.topics.solver_check import KEPT, accuracy_words, passed_words, shift_text
from tests.support.paths import ROOT

STUDY = ROOT / "experiments" / "coil" / "healthy.toml"


@pytest.fixture(scope="module")
def result() -> fmuid.Result:
    return fmuid.Study.read(STUDY).identify()


def with_(result: fmuid.Result, **changes: object) -> tuple[str, ...]:
    assert result.accuracy is not None
    return accuracy_words(result.names, replace(result.accuracy, **changes))  # type: ignore[arg-type]


def test_all_is_well(result: fmuid.Result) -> None:
    assert accuracy_words(result.names, result.accuracy) == ()
    assert result.accuracy is not None
    said = passed_words(result.accuracy)
    assert said.startswith("simulation checked by FMI 2.0 model-exchange, integrator rk45, tolerance 1e-09")
    assert accuracy_words(result.names, None) == ()


@pytest.mark.parametrize("kept", RefinementRefusal)
def test_shifted(result: fmuid.Result, kept: RefinementRefusal) -> None:
    (said,) = with_(result, outcome=AccuracyOutcome.SHIFTED, shift=np.array([0.01, -3.21]), kept=kept)
    assert "L by -3.2" in said
    assert "R by" not in said
    assert said.endswith(KEPT[kept])


@pytest.mark.parametrize("outcome", [*AccuracyOutcome][2:])
def test_what_is_not_known_is_said(result: fmuid.Result, outcome: AccuracyOutcome) -> None:
    (said,) = with_(result, outcome=outcome, shift=np.full(2, math.nan))
    assert "the error of the simulation" in said
    unknown = SolverCheck(outcome, np.full(2, math.nan))
    assert passed_words(unknown) == ""


@pytest.mark.parametrize("cause", SwitchCause)
def test_what_was_switched_is_said(result: fmuid.Result, cause: SwitchCause) -> None:
    assert result.accuracy is not None
    used, finer = result.accuracy.used, result.accuracy.finer
    said = with_(result, switches=(RefinementStep(cause, 0.25, used, finer, 17),))[0]
    assert "FMI 2.0 co-simulation" in said
    assert "rk45, tolerance 1e-09" in said
    part = {
        SwitchCause.START_FAILED: "start fails",
        SwitchCause.START_DIFFERED: "25 %",
        SwitchCause.SHIFT: "0.25 standard deviations",
    }
    assert part[cause] in said
    assert ("17 simulations" in said) == (cause is SwitchCause.SHIFT)


def test_optima_that_are_refused(result: fmuid.Result) -> None:
    assert with_(result, refused=1)[0].startswith("another optimum fitted as well")
    assert with_(result, refused=3)[0].startswith("3 other optima fitted as well")


def test_shifts_in_tables() -> None:
    assert [shift_text(each) for each in (math.nan, 1e-9, -0.25, 77.4)] == ["?", "0", "-0.25", "+77.40"]
