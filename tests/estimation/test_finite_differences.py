"""Derivatives against analytic ones, of smooth, noisy, failing and bounded functions, and by a model."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fmuid import Parameter
from fmuid.array_types import Floats
from fmuid.errors import SensitivityUnavailableError
from fmuid.estimation import LeastSquares, SensitivityError, SensitivityMethod
from fmuid.estimation.finite_differences import BoundedFunction, Derivatives
from fmuid.estimation.simulation_noise import noise_level, noise_steps, shares_of
from fmuid.identification import identify

Function = Callable[[Floats], Floats]

TIMES = np.linspace(0.0, 4.0, 300)
THETA = np.array([2.0, 0.7, -0.3])
FREE = np.full(3, -np.inf), np.full(3, np.inf)


def decay(thetas: Floats) -> Floats:
    return np.array([a * np.exp(-k * TIMES) + c * TIMES**2 for a, k, c in thetas])


def decay_jacobian(theta: Floats) -> Floats:
    a, k, _ = theta
    return np.array([np.exp(-k * TIMES), -a * TIMES * np.exp(-k * TIMES), TIMES**2])


def magnitudes(theta: Floats) -> Floats:
    return np.maximum(np.abs(theta), 0.1)


def bounded_function(function: Function, bounds: tuple[Floats, Floats] = FREE, **model: Any) -> BoundedFunction:
    return BoundedFunction(function, *bounds, magnitudes, function, **model)


def level(function: Function, theta: Floats = THETA, bounds: tuple[Floats, Floats] = FREE) -> float:
    shares = shares_of(np.zeros(function(theta[None]).shape[1], dtype=np.intp), 1)
    steps = noise_steps(magnitudes(theta), theta - bounds[0], bounds[1] - theta)
    return float(noise_level(function, theta, steps, shares)[1][0])


def differences(
    function: Function, theta: Floats = THETA, bounds: tuple[Floats, Floats] = FREE
) -> tuple[Derivatives, Floats]:
    base = function(theta[None])[0]
    noise = np.full(base.size, level(function, theta, bounds))
    return Derivatives(bounded_function(function, bounds), noise, float(np.sqrt(np.mean(base**2)))), base


def error(found: Floats, expected: Floats) -> float:
    return float(np.max(np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)))


def test_noise_of_each_output() -> None:
    """Of smooth functions and strong oscillations it is rounding."""
    assert 1e-17 < level(decay) < 1e-15
    assert level(lambda thetas: np.array([a * np.sin(400.0 * k * TIMES + c) for a, k, c in thetas])) < 1e-11
    rng = np.random.default_rng(6)
    groups = np.arange(300, dtype=np.intp) % 2

    def noisy(thetas: Floats) -> Floats:
        return decay(thetas) + np.where(groups, 1e-2, 1e-7) * rng.standard_normal((len(thetas), TIMES.size))

    steps = noise_steps(magnitudes(THETA), THETA - FREE[0], FREE[1] - THETA)
    base, noise = noise_level(noisy, THETA, steps, shares_of(groups, 2))
    np.testing.assert_allclose(noise, [1e-7, 1e-2], rtol=0.3)
    np.testing.assert_allclose(base, decay(THETA[None])[0], atol=0.06)


def test_noise_is_measured_inside_the_bounds() -> None:
    lower, upper = np.array([2.0, 0.7 - 1e-9, -1.0]), np.array([9.0, 0.7, 1.0])

    def bounded(thetas: Floats) -> Floats:
        assert (thetas >= lower).all()
        assert (thetas <= upper).all()
        return decay(thetas)

    assert level(bounded, bounds=(lower, upper)) < 1e-15
    finite, base = differences(bounded, bounds=(lower, upper))
    found, _ = finite.first_jacobian(THETA, base)
    assert error(found[[0, 2]], decay_jacobian(THETA)[[0, 2]]) < 1e-8
    assert error(found, decay_jacobian(THETA)) < 1e-4  # the second parameter has only 1e-9 of room
    assert error(finite.jacobian(THETA, base, central=False)[[0, 2]], decay_jacobian(THETA)[[0, 2]]) < 1e-7


@pytest.mark.parametrize(
    ("digits", "forward", "central"), [(99, 3e-8, 3e-9), (6, 3e-3, 3e-4), (4, 3e-2, 4e-3), (3, 0.1, 2e-2)]
)
def test_jacobian_of_outputs_that_jump(digits: int, forward: float, central: float) -> None:
    """Rounded outputs are piecewise constant: a difference over a blind 1e-8 would be zero or enormous."""
    finite, base = differences(lambda thetas: np.round(decay(thetas), digits) if digits < 99 else decay(thetas))
    first, acting = finite.first_jacobian(THETA, base)
    exact = decay_jacobian(THETA)
    assert acting.all()
    assert error(first, exact) < 3 * central
    assert error(finite.jacobian(THETA, base, central=False), exact) < forward
    assert error(finite.jacobian(THETA, base, central=True), exact) < central


def test_failing_neighbours_are_avoided() -> None:
    def fragile(thetas: Floats) -> Floats:
        outputs = decay(thetas)
        outputs[(thetas[:, 0] > 2.0) | (thetas[:, 1] < 0.7) | (np.abs(thetas[:, 2] + 0.3) > 1e-6)] = np.nan
        return outputs

    finite, base = differences(fragile)
    found, acting = finite.first_jacobian(THETA, base)
    assert acting.all()
    assert error(found, decay_jacobian(THETA)) < 1e-3
    assert error(finite.jacobian(THETA, base, central=False), decay_jacobian(THETA)) < 1e-3

    def lonely(thetas: Floats) -> Floats:
        outputs = decay(thetas)
        outputs[thetas[:, 1] != 0.7] = np.nan
        return outputs

    base = decay(THETA[None])[0]
    finite = Derivatives(bounded_function(lonely), np.full(300, 1e-16), 1.0)
    with pytest.raises(SensitivityError) as caught:
        finite.jacobian(THETA, base, central=False)
    assert caught.value.index == 1


def test_influence_is_told_from_noise() -> None:
    """The second parameter does nothing; the third one little, but more than the noise at a tenth of its magnitude."""
    rng = np.random.default_rng(7)

    def weak(thetas: Floats) -> Floats:
        noise = 1e-5 * rng.standard_normal((len(thetas), TIMES.size))
        return np.array([a * np.exp(-TIMES) + 3e-3 * c * TIMES for a, _, c in thetas]) + noise

    finite, base = differences(weak)
    found, acting = finite.first_jacobian(THETA, base)
    assert acting.tolist() == [True, False, True]
    assert error(found[2:], 3e-3 * TIMES[None]) < 0.1


def test_model_derivatives_are_weighted_until_the_model_refuses() -> None:
    noise, base, given = np.full(300, 1e-9), decay(THETA[None])[0], [True] * 5

    def by_model(theta: Floats) -> Floats | None:
        return decay_jacobian(theta) if given and given.pop() else None

    own = Derivatives(bounded_function(decay, derivatives=by_model), noise, 1.0, -2.0)
    first, acting = own.first_jacobian(THETA, base)
    assert acting.all()
    np.testing.assert_allclose(first, -2.0 * decay_jacobian(THETA), rtol=1e-14)
    stated = own.error(THETA, central=True)
    np.testing.assert_allclose(stated, 1e-6 * 2.0 * np.linalg.norm(decay_jacobian(THETA), axis=1))
    other = own.weighted(-6.0, 3.0 * noise)  # three times the weight, three times the noise: the error too
    np.testing.assert_allclose(other.error(THETA, central=True), 3.0 * stated)
    np.testing.assert_allclose(other.jacobian(THETA, base, central=True), 3.0 * first, rtol=1e-14)
    np.testing.assert_allclose(other.error(THETA, central=True), 3.0 * stated)
    drowned = own.renoised(np.full(300, 1e6), 1.0)
    assert not drowned.first_jacobian(THETA, base)[1].any()
    given.clear()
    assert error(own.jacobian(THETA, base, central=True), -2.0 * decay_jacobian(THETA)) < 1e-5
    assert not np.allclose(own.error(THETA, central=True), stated)


def test_model_is_asked_until_it_refuses() -> None:
    asked, times = [], np.linspace(0.0, 4.0, 300)

    def refusing(theta: Floats) -> Floats:
        asked.append(theta)
        if len(asked) > 2:
            raise SensitivityUnavailableError("no derivatives today")
        return decay_jacobian(theta)[:, :, None]

    parameters = {name: Parameter(start) for name, start in zip("akc", THETA.tolist(), strict=True)}
    measured = decay(np.array([[2.5, 0.8, -0.2]]))[0] + 0.01 * np.random.default_rng(2).standard_normal(300)
    plain = LeastSquares.from_function(lambda theta: decay(theta[None])[0], measured, parameters, times=times)
    problem = LeastSquares(
        plain.predictors, plain.experiments, parameters, sensitivity="forward", derivatives=[refusing]
    )
    found = identify(problem)
    assert found.setup.sensitivity == SensitivityMethod("forward", refusal="no derivatives today")
    assert len(asked) == 3
    np.testing.assert_allclose(found.values, identify(plain).values, rtol=1e-5)
