"""Covariance under coloured noise, against dense matrices, closed forms, finite differences and seeded draws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg
from scipy.signal import lfilter

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.estimation.noise import autoregression
from fmuid.estimation.noise.autoregression import Autoregression, impulse_response, most_orders
from fmuid.estimation.noise.model import NoiseModel
from fmuid.estimation.noise.output_series import OutputSeries, output_series, table_grid
from fmuid.estimation.noise.sample_grid import Rows, SampleGrid
from fmuid.estimation.noise.sandwich import ResidualNoise, SandwichSettings, sandwich
from tests.support.problems import ar1

SLOW, OSCILLATING = np.array([0.8]), np.array([1.6, -0.9])
NOTHING = np.zeros(0)


def model(coefficients: Floats, variance: float = 1.0, samples: int = 100) -> Autoregression:
    return Autoregression(coefficients, variance, samples, impulse_response(coefficients, 5000).size)


def series(rows: NDArray[Any], places: NDArray[Any], group: int = 0, grid: int = 0, pool: int = 0) -> OutputSeries:
    return OutputSeries("experiment", f"y{group}", group, rows, places, 1.0, True, grid, pool)


def made(
    jacobian: NDArray[Any], noise: Floats, prior: Floats | None = None, given: bool = False, outputs: int = 1
) -> Rows:
    """Return the rows of a linear problem that has been fitted to noise."""
    whitening = np.zeros((0, jacobian.shape[1])) if prior is None else prior
    stacked = np.vstack([jacobian, whitening])
    root = np.linalg.inv(np.linalg.qr(stacked)[1])
    columns, own = jacobian @ root, whitening @ root
    basis = columns if prior is None else np.linalg.qr(jacobian)[0]
    residual = noise - basis @ (basis.T @ noise)
    white = np.zeros(outputs, dtype=np.bool_)
    return Rows(residual, basis, columns, root, own.T @ own, np.full(outputs, given), white)


def dense(first: Autoregression, second: Autoregression, common: float, count: int) -> Floats:
    """Return the covariance (count, count) of two processes whose innovations have the covariance `common`."""
    past = 3000
    h, g = (lfilter([1.0], [1.0, *-m.coefficients], np.r_[1.0, np.zeros(count + past - 1)]) for m in (first, second))
    rows, others = (linalg.toeplitz(x, np.zeros(count + past))[past:] for x in (h, g))
    return np.asarray(common * rows @ others.T)


def regressors(count: int) -> Floats:
    t = np.linspace(0.0, 5.0, count)
    return np.column_stack([np.exp(-t), t * np.exp(-t), np.ones(count)])


# --- autoregressive models


LATE = np.concatenate([np.zeros(69), [0.7]])  # of a higher order than a block is long


@pytest.mark.parametrize("coefficients", [NOTHING, SLOW, OSCILLATING, np.array([0.3, 0.0, -0.4, 0.1]), LATE])
def test_impulse_responses_are_those_of_a_recursion(coefficients: Floats) -> None:
    found = impulse_response(coefficients, 5000)
    expected = lfilter([1.0], [1.0, *-coefficients], np.r_[1.0, np.zeros(4999)])
    np.testing.assert_allclose(found, expected[: found.size], atol=1e-10)
    assert np.abs(expected[found.size :]).max() < 2e-4 * np.abs(expected).max()


def test_spectra_and_gains_are_those_of_the_response() -> None:
    noise = model(OSCILLATING)
    response = impulse_response(OSCILLATING, 5000)
    np.testing.assert_allclose(np.fft.irfft(noise.transfer(4096), 4096)[: response.size], response, atol=1e-9)
    # the variance of an AR(2) process in closed form
    a, b = OSCILLATING
    assert noise.gain == pytest.approx((1.0 - b) / ((1.0 + b) * ((1.0 - b) ** 2 - a**2)), rel=1e-6)


def test_burg_finds_the_model_of_a_long_record_with_gaps() -> None:
    rng = np.random.default_rng(3)
    noise = lfilter([0.5], [1.0, *-OSCILLATING], rng.standard_normal(20_500))[500:]
    there = rng.random(noise.size) < 0.7
    found = autoregression.fit((noise * there)[None], there, np.ones(1), 40)
    np.testing.assert_allclose(found.coefficients, OSCILLATING, atol=0.02)
    assert found.variance == pytest.approx(0.25, rel=0.1)
    assert found.samples == there.sum()


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_what_columns_add_to_the_moments_others_take_away(share: float) -> None:
    rng = np.random.default_rng(14)
    columns, there = lfilter([1.0], [1.0, *-OSCILLATING], rng.standard_normal((3, 300))), rng.random(300) < share
    columns[2] = columns[1]
    before = columns.copy()
    found = autoregression.fit(columns * there, there, np.array([1.0, 0.5, -0.5]), 10)
    alone = autoregression.fit(columns[:1] * there, there, np.ones(1), 10)
    np.testing.assert_allclose(found.coefficients, alone.coefficients, rtol=1e-9)
    assert found.variance == pytest.approx(alone.variance, rel=1e-9)
    np.testing.assert_array_equal(columns, before)


def test_the_coefficient_of_a_short_record_is_right_on_average() -> None:
    """Burg's own is too small by 2 φ/n (Kendall), 0.03 here: 8 standard errors of the mean."""
    rng, count = np.random.default_rng(5), 50
    found = [
        autoregression.fit(ar1(rng, 0.8, count)[None], np.ones(count, dtype=np.bool_), np.ones(1), 1).coefficients[0]
        for _ in range(600)
    ]
    assert np.mean(found) == pytest.approx(0.8, abs=0.015)


