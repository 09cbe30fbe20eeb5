"""Errors that return with each cycle of an excitation: periods of inputs, likelihoods and Gram matrices, coverage."""

import re
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from experiments.coverage.periodic_error import (
    CASES,
    COUNT,
    CYCLES,
    JACOBIAN,
    PARAMETERS,
    PERIOD,
    STEP,
    covered,
    fitted,
    recorded,
    square,
    without_error,
)
from fmuid import InputError, Noise, analyze_residuals
from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, OutputSeries, sandwich_of
from fmuid.estimation.noise.low_frequency import Bins, line_counts
from fmuid.estimation.noise.output_series import period_of
from fmuid.estimation.noise.periodic_error import MeanCycle, PeriodicError, _floor, _likelihoods, _products, _summed
from fmuid.identification import identify
from tests.support.problems import ar1


def test_period_of_inputs() -> None:
    wave = np.sin(2.0 * np.pi * np.arange(1000) / 250)
    for cycles in (8, 3.6, 1.95):
        assert period_of(recorded(square(cycles))) == pytest.approx(PERIOD * STEP)
    measured = wave + 0.01 * np.random.default_rng(0).standard_normal(1000)
    assert period_of(recorded(measured)) == pytest.approx(250 * STEP, abs=3 * STEP)
    assert period_of(recorded(np.column_stack([square(), wave, np.ones(1000)]))) == pytest.approx(250 * STEP)
    n, noise = np.arange(1000), np.random.default_rng(0).standard_normal(1000)
    signals: list[Any] = [0.01 * n, noise, np.ones(1000), (n > 300).astype(float), square(1.7)]
    for inputs in signals:
        assert period_of(recorded(inputs)) == 0.0


def test_a_period_is_said_where_inputs_do_not_show_it() -> None:
    """A table without inputs; the same estimates as with the input that shows it."""
    rng = np.random.default_rng(3)
    noise = np.tile(ar1(rng, 0.8, PERIOD), CYCLES) + rng.standard_normal(COUNT)
    times = STEP * np.arange(COUNT)

    def widths(said: Noise | None) -> Floats:
        problem = LeastSquares.from_function(lambda p: JACOBIAN @ p, noise, PARAMETERS, times=times, noise=said)
        return identify(problem).std

    _, shown = fitted(noise)
    np.testing.assert_allclose(widths(Noise(excitation_period=PERIOD * STEP)), shown.std, rtol=1e-6)
    own = Noise(experiments={"experiment": Noise(excitation_period=PERIOD * STEP)})
    np.testing.assert_allclose(widths(own), shown.std, rtol=1e-6)
    assert (widths(None) < 0.5 * shown.std).all()


def test_excitation_period_is_refused() -> None:
    def build(period: float, times: Any) -> LeastSquares:
        noise = Noise(excitation_period=period)
        return LeastSquares.from_function(lambda p: JACOBIAN @ p, times, PARAMETERS, times=times, noise=noise)

    times = STEP * np.arange(COUNT)
    for period, said in ((100.3, "is 100.3 samples"), (20, "is 20 samples"), (600, "is 600 of 1000 samples")):
        with pytest.raises(InputError, match=rf"noise\.excitation_period.*{re.escape(said)}"):
            build(period * STEP, times)
    with pytest.raises(InputError, match="equally spaced"):
        build(4.0, np.sort(np.random.default_rng(0).uniform(0.0, 30.0, COUNT)))


@pytest.fixture(scope="module")
def powers() -> Floats:
    """A spectrum at the bins of harmonics, each of one harmonic here."""
    bins = Bins.of(PERIOD)
    assert bins.edges.size == PERIOD // 2 + 1
    return np.asarray(2.0 + 1.5 / (1.3 - bins.cosines))


def covariance(powers: Floats) -> Floats:
    """Return the covariance (T, T) of a periodic process of this spectrum."""
    return np.asarray(linalg.circulant(np.fft.irfft(powers, PERIOD)))


def test_likelihoods_are_those_of_the_dense_covariance(powers: Floats) -> None:
    """Of Aᵀz, A the directions that the basis leaves; spectra differ by what the Jacobian of A is, the same for all."""
    rng = np.random.default_rng(1)
    z, basis = rng.standard_normal(PERIOD), np.linalg.qr(rng.standard_normal((PERIOD, 3)))[0]
    parts = _products(np.column_stack([z, basis]))
    counts = 2.0 * Bins.of(PERIOD).counts
    spectra = np.array([powers, np.ones_like(powers)])
    found = _likelihoods(spectra, parts, counts)
    left = linalg.null_space(basis.T)

    def dense(own: Floats) -> Any:
        inner = left.T @ covariance(own) @ left
        return -0.5 * (np.linalg.slogdet(inner)[1] + left.T @ z @ np.linalg.solve(inner, left.T @ z))

    assert found[0] - found[1] == pytest.approx(dense(spectra[0]) - dense(spectra[1]), rel=1e-9)


