"""Data that say little or nothing: what they leave open is named, never given as a number that looks sure."""

import json
import math
import re
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike

import fmuid
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.data import Experiment, JointPrior, Normal, Parameter
from fmuid.data.noise import Noise
from fmuid.errors import InputError
from fmuid.estimation.covariance import UNDETERMINED_STD, ActiveBound, IdentifiabilityLevel, local_covariance
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.search.loop import TerminationReason
from fmuid.identification import identify
from fmuid.reports.shared_phrases import change_remark
from tests.support.paths import FMUS
from tests.support.problems import Fake, coil
from tests.support.results import RESULT
from tests.support.said import direction_words, ending

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


def test_a_fault_that_looks_like_another_resistance() -> None:
    """At constant voltage only R + dR shows."""
    y = 1.0 / (4.0 + 1.0) + noise(3, 1e-3)
    either = of(lambda p: np.full(600, 1.0 / (p[0] + p[1])), y, R=Parameter(4.0), dR=Parameter(0.0, nominal=1.0))
    result = identify(either)
    assert not result.converged
    assert result.outcome is TerminationReason.UNDETERMINED
    assert "R and dR are not identifiable; only R + dR is.\n→ Fix one of them" in ending(result)
    assert np.isinf(result.std).all()
    assert result["R"] + result["dR"] == pytest.approx(5.0, rel=1e-3)


def test_any_prior_on_the_direction_determines_it() -> None:
    """The data give R + dR and L + 2τ dR; one prior more and everything is known, with the precision that it brings."""
    assert len(coil_result(STEPS).identifiability.non_identifiable) == 1
    for name, prior in (("R", Normal(4.0, 0.1)), ("L", Normal(0.1, 0.002)), ("dR", Normal(1.0, 0.1))):
        result = coil_result(STEPS, **{name: prior})
        assert result.converged
        (direction,) = result.identifiability.prior_dominated
        assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT, ("R", "L", "dR"))
        assert result.std[result.names.index(name)] == pytest.approx(prior.std, rel=0.05)
        assert result[name] == pytest.approx(prior.mean, abs=1e-3 * prior.std)  # the data do not pull at it
        assert result["dR"] == pytest.approx(1.0, abs=4.0 * result.std[2])


def test_a_vague_prior_leaves_it_undetermined_in_effect() -> None:
    result = coil_result(STEPS, dR=Normal(0.0, 200.0))
    assert not result.converged
    assert re.search(r"R, L and dR are practically non-identifiable .*; only R \+ dR and L \+ ", ending(result))
    assert result.std[2] == pytest.approx(200.0, rel=0.01)


# --- a search that runs away ------------------------------------------------------------


def resting_coil(**bounds: float) -> Result:
    """Constant voltage, the current at rest with noise: R alone is determined, but noise drifts a little by chance."""
    frame = pd.DataFrame({"time": 1e-3 * np.arange(1000), "u": 1.0})
    frame["i"] = 0.25 + 0.01 * np.random.default_rng(0).standard_normal(1000)
    experiment = fmuid.Experiment(frame, ["u"], ["i"])
    parameters = {
        "R": Parameter(3.0),
        "L": Parameter(0.2, max=bounds.get("L", math.inf)),
        "i_start": Parameter(0.0, nominal=1.0),
    }
    return identify(fmuid.Problem(fmuid.System(FMUS / "Coil" / "Coil.fmu"), experiment, parameters))


def test_a_runaway_is_stopped_and_named() -> None:
    """As R and L grow together the model becomes a straight line, which fits that noise better than any coil."""
    result = resting_coil()
    assert not result.converged
    assert re.search(r"R and L are practically non-identifiable .*× scale\); only R - 0\.006", ending(result))
    assert (result.std[:2] > UNDETERMINED_STD * np.abs(result.values[:2])).all()
    assert result.history.iterations < 60
    assert result.trace.loc[result.trace["accepted"], "L"].max() < 1e4
    json.dumps(RESULT | as_json(result), allow_nan=False)


def test_a_bound_holds_a_runaway() -> None:
    result = resting_coil(L=10.0)
    assert result.estimates.at_bounds == (ActiveBound("L", 10.0),)
    assert "Widen the bound or check the model" in ending(result)


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