def test_order_one_is_the_least() -> None:
    white = np.random.default_rng(2).standard_normal((1, 300))
    found = autoregression.fit(white, np.ones(300, dtype=np.bool_), np.ones(1), 24)
    assert found.coefficients.size == 1
    assert abs(found.coefficients[0]) < 0.15


def test_few_samples_are_taken_for_white() -> None:
    assert most_orders(24, 24) == 0
    assert most_orders(25, 25) == 6
    assert most_orders(1000, 1000) == 30


def test_models_of_next_to_nothing_are_white() -> None:
    found = autoregression.fit(np.array([[1.0, -1.0, 2.0]]), np.ones(3, dtype=np.bool_), np.ones(1), 0)
    assert (found.coefficients.size, found.variance) == (0, 2.0)


@pytest.mark.parametrize("coefficients", [SLOW, OSCILLATING])
def test_scatter_of_coefficients_is_the_asymptotic_one(coefficients: Floats) -> None:
    """(1 − φ²)/n for order 1; for order 2 (1 − φ_2²)/n of both, and −φ_1 (1 + φ_2)/n between them (Box and Jenkins)."""
    found = model(coefficients).scatter()
    if coefficients.size == 1:
        expected = np.array([[1.0 - coefficients[0] ** 2]])
    else:
        a, b = coefficients
        expected = np.array([[1.0 - b**2, -a * (1.0 + b)], [-a * (1.0 + b), 1.0 - b**2]])
    np.testing.assert_allclose(found[1:, 1:], expected, rtol=1e-6)
    assert found[0, 0] == 2.0


# --- the sandwich, with models given


