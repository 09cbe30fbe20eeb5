"""Searches through simulations whose error matters; the data come from closed forms and matrix exponentials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from fmuid.estimation import SHIFT_LIMIT, AccuracyOutcome, RefinementRefusal, SwitchCause
from fmuid.identification import refinement_of
from fmuid.simulation import Refinement
from tests.support.exported import export_text
from tests.support.paths import ROOT
from tests.support.stepping import LAG, MOTOR, stepping_fmu

EXPERIMENTS = ROOT / "experiments"

TRUTH, STEP, NOISE = 2.0, 0.05, 0.004
START = {"k": fmuid.Parameter(1.0, min=0.01)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stepping")


def lag_table(noise: float = NOISE, decay: float = float(np.exp(-TRUTH * STEP)), seed: int = 1) -> fmuid.Experiment:
    """Return x' = u − 2 x for a held u; decay = 1 − 2 STEP is what explicit Euler makes of it."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    x = np.zeros(u.size)
    for i in range(u.size - 1):
        x[i + 1] = decay * x[i] + (1.0 - decay) / TRUTH * u[i]
    x += noise * rng.standard_normal(u.size)
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u, "x": x})
    return fmuid.Experiment(frame, inputs=["u"], outputs=["x"], interpolation="zoh")


MOTOR_TRUTH = {"R": 1.0, "L": 1.0 / 3e3, "K": 0.05, "J": 1e-4}
FRICTION, MOTOR_STEP = 1e-5, 1e-3  # L/R is a third of the step


@pytest.fixture(scope="module")
def motor_table() -> fmuid.Experiment:
    r, inductance, k, j = MOTOR_TRUTH.values()
    matrix = np.array([[-r / inductance, -k / inductance, 1.0 / inductance], [k / j, -FRICTION / j, 0.0], [0.0] * 3])
    exact = expm(MOTOR_STEP * matrix)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-5.0, 5.0], 100), 15)
    x = np.zeros((u.size, 2))
    for i in range(u.size - 1):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * u[i]
    x += rng.standard_normal(x.shape) * [0.02, 0.05]
    frame = pd.DataFrame({"time": MOTOR_STEP * np.arange(u.size), "u": u, "i": x[:, 0], "w": x[:, 1]})
    return fmuid.Experiment(frame, inputs=["u"], outputs=["i", "w"], interpolation="zoh")


def off(result: fmuid.Result, truth: float = TRUTH) -> float:
    """Return how far the one estimate is off, standard deviations."""
    return float(abs(result.values[0] - truth) / result.std[0])


# --- Euler inside


def solved(folder: Path, table: fmuid.Experiment | None = None, k: float = 1.0, **fmu: Any) -> fmuid.Problem:
    """Return the problem of a lag, by default from k = 1."""
    start = {"k": fmuid.Parameter(k, min=0.01)}
    return fmuid.Problem(stepping_fmu(folder, LAG, **fmu), lag_table() if table is None else table, start)


def checked(result: fmuid.Result) -> Any:
    assert result.accuracy is not None
    return result.accuracy


def test_without_a_check_the_estimate_is_wrong(folder: Path) -> None:
    """As wrong as the formula says: 1 − k h in place of e^(−kh), up to the gain."""
    result = fmuid.identify(solved(folder, lag_table(0.0)), solver_check="off")
    assert result.accuracy is None
    assert np.isnan(result.solver_error).all()
    assert abs(result["k"] - TRUTH) > 1e-4


def test_the_start_shows_it(folder: Path) -> None:
    problem = solved(folder, exchange=True)
    result = fmuid.identify(problem)
    found = checked(result)
    assert off(result) < 3.0
    assert found.outcome is AccuracyOutcome.PASSED
    assert [switch.cause for switch in found.switches] == [SwitchCause.START_DIFFERED]
    used, finer = result.setup.models[""]["run"], found.finer[""]
    assert used["integrator"] == finer["integrator"] == "rk45"
    assert [used["tolerance"], finer["tolerance"]] == pytest.approx([1e-9, 1e-11])
    assert refinement_of(result) == Refinement(1e-9)
    assert not problem.refinement.any


def test_where_the_start_fails(folder: Path) -> None:
    """Euler's steps of 0.05 s explode for k = 1e4."""
    result = fmuid.identify(solved(folder, k=1e4, exchange=True), restart=False)
    assert [switch.cause for switch in checked(result).switches] == [SwitchCause.START_FAILED]
    assert off(result) < 3.0


def test_the_optimum_shows_it(folder: Path) -> None:
    """At a start with hardly any dynamics both agree; the search goes on from the estimates."""
    result = fmuid.identify(solved(folder, lag_table(5e-4), 0.05, exchange=True), restart=False)
    (switch,) = checked(result).switches
    assert switch.cause is SwitchCause.SHIFT
    assert switch.size > SHIFT_LIMIT
    assert 0 < switch.simulations < checked(result).simulations < result.history.simulations
    assert off(result) < 3.0
    assert result.estimates.start[0] == 0.05
    assert result.trace["iteration"].is_monotonic_increasing


