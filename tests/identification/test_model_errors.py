"""Directions of model errors, their tests and refits, on records of a coil in closed form or by scipy."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.special import ndtr
from scipy.stats import f as f_distribution

import fmuid
from fmuid import Problem, Result, Simulator, assess, codec
from fmuid.array_types import Floats
from fmuid.data import SteadyExperiment
from fmuid.estimation import AccuracyOutcome, Evaluator, Grade, LeastSquares, Reason, with_shift
from fmuid.identification import (
    Assessment,
    DefectKind,
    ErrorKind,
    ModelErrors,
    find_data_defects,
    find_model_errors,
    judge,
    refit,
    without_clipped,
)
from fmuid.identification.data_defects import clipped_ends, converter_step
from fmuid.identification.directed_tests import largest_scores, probability_of
from fmuid.identification.directions import make_power
from fmuid.identification.feedback import find_feedback
from fmuid.identification.final_covariance import include_uneven_noise
from fmuid.identification.linearized_record import LinearizedRecord, exponentials
from tests.support.held_coil import COIL, COUNT, STEP, TIMES, L, R, closed, held_voltage, problem_of
from tests.support.verdict_scenes import SUBSTEPS, plain, read
from tests.support.verdict_scenes import integrated as fine_states


@cache
def _largest(voltages: bytes) -> float:
    return float(np.abs(closed(np.frombuffer(voltages))).max())


def _top(u: Floats) -> float:
    return _largest(u.tobytes())


def integrated(u: Floats, rate: Callable[[float, float, float], float], *, start: float = 0.0) -> Floats:
    """Return the current (K,) by scipy, interval by interval of the held voltage; `rate` is di/dt of t, i, u."""
    found = [start]
    for k in range(len(u) - 1):
        span = TIMES[k], TIMES[k + 1]
        solved = solve_ivp(_rate(rate, float(u[k])), span, found[-1:], rtol=1e-9, atol=1e-12)
        found.append(float(solved.y[0, -1]))
    return np.array(found)


def _rate(rate: Callable[[float, float, float], float], voltage: float) -> Callable[[float, Floats], Sequence[float]]:
    return lambda t, x: [rate(t, float(x[0]), voltage)]


@cache
def identified(scene: str, seed: int = 0) -> tuple[Problem, Result]:
    """Return a record of 1000 samples with the noise of an ordinary sensor, and its result."""
    rng = np.random.default_rng([31, seed])
    u = held_voltage(rng)
    sound = closed(u)
    level = np.sqrt(np.mean(sound**2) / 30)
    noise = rng.standard_normal(COUNT)
    made: dict[str, Callable[[], Floats]] = {
        "half a sample late": lambda: closed(u, 0.5),
        "dead time": lambda: integrated(u, lambda _, x, v: (v - 1.2 * np.tanh(x / 0.05) - R * x) / L),
        "offset": lambda: sound + 0.3 * level,
        "late with an offset": lambda: closed(u, 1.0) + 0.5 * level,
    }
    i = made[scene]() if scene in made else sound
    if scene == "colored":
        for k in range(1, COUNT):
            noise[k] = 0.6 * noise[k - 1] + 0.8 * noise[k]
    problem = problem_of(u, i + level * noise)
    return problem, fmuid.identify(problem)


def found_in(scene: str) -> ModelErrors:
    problem, result = identified(scene)
    found = find_model_errors(problem, result)
    assert found is not None
    return found


# --- directions


DIRECTIONS: dict[tuple[ErrorKind, tuple[str, ...]], Callable[[Floats, float], Floats]] = {
    (ErrorKind.OFFSET, ("i",)): lambda u, h: closed(u) + h,
    (ErrorKind.GAIN, ("i",)): lambda u, h: closed(u) * (1.0 + h),
    (ErrorKind.DELAY, ("i",)): lambda u, h: closed(u, h),
    (ErrorKind.INPUT_OFFSET, ("u",)): lambda u, h: closed(u - h),  # u reads too much
    (ErrorKind.INPUT_GAIN, ("u",)): lambda u, h: closed(u * (1.0 - h)),
    (ErrorKind.INITIAL_STATE, ("i",)): lambda u, h: closed(u) + h * np.exp(-R / L * TIMES),
    (ErrorKind.DEAD_TIME, ("u", "i")): lambda u, h: integrated(
        u, lambda _, x, v: (v - h * np.tanh(x / (0.02 * _top(u))) - R * x) / L
    ),
    (ErrorKind.DRIFT, ("R",)): lambda u, h: integrated(
        u, lambda t, x, v: (v - R * (1.0 + h * (t / TIMES[-1] - 0.5)) * x) / L
    ),
    (ErrorKind.SATURATION, ("R", "i")): lambda u, h: integrated(
        u, lambda _, x, v: (v - R * (1.0 + h * (x / _top(u)) ** 2) * x) / L
    ),
    (ErrorKind.INTERPOLATION, ("u",)): lambda u, h: integrated_linear(u, h),
    (ErrorKind.ZERO_DRIFT, ("i",)): lambda u, h: closed(u) + h * TIMES / TIMES[-1],
    (ErrorKind.NONLINEARITY, ("i",)): lambda u, h: closed(u) * (1.0 - h * (closed(u) / _top(u)) ** 2),
    (ErrorKind.HYSTERESIS, ("i",)): lambda u, h: closed(u) - h * direction(np.diff(closed(u), prepend=0.0)),
    (ErrorKind.LAG, ("i",)): lambda u, h: lagging(u, h),
    (ErrorKind.CLOCK, ("i",)): lambda u, h: closed(u) + 0.5 * (slower(u, h) - slower(u, -h)),
}
LONG = {  # integrated step by step
    *(ErrorKind.DEAD_TIME, ErrorKind.DRIFT, ErrorKind.SATURATION),
    *(ErrorKind.INTERPOLATION, ErrorKind.LAG, ErrorKind.CLOCK),
}
KEYS = [pytest.param(key, marks=pytest.mark.slow if key[0] in LONG else ()) for key in DIRECTIONS]
SIZES = {ErrorKind.DELAY: 0.5, ErrorKind.CLOCK: 0.5, ErrorKind.LAG: 0.5}  # of secants


def direction(rises: Floats) -> Floats:
    return np.asarray(np.tanh(rises / (0.02 * np.abs(rises).max())))


def lagging(u: Floats, samples: float) -> Floats:
    """Return the current behind a first-order lag, by Runge and Kutta."""
    found = fine_states(
        u[None], lambda _, x, v: np.stack([(v - R * x[0]) / L, (x[0] - x[1]) / (samples * STEP)]), states=2
    )
    return np.asarray(read(found[1])[0])


def slower(u: Floats, samples: float) -> Floats:
    """Return the current read late by a delay that grows to these samples."""
    fine = fine_states(u[None], plain)[0, 0]
    moved = TIMES - samples * STEP * TIMES / TIMES[-1]
    return np.asarray(np.interp(moved, STEP / SUBSTEPS * np.arange(len(fine)), fine))


def integrated_linear(u: Floats, share: float) -> Floats:
    """Return the current where the voltage goes this share of the way from held to linear."""
    slopes = np.append(share * np.diff(u) / STEP, 0.0)
    return integrated(u, lambda t, x, v: (v + slopes[int(t / STEP + 1e-6)] * (t % STEP) - R * x) / L)


@cache
def nearly_exact() -> tuple[Floats, Problem, Result]:
    u = held_voltage(np.random.default_rng(5))
    problem = problem_of(u, closed(u) + 1e-3 * np.random.default_rng(6).standard_normal(COUNT))
    return u, problem, fmuid.identify(problem)


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key[0].value} of {', '.join(key[1])}")
def test_columns_are_the_slopes_of_the_equations(key: tuple[ErrorKind, tuple[str, ...]]) -> None:
    u, problem, result = nearly_exact()
    found = {(each.kind, each.subject): each for each in problem.directions(result)}[key]
    size = SIZES.get(key[0], 1e-3)
    slope = (DIRECTIONS[key](u, size) - closed(u)) / size
    jacobian = problem.measured * 0.0
    if key[0] in (ErrorKind.DRIFT, ErrorKind.SATURATION):  # the parameter is its value where the record sees it
        jacobian = -result.fit.linearization.jacobian[:, 0]  # type: ignore[union-attr]
        jacobian = jacobian / np.linalg.norm(jacobian)
    left = [each - jacobian * (jacobian @ each) for each in (found.column, slope)]
    assert np.linalg.norm(left[0] - left[1]) < 0.02 * np.linalg.norm(left[1])


def test_a_free_start_value_is_no_error_of_the_initial_state() -> None:
    _, problem, _ = nearly_exact()
    free = dict(problem.given_parameters) | {"i_start": fmuid.Parameter(0.0, nominal=1.0)}
    more = fmuid.Problem(COIL, problem.experiments, free)
    kinds = {each.kind for each in more.directions(fmuid.identify(more))}
    assert ErrorKind.INITIAL_STATE not in kinds
    assert ErrorKind.OFFSET in kinds


def test_dead_times_oppose_the_flow_of_their_power() -> None:
    assert all(make_power(*each) for each in (("V", "mA"), ("N", "mm/s"), ("N.m", "rpm"), ("bar", "l/min"), ("", "A")))
    assert not any(make_power(*each) for each in (("rad/s", "A"), ("V", "V"), ("A", "rad/s")))


def test_exponentials_are_those_of_scipy() -> None:
    matrices = np.random.default_rng(1).normal(size=(5, 3, 3)) * np.array([1e-3, 0.1, 1.0, 5.0, 20.0])[:, None, None]
    e, one, two = exponentials(matrices)
    for k, matrix in enumerate(matrices):
        block = np.zeros((9, 9))
        block[:3, :3], block[:3, 3:6], block[3:6, 6:] = matrix, np.eye(3), np.eye(3)
        whole = expm(block)
        for own, other in ((e[k], whole[:3, :3]), (one[k], whole[:3, 3:6]), (two[k], whole[:3, 6:])):
            np.testing.assert_allclose(own, other, rtol=1e-7, atol=1e-7 * np.abs(other).max())


def test_linearized_sensitivities_are_those_of_simulations() -> None:
    machine = fmuid.datasets.induction_machine().problem()
    result = fmuid.identify(machine)
    local = result.fit.linearization
    assert local is not None
    (simulator,) = machine.as_in(result).simulators
    assert isinstance(simulator, Simulator)
    record = LinearizedRecord.of(simulator, result.values)
    assert record is not None
    std = np.sqrt([result.fit.variance[name] for name in machine.output_names])
    for own, column in zip(record.sensitivities / std, -local.jacobian.T, strict=True):
        assert np.linalg.norm(own.ravel() - column) < 0.02 * np.linalg.norm(column)  # A is constant in an interval


# --- tests


def test_probability_of_the_largest_score() -> None:
    null = largest_scores(np.eye(10))
    for score in (2.5, 3.2, 4.5):
        single = 2.0 * float(ndtr(-score))
        assert probability_of(null, score) == pytest.approx(1.0 - (1.0 - single) ** 10, rel=0.25)
    alike = largest_scores(np.ones((10, 10)))
    assert probability_of(alike, 3.2) < 0.3 * probability_of(null, 3.2)  # one test in ten guises


@pytest.mark.parametrize(
    ("scene", "kind"),
    [
        ("sound", None),
        ("colored", None),
        ("half a sample late", ErrorKind.DELAY),
        pytest.param("dead time", ErrorKind.DEAD_TIME, marks=pytest.mark.slow),
        ("offset", ErrorKind.OFFSET),
    ],
)
def test_errors_are_named_and_color_is_none(scene: str, kind: ErrorKind | None) -> None:
    found = found_in(scene)
    if kind is None:
        assert not found.errors and found.covers_dynamics
        return
    assert kind in found.errors[0].kinds
    test = found.errors[0].test
    assert test.probability < 0.01 and abs(test.score) > 3.0


def test_exposures_tell_what_an_unseen_error_would_do() -> None:
    found = found_in("sound")
    late = next(each for each in found.tests if each.direction.kind is ErrorKind.DELAY)
    problem, result = identified("sound")
    u = problem.experiments[0].input_values[:, 0]
    other = fmuid.identify(problem_of(u, problem.measured + closed(u, 0.3) - closed(u)))
    shift = (other.values - result.values) / result.std
    np.testing.assert_allclose(0.3 * late.shift, shift, rtol=0.2, atol=0.05)
    assert late.std < late.detectable < 10.0 * late.std


def test_nothing_is_tested_without_noise_or_with_a_robust_loss() -> None:
    u = held_voltage(np.random.default_rng(5))
    exact = problem_of(u, closed(u))
    assert find_model_errors(exact, fmuid.identify(exact)) is None
    frame = exact.experiments[0].frame
    robust = fmuid.Problem(
        COIL, fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh"), exact.given_parameters, loss="huber"
    )
    assert find_model_errors(robust, fmuid.identify(robust)) is None
    function = fmuid.estimation.LeastSquares.from_function(
        lambda p: p[0] * TIMES,
        TIMES + 0.1 * np.random.default_rng(1).standard_normal(COUNT),
        {"a": fmuid.Parameter(2.0)},
    )
    assert find_model_errors(function, fmuid.identify(function)) is None


# --- feedback


def controlled(seed: int, gain: float) -> Problem:
    """Return a record under a controller of the noisy current, exact from sample to sample; gain 0: its replay."""
    rng = np.random.default_rng([35, seed])
    wanted = 0.25 * held_voltage(rng) / 12.0
    noise, decay = 0.02 * rng.standard_normal(COUNT), np.exp(-R / L * STEP)
    i, u, integral = np.zeros((2, COUNT)), np.zeros((2, COUNT)), np.zeros(2)
    for k in range(COUNT):  # beside it the loop without noise
        error = wanted[k] - i[:, k] - [noise[k], 0.0]
        integral += 0.2 * error
        u[:, k] = 10.0 * error + integral
        if k + 1 < COUNT:
            i[:, k + 1] = decay * i[:, k] + (1.0 - decay) / R * u[:, k]
    own = 0 if gain else 1
    return problem_of(u[own], i[own] + noise)


@pytest.mark.parametrize("gain", [10.0, 0.0])
def test_inputs_that_follow_the_residual_are_a_doubt(gain: float) -> None:
    """No error has a name there; the same record without feedback passes."""
    problem = controlled(0, gain)
    result = fmuid.identify(problem)
    found = find_model_errors(problem, result)
    assert found is not None and (found.feedback is not None) == bool(gain)
    again = refit(problem, result, found) if found.errors else None
    found = found if again is None else again.found
    assert found is not None and not found.errors and not found.freed
    verdict = judge(result, Assessment(model_errors=found))
    assert verdict.reasons == ((Reason.FEEDBACK,) if gain else ())


def test_regular_steps_follow_no_residual() -> None:
    """The residual of a wrong model tells the time since the last step."""
    rng = np.random.default_rng(37)
    u = np.repeat(rng.choice([-12.0, 0.0, 12.0], COUNT // 60 + 1), 60)[:COUNT]
    slow = np.zeros(COUNT)
    for k in range(1, COUNT):
        slow[k] = 0.95 * slow[k - 1] + 0.05 * u[k]
    assert find_feedback(problem_of(u, closed(u)), slow + 0.1 * rng.standard_normal(COUNT)) is None


def test_feedback_is_an_f_test_of_two_regressions() -> None:
    rng = np.random.default_rng(36)
    u, e = rng.standard_normal((2, 300))
    u[1:] += 0.4 * e[:-1]
    times = STEP * np.arange(300.0)
    frame = pd.DataFrame({"time": times, "u": u, "i": e})
    problem = fmuid.Problem(
        COIL, fmuid.Experiment(frame, ["u"], ["i"], interpolation="linear"), {"R": fmuid.Parameter(R)}
    )
    found = find_feedback(problem, e)
    assert found is not None
    past = np.array([[1.0, *u[k - 20 : k]] for k in range(20, 300)])
    more = np.hstack([past, [e[k - 5 : k] for k in range(20, 300)]])
    few, many = (float(np.linalg.lstsq(rows, u[20:], rcond=None)[1][0]) for rows in (past, more))
    expected = f_distribution.sf((few - many) / 5 / (many / (280 - 26)), 5, 280 - 26)
    assert found.probability == pytest.approx(expected, rel=1e-6)


# --- refit


@pytest.mark.slow
def test_refit_weighs_samples_by_their_own_noise() -> None:
    rng = np.random.default_rng(33)
    u, level = held_voltage(rng), np.where(np.arange(COUNT) < COUNT // 2, 0.05, 0.5)
    problem = problem_of(u, closed(u, 1.0) + level * rng.standard_normal(COUNT))
    frame = problem.experiments[0].frame.assign(level=level)
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")
    problem = fmuid.Problem(
        COIL, experiment, problem.given_parameters, noise=fmuid.Noise(std={"i": "level"}, delay_std=0.0)
    )
    result = fmuid.identify(problem)
    found = find_model_errors(problem, result)
    again = None if found is None else refit(problem.as_in(result), result, found)
    assert again is not None and again.found is not None
    (freed,) = again.found.freed
    assert freed.test.direction.kind is ErrorKind.DELAY and abs(freed.test.size - 1.0) < 3.0 * freed.test.std
    assert (np.abs(again.result.values[:2] - [R, L]) < 3.0 * again.result.std[:2]).all()


@pytest.mark.slow
def test_two_errors_are_freed_one_after_the_other() -> None:
    problem, result = identified("late with an offset")
    again = refit(problem.as_in(result), result, found_in("late with an offset"))
    assert again is not None and again.found is not None and len(again.found.freed) == 2
    assert {ErrorKind.DELAY, ErrorKind.OFFSET} <= {kind for each in again.found.freed for kind in each.kinds}
    assert all(each.test.shift.shape == (2,) for each in again.found.freed)
    verdict = judge(result, Assessment(model_errors=again.found))
    assert len(verdict.freed) == 2 and {each.subject[1] for each in verdict.freed} <= {"R", "L"}
    assert (np.abs(again.result.values[:2] - [R, L]) < 3.0 * again.result.std[:2]).all()


def test_the_size_of_a_large_gain_is_that_of_the_sensor() -> None:
    """A direction is taken at the model's outputs, not at those with the error."""
    rng = np.random.default_rng(0)
    u = held_voltage(rng)
    experiment = problem_of(u, 1.15 * closed(u, 0.0) + 0.01 * rng.standard_normal(COUNT)).experiments[0]
    problem = Problem(COIL, experiment, {"L": fmuid.Parameter(2.0 * L, min=0.01)}, values={"R": R})
    result = fmuid.identify(problem)
    again = refit(problem, result, found) if (found := find_model_errors(problem, result)) else None
    assert again is not None and again.found is not None
    (freed,) = again.found.freed
    assert freed.test.direction.kind is ErrorKind.GAIN
    assert abs(freed.test.size - 0.15) < 4.0 * freed.test.std < 0.01


