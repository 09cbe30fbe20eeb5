"""Data that say little or nothing: what they leave open is named, never given as a number that looks sure."""

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from fmuid import Experiment, InputError, Noise, Normal, Parameter, Result
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import ActiveBound, IdentifiabilityLevel, LeastSquares, WhitenedJacobian, local_covariance
from fmuid.estimation.covariance import LIMITS
from fmuid.identification import identify
from tests.support.problems import CLOCK, Fake, coil, simulate, two_output_problem
from tests.support.results import RESULT

TIMES = 1e-3 * np.arange(600)
STEPS = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 15)


def of(function: Callable[[Floats], Floats], y: ArrayLike, **parameters: Parameter) -> LeastSquares:
    return LeastSquares.from_function(function, y, parameters)


def noise(seed: int, std: float) -> Floats:
    return std * np.random.default_rng(seed).standard_normal(TIMES.size)


# --- the coil and its fault (docs/method/coil.md) --------------------------------------

COIL = {"R": Parameter(4.0), "L": Parameter(0.1), "dR": Parameter(0.0, nominal=1.0)}


def coil_result(voltage: Floats, **priors: Normal) -> Result:
    y = coil(np.array([4.0, 0.1, 1.0]), voltage) + noise(2, 0.02)
    parameters = {name: Parameter(p.start, nominal=p.nominal, prior=priors.get(name)) for name, p in COIL.items()}
    return identify(LeastSquares.from_function(lambda theta: coil(theta, voltage), y, parameters))


def test_any_prior_on_the_direction_makes_it_identifiable() -> None:
    """The data give R + dR and L + 2τ dR; one prior more and all is known, with its precision, unless it is vague."""
    assert len(coil_result(STEPS).identifiability.non_identifiable) == 1
    for name, prior in (("R", Normal(4.0, 0.1)), ("L", Normal(0.1, 0.002)), ("dR", Normal(1.0, 0.1))):
        result = coil_result(STEPS, **{name: prior})
        assert result.converged
        (direction,) = result.identifiability.prior_dominated
        assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT, ("R", "L", "dR"))
        assert result.std[result.names.index(name)] == pytest.approx(prior.std, rel=0.05)
        assert result[name] == pytest.approx(prior.mean, abs=1e-3 * prior.std)  # the data do not pull at it
        assert result["dR"] == pytest.approx(1.0, abs=4.0 * result.std[2])
    vague = coil_result(STEPS, dR=Normal(0.0, 200.0))
    assert not vague.converged
    (direction,) = vague.identifiability.non_identifiable
    assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT_IN_EFFECT, ("R", "L", "dR"))
    assert vague.std[2] == pytest.approx(200.0, rel=0.01)


# --- a search that runs away ------------------------------------------------------------


def resting_coil(most: float = math.inf) -> Result:
    """Constant voltage, the current at rest with noise that drifts a little by chance: R alone is identifiable."""
    times, y = 1e-3 * np.arange(1000), 0.25 + 0.01 * np.random.default_rng(0).standard_normal(1000)

    def current(theta: Floats) -> Floats:
        return np.asarray(1.0 / theta[0] + (theta[2] - 1.0 / theta[0]) * np.exp(-theta[0] / theta[1] * times))

    parameters = {"R": Parameter(3.0), "L": Parameter(0.2, max=most), "i_start": Parameter(0.0, nominal=1.0)}
    return identify(of(current, y, **parameters))


def test_runaway_is_stopped_and_named() -> None:
    """As R and L grow together the model becomes a straight line, which fits that noise better than any coil."""
    result = resting_coil()
    assert not result.converged
    (direction,) = result.identifiability.non_identifiable
    assert (direction.level, direction.names[:2]) == (IdentifiabilityLevel.NOT_IN_EFFECT, ("R", "L"))
    assert (result.std[:2] > LIMITS.lost_std * np.abs(result.values[:2])).all()
    assert result.history.iterations < 60
    assert result.trace.loc[result.trace["accepted"], "L"].max() < 1e4
    json.dumps(RESULT | as_json(result), allow_nan=False)
    assert resting_coil(10.0).estimates.at_bounds == (ActiveBound("L", 10.0),)


def test_parameters_may_travel_far_for_a_gain() -> None:
    """Ten powers of ten, as long as the fit gains by it."""
    y = np.exp(-2.0 * TIMES) + noise(4, 1e-3)
    decay = of(lambda p: p[0] * 1e-10 * np.exp(-p[1] * TIMES), y, a=Parameter(1.0), k=Parameter(50.0))
    result = identify(decay)
    assert result.converged
    assert result.values == pytest.approx([1e10, 2.0], rel=1e-2)