def test_internal_steps_beside_model_exchange(folder: Path) -> None:
    result = fmuid.identify(solved(folder, internal=STEP, exchange=True))
    assert checked(result).outcome is AccuracyOutcome.PASSED
    assert off(result) < 3.0


@pytest.mark.parametrize("told", [True, False])
def test_shorter_steps_where_there_is_no_model_exchange(folder: Path, told: bool) -> None:
    result = fmuid.identify(solved(folder, told=told))
    assert checked(result).outcome is AccuracyOutcome.PASSED
    assert refinement_of(result) == Refinement(None, 4)
    assert result.setup.models[""]["run"]["divisor"] == 4
    assert off(result) < 3.0


def test_internal_steps_cannot_be_checked(folder: Path) -> None:
    result = fmuid.identify(solved(folder, internal=STEP))
    assert checked(result).outcome is AccuracyOutcome.UNCHECKABLE
    assert np.isnan(result.solver_error).all()


# --- nothing is switched


@pytest.mark.parametrize("k", [0.05, 1.0])
def test_data_made_by_this_very_solver(folder: Path, k: float) -> None:
    """Model Exchange fits clearly worse, also where the start differs: the shift is part of σ."""
    table = lag_table(5e-4, 1.0 - TRUTH * STEP)
    plain = fmuid.identify(solved(folder, table, k, exchange=True), solver_check="off")
    result = fmuid.identify(solved(folder, table, k, exchange=True))
    found = checked(result)
    assert (found.outcome, found.kept, found.switches) == (AccuracyOutcome.SHIFTED, RefinementRefusal.FITS_BETTER, ())
    assert not refinement_of(result).any
    assert result["k"] == pytest.approx(plain["k"], abs=1e-3 * plain.std[0])
    assert result.std[0] == pytest.approx(plain.std[0] * np.hypot(1.0, found.shift[0]), rel=1e-3)
    assert plain.history.simulations < result.history.simulations


def test_a_solver_that_was_asked_for_is_kept(folder: Path) -> None:
    fmu = stepping_fmu(folder, LAG, exchange=True)
    asked = fmuid.System(fmu, numerics=fmuid.Numerics(interface="co-simulation"))
    by_word = fmuid.identify(fmuid.Problem(asked, lag_table(), START))
    by_option = fmuid.identify(fmuid.Problem(fmu, lag_table(), START), solver_check="report")
    for found in (checked(by_word), checked(by_option)):
        assert (found.outcome, found.kept, found.switches) == (AccuracyOutcome.SHIFTED, RefinementRefusal.ASKED, ())
    assert by_word["k"] == by_option["k"]
    with pytest.raises(fmuid.InputError, match=r"solver_check.*'swich'.*refine"):
        fmuid.identify(solved(folder), solver_check="swich")


# --- where all is well


def test_what_the_check_takes_where_all_is_well() -> None:
    """Two simulations more: one of the start and one of the optimum, and not one bit of the estimates."""
    study = fmuid.Study.read(EXPERIMENTS / "coil" / "healthy.toml")
    with_check, without = study.identify(), fmuid.identify(study.problem(), solver_check="off")
    assert with_check.history.simulations == without.history.simulations + 2
    assert (with_check.values == without.values).all()
    assert (with_check.covariance == without.covariance).all()
    found = checked(with_check)
    assert (found.outcome, found.simulations) == (AccuracyOutcome.PASSED, 2)
    assert np.abs(found.shift).max() < 1e-6


RAMP = "model Ramp\n parameter Real k=1;\n output Real x(start=0, fixed=true);\nequation\n der(x)=k;\nend Ramp;"


def test_controlled_steps_as_long_as_the_samples_are_exact_enough(tmp_path: Path) -> None:
    """The same bits at a hundredth of the tolerance say that even that is kept: the solution is a straight line."""
    times = 0.1 * np.arange(30)
    frame = pd.DataFrame({"time": times, "x": 3.0 * times + 0.01 * np.random.default_rng(1).standard_normal(30)})
    system = fmuid.System(export_text(tmp_path, RAMP), numerics=fmuid.Numerics("model-exchange"))
    result = fmuid.identify(fmuid.Problem(system, fmuid.Experiment(frame, [], ["x"]), {"k": fmuid.Parameter(1.0)}))
    assert checked(result).outcome is AccuracyOutcome.PASSED
    assert result.solver_error[0] == 0.0


def test_no_false_alarm_on_the_induction_machine() -> None:
    study = fmuid.Study.read(EXPERIMENTS / "induction_machine" / "study.toml")
    result = study.identify()
    assert (checked(result).outcome, checked(result).switches) == (AccuracyOutcome.PASSED, ())
    assert np.abs(result.solver_error).max() < 1e-4


# --- the coil and the motor


