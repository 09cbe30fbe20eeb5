"""Reading a result: the optimum, the Kalman form, what the prior moved, and the tests of consistency."""

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmuid import (
    InputError,
    JointPrior,
    Noise,
    Normal,
    Parameter,
    Problem,
    Result,
    Study,
    analyze_residuals,
    compare_prior_and_data,
)
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import Autoregression, LeastSquares, SandwichCovariance, linear_least_squares
from fmuid.identification import (
    Deviation,
    ExtrapolationReason,
    PriorDataComparison,
    PriorInfluence,
    ResidualAnalysis,
    identify,
)
from tests.support.paths import ROOT
from tests.support.problems import ar1
from tests.support.results import changed

STUDY = ROOT / "experiments" / "induction_machine" / "study.toml"
COUNT = 120
PHI = np.column_stack([np.ones(COUNT), np.linspace(0.0, 1.0, COUNT), np.sin(np.linspace(0.0, 20.0, COUNT))])
TRUTH = np.array([1.0, 2.0, 0.5])
MEAN = np.array([0.95, 2.2, 0.4])
COVARIANCE = np.array([[4e-3, -3e-3, 0.0], [-3e-3, 2e-2, 1e-3], [0.0, 1e-3, 1e-2]])
VARIANCE = 0.04
NAMES = ("a", "b", "c")


def linear(
    measured: Floats, prior: JointPrior | None = None, own: dict[str, Normal] | None = None, **words: Any
) -> tuple[LeastSquares, Result]:
    """Identify y = Φ θ."""
    scales = zip(NAMES, (1.0, 20.0, 5.0), strict=True)
    parameters = {name: Parameter(1.0, nominal=scale, prior=(own or {}).get(name)) for name, scale in scales}
    words = {"noise": Noise(VARIANCE)} | words
    problem = LeastSquares.from_function(lambda theta: PHI @ theta, measured, parameters, joint_prior=prior, **words)
    return problem, identify(problem)


def noisy(rng: np.random.Generator, theta: Floats = TRUTH) -> Floats:
    return np.asarray(PHI @ theta + math.sqrt(VARIANCE) * rng.standard_normal(COUNT))


def joint(mean: Floats = MEAN) -> JointPrior:
    return JointPrior(NAMES, mean, COVARIANCE)


def information() -> Floats:
    """P_opt⁻¹ of the linear model."""
    return np.asarray(PHI.T @ PHI / VARIANCE)


def white_reading(problem: LeastSquares, result: Result, **words: Any) -> PriorDataComparison:
    """Read a result with residuals that are taken for white."""
    found = analyze_residuals(problem, result)
    assert result.fit.noise is not None
    models = tuple(
        dataclasses.replace(each, process=Autoregression(np.zeros(0), 1.0, each.process.samples))
        for each in result.fit.noise.models
    )
    series = tuple(dataclasses.replace(each, noise=own) for each, own in zip(found.series, models, strict=True))
    innovations = tuple(np.eye(len(each)) for each in result.fit.noise.innovations)
    noise = dataclasses.replace(result.fit.noise, models=models, innovations=innovations)
    taken = changed(result, noise=noise, covariance=result.estimates.covariance_white_noise)
    with pytest.MonkeyPatch.context() as patched:  # also where the optimum of the data is searched
        patched.setattr(
            "fmuid.identification.prior_and_data.sandwich_of",
            lambda *_: SandwichCovariance(taken.covariance, taken.estimates.variance_dof, noise),
        )
        return compare_prior_and_data(problem, taken, diagnostics=ResidualAnalysis(series, found.widening), **words)


@pytest.mark.parametrize("search", [False, True])
def test_prior_data_and_combined_of_a_linear_problem(search: bool) -> None:
    """Closed forms: θ_opt by least squares, the optimum and the distance of docs/method/noise-variances.md."""
    y = noisy(np.random.default_rng(1))
    problem, result = linear(y, joint())
    reading = white_reading(problem, result, search_data=search)
    data = linear_least_squares(PHI, y)
    np.testing.assert_allclose(reading.data, data.values, rtol=1e-6)
    np.testing.assert_allclose(reading.data_std, np.sqrt(np.diag(np.linalg.inv(information()))), rtol=1e-6)
    weight = np.linalg.inv(COVARIANCE)
    optimum = np.linalg.solve(weight + information(), weight @ MEAN + information() @ data.values)
    np.testing.assert_allclose(reading.combined, optimum, rtol=1e-6)
    np.testing.assert_allclose(reading.combined_std, np.sqrt(np.diag(np.linalg.inv(weight + information()))), rtol=1e-6)
    np.testing.assert_allclose(reading.pull, (optimum - MEAN) / np.sqrt(np.diag(COVARIANCE)), rtol=1e-4)
    assert reading.agreement is not None
    apart = data.values - MEAN
    distance = apart @ np.linalg.solve(COVARIANCE + np.linalg.inv(information()), apart)
    assert reading.agreement.statistic == pytest.approx(distance, rel=1e-5)
    assert reading.agreement.degrees_of_freedom == 3
    assert reading.agreement.probability == pytest.approx(stats.chi2(3).sf(distance), rel=1e-4)
    assert reading.searched is search
    if search:
        np.testing.assert_allclose(reading.weighted_mean, optimum, rtol=1e-6)
        assert (np.abs(reading.nonlinearity) < 1e-3).all()
    else:
        assert np.isnan(reading.nonlinearity).all()