# --- how little is too little -----------------------------------------------------------


def bend(std: float, start: float = 1.0, truth: float = 1.0) -> Result:
    """Fit a line with a bend whose standard deviation is `std`, without noise in the data."""
    column = (TIMES - TIMES.mean()) ** 2
    column -= np.polynomial.Polynomial.fit(TIMES, column, 1)(TIMES)
    column /= np.linalg.norm(column) * std
    return identify(
        LeastSquares.from_function(
            lambda theta: theta[0] * TIMES + theta[1] + theta[2] * column,
            2.0 * TIMES + 1.0 + truth * column,
            {"slope": Parameter(1.0), "offset": Parameter(2.0), "bend": Parameter(start)},
            noise=Noise(1.0),
        )
    )


@pytest.mark.parametrize(
    ("std", "truth", "level"),
    [
        (0.5, 1.0, None),
        (0.5, 0.0, IdentifiabilityLevel.HARDLY),  # 0 ± 0.5 is an estimate where the start says that 1 would be sizeable
        (9.0, 1.0, IdentifiabilityLevel.HARDLY),
        (3.0, 1e-4, IdentifiabilityLevel.HARDLY),  # which happens to lie near zero
        (11.0, 1.0, IdentifiabilityLevel.NOT_IN_EFFECT),
    ],
)
def test_level_of_a_weak_direction(std: float, truth: float, level: IdentifiabilityLevel | None) -> None:
    result = bend(std, truth=truth)
    found = (*result.identifiability.non_identifiable, *result.identifiability.weakly_identifiable)
    assert [(each.level, each.names) for each in found] == ([] if level is None else [(level, ("bend",))])
    assert result.converged == (level is not IdentifiabilityLevel.NOT_IN_EFFECT)
    assert result.std[2] == pytest.approx(std, rel=1e-5)
    assert truth < 1.0 or all(each.std == pytest.approx(std, rel=1e-5) for each in found)


def test_singular_and_weak_directions_together() -> None:
    """a + b is known, a − b not at all; c to 20 of its magnitudes, d well."""
    rows, _ = np.linalg.qr(np.random.default_rng(6).standard_normal((50, 3)))
    jacobian = np.column_stack([rows[:, 0], rows[:, 0], rows[:, 1] / 20.0, 30.0 * rows[:, 2]])
    found = local_covariance("abcd", WhitenedJacobian(jacobian, np.zeros(4)), np.ones(4))
    assert found.rank == 3
    none, in_effect = found.undetermined
    assert (none.level, none.names, none.std) == (IdentifiabilityLevel.NOT, ("a", "b"), math.inf)
    assert none.coefficients[0] == pytest.approx(-none.coefficients[1])
    assert (in_effect.level, in_effect.names) == (IdentifiabilityLevel.NOT_IN_EFFECT, ("c",))
    assert in_effect.std == pytest.approx(20.0)
    std = np.sqrt(np.diag(found.covariance))
    assert std == pytest.approx([math.inf, math.inf, 20.0, 1.0 / 30.0], rel=1e-9)
    assert found.leverage(jacobian).sum() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("effect", "error", "level"),
    [
        (0.0, 5.0, IdentifiabilityLevel.NOT),  # nothing at all
        (0.01, 0.01, IdentifiabilityLevel.NOT),  # less than would ever show
        (3.0, 5.0, IdentifiabilityLevel.HIDDEN),  # errors where without them it would be known to a third
    ],
)
def test_level_of_an_effect_hidden_by_errors(effect: float, error: float, level: IdentifiabilityLevel) -> None:
    rows, _ = np.linalg.qr(np.random.default_rng(6).standard_normal((50, 2)))
    jacobian = WhitenedJacobian(rows * [100.0, effect], np.array([0.0, error]))
    (found,) = local_covariance("ab", jacobian, np.ones(2)).undetermined
    assert (found.level, found.names) == (level, ("b",))


def test_direction_is_relative_to_the_magnitudes() -> None:
    """Whatever the units are."""
    theta, magnitudes = np.array([0.047, -3.0, 0.0, 21.5]), np.array([0.047, 3.0, 5.0, 21.5])
    null = np.array([0.5, 0.25, -0.125, 1.0])  # per cent of the magnitudes
    others = np.linalg.svd(null[None])[2][1:]
    jacobian = np.random.default_rng(8).standard_normal((50, 3)) @ others / magnitudes
    given = WhitenedJacobian(jacobian, np.zeros(4))
    (direction,) = local_covariance("kyzx", given, magnitudes, theta=theta).undetermined
    along = np.array(direction.coefficients) / (null * magnitudes)
    np.testing.assert_allclose(along, along[0], rtol=1e-6)