def test_alternatives_widen_intervals() -> None:
    problem, result = identified("dead time")
    again = refit(problem.as_in(result), result, found_in("dead time"))
    assert again is not None and again.found is not None
    freed = again.found.freed[0]
    assert ErrorKind.DEAD_TIME in freed.kinds
    verdict = judge(result, Assessment(model_errors=again.found))
    # where the current sticks at zero, refits do not settle: a doubt
    assert verdict.freed and verdict.reasons == (Reason.MODEL_ERROR,)


@pytest.mark.slow
def test_an_alternative_of_usual_size_is_freed() -> None:
    """L fixed 30 % too large, or gains 30 % off: a sensor is not so wrong."""
    rng = np.random.default_rng([34, 0])
    u = held_voltage(rng)
    current = closed(u)
    noisy = current + np.sqrt(np.mean(current**2) / 30) * rng.standard_normal(COUNT)
    problem = fmuid.Problem(COIL, problem_of(u, noisy).experiments, {"R": fmuid.Parameter(3.0)}, values={"L": 1.3 * L})
    result = fmuid.identify(problem)
    found = find_model_errors(problem.as_in(result), result)
    assert found is not None and found.errors[0].kinds == {ErrorKind.FIXED}
    again = refit(problem.as_in(result), result, found)
    assert again is not None and again.found is not None
    (freed,) = again.found.freed
    assert (freed.test.direction.kind, freed.settled) == (ErrorKind.FIXED, True)
    assert freed.test.size == pytest.approx(1.0 / 1.3 - 1.0, abs=3.0 * freed.test.std) and freed.test.std < 0.02
    assert abs(again.result.values[0] - R) < 3.0 * again.result.std[0]


