"""Searches through simulations whose error matters; the data come from closed forms and matrix exponentials."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import fmuid
from fmuid.array_types import Floats
from fmuid.estimation import SHIFT_LIMIT, AccuracyOutcome, Doubt, Reason, RefinementRefusal, SwitchCause
from fmuid.identification import judge, refinement_of
from fmuid.reports.topics.solver_check import unchecked_words
from fmuid.simulation import Refinement, closing
from tests.support.paths import FMUS, ROOT
from tests.support.stepping import LAG, MOTOR, stepping_fmu

EXPERIMENTS = ROOT / "experiments"

TRUTH, STEP, NOISE = 2.0, 0.05, 0.004
START = {"k": fmuid.Parameter(1.0, min=0.01)}
SYNCHRONOUS = fmuid.Noise(delay_std=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stepping")


def lag_table(noise: float = NOISE, decay: float = float(np.exp(-TRUTH * STEP)), seed: int = 1) -> fmuid.Experiment:
    """Return x' = u − 2 x for a held u; decay = 1 − 2 STEP is what explicit Euler makes of it."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    x = lfilter([0.0, (1.0 - decay) / TRUTH], [1.0, -decay], u) + noise * rng.standard_normal(u.size)
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u, "x": x})
    return fmuid.Experiment(frame, inputs=["u"], outputs=["x"], interpolation="zoh")


def off(result: fmuid.Result, truth: float = TRUTH) -> float:
    """Return how far the one estimate is off, standard deviations."""
    return float(abs(result.values[0] - truth) / result.std[0])


def solved(folder: Path, table: fmuid.Experiment | None = None, k: float = 1.0, **fmu: Any) -> fmuid.Problem:
    """Return the problem of a lag whose FMU steps by explicit Euler, by default from k = 1."""
    start, loss = {"k": fmuid.Parameter(k, min=0.01)}, fmu.pop("loss", "linear")
    return fmuid.Problem(
        stepping_fmu(folder, LAG, **fmu), lag_table() if table is None else table, start, loss=loss, noise=SYNCHRONOUS
    )


def checked(result: fmuid.Result) -> Any:
    assert result.accuracy is not None
    return result.accuracy


@pytest.mark.parametrize("internal", [0.0, STEP])
def test_the_start_shows_it(folder: Path, internal: float) -> None:
    problem = solved(folder, exchange=True, internal=internal)
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
    unchecked = fmuid.identify(problem, solver_check="off")
    assert unchecked.accuracy is None
    assert np.isnan(unchecked.solver_error).all()
    assert abs(unchecked["k"] - result["k"]) > 1e-4


def test_where_the_start_fails(folder: Path) -> None:
    """Euler's steps of 0.05 s explode for k = 1e4."""
    result = fmuid.identify(solved(folder, k=1e4, exchange=True), restart=False)
    assert [switch.cause for switch in checked(result).switches] == [SwitchCause.START_FAILED]
    assert off(result) < 3.0


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_optimum_shows_it(folder: Path, loss: str) -> None:
    """At a start with hardly any dynamics both agree; the search goes on from the estimates."""
    result = fmuid.identify(solved(folder, lag_table(5e-4), 0.05, exchange=True, loss=loss), restart=False)
    (switch,) = checked(result).switches
    assert switch.cause is SwitchCause.SHIFT
    assert switch.size > SHIFT_LIMIT
    assert 0 < switch.simulations < checked(result).simulations < result.history.simulations
    assert off(result) < 3.0
    assert result.estimates.start[0] == 0.05
    assert result.trace["iteration"].is_monotonic_increasing


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


@pytest.mark.parametrize(
    ("draws", "least"),
    [(1, 1), pytest.param(12, 11, marks=pytest.mark.slow), pytest.param(200, 195, marks=pytest.mark.campaign)],
)
def test_the_coil_does_not_alias(draws: int, least: int) -> None:
    """From (20 Ω, 10 mH) steps of 1 ms alias e^−0.04 in the coil's own Runge–Kutta, at L = 1.42 mH.

    From random starts too it is the right inductance, or one that is not identifiable from time constants of 50 µs.
    """
    rng, right = np.random.default_rng(0), 0
    starts = np.exp(rng.uniform(np.log([0.1, 1e-3]), np.log([100.0, 1.0]), (draws, 2)))
    for r, inductance in [[20.0, 0.01], *starts[1:].tolist()]:
        start = [f"parameters.R.start={r!r}", f"parameters.L.start={inductance!r}"]
        result = fmuid.Study.read(EXPERIMENTS / "coil" / "healthy.toml", start).identify()
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


def test_half_the_step_suggests_a_bound(folder: Path) -> None:
    """A quarter of the step fails: Richardson's bound from half of it is about the true error of Euler's steps."""
    table = lag_table(noise=1e-5)
    failed = fmuid.identify(solved(folder, table, least=0.6 * STEP))
    assert checked(failed).outcome is AccuracyOutcome.FAILED
    assert np.isnan(checked(failed).shift).all()
    result = fmuid.identify(solved(folder, table, least=0.4 * STEP))
    found = checked(result)
    assert found.outcome is AccuracyOutcome.FAILED
    assert abs(found.shift[0]) == pytest.approx(off(result), rel=0.3)
    doubt = next(each for each in judge(result).doubts if each.reason is Reason.SOLVER_UNCHECKED)
    assert doubt.values["bound"] == found.largest
    assert unchecked_words(doubt).startswith("half the communication step suggests ")
    assert unchecked_words(Doubt(doubt.reason, ("failed",))) == "shorter communication steps fail"


