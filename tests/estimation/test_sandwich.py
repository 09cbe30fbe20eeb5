"""Covariance under colored noise, against dense matrices, closed forms, finite differences and seeded draws."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg
from scipy.signal import lfilter

from experiments.coverage.colored_noise import LEVEL, count
from fmuid import Experiment
from fmuid.array_types import Floats
from fmuid.estimation import Autoregression, NoiseModel, OutputSeries, ResidualNoise, Rows, output_series, sandwich
from fmuid.estimation.noise.autoregression import impulse_response
from fmuid.estimation.noise.output_series import table_grid
from fmuid.estimation.noise.sample_grid import SampleGrid
from fmuid.estimation.noise.sandwich import SandwichSettings
from tests.support.problems import ar1

SLOW, OSCILLATING = np.array([0.8]), np.array([1.6, -0.9])
SETTINGS = "fmuid.estimation.noise.sandwich.SETTINGS"


def model(coefficients: Floats, variance: float = 1.0) -> Autoregression:
    return Autoregression(coefficients, variance, 100, impulse_response(coefficients, 5000).size)


def series(rows: Any, places: Any = None, group: int = 0, grid: int = 0, pool: int = 0) -> OutputSeries:
    """Return a series of these rows, or of so many."""
    rows = np.arange(rows) if isinstance(rows, int) else rows
    return OutputSeries(
        "experiment", f"y{group}", group, rows, rows if places is None else places, 1.0, True, grid, pool
    )


def made(
    jacobian: NDArray[Any], noise: Floats, prior: Floats | None = None, given: bool = False, outputs: int = 1
) -> Rows:
    """Return the rows of a linear problem that has been fitted to noise."""
    whitening = np.zeros((0, jacobian.shape[1])) if prior is None else prior
    root = np.linalg.inv(np.linalg.qr(np.vstack([jacobian, whitening]))[1])
    columns, own = jacobian @ root, whitening @ root
    basis = columns if prior is None else np.linalg.qr(jacobian)[0]
    white = np.zeros(outputs, dtype=np.bool_)
    return Rows(noise - basis @ (basis.T @ noise), basis, columns, root, own.T @ own, np.full(outputs, given), white)


def mean(noise: Floats, given: bool = False, outputs: int = 1) -> Rows:
    """Return the rows of a mean fitted to noise."""
    return made(np.ones((noise.size, 1)), noise, given=given, outputs=outputs)


def dense(first: Autoregression, second: Autoregression, common: float, count: int) -> Floats:
    """Return the covariance (count, count) of two processes whose innovations have the covariance `common`."""
    past = 500
    h, g = (lfilter([1.0], [1.0, *-m.coefficients], np.r_[1.0, np.zeros(count + past - 1)]) for m in (first, second))
    rows, others = (linalg.toeplitz(x, np.zeros(count + past))[past:] for x in (h, g))
    return np.asarray(common * rows @ others.T)


def regressors(count: int) -> Floats:
    t = np.linspace(0.0, 5.0, count)
    return np.column_stack([np.exp(-t), t * np.exp(-t), np.ones(count)])


def variance_of_mean(share: float, count: int) -> float:
    """Return the variance of the mean of AR(1) noise of variance 1."""
    lags = np.arange(1, count)
    return (1.0 + 2.0 * float((1.0 - lags / count) @ share**lags)) / count


# --- models given


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
def test_gram_is_that_of_the_dense_covariance(share: float) -> None:
    grid, models, covariance = crossed(share)
    columns = grid.rows.columns
    expected = columns.T @ covariance @ columns
    np.testing.assert_allclose(grid.take(models, columns, grid.innovations), expected, rtol=2e-3)
    noise = ResidualNoise(tuple(map(NoiseModel, grid.series, models)), (grid.innovations,))
    np.testing.assert_allclose(noise.gram(columns), expected, rtol=2e-3)


def test_removed_part_is_that_of_projections() -> None:
    grid, models, covariance = crossed(0.4)
    columns = grid.rows.columns
    grid.add_removed(grid.take(models, columns, grid.innovations))
    left = np.eye(len(columns)) - columns @ columns.T
    expected = covariance - left @ covariance @ left
    for own, one in zip(grid.columns, grid.series, strict=True):
        plus, minus = own[1:4, one.places], own[4:7, one.places]
        found = 0.5 * (plus.T @ plus - minus.T @ minus)
        np.testing.assert_allclose(found, expected[np.ix_(one.rows, one.rows)], atol=5e-3)


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("slow", [(), (0.97, 0.9)])
def test_slopes_of_variances_are_those_of_differences(slow: tuple[float, ...], given: bool) -> None:
    rows = made(regressors(80)[:, [0, 2]], np.random.default_rng(4).standard_normal(80), given=given)
    grid = SampleGrid(rows, [series(80)], [0])

    def variances(values: Floats) -> Floats:
        own = Autoregression(values[1:3], math.exp(values[0]), 100, 800, *values[3:])
        own = Autoregression(values[1:3], 1.0 / own.gain, 100, 800, *values[3:]) if given else own
        return np.diag(rows.root @ grid.take([own], rows.columns) @ rows.root.T)

    at, h = np.array([0.0, 0.6, -0.4, *slow]), 1e-5
    expected = [(variances(at + h * row) - variances(at - h * row)) / (2.0 * h) for row in np.eye(at.size)]
    variances(at)
    np.testing.assert_allclose(grid.slopes()[0], np.transpose(expected), rtol=1e-3, atol=1e-5)


def test_prior_adds_its_own_error() -> None:
    """V = H⁻¹ JᵀΓJ H⁻¹ + H⁻¹ P H⁻¹, from the definition, with the models found."""
    jacobian, prior = regressors(200), np.diag([3.0, 0.0, 5.0])
    found = sandwich(made(jacobian, ar1(np.random.default_rng(6), 0.8, 200), prior), [series(200)])
    own = found.noise.models[0].process
    inverse = np.linalg.inv(jacobian.T @ jacobian + prior.T @ prior)
    inner = jacobian.T @ dense(own, own, own.variance, 200) @ jacobian + prior.T @ prior
    np.testing.assert_allclose(found.covariance, inverse @ inner @ inverse, rtol=2e-3)


# --- the whole, against draws


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.8])
def test_variances_and_degrees_of_freedom_are_those_of_draws(share: float) -> None:
    """Of the mean of 150 samples: its variance in closed form, and the scatter of the stated one."""
    rng = np.random.default_rng(7)
    found = [sandwich(mean(ar1(rng, share, 150)), [series(150)]) for _ in range(150)]
    stated = np.array([each.covariance[0, 0] for each in found])
    assert np.median(stated) == pytest.approx(variance_of_mean(share, 150), rel=0.15)
    freedom = float(np.median([each.freedom[0] for each in found]))
    assert 2.0 / np.var(np.log(stated)) == pytest.approx(freedom, rel=0.5)


def test_correction_gives_back_what_the_fit_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a parabola fitted to 60 samples: without it the variances are too small by a third."""
    rng, count = np.random.default_rng(8), 60
    jacobian = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), 2)
    influence, own = np.linalg.pinv(jacobian), model(SLOW, 0.36)
    true = np.diag(influence @ dense(own, own, 0.36, count) @ influence.T)
    draws = [made(jacobian, ar1(rng, 0.8, count)) for _ in range(25)]

    def ratio() -> Floats:
        return np.asarray(np.median([np.diag(sandwich(each, [series(count)]).covariance) for each in draws], 0) / true)

    whole = ratio()
    monkeypatch.setattr(SETTINGS, SandwichSettings(rounds=0))
    assert (whole > 0.6).all()
    assert (whole > 1.2 * ratio()).all()