def test_what_returns_adds_the_dense_covariance(powers: Floats) -> None:
    """An error g of covariance Γ in each cycle of two outputs, once g and once −g/2: of Cᵀ(g, −g/2, g, ...)."""
    columns = np.random.default_rng(2).standard_normal((2 * COUNT, 3))
    series = tuple(
        OutputSeries("experiment", f"y{k}", k, np.arange(k, 2 * COUNT, 2), np.arange(COUNT), STEP, True, 0, k)
        for k in (0, 1)
    )
    assert line_counts(PERIOD).sum() == PERIOD
    np.testing.assert_allclose(
        _summed(columns, series[0], PERIOD), columns[::2].reshape(CYCLES, PERIOD, 3).sum(0) / CYCLES**0.5
    )
    factors, points, weights = np.array([1.0, -0.5]), np.array([powers, 2.0 * powers]), np.array([0.5, 0.3])
    both = PeriodicError(series, factors, PERIOD, powers, points, weights, np.zeros(2))
    whole = np.kron(np.tile(covariance(powers / CYCLES), (CYCLES, CYCLES)), np.outer(factors, factors))
    np.testing.assert_allclose(both.gram(columns), columns.T @ whole @ columns, rtol=1e-9)
    assert both.probability == pytest.approx(0.8)
    own = np.diag(columns.T @ whole @ columns)
    logs = np.log1p(np.array([0.0, 1.0, 2.0])[:, None] * own / 5.0)
    weights = np.array([0.2, 0.5, 0.3])
    expected = weights @ logs**2 - (weights @ logs) ** 2
    np.testing.assert_allclose(both.scatter(columns, np.full(3, 5.0)), expected, rtol=1e-9)


def test_the_noise_of_a_sum_of_outputs_has_the_dense_spectrum() -> None:
    """Of two autoregressions of order 1 around a circle, w = (2, −1), whose innovations are correlated."""
    shares, weights, common = (0.8, 0.3), np.array([2.0, -1.0]), np.array([[1.0, 0.6], [0.6, 2.0]])
    series = OutputSeries("experiment", "y", 0, np.arange(COUNT), np.arange(COUNT), STEP, True, 0, 0)
    responses = [1.0 / (1.0 - share * np.exp(-2j * np.pi * np.arange(PERIOD) / PERIOD)) for share in shares]
    half = PERIOD // 2 + 1
    folded = [MeanCycle(series, np.zeros((PERIOD, 2)), own[:half], 1.0, 1.0) for own in responses]
    filters = [np.linalg.inv(np.eye(PERIOD) - share * np.roll(np.eye(PERIOD), 1, axis=0)) for share in shares]
    dense = sum(weights[i] * weights[j] * common[i, j] * filters[i] @ filters[j].T for i in range(2) for j in range(2))
    np.testing.assert_allclose(_floor(folded, weights, common), np.fft.rfft(np.asarray(dense)[:, 0]).real, rtol=1e-9)


@pytest.mark.parametrize(("signs", "least", "most"), [((1.0, 1.0), 1.2, 1.7), ((1.0, -1.0), 0.0, 0.4)])
def test_error_common_to_outputs_adds_up_or_cancels(signs: tuple[float, float], least: float, most: float) -> None:
    """Outputs of the same sensitivities: √2, or nothing; against errors of their own in each."""
    rng = np.random.default_rng(5)
    error, white = np.tile(ar1(rng, 0.8, PERIOD), CYCLES), rng.standard_normal((COUNT, 2))
    problem, result = fitted(2.0 * np.outer(error, signs) + white)
    assert result.fit.noise is not None
    assert result.fit.linearization is not None
    rest, found = sorted(result.fit.noise.returning, key=lambda each: float(each.shares.sum()))
    assert found.probability > 0.99
    assert found.factors[1] / found.factors[0] == pytest.approx(signs[1] / signs[0], rel=0.1)
    np.testing.assert_allclose(found.shares, 0.8, atol=0.21)
    assert (rest.shares < 0.05).all()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fmuid.estimation.noise.periodic_error._together", lambda _folded, alone, _noise: alone)
        apart = sandwich_of(problem, result.fit.linearization, np.array([False, False]))
    wider = np.sqrt(np.diag(result.covariance) / np.diag(apart.covariance))
    assert (wider > least).all()
    assert (wider < most).all()
    assert {each.output for each in analyze_residuals(problem, result).returning} == {"y", "y1"}


def test_periodic_error_is_found_and_allowed_for() -> None:
    rng = np.random.default_rng(3)
    problem, result = fitted(np.tile(ar1(rng, 0.8, PERIOD), CYCLES) + rng.standard_normal(COUNT))
    assert result.fit.noise is not None
    assert result.fit.linearization is not None
    (found,) = result.fit.noise.returning
    assert found.probability > 0.99
    assert found.shares == pytest.approx([0.5], abs=0.2)
    root = result.fit.linearization.root
    gram = result.fit.noise.gram(result.fit.linearization.jacobian @ root)
    np.testing.assert_allclose(root @ gram @ root.T, result.covariance, rtol=1e-9)
    (said,) = analyze_residuals(problem, result).returning
    assert said.period == pytest.approx(PERIOD * STEP)


@pytest.mark.parametrize("kind", ["white", "walk"])
def test_where_nothing_returns_hardly_anything_changes(kind: str) -> None:
    """A random walk is slower than the cycle: folded to its mean cycle it would be lost."""
    rng = np.random.default_rng(4)
    problem, result = fitted(rng.standard_normal(COUNT) if kind == "white" else np.cumsum(rng.standard_normal(COUNT)))
    without = without_error(problem, result)
    wider = np.sqrt(np.diag(result.covariance) / np.diag(without.covariance))
    assert (wider >= 1.0).all()
    assert (wider < 1.02).all()
    assert (result.estimates.variance_dof <= without.freedom).all()
    assert analyze_residuals(problem, result).returning == ()


@pytest.mark.slow
@pytest.mark.parametrize("case", ["error 0.3 of white noise", "error 1, AR(1) 0.8 noise"])
def test_intervals_hold_under_a_periodic_error(case: str) -> None:
    """Of 40 draws: 85 % is three standard errors below 95 %."""
    inside, without, _ = covered(CASES[case], 40)
    assert inside > 0.85
    assert without < 0.87