def test_weak_and_undetermined() -> None:
    assert bend(0.5).identifiability.weakly_identifiable == ()
    weak = bend(9.0)
    assert weak.converged
    (direction,) = weak.identifiability.weakly_identifiable
    assert (direction.level, direction.names) == (IdentifiabilityLevel.HARDLY, ("bend",))
    assert direction.std == pytest.approx(9.0, rel=1e-5)
    assert direction_words(direction).startswith("bend is weakly identifiable: σ is 900 % of its scale.")
    (direction,) = bend(3.0, truth=1e-4).identifiability.weakly_identifiable  # which happens to lie near zero
    assert direction.level is IdentifiabilityLevel.HARDLY
    assert direction_words(direction).startswith("bend is weakly identifiable: σ is 3, far above its value.")
    lost = bend(11.0)
    assert not lost.converged
    assert lost.identifiability.weakly_identifiable == ()
    (direction,) = lost.identifiability.non_identifiable
    assert direction.level is IdentifiabilityLevel.NOT_IN_EFFECT
    assert direction_words(direction).startswith("bend is practically non-identifiable: σ is 11 × its scale.")
    assert lost.std == pytest.approx([weak.std[0], weak.std[1], 11.0], rel=1e-5)


def test_an_estimate_near_zero_is_not_undetermined() -> None:
    """0 ± 0.5 is a finding where the start says that 1 would be sizeable."""
    result = bend(0.5, truth=0.0)
    assert result.converged
    assert result.identifiability.non_identifiable == ()
    assert result.std[2] == pytest.approx(0.5, rel=1e-5)


def test_nearly_alike_parameters_are_named_together() -> None:
    """Their estimates lie a thousand times where they began, and are as uncertain: no number to be sure of."""
    y = 1.0 / (5.0 + 1e-6 * TIMES) + noise(5, 1e-3)
    parameters = {"R": Parameter(4.0), "dR": Parameter(0.5, nominal=1.0)}
    result = identify(of(lambda p: 1.0 / (p[0] + p[1] * (1.0 + 1e-6 * TIMES)), y, **parameters))
    assert not result.converged
    assert re.search(r"R and dR are practically non-identifiable .*; only R \+ dR is\.", ending(result))
    assert (result.std > 0.3 * np.abs(result.values)).all()
    assert result.values.sum() == pytest.approx(5.0, rel=1e-3)


def test_singular_and_weak_directions_together() -> None:
    """a + b is known, a − b not at all; c to 20 of its magnitudes, d well."""
    rows = np.random.default_rng(6).standard_normal((50, 3))
    rows /= np.linalg.norm(rows, axis=0)
    rows, _ = np.linalg.qr(rows)
    jacobian = np.column_stack([rows[:, 0], rows[:, 0], rows[:, 1] / 20.0, 30.0 * rows[:, 2]])
    found = local_covariance("abcd", jacobian, np.ones(4), np.zeros(4))
    assert found.rank == 3
    none, in_effect = found.undetermined
    assert (none.level, none.names, none.std) == (IdentifiabilityLevel.NOT, ("a", "b"), math.inf)
    assert none.coefficients[0] == pytest.approx(-none.coefficients[1])
    assert (in_effect.level, in_effect.names) == (IdentifiabilityLevel.NOT_IN_EFFECT, ("c",))
    assert in_effect.std == pytest.approx(20.0)
    assert [direction_words(each).splitlines()[0] for each in found.undetermined] == [
        "a and b are not identifiable; only a + b is.",
        "c is practically non-identifiable: σ is 20 × its scale.",
    ]
    std = np.sqrt(np.diag(found.covariance))
    assert std[:2].tolist() == [math.inf, math.inf]
    assert std[2:] == pytest.approx([20.0, 1.0 / 30.0], rel=1e-9)
    assert found.leverage(jacobian).sum() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("effect", "error", "determined"),
    [
        (0.0, 5.0, IdentifiabilityLevel.NOT),  # nothing at all
        (0.01, 0.01, IdentifiabilityLevel.NOT),  # less than would ever tell it
        (3.0, 5.0, IdentifiabilityLevel.HIDDEN),  # errors where without them it would be known to a third
    ],
)
def test_what_errors_hide_does_not_count_as_without_effect(
    effect: float, error: float, determined: IdentifiabilityLevel
) -> None:
    rows, _ = np.linalg.qr(np.random.default_rng(6).standard_normal((50, 2)))
    found = local_covariance("ab", rows * [100.0, effect], np.ones(2), np.array([0.0, error]))
    (direction,) = found.undetermined
    assert (direction.level, direction.names) == (determined, ("b",))
    said = "its effect is below the solver error" if effect == 3.0 else "it has no effect on any output"
    assert direction_words(direction).startswith(f"b is not identifiable: {said}.")