def test_outputs_that_err_together_add_up() -> None:
    """Two sensors with the same white error: their mean is no better than one of them."""
    rng, count = np.random.default_rng(9), 400
    error, first = rng.standard_normal(count), np.arange(count)
    rows = mean(np.concatenate([error, error + 0.1 * rng.standard_normal(count)]), outputs=2)
    for grid, expected in ((0, 1.0), (1, 0.5)):
        both = [series(count), series(count + first, first, 1, grid, 1)]
        assert sandwich(rows, both).covariance[0, 0] == pytest.approx(expected / count, rel=0.25)


def test_innovations_of_outputs_with_gaps_have_a_covariance() -> None:
    """Correlations over different samples may contradict each other."""
    rng, count = np.random.default_rng(3), 40
    there = rng.random((3, count)) < 0.6
    places = [np.flatnonzero(each) for each in there]
    firsts = np.cumsum([0, *(each.size for each in places)])
    outputs = [series(firsts[k] + np.arange(own.size), own, k) for k, own in enumerate(places)]
    error = rng.standard_normal(count)
    noise = np.concatenate([error[own] + 0.1 * rng.standard_normal(own.size) for own in places])
    rows = mean(noise, outputs=3)
    grid = SampleGrid(rows, outputs, [0, 1, 2])
    grid.take([model(np.zeros(0), variance) for variance in (1.0, 4.0, 9.0)], rows.columns)
    assert np.linalg.eigvalsh(grid.innovations)[0] > 0.0
    np.testing.assert_allclose(np.diag(grid.innovations), [1.0, 4.0, 9.0], rtol=1e-6)
    assert grid.innovations[0, 1] == pytest.approx(2.0, rel=0.3)