# --- a prior and no data, data and no prior ---------------------------------------------


def line(theta: Floats) -> Floats:
    return np.asarray(theta[0] * TIMES)


@pytest.mark.parametrize("known", [Noise(), Noise(1e-4)])
def test_parameter_with_a_prior_and_no_data(known: Noise) -> None:
    """It keeps its prior, and the others are what they are without it."""
    y, slope = line(np.array([2.0])) + noise(7, 1e-2), {"slope": Parameter(1.0)}
    single = identify(LeastSquares.from_function(line, y, slope, noise=known))
    idle = {"idle": Parameter(3.0, prior=Normal(2.5, 0.5))}
    both = identify(LeastSquares.from_function(line, y, slope | idle, noise=known))
    assert both.converged
    assert both.values == pytest.approx([single["slope"], 2.5], rel=1e-9)
    assert both.std == pytest.approx([single.std[0], 0.5], rel=1e-6)
    assert both.estimates.prior_z_score[1] == pytest.approx(0.0, abs=1e-9)
    (direction,) = both.identifiability.prior_dominated
    assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT, ("idle",))


def test_one_sample_and_three_priors() -> None:
    """The closed form of a linear measurement with a Gaussian prior, by the Kalman gain."""
    row, prior = np.array([1.0, 2.0, -1.0]), np.array([0.5, 0.1, 2.0])
    parameters = {n: Parameter(1.0, prior=Normal(1.0, std)) for n, std in zip("abc", prior.tolist(), strict=True)}
    function: Callable[[Floats], Floats] = lambda theta: np.array([row @ theta])  # noqa: E731
    result = identify(LeastSquares.from_function(function, [4.0], parameters, noise=Noise(0.04)))
    gain = prior**2 * row / (row**2 @ prior**2 + 0.04)
    assert result.values == pytest.approx(1.0 + gain * (4.0 - 2.0), rel=1e-6)
    np.testing.assert_allclose(result.covariance, np.diag(prior**2) - np.outer(gain, row * prior**2), rtol=1e-6)


def test_prior_counts_in_the_experiment_that_needs_it() -> None:
    """`gain` per experiment: the second has one sample, too few beside the noise; its prior holds it."""
    counted, few = np.ones((50, 2), dtype=np.bool_), np.zeros((50, 2), dtype=np.bool_)
    few[0] = True
    rng, tables = np.random.default_rng(9), []
    for name, gain, kept in (("first", 2.0, counted), ("second", 5.0, few)):
        y = simulate(1.5, gain) + rng.standard_normal((50, 2)) * [2e4, 1e-3]
        tables.append(Experiment.of_arrays(name, np.linspace(0.0, 2.0, 50), ("a", "b"), y, kept))
    gain_of_each = Parameter(3.0, per_experiment=True, prior=Normal(3.0, 0.3))
    parameters = {"k": Parameter(1.0, min=0.0), "gain": gain_of_each}
    result = identify(LeastSquares([Fake(), Fake()], tables, parameters, noise=Noise({"a": 4e8, "b": 1e-6})))
    assert result.converged
    assert result.std[2] == pytest.approx(0.3, rel=0.01)
    assert result.std[1] < 0.2


# --- numbers beyond all measure ---------------------------------------------------------


@pytest.mark.parametrize(("magnitude", "loss"), [(1e-90, "linear"), (1e90, "cauchy"), (1e30, "linear")])
def test_absurd_magnitudes_make_no_warnings(magnitude: float, loss: str) -> None:
    """In any unit the same estimates; warnings are errors here."""
    y = 2.0 * np.exp(-3.0 * TIMES) + noise(10, 0.01)

    def fit(factor: float) -> Result:
        def decay(theta: Floats) -> Floats:
            return np.asarray(factor * (theta[0] / factor) * np.exp(-theta[1] * factor * TIMES))

        parameters = {"a": Parameter(factor), "k": Parameter(1.0 / factor)}
        return identify(LeastSquares.from_function(decay, factor * y, parameters, loss=loss))

    plain, result = fit(1.0), fit(magnitude)
    assert result.converged
    assert result.values * [1.0 / magnitude, magnitude] == pytest.approx(plain.values, rel=1e-5)
    assert result.std * [1.0 / magnitude, magnitude] == pytest.approx(plain.std, rel=1e-4)
    assert result.estimates.variance_dof == pytest.approx(plain.estimates.variance_dof, rel=1e-3)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Parameter(1e300), "1e"),
        (lambda: Parameter(1e-300), "1e-300.*nominal"),
        (lambda: Parameter(0.0, nominal=1e-300), "nominal"),
        (lambda: Normal(0.0, 1e300), "std"),
        (lambda: Noise(1e-300), "extreme"),
        (lambda: of(line, np.full(600, 1e300), slope=Parameter(1.0)), r"'y'.*1e\+300"),
        (lambda: identify(of(lambda theta: np.exp(theta[0] * TIMES), TIMES, a=Parameter(1e4))), "a = 10000 fails"),
    ],
)
def test_extreme_numbers_are_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()