def crossed(share: float) -> tuple[SampleGrid, list[Autoregression], Floats]:
    """Return two outputs with gaps, their models, and the dense covariance of all their rows."""
    count, rng = 60, np.random.default_rng(2)
    there = rng.random((2, count)) < 0.7
    there[:, [0, -1]] = True
    places = [np.flatnonzero(each) for each in there]
    first = np.arange(places[0].size)
    both = [series(first, places[0]), series(first.size + np.arange(places[1].size), places[1], 1)]
    jacobian = np.vstack([regressors(count)[places[0]], regressors(count)[places[1]] * [1.0, -2.0, 0.5]])
    models = [model(SLOW, 1.0), model(OSCILLATING, 0.25)]
    rows = made(jacobian, rng.standard_normal(len(jacobian)), outputs=2)
    grid = SampleGrid(rows, both, [0, 1])
    grid.take(models, rows.columns, np.array([[1.0, share], [share, 0.25]]))
    blocks = [
        [dense(models[i], models[j], grid.innovations[i, j], count)[np.ix_(places[i], places[j])] for j in (0, 1)]
        for i in (0, 1)
    ]
    return grid, models, np.block(blocks)


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_gram_matrix_is_that_of_the_dense_covariance(share: float) -> None:
    grid, models, covariance = crossed(share)
    columns = grid.rows.columns
    expected = columns.T @ covariance @ columns
    np.testing.assert_allclose(grid.take(models, grid.rows.columns, grid.innovations), expected, rtol=2e-3)
    noise = ResidualNoise(tuple(map(NoiseModel, grid.series, models)), (grid.innovations,))
    np.testing.assert_allclose(noise.gram(columns), expected, rtol=2e-3)


def test_what_the_fit_removes_is_that_of_projections() -> None:
    grid, models, covariance = crossed(0.4)
    grid.add_removed(grid.take(models, grid.rows.columns, grid.innovations))
    columns = grid.rows.columns
    left = np.eye(len(columns)) - columns @ columns.T
    expected = covariance - left @ covariance @ left
    for own, one in zip(grid.columns, grid.series, strict=True):
        plus, minus = own[1:4, one.places], own[4:7, one.places]
        found = 0.5 * (plus.T @ plus - minus.T @ minus)
        np.testing.assert_allclose(found, expected[np.ix_(one.rows, one.rows)], atol=5e-3)


@pytest.mark.parametrize("given", [False, True])
def test_slopes_of_variances_are_those_of_differences(given: bool) -> None:
    rows = made(regressors(80), np.random.default_rng(4).standard_normal(80), given=given)
    grid = SampleGrid(rows, [series(np.arange(80), np.arange(80))], [0])

    def variances(coefficients: Floats, variance: float) -> Floats:
        own = model(coefficients, variance)
        gram = grid.take([own if not given else model(coefficients, 1.0 / own.gain)], rows.columns)
        return np.diag(rows.root @ gram @ rows.root.T)

    at, h = OSCILLATING, 1e-4
    expected = [(variances(at, math.exp(h)) - variances(at, math.exp(-h))) / (2.0 * h)]
    for j in range(2):
        step = h * np.eye(2)[j]
        expected.append((variances(at + step, 1.0) - variances(at - step, 1.0)) / (2.0 * h))
    variances(at, 1.0)
    np.testing.assert_allclose(grid.slopes()[0], np.transpose(expected), rtol=1e-2, atol=1e-4)


def test_a_prior_adds_its_own_error() -> None:
    """V = H⁻¹ JᵀΓJ H⁻¹ + H⁻¹ P H⁻¹, from the definition, with the models found."""
    jacobian = regressors(200)
    prior = np.diag([3.0, 0.0, 5.0])
    noise = ar1(np.random.default_rng(6), 0.8, 200)
    found = sandwich(made(jacobian, noise, prior), [series(np.arange(200), np.arange(200))])
    own = found.noise.models[0].process
    inverse = np.linalg.inv(jacobian.T @ jacobian + prior.T @ prior)
    inner = jacobian.T @ dense(own, own, own.variance, 200) @ jacobian + prior.T @ prior
    np.testing.assert_allclose(found.covariance, inverse @ inner @ inverse, rtol=2e-3)


# --- the whole, against draws


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.8])
def test_variances_and_degrees_of_freedom_are_those_of_draws(share: float) -> None:
    """Of the mean of 150 samples: its variance in closed form, and the scatter of what is stated of it."""
    rng, count = np.random.default_rng(7), 150
    lags = np.arange(1, count)
    true = (1.0 + 2.0 * float((1.0 - lags / count) @ share**lags)) / count
    one = [series(np.arange(count), np.arange(count))]
    found = [sandwich(made(np.ones((count, 1)), ar1(rng, share, count)), one) for _ in range(150)]
    stated = np.array([each.covariance[0, 0] for each in found])
    assert np.median(stated) == pytest.approx(true, rel=0.15)
    freedom = float(np.median([each.freedom[0] for each in found]))
    assert 2.0 / np.var(np.log(stated)) == pytest.approx(freedom, rel=0.5)


