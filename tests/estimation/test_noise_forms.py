"""Forms in which noise is given: each against the closed form of a linear model."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from fmuid import Experiment, InputError, Noise, Parameter, Result, analyze_residuals, compare_prior_and_data
from fmuid.array_types import Floats
from fmuid.data import UNITS, robust_variance
from fmuid.estimation import Evaluator, LeastSquares, misfits
from fmuid.estimation.cost_components import fitted
from fmuid.estimation.noise.uneven import uneven_levels
from fmuid.estimation.predictors import FunctionPredictor
from fmuid.identification import Deviation, identify
from fmuid.identification.sampler import log_density
from tests.support.problems import ar1

COUNT = 60
X = np.linspace(-1.0, 2.0, COUNT)
PHI = np.column_stack([np.ones(COUNT), X])
TRUTH = np.array([2.0, -1.0])
STD = 0.05 + 0.4 * np.abs(np.sin(7.0 * X))
WEIGHTS = 3.0 + np.cos(5.0 * X)
PARAMETERS = {"a": Parameter(1.0), "b": Parameter(-0.5)}


def one(noise: Noise, std: Floats = STD, **words: Any) -> LeastSquares:
    y = PHI @ TRUTH + std * np.random.default_rng(1).standard_normal(COUNT)
    return LeastSquares.from_function(lambda p: PHI @ p, y, PARAMETERS, noise=noise, **words)


def two(noise: Noise, **words: Any) -> LeastSquares:
    """Two outputs of the same parameters, a third of the second missing."""
    rng = np.random.default_rng(2)
    y = np.column_stack([PHI @ TRUTH, PHI[::-1] @ TRUTH]) + rng.standard_normal((COUNT, 2)) * [0.1, 0.4]
    y[::3, 1] = np.nan
    return LeastSquares.from_function(
        lambda p: np.column_stack([PHI @ p, PHI[::-1] @ p]), y, PARAMETERS, noise=noise, outputs=("u", "v"), **words
    )


def rows_of_two(problem: LeastSquares) -> tuple[Floats, Floats, Floats]:
    """Return regressors, samples and which output each is of, one output after the other."""
    y = problem.experiments[0].output_values
    there = ~np.isnan(y)
    phi = np.vstack([PHI[there[:, 0]], PHI[::-1][there[:, 1]]])
    return phi, np.concatenate([y[there[:, k], k] for k in (0, 1)]), np.repeat([0, 1], there.sum(axis=0))


def weighted(phi: Floats, y: Floats, weights: Floats) -> tuple[Floats, Floats, float]:
    """Return (ΦᵀWΦ)⁻¹ΦᵀWy, (ΦᵀWΦ)⁻¹ and the weighted sum of squares that is left."""
    inverse = np.asarray(np.linalg.inv(phi.T @ (weights[:, None] * phi)), dtype=np.float64)
    found = inverse @ phi.T @ (weights * y)
    return found, inverse, float(weights @ (y - phi @ found) ** 2)


def same(result: Result, values: Floats, covariance: Floats) -> None:
    np.testing.assert_allclose(result.values, values, rtol=1e-6)
    np.testing.assert_allclose(result.estimates.covariance_white_noise, covariance, rtol=1e-6)


def test_standard_deviation_for_each_sample() -> None:
    problem = one(Noise(std=STD.tolist()))
    result, y = identify(problem), problem.experiments[0].output_values[:, 0]
    values, inverse, left = weighted(PHI, y, STD**-2)
    same(result, values, inverse)
    assert result.fit.cost == pytest.approx(left)
    assert result.fit.given_variance["y"] == pytest.approx(float(np.mean(STD**2)))
    density = float(np.sum(stats.norm.logpdf(y, PHI @ values, STD)))
    assert result.fit.log_likelihood == pytest.approx(density, rel=1e-8)
    np.testing.assert_allclose(result.fit.frames[0]["simulated.y"], PHI @ values, rtol=1e-6)
    squares = misfits(Evaluator(problem), values[None]).squares
    np.testing.assert_allclose(fitted(problem, result).squares, squares, rtol=1e-6)
    (found,) = analyze_residuals(problem, result).series
    residual = y - PHI @ result.values
    assert found.std == pytest.approx(float(residual.std()))
    lag, value = found.whiteness.strongest
    assert value == found.whiteness.autocorrelation[lag]
    assert found.normality.kurtosis == pytest.approx(float(stats.kurtosis(residual / STD)))


def test_weights_leave_one_variance_to_be_estimated() -> None:
    """Of samples, of outputs, of experiments."""
    problem = one(Noise(weights=WEIGHTS.tolist()), 0.3 / np.sqrt(WEIGHTS))
    result = identify(problem)
    values, inverse, left = weighted(PHI, problem.experiments[0].output_values[:, 0], WEIGHTS)
    variance = left / (COUNT - 2)
    same(result, values, variance * inverse)
    assert result.fit.noise_variance["y"] == pytest.approx(variance * float(np.mean(1.0 / WEIGHTS)))
    problem = two(Noise(weights={"u": 16.0, "v": 1.0}))
    phi, y, output = rows_of_two(problem)
    values, inverse, left = weighted(phi, y, np.where(output == 0, 16.0, 1.0))
    variance, result = left / (y.size - 2), identify(problem)
    same(result, values, variance * inverse)
    assert result.fit.noise_variance == pytest.approx({"u": variance / 16.0, "v": variance})
    problem = several(Noise(experiments={"second": Noise(weights=0.04)}))
    y = np.concatenate([each.output_values[:, 0] for each in problem.experiments])
    values, inverse, left = weighted(np.vstack([PHI, PHI]), y, np.repeat([1.0, 0.04], COUNT))
    same(identify(problem), values, left / (2 * COUNT - 2) * inverse)


@pytest.mark.parametrize("noise", [Noise(shared_variance=["u", "v"]), Noise(weights={"u": 1.0, "v": 1.0})])
def test_one_variance_common_to_outputs(noise: Noise) -> None:
    """The criterion (1.61) and its one variance."""
    problem = two(noise)
    result, (phi, y, _) = identify(problem), rows_of_two(problem)
    values, inverse, left = weighted(phi, y, np.ones(y.size))
    same(result, values, left / (y.size - 2) * inverse)
    assert result.fit.noise_variance == pytest.approx(dict.fromkeys("uv", left / (y.size - 2)))
    assert result.fit.degrees_of_freedom == y.size - 2
    density = np.sum(stats.norm.logpdf(y - phi @ values, scale=(left / y.size) ** 0.5))
    assert result.fit.log_likelihood == pytest.approx(float(density))


def test_what_is_common_is_common_to_all_criteria() -> None:
    """Maps and global searches concentrate the variance, the posterior integrates it out: K ln J of all together."""
    problem, away = two(Noise(shared_variance=True)), np.array([[2.0, -1.0], [2.1, -0.8], [1.5, -1.2]])
    phi, y, _ = rows_of_two(problem)
    squares = np.array([np.sum((y - phi @ each) ** 2) for each in away])
    expected = y.size * np.log(squares / squares[0])
    found = misfits(Evaluator(problem), away).concentrated(problem)
    np.testing.assert_allclose(found - found[0], expected, rtol=1e-9)
    density = log_density(Evaluator(problem))(away)
    np.testing.assert_allclose(density - density[0], -0.5 * expected, rtol=1e-9)


def test_a_common_variance_is_robust_with_a_robust_loss() -> None:
    problem = two(Noise(weights={"u": 4.0, "v": 1.0}), loss="huber")
    residual = problem.measured - Evaluator(problem).predict(TRUTH[None])[0]
    common = robust_variance(np.where(problem.groups == 0, 2.0, 1.0) * residual, float(residual.size))
    np.testing.assert_allclose(problem.noise_variances(residual), [common / 4.0, common], rtol=1e-9)


def test_a_share_of_the_spread() -> None:
    problem = one(Noise(relative_std=0.02))
    y = problem.experiments[0].output_values[:, 0]
    expected = (0.02 * np.std(y)) ** 2
    assert identify(problem).fit.given_variance["y"] == pytest.approx(expected)
    same(identify(problem), *weighted(PHI, y, np.full(COUNT, 1.0 / expected))[:2])


def several(noise: Noise, names: tuple[str, ...] = ("first", "second")) -> LeastSquares:
    """Two experiments of one output."""
    rng, tables = np.random.default_rng(3), []
    for name, std in zip(names, (0.1, 0.5), strict=True):
        y = (PHI @ TRUTH + std * rng.standard_normal(COUNT))[:, None]
        tables.append(Experiment.of_arrays(name, X, ("y",), y, np.ones_like(y, dtype=np.bool_)))
    predictor = FunctionPredictor(lambda p: PHI @ p, (COUNT, 1))
    return LeastSquares([predictor, predictor], tables, PARAMETERS, noise=noise)


@pytest.mark.parametrize(
    ("noise", "std"),
    [
        (Noise(std=0.1, experiments={"second": Noise(0.25)}), 0.5),
        (Noise({"y": 0.01}, experiments={"second": Noise(std=[0.5] * COUNT)}), 0.5),
        (Noise(std=0.1, experiments={"second": Noise(relative_std=0.25)}), None),
    ],
)
def test_noise_of_single_experiments(noise: Noise, std: float | None) -> None:
    problem = several(noise)
    first, second = (each.output_values[:, 0] for each in problem.experiments)
    weights = np.repeat([100.0, (std or 0.25 * float(np.std(second))) ** -2], COUNT)
    same(identify(problem), *weighted(np.vstack([PHI, PHI]), np.concatenate([first, second]), weights)[:2])


def recorded(noise: Noise, change: Any = None) -> LeastSquares:
    """A table with columns of standard deviations, of which the output's first cell is empty."""
    y = PHI @ TRUTH + STD * np.random.default_rng(1).standard_normal(COUNT)
    frame = pd.DataFrame({"time": X + 1.0, "y": y, "sd": STD, "milli": 1e3 * STD})
    frame.loc[0, ["y", "sd"]] = np.nan
    if change is not None:
        change(frame)
    frame.attrs[UNITS] = {"y": "V", "sd": "V", "milli": "mV", "time": "s"}
    experiment = Experiment(frame, outputs=["y"], name="run", source="run.csv")
    return LeastSquares([FunctionPredictor(lambda p: PHI @ p, (COUNT, 1))], [experiment], PARAMETERS, noise=noise)