def test_a_sum_of_parameters_does_not_stall_the_search() -> None:
    """Two columns are the same to the last bit, and what the reduction's rounding leaves of it is no direction to go.

    Of starts and lengths drawn at random one in a hundred stalled, this one.
    """
    rng = np.random.default_rng(58)
    t = rng.uniform(0.5, 2.0, int(rng.integers(20, 3000)))
    y = 0.1 * t + 1e-3 * rng.standard_normal(t.size)
    start = 10.0 ** rng.uniform(-3.0, 3.0, 2)
    parameters = {name: Parameter(value) for name, value in zip("ab", start.tolist(), strict=True)}
    result = identify(LeastSquares.from_function(lambda theta: t * (theta[0] + theta[1]), y, parameters))
    assert result.outcome is TerminationReason.UNDETERMINED
    assert "only a + b is." in ending(result)


def test_directions_are_told_relative_to_the_values() -> None:
    """Whatever the units are, no step is larger than one in a hundred."""
    theta, magnitudes = np.array([0.047, -3.0, 0.0, 21.5]), np.array([0.047, 3.0, 5.0, 21.5])
    null = np.array([0.5, 0.25, -0.125, 1.0])  # per cent of the magnitudes
    others = np.linalg.svd(null[None])[2][1:]
    jacobian = np.random.default_rng(8).standard_normal((50, 3)) @ others / magnitudes
    found = local_covariance(["k", "y", "z", "x"], jacobian, magnitudes, np.zeros(4), theta=theta)
    (direction,) = found.undetermined
    along = np.array(direction.coefficients) / (null * magnitudes)
    np.testing.assert_allclose(along, along[0], rtol=1e-6)
    assert str(change_remark(direction)) == (
        "No output changes along x +1 %, k +0.5 %, y +0.25 % of its scale 3, z -0.125 % of its scale 5."
    )


# --- a prior and no data, data and no prior ---------------------------------------------


def line(theta: Floats) -> Floats:
    return np.asarray(theta[0] * TIMES)


@pytest.mark.parametrize("variance", ["estimate", 1e-4])
def test_a_parameter_with_a_prior_and_no_data(variance: object) -> None:
    """It keeps its prior, and the others are what they are without it."""
    y = line(np.array([2.0])) + noise(7, 1e-2)
    words = Noise() if variance == "estimate" else Noise(1e-4)
    single = identify(LeastSquares.from_function(line, y, {"slope": Parameter(1.0)}, noise=words))
    both = identify(
        LeastSquares.from_function(
            line, y, {"slope": Parameter(1.0), "idle": Parameter(3.0, prior=Normal(2.5, 0.5))}, noise=words
        )
    )
    assert both.converged
    assert both["idle"] == pytest.approx(2.5, rel=1e-9)
    assert both.std[1] == pytest.approx(0.5, rel=1e-9)
    assert both.estimates.prior_z_score[1] == pytest.approx(0.0, abs=1e-9)
    assert both["slope"] == pytest.approx(single["slope"], rel=1e-9)
    assert both.std[0] == pytest.approx(single.std[0], rel=1e-6)
    (direction,) = both.identifiability.prior_dominated
    assert (direction.level, direction.names) == (IdentifiabilityLevel.NOT, ("idle",))
    assert direction_words(direction).startswith("idle is not identifiable: it has no effect on any output.")


def test_priors_and_no_useful_data_at_all() -> None:
    joint = JointPrior(["a", "b"], [1.0, 2.0], [[0.04, 0.01], [0.01, 0.09]])
    y = 3.0 + noise(8, 0.1)
    result = identify(
        LeastSquares.from_function(
            lambda _: np.full(600, 3.0), y, {"a": Parameter(2.0), "b": Parameter(1.0)}, joint_prior=joint
        )
    )
    assert result.converged
    assert result.values == pytest.approx([1.0, 2.0], rel=1e-6)
    np.testing.assert_allclose(result.covariance, joint.covariance, rtol=1e-9)
    assert len(result.identifiability.prior_dominated) == 2
    assert result.fit.noise_variance["y"] == pytest.approx(0.01, rel=0.15)


def test_one_sample_and_three_priors() -> None:
    """The closed form of a linear measurement with a Gaussian prior, by the Kalman gain."""
    row, prior = np.array([1.0, 2.0, -1.0]), np.array([0.5, 0.1, 2.0])
    result = identify(
        LeastSquares.from_function(
            lambda theta: np.array([row @ theta]),
            [4.0],
            {n: Parameter(1.0, prior=Normal(1.0, std)) for n, std in zip("abc", prior.tolist(), strict=True)},
            noise=Noise(0.04),
        )
    )
    gain = prior**2 * row / (row**2 @ prior**2 + 0.04)
    assert result.values == pytest.approx(1.0 + gain * (4.0 - 2.0), rel=1e-6)
    np.testing.assert_allclose(result.covariance, np.diag(prior**2) - np.outer(gain, row * prior**2), rtol=1e-6)