def test_what_the_fit_takes_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a parabola fitted to 60 samples: without it the variances are too small by a third."""
    rng, count = np.random.default_rng(8), 60
    jacobian = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), 2)
    influence, own = np.linalg.pinv(jacobian), model(SLOW, 0.36)
    true = np.diag(influence @ dense(own, own, 0.36, count) @ influence.T)
    one = [series(np.arange(count), np.arange(count))]
    draws = [made(jacobian, ar1(rng, 0.8, count)) for _ in range(80)]

    def ratio() -> Floats:
        stated = np.median([np.diag(sandwich(rows, one).covariance) for rows in draws], axis=0)
        return np.asarray(stated / true)

    whole = ratio()
    monkeypatch.setattr("fmuid.estimation.noise.sandwich.SETTINGS", SandwichSettings(rounds=0))
    assert (whole > 0.6).all()
    assert (whole > 1.2 * ratio()).all()


def test_outputs_that_err_together_add_up() -> None:
    """Two sensors with the same white error: their mean is no better than one of them."""
    rng, count = np.random.default_rng(9), 400
    error = rng.standard_normal(count)
    noise = np.concatenate([error, error + 0.1 * rng.standard_normal(count)])
    first = np.arange(count)
    both = [series(first, first), series(count + first, first, 1, 0, 1)]
    found = sandwich(made(np.ones((2 * count, 1)), noise, outputs=2), both)
    assert found.covariance[0, 0] == pytest.approx(1.0 / count, rel=0.25)
    apart = sandwich(made(np.ones((2 * count, 1)), noise, outputs=2), [both[0], series(count + first, first, 1, 1, 1)])
    assert apart.covariance[0, 0] == pytest.approx(0.5 / count, rel=0.25)


def test_a_given_variance_holds() -> None:
    """Of noise half as large as said, what is said counts."""
    noise = 0.5 * np.random.default_rng(10).standard_normal(2000)
    found = sandwich(made(np.ones((2000, 1)), noise, given=True), [series(np.arange(2000), np.arange(2000))])
    assert found.covariance[0, 0] == pytest.approx(1.0 / 2000.0, rel=0.15)


def test_a_residual_of_rounding_is_taken_for_white() -> None:
    rows = made(np.ones((50, 1)), 1e-9 * np.arange(50.0))
    rows.white[:] = True
    found = sandwich(rows, [series(np.arange(50), np.arange(50))])
    assert found.covariance[0, 0] == pytest.approx(0.02)
    assert math.isinf(found.freedom[0])


def test_short_experiments_share_a_model() -> None:
    """Thirty experiments of 20 samples with one offset: alone none of them knows of its colour."""
    rng, count, tests = np.random.default_rng(11), 20, 30
    noise = np.concatenate([ar1(rng, 0.8, count) for _ in range(tests)])
    parts = [series(count * i + np.arange(count), np.arange(count), 0, i, 0) for i in range(tests)]
    found = sandwich(made(np.ones((count * tests, 1)), noise), parts)
    lags = np.arange(1, count)
    true = (1.0 + 2.0 * float((1.0 - lags / count) @ 0.8**lags)) / count / tests
    assert found.covariance[0, 0] == pytest.approx(true, rel=0.3)
    assert {each.process.samples for each in found.noise.models} == {count * tests}


def test_what_a_fit_hardly_takes_is_not_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 3000 samples of white noise three parameters take a thousandth: with the correction variances are the same."""
    rows = made(regressors(3000), np.random.default_rng(12).standard_normal(3000))
    own = [series(np.arange(3000), np.arange(3000))]
    calls: list[Floats] = []
    monkeypatch.setattr(SampleGrid, "add_removed", lambda _, gram: calls.append(gram))
    without = sandwich(rows, own).covariance
    assert not calls
    monkeypatch.undo()
    monkeypatch.setattr("fmuid.estimation.noise.sandwich.SETTINGS", SandwichSettings(slight=0.0))
    np.testing.assert_allclose(np.diag(without), np.diag(sandwich(rows, own).covariance), rtol=5e-3)


