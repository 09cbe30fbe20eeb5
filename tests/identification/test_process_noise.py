"""Disturbances of states against colored noise of sensors, on equations of our own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

import fmuid
from fmuid.array_types import Floats
from fmuid.identification.linearized_record import DiscreteStateSpace
from fmuid.identification.model_errors import ProcessNoise
from fmuid.identification.process_noise import find_process_noise
from fmuid.reports.topics.assumptions import model_error_remarks
from tests.support.held_coil import COUNT, L, R, closed, held_voltage, problem_of
from tests.support.quick import first

STEP = 0.01
DRIVE = np.array([[0.0, 1.0, 0.0], [0.0, -0.5, 4.0], [0.0, -3.0, -20.0]])  # angle, speed, current
STATES = ("angle", "speed", "current")


def colored(rng: np.random.Generator, count: int, *coefficients: float) -> Floats:
    """Return an autoregression of unit variance."""
    white, found = rng.standard_normal(count + 200), np.zeros(count + 200)
    for k in range(2, count + 200):
        found[k] = sum(a * found[k - 1 - i] for i, a in enumerate(coefficients)) + white[k]
    return np.asarray(found[200:] / found[200:].std())


def coil(seed: int, coefficients: Sequence[float] = (), disturbance: float = 0.0) -> tuple[fmuid.Problem, float]:
    """Return a problem of a coil, and the disturbance's share of the residual's variance."""
    rng = np.random.default_rng([71, seed])
    u = held_voltage(rng)
    sound, moved = closed(u), closed(u + disturbance * rng.standard_normal(COUNT))
    level = np.sqrt(np.mean(sound**2) / 30)
    noise = level * colored(rng, COUNT, *coefficients)
    return problem_of(u, moved + noise), float(np.var(moved - sound) / np.var(moved - sound + noise))


def found_in(problem: fmuid.Problem) -> ProcessNoise | None:
    return problem.process_noise(fmuid.identify(problem))


@pytest.mark.parametrize(
    "coefficients", [(), *(pytest.param(each, marks=pytest.mark.slow) for each in ((0.6,), (1.2, -0.5)))]
)
def test_noise_of_sensors_is_no_disturbance(coefficients: Sequence[float]) -> None:
    assert [found_in(coil(seed, coefficients)[0]) for seed in range(4)] == [None] * 4


@pytest.mark.slow
def test_a_disturbed_voltage_disturbs_the_current() -> None:
    for seed in range(4):
        problem, share = coil(seed, disturbance=6.0)
        found = found_in(problem)
        assert found is not None and found.states == ("i",)
        assert found.share == pytest.approx(share, abs=0.15)
    errors = fmuid.assess(problem, fmuid.identify(problem)).model_errors
    told = [each.text for each in model_error_remarks(errors)]
    assert any(each.startswith("Noise looks like a disturbance of i (") for each in told)


def drive(seed: int, state: int, seen: Sequence[int]) -> tuple[DiscreteStateSpace, Floats]:
    """Return steps of a drive, and outputs under a disturbance of one state, with noise of the sensors."""
    rng, e = np.random.default_rng([72, seed]), expm(DRIVE * STEP)
    by_rate = expm(np.block([[DRIVE, np.eye(3)], [np.zeros((3, 6))]]) * STEP)[:3, 3:]
    x = np.zeros((2000, 3))
    for k in range(1999):
        x[k + 1] = e @ x[k] + by_rate[:, state] * rng.standard_normal()
    y = x[:, list(seen)]
    return DiscreteStateSpace(e, by_rate, np.eye(3)[list(seen)]), y + 0.5 * y.std(axis=0) * rng.standard_normal(y.shape)


@pytest.mark.parametrize("state", first(1, [1, 2]))
def test_the_disturbed_state_of_a_drive_is_named(state: int) -> None:
    for seed in range(3):
        space, residual = drive(seed, state, (1, 2))
        found = find_process_noise(STATES, [space], [residual])
        assert found is not None and found.states == (STATES[state],)
        parts = [residual[:1000], residual[1000:]]
        again = find_process_noise(STATES, [space, space], parts)
        assert again is not None and again.states == found.states


def test_samples_that_do_not_count_are_left_out() -> None:
    space, residual = drive(0, 1, (1, 2))
    residual[300:320], residual[700, 0] = np.nan, np.nan
    found = find_process_noise(STATES, [space], [residual])
    assert found is not None and found.states == ("speed",)


def test_an_unstable_model_has_no_stationary_disturbance() -> None:
    space = DiscreteStateSpace(np.array([[1.5]]), np.eye(1), np.eye(1))
    residual = colored(np.random.default_rng(1), 500, 0.6)[:, None]
    assert find_process_noise(["x"], [space], [residual]) is None


@pytest.mark.campaign
@pytest.mark.parametrize("coefficients", [(0.6,), (0.9,), (1.2, -0.5), (0.3, 0.4)])
def test_level_of_disturbances(coefficients: Sequence[float]) -> None:
    found = sum(found_in(coil(seed, coefficients)[0]) is not None for seed in range(200))
    assert found <= 8


@pytest.mark.campaign
@pytest.mark.parametrize("volts", [2.4, 6.0])
def test_intervals_under_disturbances(volts: float) -> None:
    held, named = np.zeros(2), 0
    for seed in range(200):
        problem, _ = coil(seed, disturbance=volts)
        result = fmuid.identify(problem)
        low, high = result.intervals(0.95).to_numpy(float).T
        held += (low <= [R, L]) & (np.array([R, L]) <= high)
        named += found_in(problem) is not None
    assert named >= 180
    assert all(stats.binomtest(int(each), 200, 0.95).pvalue > 1e-3 for each in held)