# --- directions, bounds and intervals in a result


@pytest.mark.parametrize(
    "draws", [pytest.param(50, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.campaign)]
)
def test_intervals_cover_as_often_as_they_say(draws: int) -> None:
    """Of a nonlinear problem with 12 samples, where Student's t differs from the normal distribution."""
    times, inside = np.linspace(0.0, 2.0, 12), np.zeros(2)

    def decay(theta: Floats) -> Floats:
        return np.asarray(theta[0] * np.exp(-theta[1] * times))

    for seed in range(draws):
        y = decay(np.array([3.0, 1.0])) + 0.1 * np.random.default_rng(seed).standard_normal(12)
        result = identify(LeastSquares.from_function(decay, y, {"a": Parameter(2.0), "k": Parameter(1.5)}))
        assert result.converged
        interval = result.intervals()
        inside += (interval["lower"] < [3.0, 1.0]) & (interval["upper"] > [3.0, 1.0])
    assert (np.abs(inside / draws - 0.95) < 2.6 * math.sqrt(0.05 * 0.95 / draws)).all()


def test_strong_correlations_are_listed() -> None:
    """A line whose abscissas lie far from zero: intercept and slope are correlated by −mean(t)/rms(t)."""
    t = np.linspace(10.0, 11.0, 40)
    y = 1.0 + 2.0 * t + 0.01 * np.random.default_rng(1).standard_normal(40)
    parameters = {"offset": Parameter(2.0), "slope": Parameter(1.0)}
    result = identify(LeastSquares.from_function(lambda theta: theta[0] + theta[1] * t, y, parameters))
    ((first, second, value),) = result.estimates.strong_correlations
    assert (first, second) == ("offset", "slope")
    assert value == pytest.approx(-np.mean(t) / np.sqrt(np.mean(t**2)), abs=1e-4)


def test_bounds_are_named_and_end_intervals() -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, min=0.0, max=1.2)}))
    assert result.converged
    assert result.estimates.at_bounds == (ActiveBound("k", 1.2),)
    assert result["k"] == 1.2
    # one-sided where the estimate stands on a bound
    lower, upper = result.intervals(0.9).to_numpy()[0].tolist()
    assert upper == 1.2
    assert lower == pytest.approx(1.2 - stats.t.ppf(0.9, result.estimates.variance_dof[0]) * result.std[0])
    free = identify(two_output_problem())
    lower, upper = free.intervals().to_numpy()[0].tolist()
    bound = 0.5 * (free["k"] + upper)
    held = identify(two_output_problem(parameters={"k": Parameter(1.0, min=0.0, max=bound)}))
    assert held.intervals().to_numpy()[0].tolist() == pytest.approx([lower, bound], rel=1e-5)
    assert not held.estimates.at_bounds


def test_few_samples_of_an_output_widen_what_depends_on_them_alone() -> None:
    """Three samples, of which one parameter takes one: Student's t of two degrees of freedom."""

    def both(theta: Floats) -> Floats:
        return np.column_stack([theta[0] * np.exp(-CLOCK), np.full(100, theta[1])])

    y = both(np.array([1.0, 2.0])) + np.random.default_rng(4).standard_normal((100, 2)) * [0.1, 0.3]
    y[[*range(20), *range(21, 50), *range(51, 90), *range(91, 100)], 1] = np.nan
    parameters = {"a": Parameter(0.5), "c": Parameter(1.0)}
    result = identify(LeastSquares.from_function(both, y, parameters, outputs=("u", "i"), times=CLOCK))
    assert result.estimates.variance_dof[1] == pytest.approx(2.0, rel=0.02)
    assert result.estimates.variance_dof[0] > 20.0
    assert result.std[1] == pytest.approx(np.nanstd(y[:, 1], ddof=1) / math.sqrt(3.0), rel=0.02)