@pytest.mark.slow
def test_no_error_is_freed_that_is_not_significant(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, result = identified("half a sample late")
    module = importlib.import_module("fmuid.identification.refit")
    monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, significant=100.0))
    assert refit(problem.as_in(result), result, found_in("half a sample late")) is None


# --- verdict


def test_color_alone_is_no_doubt_where_the_model_was_tested() -> None:
    problem, result = identified("colored")
    checks = assess(problem, result)
    assert judge(result, checks).grade is Grade.PASSED
    assert Reason.COLORED_RESIDUAL in judge(result, Assessment(residuals=checks.residuals)).reasons


EXPERIMENT = {"data": "late.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "zoh"}


def late_study(folder: Path, **sections: object) -> fmuid.Study:
    problem, _ = identified("half a sample late")
    problem.experiments[0].frame.to_csv(folder / "late.csv", index=False)
    content = {
        "model": {"fmu": str(COIL)},
        "experiments": [EXPERIMENT],
        "parameters": {"R": {"start": 3.0, "min": 0.0}, "L": {"start": 0.03, "min": 1e-4}},
        "noise": {"delay_std": 0.0},
    }
    return fmuid.Study.of(content | sections, folder / "study.toml")


def test_profiles_are_of_the_model_without_freed_errors(tmp_path: Path) -> None:
    found = fmuid.run(late_study(tmp_path, uncertainty={"profile_likelihood": True}))
    verdict = found.result.verdict
    assert verdict is not None and not verdict.freed and Reason.MODEL_ERROR in verdict.reasons
    assert [each.name for each in found.assessment.profiles] == ["R", "L"]
    assert str(fmuid.Document.of(found))


@pytest.mark.parametrize("mode", ["refit", "report", pytest.param("off", marks=pytest.mark.slow)])
def test_a_study_frees_reports_or_ignores_errors(tmp_path: Path, mode: str) -> None:
    study = late_study(tmp_path, estimation={"model_error": mode})
    found = fmuid.run(study, tmp_path / "results")
    verdict, errors = found.result.verdict, found.assessment.model_errors
    assert found.result.names == ("R", "L")
    assert (errors is None) == (mode == "off")
    assert (Reason.MODEL_ERROR in verdict.reasons) == (mode == "report")
    assert bool(verdict.freed) == (mode == "refit")
    inside = [low < true < high for true, (low, high) in zip((R, L), found.intervals["local"].values(), strict=True)]
    assert all(inside) == (mode == "refit")
    text = str(fmuid.Document.of(found).reason)
    assert ("i lags by" in text and ", or delay of i" in text) == (mode != "off")
    kept = codec.read(tmp_path / "results" / "result.json", "fmuid/result/2", type(found), "")
    assert kept.result.verdict == verdict
    again = kept.assessment.model_errors
    assert (again is None) == (errors is None)
    if again is not None and errors is not None:
        assert [each.direction.kind for each in again.tests] == [each.direction.kind for each in errors.tests]


# --- defects of the data


def damaged(kind: str, seed: int = 0) -> tuple[Problem, Result]:
    """Return a record whose sensor has a defect, and its result."""
    rng = np.random.default_rng([32, seed])
    u = held_voltage(rng)
    i, noise = closed(u), rng.standard_normal(COUNT)
    level = float(np.sqrt(np.mean(i**2) / 30))
    match kind:
        case "quantized":
            measured = np.rint((i + 0.15 * level * noise) / level) * level
        case "clipped":
            limit = 0.8 * float(np.abs(i).max())
            measured = np.clip(i + level * noise, -limit, limit)
        case "hum":
            measured = i + level * (noise + np.cos(2.0 * np.pi * 50.0 * TIMES + 1.0))
        case "repeated":
            measured = np.repeat((i + level * noise)[::2], 2)[:COUNT]
        case _:
            measured = i + level * noise * (np.abs(i) / np.sqrt(np.mean(i**2)) if kind == "uneven" else 1.0)
    problem = problem_of(u, measured)
    return problem, fmuid.identify(problem)


@pytest.mark.parametrize("kind", ["quantized", "clipped", "repeated", "hum", "uneven"])
def test_defects_of_data_are_named(kind: str) -> None:
    """Uneven noise and hum are no doubt: σ allows for them."""
    problem, result = damaged(kind)
    found = find_data_defects(problem, result)
    assert DefectKind(kind) in {each.kind for each in found}
    assert (Reason.DATA_DEFECT in judge(result, Assessment(data_defects=found)).reasons) == DefectKind(kind).is_doubt


def test_uneven_noise_has_its_own_covariance() -> None:
    """Std in proportion to |i|: against the covariance by the true levels, and that of constant noise."""
    _, result = damaged("uneven")
    local, noise = result.fit.linearization, result.fit.noise
    assert local is not None and noise is not None and noise.levels is not None
    i = result.fit.simulated[0][:, 0]
    true = np.abs(i) / np.sqrt(np.mean(i**2))
    share = local.jacobian @ local.root
    expected = local.root @ (share * true[:, None] ** 2).T @ share @ local.root.T
    assert result.std == pytest.approx(np.sqrt(np.diag(expected)), rel=0.15)
    assert (np.abs(np.sqrt(np.diag(expected)) / np.linalg.norm(local.root, axis=1) - 1.0) > 0.1).any()


def test_a_solver_error_is_added_once_to_uneven_noise() -> None:
    problem, result = damaged("uneven")
    searched = fmuid.Marquardt().search(Evaluator(problem))
    check = result.accuracy
    assert check is not None
    shift = np.array([0.5, 2.0])
    shifted = with_shift(searched, replace(check, outcome=AccuracyOutcome.SHIFTED, shift=shift))
    found = include_uneven_noise(
        problem, replace(shifted, accuracy=replace(check, outcome=AccuracyOutcome.SHIFTED, shift=shift))
    )
    moved, plain = shift * searched.std, include_uneven_noise(problem, searched)
    for wide, narrow in ((found.std, plain.std), (found.estimates.std_white_noise, searched.estimates.std_white_noise)):
        assert wide**2 == pytest.approx(narrow**2 + moved**2, rel=1e-6)


@pytest.mark.parametrize("kind", [fmuid.Experiment, SteadyExperiment])
def test_rows_without_a_time_are_not_clipped(kind: type[fmuid.Experiment]) -> None:
    """Load points repeat their largest value; samples of a sensor do not."""
    u = np.linspace(0.0, 1.0, 60)
    frame = pd.DataFrame({"time": u, "u": u, "i": np.minimum(u, 0.8)})
    experiment = kind(frame, ["u"], ["i"])
    problem = LeastSquares([], [experiment], {"R": fmuid.Parameter(1.0)})
    fit = SimpleNamespace(simulated=(u[:, None],), noise_variance={"i": 1e-4})
    found = without_clipped(problem, SimpleNamespace(fit=fit))  # type: ignore[arg-type]
    assert (found is None) == (kind is SteadyExperiment)


def test_an_end_that_the_model_has_is_no_clipping() -> None:
    values = np.minimum(np.linspace(0.0, 1.0, 60), 0.8)
    assert clipped_ends(values, values + 1e-3) == [(0.8, 1.0)]
    assert clipped_ends(values, values) == []


def test_clipped_stretches_do_not_count(tmp_path: Path) -> None:
    """Clipped at 80 % of the range, R is far off; without these stretches it is not."""
    problem, biased = damaged("clipped")
    assert np.abs(biased.values[0] - R) > 3.0 * biased.std[0]
    problem.experiments[0].frame.to_csv(tmp_path / "clipped.csv", index=False)
    found = fmuid.run(late_study(tmp_path, experiments=[{**EXPERIMENT, "data": "clipped.csv"}]))
    assert (np.abs(found.result.values - [R, L]) < 3.0 * found.result.std).all()
    verdict = found.result.verdict
    assert verdict is not None and verdict.grade is Grade.PASSED
    assert [each.subject[0] for each in verdict.freed] == ["excluded", "excluded"]
    assert "do not count" in str(fmuid.Document.of(found).reason)


@pytest.mark.parametrize("scene", ["sound", "colored"])
def test_sound_data_have_no_defect(scene: str) -> None:
    assert [find_data_defects(*identified(scene, seed)) for seed in range(3)] == [()] * 3


def test_a_step_is_found_where_all_values_are_its_multiples() -> None:
    values = np.random.default_rng(1).standard_normal(500)
    assert converter_step(np.rint(values / 0.25) * 0.25 + 0.1) == pytest.approx(0.25)
    assert converter_step(values) == 0.0
    assert converter_step(np.where(values > 0.0, 1.0, 0.0)) == 0.0  # a switch has no converter


@pytest.mark.campaign
@pytest.mark.parametrize("scene", ["sound", "colored"])
def test_false_alarms_of_all_tests_together(scene: str) -> None:
    alarms = uneven = follows = 0
    for seed in range(400):
        problem, result = identified.__wrapped__(scene, seed)
        found = find_model_errors(problem, result)
        alarms += bool(found is not None and found.errors)
        uneven += bool(find_data_defects(problem, result))
        follows += found is not None and found.feedback is not None
    assert alarms <= 10  # 1 % of 400 by the exact binomial test at 0.1 %
    assert uneven <= 10
    assert follows <= 4  # 0.1 %
