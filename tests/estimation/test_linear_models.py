"""Estimates of linear models: closed forms, filters against scipy's, biases against their own formulas."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy import signal, special

import fmuid
from fmuid.array_types import Floats
from fmuid.estimation import (
    Estimator,
    LinearEstimate,
    Term,
    equation_error,
    instrumental_variables,
    linear_least_squares,
)
from fmuid.estimation.equation_error import StateVariableFilter
from fmuid.estimation.linear import colored_covariance
from tests.support.quick import first

R, L = 4.0, 0.1
STEP, SAMPLES = 1e-3, 1200
TIMES = STEP * np.arange(SAMPLES)
BITS = np.random.default_rng(7).integers(0, 2, SAMPLES // 15) * 2.0 - 1.0
VOLTAGE = Term(np.repeat(BITS, 15), interpolation="zoh")


def current(theta: Floats, first: float = 0.0) -> Floats:
    """The closed form of R i + L di/dt = u at the samples, the voltage held."""
    decay = math.exp(-theta[0] / theta[1] * STEP)
    driven = signal.lfilter([0.0, (1.0 - decay) / theta[0]], [1.0, -decay], np.asarray(VOLTAGE.values))
    return np.asarray(driven + first * decay ** np.arange(SAMPLES))


def terms(i: Floats) -> dict[str, Term]:
    return {"R": Term(i), "L": Term(i, derivative=1)}


CLEAN = current(np.array([R, L]))
NOISE = math.sqrt(float(np.mean(CLEAN**2)) / 10.0)
NOISY = CLEAN + NOISE * np.random.default_rng(6).standard_normal(SAMPLES)


def model(theta: Floats) -> dict[str, Term]:
    return terms(current(theta))


# --- linear least squares


def test_straight_line_in_closed_form() -> None:
    x, y = np.arange(5.0), np.array([1.1, 2.9, 5.2, 6.8, 9.1])
    found = linear_least_squares(np.column_stack([x, np.ones(5)]), y, ["slope", "offset"])
    spread = x - x.mean()
    slope = (spread @ y) / (spread @ spread)
    left = y - y.mean() - slope * spread
    variance = (left @ left) / 3
    assert found.values == pytest.approx([slope, y.mean() - slope * x.mean()], rel=1e-12)
    assert found.variance == pytest.approx(variance, rel=1e-12)
    assert found.std[0] == pytest.approx(math.sqrt(variance / (spread @ spread)), rel=1e-12)
    assert found.degrees_of_freedom == 3
    assert found.residual == pytest.approx(left, abs=1e-12)
    t95 = 3.182446  # Student's t of 3 degrees of freedom, from tables
    assert found.intervals().loc["slope", "upper"] == pytest.approx(slope + t95 * found.std[0], rel=1e-6)
    assert found["slope"] == found.values[0]
    with pytest.raises(fmuid.InputError, match="'Q'"):
        found["Q"]


def test_missing_samples_do_not_count() -> None:
    rng = np.random.default_rng(0)
    rows, y = rng.standard_normal((50, 2)), rng.standard_normal(50)
    kept = np.ones(50, dtype=bool)
    kept[[3, 20]] = False
    less = linear_least_squares(rows[kept], y[kept])
    y[3], rows[20, 1] = np.nan, np.nan
    whole = linear_least_squares(rows, y)
    assert whole.values == pytest.approx(less.values, rel=1e-12)
    assert whole.covariance == pytest.approx(less.covariance, rel=1e-12)
    assert (np.isnan(whole.residual) == ~kept).all()
    assert whole.names == ("theta1", "theta2")


@pytest.mark.parametrize(
    ("rows", "measured", "names", "words"),
    [
        (np.ones((3, 2)), np.ones(4), [], "shapes"),
        (np.ones((3, 2)), np.ones(3), ["a"], "1 names.*2"),
        (np.array([[1.0], [np.inf]]), np.ones(2), [], "finite"),
        (np.eye(2), np.ones(2), [], "2 samples are too few for 2"),
        (np.column_stack([np.ones(4), np.zeros(4)]), np.ones(4), ["a", "b"], "'b' is zero"),
        (np.outer(np.arange(1.0, 5), [1, 2]), np.ones(4), ["a", "b"], "'a' and 'b' depend"),
    ],
)
def test_regression_is_refused(rows: Floats, measured: Floats, names: list[str], words: str) -> None:
    with pytest.raises(fmuid.InputError, match=words):
        linear_least_squares(rows, measured, names)


# --- filters


@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_filters_are_those_of_scipy(interpolation: str, derivative: int) -> None:
    values = np.random.default_rng(2).standard_normal(200)
    own = StateVariableFilter(TIMES[:200], 300.0, 2).columns([Term(values, derivative, interpolation)])[:, 0]
    numerator = [300.0**2] + derivative * [0.0]
    system = (numerator, np.poly([-300.0, -300.0]))
    _, reference, _ = signal.lsim(system, values, TIMES[:200], interp=interpolation == "linear")
    assert own == pytest.approx(reference, abs=1e-9 * np.abs(reference).max())


def test_irregular_times_follow_the_closed_form() -> None:
    """A ramp through 1/(s/λ + 1)², at times of any distances: t − 2/λ + (t + 2/λ) e^(−λt)."""
    times = np.concatenate([[0.0], np.cumsum(np.random.default_rng(3).uniform(0.2, 3.0, 100) * 1e-2)])
    found = StateVariableFilter(times, 5.0, 2).columns([Term(times), Term(times, 1)])
    fade = np.exp(-5.0 * times)
    assert found[:, 0] == pytest.approx(times - 0.4 + (times + 0.4) * fade, abs=1e-12)
    assert found[:, 1] == pytest.approx(1.0 - (1.0 + 5.0 * times) * fade, abs=1e-12)


# --- filtered equations


@pytest.mark.parametrize("first", [0.0, 0.7])
def test_the_coil_without_noise(first: float) -> None:
    """The filter is exact, the current nearly linear between samples, and what it was at the start does not count."""
    found = equation_error(TIMES, VOLTAGE, terms(current(np.array([R, L]), first)), cutoff=40.0)
    assert found.values == pytest.approx([R, L], rel=2e-4)
    assert found.estimator is Estimator.EQUATION_ERROR


def test_an_oscillator_from_anywhere_at_irregular_times_with_holes() -> None:
    """y″ + 2 ζω y′ + ω² y = 0, of which position and speed at the start are not known: no input at all."""
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.4, 1.6, 4000) * 1e-3)
    omega, zeta = 6.0, 0.1
    damped = omega * math.sqrt(1.0 - zeta**2)
    y = np.exp(-zeta * omega * times) * np.cos(damped * times + 0.3)
    y[rng.random(times.size) < 0.2] = np.nan
    found = equation_error(times, Term(-y, derivative=2), {"damping": Term(y, 1), "stiffness": Term(y)}, cutoff=6.0)
    assert found.values == pytest.approx([2.0 * zeta * omega, omega**2], rel=1e-3)


def limits(cutoff: float) -> tuple[Floats, Floats]:
    """Where filtered estimates end up, and how instruments scatter, by the filter's answers g to a sample's noise.

    plim θ̂ = (M + σ² Σ g gᵀ)⁻¹ M θ; the residual is the noise through θᵀg, as a Toeplitz matrix H, so that the
    covariance with instruments Z is σ² (ZᵀZ)⁻¹ ZᵀHHᵀZ (ZᵀZ)⁻¹.
    """
    pulse = np.zeros(SAMPLES)
    pulse[1] = 1.0
    svf = StateVariableFilter(TIMES, cutoff, 2)
    answers, clean = (svf.columns([*terms(signal_).values()]) for signal_ in (pulse, CLEAN))
    moments = clean.T @ clean
    found = np.linalg.solve(moments + SAMPLES * NOISE**2 * answers.T @ answers, moments @ [R, L])
    response = (answers @ [R, L])[1:]
    backward = np.column_stack([np.correlate(z, response, "full")[response.size - 1 :] for z in clean.T])
    inverse = np.linalg.inv(moments)
    return np.asarray(found, dtype=np.float64), NOISE * np.sqrt(np.diag(inverse @ backward.T @ backward @ inverse))


@pytest.mark.parametrize("cutoff", first(1, [400.0, 40.0]))
def test_filtered_equations_are_biased_and_instruments_are_not(cutoff: float) -> None:
    rng, count = np.random.default_rng(5), 5
    lp, iv, stated = [], [], []
    for _ in range(count):
        mine = terms(CLEAN + NOISE * rng.standard_normal(SAMPLES))
        lp.append(equation_error(TIMES, VOLTAGE, mine, cutoff=cutoff).values)
        found = instrumental_variables(TIMES, VOLTAGE, mine, model, cutoff=cutoff)
        assert found.converged
        iv.append(found.values)
        stated.append(found.std)
    limit, scatter = limits(cutoff)
    mean = scatter / math.sqrt(count)
    assert (np.abs(np.mean(lp, axis=0) - limit) < 3.0 * mean).all()
    assert (np.abs(np.mean(iv, axis=0) - [R, L]) < 3.0 * mean).all()
    assert np.mean(stated, axis=0) == pytest.approx(scatter, rel=0.2)
    assert cutoff == 40.0 or np.mean(lp, axis=0)[1] < 0.85 * L


@pytest.mark.slow
def test_the_variance_of_a_mean_of_colored_noise_is_right_and_so_is_its_scatter() -> None:
    """Of an autoregression φ: Var = σ² Σ (1 − |τ|/K) φ^|τ| / K; without what the fit takes it is 12 % too small."""
    count, phi, rng = 150, 0.6, np.random.default_rng(8)
    noise = signal.lfilter([1.0], [1.0, -phi], rng.standard_normal((600, count + 50)))[:, 50:]
    lags = np.arange(1, count)
    exact = (1.0 + 2.0 * np.sum((1.0 - lags / count) * phi**lags)) / count / (1.0 - phi**2)
    basis, rows = np.full((count, 1), count**-0.5), np.ones((count, 1))
    solution = np.array([[count**-0.5]])
    each = [colored_covariance(basis, solution, rows, one - one.mean()) for one in noise]
    found, freedom = (np.ravel(part) for part in zip(*each, strict=True))
    assert found.mean() == pytest.approx(exact, rel=0.06)
    held = np.abs(noise.mean(axis=1)) < special.stdtrit(freedom, 0.975) * np.sqrt(found)
    assert 0.93 < held.mean() < 0.97
    assert np.median(freedom) == pytest.approx(2.0 * (found.mean() / found.std()) ** 2, rel=0.3)


def noise_of(kind: str, rng: np.random.Generator) -> Floats:
    """White noise, an autoregression of 5 samples, or differences with next to no power where the coil has its own."""
    white = rng.standard_normal(SAMPLES + 100)
    if kind == "slow":
        white = signal.lfilter([0.6], [1.0, -0.8], white)
    elif kind == "fast":
        white = signal.lfilter([0.74, -0.67], [1.0], white)
    return NOISE * np.asarray(white[100:])


@pytest.mark.parametrize(
    ("cutoff", "kind", "draws"),
    [
        pytest.param(40.0, "slow", 40, marks=pytest.mark.slow),
        *(pytest.param(*case, 200, marks=pytest.mark.campaign) for case in ((40.0, "white"), (40.0, "slow"))),
        pytest.param(400.0, "fast", 200, marks=pytest.mark.campaign),
    ],
)
def test_intervals_of_instruments_hold(cutoff: float, kind: str, draws: int) -> None:
    rng, values, stds, freedom, held = np.random.default_rng(9), [], [], [], []
    for _ in range(draws):
        found = instrumental_variables(TIMES, VOLTAGE, terms(CLEAN + noise_of(kind, rng)), model, cutoff=cutoff)
        values.append(found.values)
        stds.append(found.std)
        freedom.append(found.freedom)
        interval = found.intervals()
        held.append((interval["lower"] < [R, L]) & (interval["upper"] > [R, L]))
    error = math.sqrt(0.05 * 0.95 / draws)  # 93 to 97 %, and some standard errors
    assert (np.abs(np.mean(held, axis=0) - 0.95) < 0.02 + 2.4 * error).all()
    if draws < 200:
        return
    ratio = np.sqrt(np.mean(np.square(stds), axis=0)) / np.std(values, axis=0)
    assert ((ratio > 0.93) & (ratio < 1.15)).all()
    scatter = np.std(stds, axis=0) / np.mean(stds, axis=0)
    assert scatter == pytest.approx(np.sqrt(0.5 / np.median(freedom, axis=0)), rel=0.35)


def test_instruments_settle_from_any_values_or_tell() -> None:
    near = instrumental_variables(TIMES, VOLTAGE, terms(NOISY), model, cutoff=40.0)
    far = instrumental_variables(TIMES, VOLTAGE, terms(NOISY), model, cutoff=40.0, start=[20.0, 0.02])
    assert far.estimator is Estimator.INSTRUMENTAL_VARIABLES
    assert far.rounds > near.rounds
    assert (np.abs(far.values - near.values) < 0.01 * near.std).all()
    rng = np.random.default_rng(0)

    def restless(_: Floats) -> Mapping[str, Term]:
        return terms(CLEAN + 0.1 * rng.standard_normal(SAMPLES))

    found = instrumental_variables(TIMES, VOLTAGE, terms(NOISY), restless, cutoff=40.0)
    assert (found.converged, found.rounds) == (False, 20)


def exploding(theta: Floats) -> dict[str, Term]:
    return terms(np.full(SAMPLES, np.inf) * theta[0])


def instruments(fields: Any, **words: Any) -> LinearEstimate:
    return instrumental_variables(TIMES, VOLTAGE, terms(CLEAN), fields, cutoff=40.0, **words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times": TIMES[::-1]}, "times"),
        ({"cutoff": 0.0}, "cutoff.*positive"),
        ({"order": 0}, "order must be 1, 2"),
        ({"order": 1, "target": Term(CLEAN, 2)}, "order 1.*derivative 2"),
        ({"target": Term(CLEAN[1:])}, "1200 values"),
        ({"target": Term(np.full(SAMPLES, np.nan))}, "finite"),
        ({"target": Term(np.where(TIMES > 0.5, np.nan, CLEAN))}, "no sample from 0.5"),
        ({"terms": {}}, "terms"),
        ({"terms": {"R": Term(CLEAN), "S": Term(2.0 * CLEAN)}}, "'R' and 'S' depend"),
        (lambda: Term(CLEAN, interpolation="held"), "'held'"),
        (lambda: Term(CLEAN, derivative=-1), "derivative"),
        (lambda: instruments(lambda _: {"R": Term(CLEAN), "l": Term(CLEAN, 1)}), "'L'"),
        (lambda: instruments(exploding), "'R'.*not finite"),
        (lambda: instruments(model, start=[1.0]), "start.*2 values"),
    ],
)
def test_filter_and_instruments_are_refused(change: Any, words: str) -> None:
    given = {"times": TIMES, "target": VOLTAGE, "terms": terms(CLEAN), "cutoff": 40.0}
    with pytest.raises(fmuid.InputError, match=words):
        change() if callable(change) else equation_error(**(given | change))