# --- series


def test_noise_that_is_nearly_a_random_walk_leaves_no_nonsense() -> None:
    """In this draw what the correction added grew without end, and then past zero: the std said was 1e-151."""
    t = np.tile(0.032 * np.arange(125), 8)
    rows = made(np.column_stack([np.exp(-t), -3.0 * t * np.exp(-t)]), ar1(np.random.default_rng([7, 145]), 0.99, 1000))
    found = sandwich(rows, [series(np.arange(1000), np.arange(1000))])
    powers = linalg.toeplitz(0.99 ** np.arange(1000))
    true = np.diag(rows.root @ (rows.columns.T @ powers @ rows.columns) @ rows.root.T)
    ratio = np.sqrt(np.diag(found.covariance) / true)
    assert (ratio > 0.3).all()
    assert (ratio < 5.0).all()  # that of one to two degrees of freedom


def table(times: NDArray[Any], counted: NDArray[np.bool_], name: str = "a") -> Experiment:
    outputs = tuple(f"y{i}" for i in range(counted.shape[1]))
    return Experiment.of_arrays(name, times, outputs, np.zeros(counted.shape), counted)


def test_rows_are_found_on_the_grid_of_each_output() -> None:
    counted = np.ones((21, 2), dtype=np.bool_)
    counted[:, 1] = np.arange(21) % 5 == 2
    counted[7:10, 0] = False
    fast, slow = output_series([table(0.1 * np.arange(21), counted)], ("y0", "y1"))
    assert fast.rows.tolist() + slow.rows.tolist() != sorted(fast.rows.tolist() + slow.rows.tolist())
    flat = np.flatnonzero(counted)
    assert (flat[fast.rows] // 2).tolist() == fast.places.tolist()
    assert (flat[slow.rows] // 2).tolist() == [2, 7, 12, 17]
    assert slow.places.tolist() == [0, 1, 2, 3]
    assert (fast.step, slow.step) == pytest.approx((0.1, 0.5))
    assert fast.grid != slow.grid


def test_outputs_with_gaps_at_random_share_the_grid() -> None:
    counted = np.random.default_rng(0).random((60, 2)) < 0.5
    first, second = output_series([table(np.arange(60.0), counted)], ("y0", "y1"))
    assert first.grid == second.grid
    assert first.places.tolist() == np.flatnonzero(counted[:, 0]).tolist()


def test_samples_off_any_grid_are_counted_and_said() -> None:
    times = np.cumsum(np.random.default_rng(0).exponential(1.0, 50))
    (found,) = output_series([table(times, np.ones((50, 1), dtype=np.bool_))], ("y0",))
    assert not found.regular
    assert found.places.tolist() == list(range(50))


def test_a_time_given_twice_is_one_place_of_the_table() -> None:
    places, step, regular = table_grid(np.array([0.0, 1.0, 1.0, 2.0, 5.0]))
    assert (places.tolist(), step, regular) == ([0, 1, 1, 2, 5], 1.0, True)
    (found,) = output_series([table(np.array([0.0, 1.0, 1.0, 2.0]), np.ones((4, 1), dtype=np.bool_))], ("y0",))
    assert found.places.tolist() == [0, 1, 2, 3]


def test_models_are_shared_by_short_experiments_of_one_step() -> None:
    short, long = np.ones((20, 1), dtype=np.bool_), np.ones((200, 1), dtype=np.bool_)
    experiments = [
        table(0.1 * np.arange(20), short, "a"),
        table(0.1 * np.arange(20), short, "b"),
        table(0.2 * np.arange(20), short, "c"),
        table(0.1 * np.arange(200), long, "d"),
        table(0.1 * np.arange(200), long, "e"),
    ]
    pools = [each.pool for each in output_series(experiments, ("y0",))]
    assert pools[0] == pools[1]
    assert len(set(pools)) == 4