@pytest.mark.parametrize(("resistance", "holds"), [(3.83, True), (3.95, False)])
def test_a_changed_machine_is_noticed(resistance: float, holds: bool) -> None:
    """The chapter's prior of the induction machine, and a rotor resistance ten of its standard deviations away."""
    study, mean = Study.read(STUDY), (9.81, resistance, 0.436, 0.0762)
    stds = np.sqrt([2e-3, 2e-4, 6e-7, 1e-7]).tolist()
    parameters = {
        name: Parameter(m, min=1e-4, prior=Normal(m, s))
        for name, m, s in zip(("Rs", "Rr", "Lm", "Lf"), mean, stds, strict=True)
    }
    problem = Problem(study.system, study.tables, parameters, noise=Noise(0.0462, delay_std=0.0))
    reading = compare_prior_and_data(problem, identify(problem), search_data=True)
    assert reading.searched
    assert reading.agreement is not None
    assert reading.agreement.holds is holds
    if holds:
        assert (np.abs(reading.nonlinearity) < 0.05).all()
        assert all(each.deviation is Deviation.NONE for each in reading.variances)
    else:
        assert reading.agreement.probability < 1e-6
        assert np.argmax(np.abs(reading.conflict)) == 1
        assert PriorInfluence("Rr", "Rr", rests=False) in reading.influences


def test_the_data_alone_are_searched() -> None:
    """Of a nonlinear problem the search finds the optimum that an identification without prior finds."""
    times = np.linspace(0.0, 3.0, 80)

    def decay(theta: Floats) -> Floats:
        return np.asarray(theta[0] * np.exp(-theta[1] * times))

    y = decay(np.array([2.0, 1.5])) + 0.05 * np.random.default_rng(3).standard_normal(80)
    free = {"gain": Parameter(1.0), "rate": Parameter(1.0)}
    noise = Noise(0.05**2)
    alone = identify(LeastSquares.from_function(decay, y, free, noise=noise))
    with_prior = free | {"rate": Parameter(1.0, prior=Normal(0.6, 0.02))}
    problem = LeastSquares.from_function(decay, y, with_prior, noise=noise)
    result = identify(problem)
    reading = compare_prior_and_data(problem, result, search_data=True)
    np.testing.assert_allclose(reading.data, alone.values, rtol=1e-5)
    np.testing.assert_allclose(reading.data_std, alone.std, rtol=1e-3)
    # far from each other, the paraboloids of both do not describe what lies between
    assert np.abs(reading.nonlinearity).max() > 0.5
    assert reading.bent
    extrapolated = compare_prior_and_data(problem, result)
    assert np.abs((extrapolated.data - alone.values) / alone.std).max() > 0.5


def test_whose_prior_moved_what() -> None:
    """The moves add up, and removing one of two independent priors undoes what it did beside the other."""
    y = noisy(np.random.default_rng(4))
    problem, result = linear(y, own={"a": Normal(1.3, 0.02), "c": Normal(0.5, 0.05)})
    reading = compare_prior_and_data(problem, result)
    np.testing.assert_allclose(reading.moves.sum(axis=1), reading.combined - reading.data, rtol=1e-5)
    assert (reading.moves[:, 1] == 0.0).all()
    assert reading.moved_by[0] == reading.moved_by[1] == "a"
    # the force of a prior at the estimate, through the data's compliance
    force = (1.3 - result["a"]) / 0.02**2
    np.testing.assert_allclose(reading.moves[:, 0], np.linalg.inv(information())[:, 0] * force, rtol=1e-5)
    assert ("b", "a") in {(each.name, each.prior) for each in reading.influences}