def test_a_start_that_shorter_steps_alone_can_simulate(folder: Path) -> None:
    """A motor whose L/R is a third of a step, without model exchange; nothing can simulate the last start."""
    truth, friction, step = {"R": 1.0, "L": 1.0 / 3e3, "K": 0.05, "J": 1e-4}, 1e-5, 1e-3
    r, inductance, k, j = truth.values()
    matrix = np.array([[-r / inductance, -k / inductance, 1.0 / inductance], [k / j, -friction / j, 0.0], [0.0] * 3])
    exact, rng = expm(step * matrix), np.random.default_rng(3)
    u = np.repeat(rng.choice([-5.0, 5.0], 100), 15)
    x = np.zeros((u.size, 2))
    for i in range(u.size - 1):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * u[i]
    x += rng.standard_normal(x.shape) * [0.02, 0.05]
    frame = pd.DataFrame({"time": step * np.arange(u.size), "u": u, "i": x[:, 0], "w": x[:, 1]})
    table = fmuid.Experiment(frame, inputs=["u"], outputs=["i", "w"], interpolation="zoh")
    start = dict(zip(truth, (1.43, 2.1e-4, 0.035, 6.6e-5), strict=True))
    fmu = stepping_fmu(folder, MOTOR, order=4)

    def motor(**changed: float) -> fmuid.Problem:
        parameters = {name: fmuid.Parameter(value, min=1e-7) for name, value in (start | changed).items()}
        return fmuid.Problem(fmu, table, parameters, values={"F": friction})

    with pytest.raises(fmuid.SimulationError):
        fmuid.identify(motor(), solver_check="off", restart=False)
    result = fmuid.identify(motor(), restart=False)
    assert checked(result).switches[0].cause is SwitchCause.START_FAILED
    assert checked(result).outcome is AccuracyOutcome.PASSED
    assert (np.abs(result.values - np.array(list(truth.values()))) < 3.5 * result.std).all()
    with pytest.raises(fmuid.SimulationError):
        fmuid.identify(motor(L=1e-6), restart=False)


GAIN, INTEGRAL_TIME = 5.0, 0.4  # of the loop around x' = u − 2 x, sampled every 0.05 s
CONTROL = {"controller.K": GAIN, "controller.Ti": INTEGRAL_TIME}


def sampled_loop() -> fmuid.Experiment:
    """Return what a control does whose command is held: closed forms from sample to sample."""
    rng = np.random.default_rng(5)
    reference = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    decay, x, integral = float(np.exp(-TRUTH * STEP)), np.zeros(reference.size), 0.0
    for i, wanted in enumerate(reference[:-1]):
        error = wanted - x[i]
        x[i + 1] = decay * x[i] + (1.0 - decay) / TRUTH * (GAIN * error + integral)
        integral += GAIN / INTEGRAL_TIME * STEP * error
    return _looped(reference, x + NOISE * rng.standard_normal(x.size))


def continuous_loop() -> fmuid.Experiment:
    """Return what a control does that acts all the time: a matrix exponential from sample to sample."""
    rng = np.random.default_rng(6)
    reference = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    rows = [[-TRUTH - GAIN, 1.0, GAIN], [-GAIN / INTEGRAL_TIME, 0.0, GAIN / INTEGRAL_TIME], [0.0] * 3]
    exact, x = expm(STEP * np.array(rows)), np.zeros((reference.size, 2))
    for i, wanted in enumerate(reference[:-1]):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * wanted
    return _looped(reference, x[:, 0] + NOISE * rng.standard_normal(reference.size))


def _looped(reference: Floats, x: Floats) -> fmuid.Experiment:
    frame = pd.DataFrame({"time": STEP * np.arange(x.size), "controller.reference": reference, "lag.x": x})
    return fmuid.Experiment(frame, ["controller.reference"], ["lag.x"], interpolation="zoh")


def in_a_loop(folder: Path, table: fmuid.Experiment, order: int, samples: bool | None) -> fmuid.Result:
    """Identify a lag under its control, of which it is said whether it samples."""
    models = {
        "lag": fmuid.Component(stepping_fmu(folder, LAG, order=order, exchange=True)),
        "controller": fmuid.Component(FMUS / "CoilController/CoilController.fmu", fmuid.Numerics(samples=samples)),
    }
    links = [("lag.x", "controller.i"), ("controller.u", "lag.u")]
    with closing(fmuid.System(components=models, connections=links)) as system:
        return fmuid.identify(
            fmuid.Problem(system, table, {"lag.k": fmuid.Parameter(1.0, min=0.01)}, values=CONTROL, noise=SYNCHRONOUS)
        )


def test_a_sampled_control_is_not_made_a_faster_one(folder: Path) -> None:
    """Unsaid, the estimate stays where finer steps would move it from; Euler inside the lag is refined anyway."""
    result, said, euler = (in_a_loop(folder, sampled_loop(), *how) for how in ((4, None), (4, True), (1, None)))
    assert off(result) < 3.0
    found = checked(result)
    assert (found.outcome, found.switches, found.divisor) == (AccuracyOutcome.COUPLED, (), 1)
    assert found.largest > 10.0
    assert (checked(said).outcome, checked(said).switches) == (AccuracyOutcome.PASSED, ())
    assert said.values == pytest.approx(result.values, rel=1e-9)
    assert said.std == pytest.approx(result.std, rel=1e-6)
    assert off(euler) < 3.0
    found = checked(euler)
    assert (found.outcome, found.tolerance, found.divisor) == (AccuracyOutcome.COUPLED, 1e-9, 1)


def test_a_continuous_control_is_for_the_study_to_say(folder: Path) -> None:
    unsaid, said = (in_a_loop(folder, continuous_loop(), 4, samples) for samples in (None, False))
    assert off(unsaid) > 5.0
    assert checked(unsaid).outcome is AccuracyOutcome.COUPLED
    assert checked(said).divisor > 1
    assert off(said) < 3.0