def coil(r: float, inductance: float) -> fmuid.Result:
    start = [f"parameters.R.start={r!r}", f"parameters.L.start={inductance!r}"]
    return fmuid.Study.read(EXPERIMENTS / "coil" / "healthy.toml", start).identify()


def test_the_coil_no_longer_aliases() -> None:
    """From here steps of 1 ms alias e^−0.04 in the coil's own Runge–Kutta, at L = 1.42 mH."""
    result = coil(20.0, 0.01)
    assert result["L"] == pytest.approx(0.1, abs=4.0 * result.std[1])
    assert result.std[1] < 0.002


@pytest.mark.parametrize(
    ("draws", "least"),
    [pytest.param(12, 11, marks=pytest.mark.slow), pytest.param(200, 195, marks=pytest.mark.campaign)],
)
def test_the_coil_from_random_starts(draws: int, least: int) -> None:
    """The right inductance; or, from time constants of 50 µs in steps of 1 ms, that it is not identifiable there."""
    rng, right = np.random.default_rng(0), 0
    for r, inductance in np.exp(rng.uniform(np.log([0.1, 1e-3]), np.log([100.0, 1.0]), (draws, 2))).tolist():
        result = coil(r, inductance)
        assert result.converged or (inductance / r < 5e-5 and result.estimates.at_bounds), (r, inductance)
        if result.converged:
            right += 1
            assert result["L"] == pytest.approx(0.1, abs=4.0 * result.std[1]), (r, inductance)
            assert result.std[1] < 0.002
    assert right >= least


BOX = ("parameters.R.min=0.1", "parameters.R.max=100.0", "parameters.L.min=1e-3", "estimation.n_starts=20")


def test_an_alias_is_no_optimum() -> None:
    """From some starts the coil's co-simulation fits as well at L = 1.42 mH, which model exchange does not bear out."""
    study = fmuid.Study.read(EXPERIMENTS / "coil" / "healthy.toml", [*BOX, "parameters.L.max=1.0"])
    without = fmuid.identify(study.problem(), study.estimator, solver_check="off")
    assert sorted(round(optimum.theta[1], 4) for optimum in without.history.optima) == [0.0014, 0.1007]
    result = study.identify()
    assert [round(optimum.theta[1], 4) for optimum in result.history.optima] == [0.1007]
    assert result["L"] == pytest.approx(0.1, abs=4.0 * result.std[1])
    assert (checked(result).refused, checked(result).switches) == (1, ())


@pytest.mark.slow
def test_a_box_that_holds_the_alias_alone() -> None:
    """Model exchange leaves it for the bound behind which the truth is."""
    start = "parameters.L.start=0.005"
    study = fmuid.Study.read(EXPERIMENTS / "coil" / "healthy.toml", [*BOX, "parameters.L.max=0.01", start])
    result = study.identify()
    assert [bound.name for bound in result.estimates.at_bounds] == ["L"]
    assert [switch.cause for switch in checked(result).switches] == [SwitchCause.SHIFT]


def test_a_start_that_shorter_steps_alone_can_simulate(folder: Path, motor_table: fmuid.Experiment) -> None:
    """Without model exchange; a start that nothing can simulate is said to be one."""
    start = dict(zip(MOTOR_TRUTH, (1.43, 2.1e-4, 0.035, 6.6e-5), strict=True))
    parameters = {name: fmuid.Parameter(value, min=1e-7) for name, value in start.items()}
    problem = fmuid.Problem(stepping_fmu(folder, MOTOR, order=4), motor_table, parameters, values={"F": FRICTION})
    with pytest.raises(fmuid.SimulationError):
        fmuid.identify(problem, solver_check="off", restart=False)
    result = fmuid.identify(problem, restart=False)
    assert checked(result).switches[0].cause is SwitchCause.START_FAILED
    assert checked(result).outcome is AccuracyOutcome.PASSED
    assert (np.abs(result.values - np.array(list(MOTOR_TRUTH.values()))) < 3.5 * result.std).all()
    far = parameters | {"L": fmuid.Parameter(1e-6, min=1e-7)}
    with pytest.raises(fmuid.SimulationError):
        fmuid.identify(fmuid.Problem(problem.system, motor_table, far, values={"F": FRICTION}), restart=False)


@pytest.mark.parametrize("order", [1, 4])
def test_a_motor_faster_than_its_steps(folder: Path, motor_table: fmuid.Experiment, order: int) -> None:
    parameters = {name: fmuid.Parameter(2.0 * value, min=1e-7) for name, value in MOTOR_TRUTH.items()}
    fmu = stepping_fmu(folder, MOTOR, order=order, exchange=True)
    result = fmuid.identify(fmuid.Problem(fmu, motor_table, parameters, values={"F": FRICTION}))
    assert (np.abs(result.values - np.array(list(MOTOR_TRUTH.values()))) < 3.5 * result.std).all()
    assert checked(result).outcome is AccuracyOutcome.PASSED