def test_given_variance_holds_and_rounding_is_white() -> None:
    given = mean(0.5 * np.random.default_rng(10).standard_normal(2000), given=True)
    assert sandwich(given, [series(2000)]).covariance[0, 0] == pytest.approx(1.0 / 2000.0, rel=0.15)
    rounding = mean(1e-9 * np.arange(50.0))
    rounding.white[:] = True
    found = sandwich(rounding, [series(50)])
    assert found.covariance[0, 0] == pytest.approx(0.02)
    assert math.isinf(found.freedom[0])


def test_short_experiments_share_a_model() -> None:
    """Thirty experiments of 20 samples with one offset: none alone shows its color."""
    rng, count, tests = np.random.default_rng(11), 20, 30
    noise = np.concatenate([ar1(rng, 0.8, count) for _ in range(tests)])
    parts = [series(count * i + np.arange(count), np.arange(count), 0, i, 0) for i in range(tests)]
    found = sandwich(mean(noise), parts)
    assert found.covariance[0, 0] == pytest.approx(variance_of_mean(0.8, count) / tests, rel=0.3)
    assert {each.process.samples for each in found.noise.models} == {count * tests}


def test_correction_of_nearly_a_random_walk_stays_bounded() -> None:
    """In this draw what the correction added grew without end, and then past zero: the std said was 1e-151."""
    t = np.tile(0.032 * np.arange(125), 8)
    rows = made(np.column_stack([np.exp(-t), -3.0 * t * np.exp(-t)]), ar1(np.random.default_rng([7, 145]), 0.99, 1000))
    powers = linalg.toeplitz(0.99 ** np.arange(1000))
    true = np.diag(rows.root @ (rows.columns.T @ powers @ rows.columns) @ rows.root.T)
    ratio = np.sqrt(np.diag(sandwich(rows, [series(1000)]).covariance) / true)
    assert (ratio > 0.3).all()
    assert (ratio < 5.0).all()  # that of one to two degrees of freedom


# --- series


def table(times: NDArray[Any], counted: NDArray[np.bool_] | None = None, name: str = "a") -> Experiment:
    counted = np.ones((times.size, 1), dtype=np.bool_) if counted is None else counted
    outputs = tuple(f"y{i}" for i in range(counted.shape[1]))
    return Experiment.of_arrays(name, times, outputs, np.zeros(counted.shape), counted)