@pytest.mark.parametrize("column", ["sd", "milli"])
def test_a_column_of_standard_deviations(column: str) -> None:
    """It need not be there where the output is not, and is converted to the output's unit."""
    problem = recorded(Noise(std=column))
    y = problem.experiments[0].output_values[1:, 0]
    same(identify(problem), *weighted(PHI[1:], y, STD[1:] ** -2)[:2])


def flat() -> LeastSquares:
    words: Any = {"noise": Noise(relative_std=0.1)}
    return LeastSquares.from_function(lambda p: p[0] * np.ones(9), np.ones(9), {"a": Parameter(0.5)}, **words)


def spoiled(value: float) -> LeastSquares:
    return recorded(Noise(std="sd"), lambda frame: frame.__setitem__("sd", frame["sd"].where(X < 1.9, value)))


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: Noise(0.0), "variance.*positive.*0"),
        (lambda: Noise({"a": -1.0}), "variance.*'a'.*positive"),
        (lambda: Noise("guess"), "estimate"),  # type: ignore[arg-type]
        (lambda: Noise(initial_variance="estimate"), "initial_variance.*positive"),  # type: ignore[arg-type]
        (lambda: Noise(initial_variance=float("inf")), "finite"),
        (lambda: Noise(True), "positive"),
        (lambda: Noise(std=-1.0), "std.*positive.*-1"),
        (lambda: Noise(relative_std={"u": np.nan}), "relative_std of output 'u'.*nan"),
        (lambda: Noise(weights={"u": 0.0}), "weights of output 'u'.*0"),
        (lambda: Noise(relative_std="sd"), "relative_std.*'sd'"),  # type: ignore[arg-type]
        (lambda: two(Noise(std={"w": 1.0})), "noise.std.*'w'"),
        (lambda: two(Noise(shared_variance=["u", "w"])), "shared_variance.*'w'"),
        (lambda: two(Noise(0.1, std={"u": 1.0})), "variance and std of output 'u'"),
        (lambda: two(Noise({"u": 0.1}, shared_variance=["u"])), "shared_variance.*'u'"),
        (lambda: two(Noise(weights={"u": 2.0})), "weights.*'u'"),
        (lambda: two(Noise(experiments={"x": Noise(0.1)})), "'x'"),
        (lambda: Noise(experiments={"x": Noise(initial_variance=1.0)}), "experiment 'x'"),
        (lambda: two(Noise(experiments={"experiment": Noise(std={"w": 1.0})})), "noise.std.*'w'"),
        (lambda: several(Noise(experiments={"first": Noise(0.1)})), "'y'"),
        (flat, "'y'"),
        (lambda: spoiled(np.nan), "run.csv.*'sd'.*no value.*row 59"),
        (lambda: spoiled(-0.1), "run.csv.*'sd'.*-0.1.*row 59"),
        (lambda: spoiled(np.inf), "run.csv.*'sd'.*inf.*row 59"),
        (lambda: recorded(Noise(std="sb")), "run.csv.*'sb'"),
        (lambda: recorded(Noise(std="time")), "run.csv.*'time'.*'y'"),
        (lambda: one(Noise(std="sd")), "'sd'"),
        (lambda: one(Noise(std=[1.0, 2.0])), "2 values for 60"),
    ],
)
def test_noise_is_refused(build: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        build()


@pytest.mark.parametrize("color", [0.0, 0.8])
def test_stated_variance_scales_standard_deviations_alone(color: float) -> None:
    """Dahlquist's equation with residuals of variance 1e-4, white or AR(1): the stated level invents no noise."""
    times = np.linspace(0.0, 3.0, 200)
    measured = np.exp(-0.7 * times) + 0.01 * ar1(np.random.default_rng(5), color, times.size)

    def stated(variance: Any) -> tuple[LeastSquares, Result]:
        words: Any = {"times": times, "noise": Noise(variance=variance)}
        k = {"k": Parameter(1.0, min=0.0)}
        problem = LeastSquares.from_function(lambda theta: np.exp(-theta[0] * times), measured, k, **words)
        return problem, identify(problem)

    _, own = stated("estimate")
    deviations = {1e-2: Deviation.SMALLER, 1e-4: Deviation.NONE, 1e-6: Deviation.LARGER}
    for variance, deviation in deviations.items():
        problem, found = stated(variance)
        diagnostics = analyze_residuals(problem, found)
        assert found.values == pytest.approx(own.values, abs=1e-3 * own.std[0])
        assert found.std == pytest.approx(own.std * math.sqrt(variance / own.fit.noise_variance["y"]), rel=0.1)
        assert found.estimates.colored_noise_factor == pytest.approx(own.estimates.colored_noise_factor, rel=0.1)
        assert diagnostics.slow == ()
        (test,) = compare_prior_and_data(problem, found, diagnostics=diagnostics).variances
        assert (test.known, test.estimated) == (variance, found.fit.noise_variance["y"])
        if color == 0.0:
            assert found.estimates.colored_noise_factor == pytest.approx(1.0, abs=0.1)
            assert test.deviation is deviation


def test_noise_far_from_a_fit_is_not_uneven() -> None:
    """Its squares overflow; nothing is said, as of equal ones."""
    rows = np.arange(60)
    model: Any = SimpleNamespace(series=SimpleNamespace(rows=rows, ordered=False), whiten=lambda residual: residual)
    residual = np.where(rows % 2, 1e80, 1.0)
    with np.errstate(over="raise"):
        assert uneven_levels([model], residual, rows.astype(np.float64)) is None