@pytest.mark.campaign
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_false_alarms_come_as_often_as_the_level_says(colour: float) -> None:
    """Over 300 draws of noise and of the truth from the prior, white noise or not: the tests know its colour."""
    rng = np.random.default_rng(7)
    phi = np.column_stack([np.ones(600), np.sin(np.linspace(0.0, 9.0, 600))])
    stds = np.array([0.02, 0.03]) if colour == 0 else np.array([0.1, 0.1])
    apart, larger = [], []
    for _ in range(300):
        truth = np.array([1.0, 1.0]) + stds * rng.standard_normal(2)
        y = phi @ truth + 0.3 * ar1(rng, colour, 600)
        parameters = {name: Parameter(1.0, prior=Normal(1.0, std)) for name, std in zip("ab", stds, strict=True)}
        problem = LeastSquares.from_function(lambda theta: phi @ theta, y, parameters, noise=Noise(0.09))
        reading = compare_prior_and_data(problem, identify(problem))
        assert reading.agreement is not None
        apart.append(reading.agreement.probability < 0.05)
        larger.append(reading.variances[0].probability < 0.05)
    assert 0.02 <= np.mean(apart) <= 0.1
    assert 0.02 <= np.mean(larger) <= 0.1


def test_the_known_variance() -> None:
    """One output as noisy as known, one that is noisier; together by their degrees of freedom."""
    rng = np.random.default_rng(8)
    y = np.column_stack([noisy(rng), PHI @ TRUTH + 0.3 * rng.standard_normal(COUNT)])
    parameters = {name: Parameter(1.0) for name in NAMES}
    problem = LeastSquares.from_function(
        lambda theta: np.column_stack([PHI @ theta, PHI @ theta]), y, parameters, outputs=("u", "i")
    )
    result = identify(problem)
    assert compare_prior_and_data(problem, result).variances == ()
    reading = white_reading(problem, result, healthy={"i": VARIANCE, "u": VARIANCE})
    one, other, both = reading.variances
    assert (one.output, other.output, both.output) == ("u", "i", "")
    assert one.ratio == result.fit.noise_variance["u"] / VARIANCE
    assert one.degrees_of_freedom + other.degrees_of_freedom == pytest.approx(2 * COUNT - 3, abs=1e-3)
    expected = stats.chi2(other.degrees_of_freedom).sf(other.ratio * other.degrees_of_freedom)
    assert other.probability == pytest.approx(expected)
    total = one.ratio * one.degrees_of_freedom + other.ratio * other.degrees_of_freedom
    assert both.probability == pytest.approx(stats.chi2(2 * COUNT - 3).sf(total), rel=1e-3)
    assert [each.deviation for each in (one, other)] == [Deviation.NONE, Deviation.LARGER]
    smaller = white_reading(problem, result, healthy={"u": 4.0 * VARIANCE})
    assert smaller.variances[0].deviation is Deviation.SMALLER
    for healthy, said in (({"x": 1.0}, "unknown output 'x'"), ({"u": 0.0}, "variance of 'u' must be positive")):
        with pytest.raises(InputError, match=f"healthy: {said}"):
            compare_prior_and_data(problem, result, healthy=healthy)


def test_a_search_that_ends_at_a_bound_is_said() -> None:
    y = noisy(np.random.default_rng(9))
    parameters = {name: Parameter(1.0) for name in NAMES} | {"a": Parameter(1.5, min=1.2, prior=Normal(1.5, 0.02))}
    problem = LeastSquares.from_function(lambda theta: PHI @ theta, y, parameters, noise=Noise(VARIANCE))
    result = identify(problem)
    assert result.estimates.at_bounds == ()
    reading = compare_prior_and_data(problem, result, search_data=True)
    assert not reading.searched
    assert reading.obstacle == ExtrapolationReason(at_bounds=("a",))
    np.testing.assert_allclose(reading.data, linear_least_squares(PHI, y).values, rtol=1e-5)


def test_written_and_read() -> None:
    problem, result = linear(noisy(np.random.default_rng(10)), joint())
    reading = compare_prior_and_data(problem, result, search_data=True)
    written = json.loads(json.dumps(as_json(reading), allow_nan=False))
    assert written["variances"][0]["deviation"] == reading.variances[0].deviation.value
    assert written["parameters"]["b"]["data"] == reading.data[1]
    assert (written["agreement"]["degrees_of_freedom"], written["variances"][0]["output"]) == (3, "y")
    assert (reading.table["parameter"].tolist(), reading.table.shape) == (list(NAMES), (3, 13))
    with pytest.raises(InputError, match="Identify the study again"):
        compare_prior_and_data(problem, changed(result, linearization=None))
