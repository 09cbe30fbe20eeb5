"""Delay within ±½ sample in every interval, on records of a coil in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

import fmuid
from fmuid import Result
from fmuid.array_types import Flags, Floats
from fmuid.estimation import Evaluator, Reason, augmented
from fmuid.identification import SamplerSettings, judge
from fmuid.identification.acquisition_delay import DELAY_PRIOR, delay_columns, secants, with_delay
from tests.support.held_coil import COUNT, L, R, closed, held_voltage, problem_of

SHORT = 200


def record(seed: int, delay: float, count: int = SHORT, delay_std: float | None = None) -> fmuid.Problem:
    """Return a problem of a record read `delay` samples late, with ordinary noise."""
    rng = np.random.default_rng([91, seed])
    u = held_voltage(rng)
    late = closed(u, delay)
    noisy = late + np.sqrt(np.mean(late**2) / 30) * rng.standard_normal(COUNT)
    made = problem_of(u, noisy)
    experiment = fmuid.Experiment(made.experiments[0].frame.iloc[:count], ["u"], ["i"], interpolation="zoh")
    return fmuid.Problem(made.system, experiment, made.given_parameters, noise=fmuid.Noise(delay_std=delay_std))


def holds(result: Result) -> Flags:
    low, high = result.intervals(0.95).to_numpy(float).T
    return (low <= [R, L]) & (np.array([R, L]) <= high)


def covered(draws: int, delay: float, count: int, delay_std: float | None = None) -> Floats:
    """Return in how many draws each interval holds (2,)."""
    return np.asarray(
        np.sum([holds(fmuid.identify(record(seed, delay, count, delay_std))) for seed in range(draws)], axis=0)
    )


def usual(held: Floats, draws: int) -> bool:
    """Return True if so many of 95 % intervals hold by the exact binomial test at 0.1 %."""
    return all(stats.binomtest(int(each), draws, 0.95).pvalue > 1e-3 for each in held)


def test_secants_are_the_delayed_record() -> None:
    u = held_voltage(np.random.default_rng(2))
    table = problem_of(u, closed(u)).experiments[0]
    late, early = secants(table, closed(u)[:, None], 0.29)
    assert closed(u, 0.29) - closed(u) == pytest.approx(late[:, 0], abs=2e-3 * np.ptp(closed(u)))
    assert early[:-1] == pytest.approx(-late[1:])


def test_estimates_are_those_with_the_delay_as_parameters() -> None:
    """The linear step against a search of R, L and both sizes, and against the formula of the least squares."""
    problem = record(1, 0.25)
    result, alone = fmuid.identify(problem), fmuid.identify(record(1, 0.25, delay_std=0.0))
    _, searched = with_delay(problem, result)
    assert (np.abs(result.values - searched.values[:2]) < 0.05 * result.std).all()
    assert result.std == pytest.approx(searched.std[:2], rel=0.05)
    local, columns = alone.fit.linearization, delay_columns(problem, alone)
    assert local is not None
    design = np.hstack([-local.jacobian, columns])
    normal = design.T @ design + np.diag([0.0, 0.0, *(1.0 / DELAY_PRIOR**2)])
    step = np.linalg.solve(normal, design.T @ local.residual)
    assert augmented(local, columns, DELAY_PRIOR).step == pytest.approx(step, rel=1e-6)
    assert (np.abs(result.values - alone.values - step[:2]) < 0.05 * result.std).all()


@pytest.mark.slow
def test_profiles_and_samples_include_the_delay() -> None:
    problem = record(2, 0.5)
    result = fmuid.identify(problem)
    local = result.intervals(0.95)
    for each in fmuid.profile_likelihood(problem, result):
        low, high = local.loc[each.name].to_numpy(float)
        assert [each.lower, each.upper] == pytest.approx([low, high], abs=0.1 * (high - low))
    samples = fmuid.sample_posterior(problem, result, SamplerSettings(max_steps=2000, effective_size=400))
    assert samples.names == ("R", "L")
    assert samples.std == pytest.approx(result.std, rel=0.15)


@pytest.mark.slow
def test_intervals_hold_for_late_and_sound_records() -> None:
    draws = 40
    assert usual(covered(draws, 0.5, SHORT), draws)
    assert covered(draws, 0.5, SHORT, delay_std=0.0).min() < 0.7 * draws
    found = [fmuid.identify(record(seed, 0.0)).fit.delay for seed in range(10)]
    widening = np.mean([each.widening for each in found if each is not None], axis=0)
    assert (widening < 1.25).all() and widening.max() > 1.02


@pytest.mark.campaign
@pytest.mark.parametrize("count", [SHORT, COUNT])
def test_intervals_hold_in_many_records(count: int) -> None:
    """Without a delay, and with one that is uniform within half a sample; at its end the prior is too narrow."""
    assert usual(covered(400, 0.0, count), 400)
    delays = np.random.default_rng(5).uniform(0.0, 0.5, 400).tolist()
    held = [holds(fmuid.identify(record(seed, delay, count))) for seed, delay in enumerate(delays)]
    assert usual(np.sum(held, axis=0), 400)
    assert covered(400, 0.5, count).min() >= 0.87 * 400


def test_a_dominating_delay_is_said() -> None:
    result = fmuid.identify(record(3, 0.0, SHORT, delay_std=2.0))
    verdict = judge(result)
    assert [each.reason for each in verdict.freed] == [Reason.ACQUISITION_DELAY]
    assert not judge(fmuid.identify(record(3, 0.0, SHORT))).freed


def test_results_without_a_delay() -> None:
    """Synchronous, of a robust loss, or of an experiment whose noise says so; simulations are counted."""
    problem = record(4, 0.0)
    (experiment,) = problem.experiments
    own = fmuid.Noise(delay_std=0.5, experiments={experiment.name: fmuid.Noise(delay_std=0.0)})
    for more in ({"noise": fmuid.Noise(delay_std=0.0)}, {"loss": "huber"}, {"noise": own}):
        made = fmuid.Problem(problem.system, experiment, problem.given_parameters, **more)
        assert fmuid.identify(made).fit.delay is None
    evaluator = Evaluator(problem)
    assert fmuid.identify(evaluator).history.simulations == evaluator.simulations
    with pytest.raises(fmuid.InputError, match="delay_std"):
        fmuid.Noise(delay_std=-math.inf)
