"""Starts that are far away, or lead to a bad fit: what is tried then, and what is said of it."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.starts.draws import DC_MOTOR, Record, draw
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import RestartAttempt, SearchFailure, StartingPointSource
from fmuid.identification import starting_points
from fmuid.identification.equation_error_start import SETTINGS, equation_start
from fmuid.identification.starting_points import EndedSearch, is_confirmed
from tests.support.exported import export_text
from tests.support.paths import FMUS

EXPERIMENTS = FMUS.parent / "experiments"

MODEL = (EXPERIMENTS / "starts" / "DcMotor.mo").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("motor"), MODEL)


@pytest.fixture(scope="module")
def record() -> Record:
    """A motor whose start is three to thirty times away in every parameter."""
    return draw("dc", 2, 3.0, 30.0)


def problem(motor: Path, record: Record, start: Floats | None = None) -> fmuid.Problem:
    machine = DC_MOTOR
    columns = {f"m_{name}": values for name, values in zip(machine.outputs, record.measured.T, strict=True)}
    frame = pd.DataFrame({"time": record.times, "u": record.inputs[:, 0], **columns})
    names = {name: f"m_{name}" for name in machine.outputs}
    given = record.start if start is None else start
    parameters = {n: fmuid.Parameter(s, min=0.0) for n, s in zip(machine.parameters, given.tolist(), strict=True)}
    parameters |= {n: fmuid.Parameter(0.0, nominal=s) for n, s in zip(machine.states, machine.nominal, strict=True)}
    return fmuid.Problem(motor, fmuid.Experiment(frame, ["u"], names, interpolation="zoh"), parameters)


@pytest.mark.slow
def test_a_motor_from_far_away_is_found_by_its_equations(motor: Path, record: Record) -> None:
    whole = problem(motor, record)
    result = fmuid.identify(whole)
    assert result.converged
    noise = np.sqrt(np.nanmean((record.measured - record.clean) ** 2, axis=0))
    found = np.sqrt([result.fit.noise_variance[name] for name in DC_MOTOR.outputs])
    assert (found < 1.02 * noise).all()
    assert [(each.remedy, each.trouble) for each in result.history.restarts] == [
        (StartingPointSource.GIVEN, SearchFailure.FAR),
        (StartingPointSource.EQUATION_ERROR, SearchFailure.NONE),
    ]
    assert [each.kept for each in result.history.restarts] == [False, True]
    assert result.estimates.start == pytest.approx(whole.parameters.start)
    assert result.history.simulations <= 400
    data = json.loads(json.dumps(as_json(result)))
    assert [each["remedy"] for each in data["history"]["restarts"]] == ["given", "equation_error"]


def test_the_equations_give_a_start_and_the_initial_states(motor: Path, record: Record) -> None:
    whole = problem(motor, record)
    found = equation_start(whole, whole.parameters.start)
    assert found is not None
    theta, noise_ratio = found
    assert 1.0 < noise_ratio < SETTINGS.poor
    ratios = theta[:6] / record.truth
    assert (ratios > 1 / 3).all()
    assert (ratios < 3).all()
    assert theta[6:] == pytest.approx(record.measured[1], rel=1e-6)  # the median of three; a missing one is filled


NONE, UNFINISHED, LARGE = SearchFailure.NONE, SearchFailure.UNFINISHED, SearchFailure.LARGE_RESIDUAL


@pytest.fixture(scope="module")
def curved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = "model Curved\n parameter Real a=1, b=1;\n output Real x(start=0, fixed=true);\n output Real y;\n"
    return export_text(tmp_path_factory.mktemp("curved"), f"{model}equation\n der(x)=1;\n y=a*sin(b*x);\nend Curved;")


def wave(curved: Path, start: float, extra: Callable[[Floats], Floats] | None = None) -> fmuid.Problem:
    """A sine, whose frequency has secondary optima; its state is not measured, so that the equations do not help."""
    times = np.linspace(0.0, 10.0, 300)
    y = np.sin(3.0 * times) + 0.02 * np.random.default_rng(3).standard_normal(300)
    y = y if extra is None else y + extra(times)
    frame = pd.DataFrame({"time": times, "y": y})
    parameters = {"a": fmuid.Parameter(0.5, min=0.0, max=3.0), "b": fmuid.Parameter(start, min=0.5, max=5.0)}
    return fmuid.Problem(curved, fmuid.Experiment(frame, [], ["y"]), parameters)


@pytest.mark.slow
def test_a_good_start_takes_what_it_took(curved: Path) -> None:
    """Not one simulation more, and the same estimates to the last bit."""
    near = wave(curved, 3.0)
    result, plain = fmuid.identify(near), fmuid.identify(near, restart=False)
    assert result.history.restarts == ()
    assert result.history.simulations == plain.history.simulations
    assert (result.values == plain.values).all()


@pytest.mark.slow
def test_a_secondary_optimum_is_left_for_points_of_the_box(curved: Path) -> None:
    stuck = fmuid.identify(wave(curved, 1.0), restart=False)
    assert abs(stuck["b"] - 3.0) > 0.1
    result = fmuid.identify(wave(curved, 1.0))
    assert result["b"] == pytest.approx(3.0, abs=0.01)
    first, corrected, given = result.history.restarts[:3]
    assert (first.remedy, first.trouble) == (StartingPointSource.GIVEN, SearchFailure.FAR)
    assert corrected.remedy is StartingPointSource.CORRECTION  # where the equations give nothing
    assert given.remedy is StartingPointSource.GIVEN
    assert given.trouble in (SearchFailure.LARGE_RESIDUAL, SearchFailure.UNFINISHED)
    assert given.noise_ratio > 3.0
    assert result.history.restarts[-1].remedy is StartingPointSource.SOBOL
    assert result.history.restarts[-1].kept
    assert result.history.simulations == sum(each.simulations for each in result.history.restarts)


def test_a_guess_waits_for_the_others_and_is_gone_on_with(curved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starting_points, "SETTINGS", replace(starting_points.SETTINGS, patience=1))
    result = fmuid.identify(wave(curved, 1.0))
    assert result["b"] == pytest.approx(3.0, abs=0.01)
    *before, last = result.history.restarts
    assert {each.trouble for each in before if each.remedy is StartingPointSource.SOBOL} == {SearchFailure.UNFINISHED}
    assert (last.remedy, last.trouble, last.kept) == (StartingPointSource.SOBOL, SearchFailure.NONE, True)


def test_a_model_that_is_wrong_is_confirmed_by_a_second_start(curved: Path) -> None:
    """What the model does not know moves the output far beyond the noise: no start mends that, and it is said."""
    result = fmuid.identify(wave(curved, 2.9, lambda t: 0.3 * np.cos(1.3 * t)))
    assert result.converged
    kept = next(each for each in result.history.restarts if each.kept)
    assert kept.trouble is SearchFailure.MODEL_ERROR


def ended(remedy: StartingPointSource, values: list[float], worth: float = 0.0, number: int = 0) -> EndedSearch:
    """A search that ended with standard deviations of 0.1, the second one without end."""
    result: Any = SimpleNamespace(values=np.array(values), std=np.array([0.1, np.inf]))
    return EndedSearch(result, RestartAttempt(remedy, SearchFailure.LARGE_RESIDUAL, 20.0), number, worth)


EQUATIONS, CORRECTION = StartingPointSource.EQUATION_ERROR, StartingPointSource.CORRECTION


@pytest.mark.parametrize(
    ("remedy", "value", "worth", "equation_ratio", "confirmed"),
    [
        (EQUATIONS, 1.05, 0.0, np.nan, True),
        (EQUATIONS, 1.05, 0.0, 15.0, True),
        (EQUATIONS, 1.05, 0.0, 3.0, False),  # the equations hold: a secondary optimum
        (EQUATIONS, 1.2, 0.0, np.nan, False),
        (EQUATIONS, 1.05, -4.0, np.nan, False),
        (CORRECTION, 1.05, 0.0, np.nan, False),  # which set out from the given start
    ],
)
def test_searches_agree_in_cost_and_estimates(
    remedy: StartingPointSource, value: float, worth: float, equation_ratio: float, confirmed: bool
) -> None:
    one, other = ended(StartingPointSource.GIVEN, [1.0, 2.0], number=1), ended(remedy, [value, 7.0], worth)
    assert is_confirmed(one, [other, one], equation_ratio) == confirmed


def test_no_search_goes_back_to_a_rougher_simulation(motor: Path) -> None:
    """This motor's co-simulation is so rough that a search by it crawls on for thousands of simulations."""
    result = fmuid.identify(problem(motor, draw("dc", 22)))
    assert result.converged
    assert [each.kept for each in result.history.restarts] == [False, True]
    assert result.history.simulations < 400