def test_one_run_may_need_the_prior_and_another_not() -> None:
    """`gain` per experiment: the second run has one sample, too few beside the noise; its prior holds it."""
    times = np.linspace(0.0, 2.0, 50)
    counted = np.ones((50, 2), dtype=np.bool_)
    few = np.zeros((50, 2), dtype=np.bool_)
    few[0] = True
    rng = np.random.default_rng(9)
    tables = []
    for name, gain, kept in (("first", 2.0, counted), ("second", 5.0, few)):
        y = np.column_stack([1e3 * gain * np.exp(-1.5 * times), 1e-3 * gain * np.sin(1.5 * times)])
        tables.append(
            Experiment.of_arrays(name, times, ("a", "b"), y + rng.standard_normal((50, 2)) * [2e4, 1e-3], kept)
        )
    parameters = {
        "k": Parameter(1.0, min=0.0),
        "gain": Parameter(3.0, per_experiment=True, prior=Normal(3.0, 0.3)),
    }
    result = identify(LeastSquares([Fake(), Fake()], tables, parameters, noise=Noise({"a": 4e8, "b": 1e-6})))
    assert result.converged
    assert result.std[2] == pytest.approx(0.3, rel=0.01)
    assert result.std[1] < 0.2


# --- numbers beyond all measure ---------------------------------------------------------


@pytest.mark.parametrize("magnitude", [1e-90, 1e-30, 1e30, 1e90])
@pytest.mark.parametrize("loss", ["linear", "cauchy"])
def test_absurd_magnitudes_make_no_warnings(magnitude: float, loss: str) -> None:
    """In any unit the same estimates; warnings are errors here."""
    y = 2.0 * np.exp(-3.0 * TIMES) + noise(10, 0.01)

    def scaled(theta: Floats) -> Floats:
        return np.asarray(magnitude * (theta[0] / magnitude) * np.exp(-theta[1] * magnitude * TIMES))

    def fit(factor: float, function: Callable[[Floats], Floats]) -> Result:
        parameters = {"a": Parameter(factor), "k": Parameter(1.0 / factor)}
        return identify(LeastSquares.from_function(function, factor * y, parameters, loss=loss))

    plain = fit(1.0, lambda theta: np.asarray(theta[0] * np.exp(-theta[1] * TIMES)))
    result = fit(magnitude, scaled)
    assert result.converged
    assert result.values * [1.0 / magnitude, magnitude] == pytest.approx(plain.values, rel=1e-5)
    assert result.std * [1.0 / magnitude, magnitude] == pytest.approx(plain.std, rel=1e-4)
    assert result.estimates.variance_dof == pytest.approx(plain.estimates.variance_dof, rel=1e-3)


@pytest.mark.parametrize("start", [1e-90, -1e60, 1e90])
def test_a_start_far_from_anything_makes_no_warnings(start: float) -> None:
    y = np.exp(-TIMES) + noise(11, 0.1)
    try:
        result = identify(
            LeastSquares.from_function(
                lambda theta: theta[0] * np.exp(-theta[1] * TIMES) + theta[2],
                y,
                {"a": Parameter(start), "k": Parameter(1.0), "c": Parameter(1.0)},
            )
        )
    except InputError as error:
        assert "changes no measured output" in str(error) or "change no measured output" in str(error)
    else:
        result.intervals()
        json.dumps(RESULT | as_json(result), allow_nan=False)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Parameter(1e300), "start must not exceed 1e"),
        (lambda: Parameter(1e-300), "start 1e-300 has no magnitude; give nominal"),
        (lambda: Parameter(0.0, nominal=1e-300), "nominal must be greater than 0"),
        (lambda: Normal(0.0, 1e300), "the std of a prior must not exceed"),
        (lambda: Noise(1e-300), "too extreme to calculate with"),
        (lambda: of(line, np.full(600, 1e300), slope=Parameter(1.0)), "of output 'y' is 1e\\+300 in magnitude"),
        (
            lambda: identify(of(lambda theta: np.exp(theta[0] * TIMES), TIMES, a=Parameter(1e4))),
            "the simulation with a = 10000 fails .*; start elsewhere",
        ),
    ],
)
def test_what_cannot_be_calculated_with_is_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()