def test_rows_are_found_on_the_grid_of_each_output() -> None:
    counted = np.ones((21, 2), dtype=np.bool_)
    counted[:, 1] = np.arange(21) % 5 == 2
    counted[7:10, 0] = False
    fast, slow = output_series([table(0.1 * np.arange(21), counted)], ("y0", "y1"))
    flat = np.flatnonzero(counted)
    assert (flat[fast.rows] // 2).tolist() == fast.places.tolist()
    assert (flat[slow.rows] // 2).tolist() == [2, 7, 12, 17]
    assert slow.places.tolist() == [0, 1, 2, 3]
    assert (fast.step, slow.step) == pytest.approx((0.1, 0.5))
    assert fast.grid != slow.grid
    counted = np.random.default_rng(0).random((60, 2)) < 0.5  # gaps at random share the grid
    first, second = output_series([table(np.arange(60.0), counted)], ("y0", "y1"))
    assert first.grid == second.grid
    assert first.places.tolist() == np.flatnonzero(counted[:, 0]).tolist()


def test_samples_off_any_grid_are_counted() -> None:
    (found,) = output_series([table(np.cumsum(np.random.default_rng(0).exponential(1.0, 50)))], ("y0",))
    assert not found.regular
    assert found.places.tolist() == list(range(50))
    places, step, regular = table_grid(np.array([0.0, 1.0, 1.0, 2.0, 5.0]))  # a time given twice is one place
    assert (places.tolist(), step, regular) == ([0, 1, 1, 2, 5], 1.0, True)
    (found,) = output_series([table(np.array([0.0, 1.0, 1.0, 2.0]))], ("y0",))
    assert found.places.tolist() == [0, 1, 2, 3]


def test_models_are_shared_by_short_experiments_of_one_step() -> None:
    kinds = (("a", 0.1, 20), ("b", 0.1, 20), ("c", 0.2, 20), ("d", 0.1, 200), ("e", 0.1, 200))
    experiments = [table(step * np.arange(count), name=name) for name, step, count in kinds]
    pools = [each.pool for each in output_series(experiments, ("y0",))]
    assert pools[0] == pools[1]
    assert len(set(pools)) == 4


CHECKED = {
    "AR(1) 0.8": 200,
    "AR(1) 0.5, a third missing": 200,
    "AR(1) 0.5": 40,
    "truth on a bound": 200,
    "white and slow": 1500,
    "white": 200,
}
MANY = [pytest.param(case, 200, marks=pytest.mark.campaign) for case in CHECKED]
FEW = [pytest.param(case, 50, marks=pytest.mark.slow) for case in ("AR(1) 0.5", "white")]


@pytest.mark.parametrize(("case", "draws"), FEW + MANY)
def test_intervals_and_tests_hold_under_colored_noise(case: str, draws: int) -> None:
    """By four standard errors of the draws."""
    found = count(case, CHECKED[case], draws, 25)
    assert found.local / draws > LEVEL - 4.0 * math.sqrt(LEVEL * (1.0 - LEVEL) / draws)
    assert found.plain / draws < 0.85 or case == "white"
    assert np.median(found.wider) < 1.05 or case != "white"
    assert min(found.profile, found.posterior) / found.more > 0.7
    assert max(found.ratio, found.wald) / draws < 0.06


def test_estimated_weights_of_two_outputs_are_in_the_variance() -> None:
    """Eight readings each of one value by two instruments of unknown noise, 1 and 2 (Graybill and Deal, 1959).

    Without the term of Kenward and Roger the mean variance is 0.83 of that of the estimates.
    """
    rng, count, variances = np.random.default_rng(5), 8, []
    each = [OutputSeries("e", f"y{k}", k, count * k + np.arange(count), np.arange(count), 1.0, True, k, k, False)
            for k in range(2)]  # fmt: skip
    readings, noise = rng.standard_normal((2000, 2, count)) * [[1.0], [2.0]], np.full((2000, 2), [1.0, 4.0])
    for _ in range(40):
        weights = 1.0 / noise / np.sum(1.0 / noise, axis=1, keepdims=True)
        means = np.sum(weights * readings.mean(axis=2), axis=1)
        left = readings - means[:, None, None]
        noise = np.sum(left**2, axis=2) / (count - weights)
    for residual, levels in zip(left, np.repeat(np.sqrt(noise), count, axis=1), strict=True):
        found = sandwich(made(1.0 / levels[:, None], residual.ravel() / levels, outputs=2), each)
        variances.append(found.covariance[0, 0])
    assert np.mean(variances) == pytest.approx(np.var(means), rel=0.06)
