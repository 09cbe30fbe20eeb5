"""Derivatives that a model gives, and differences where it refuses: against the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from fmuid.array_types import Floats
from fmuid.errors import SensitivityUnavailableError
from fmuid.estimation.finite_differences import BoundedFunction, FiniteDifferences
from fmuid.estimation.model_sensitivities import RELATIVE_ERROR, ModelSensitivities

TIMES = np.linspace(0.0, 3.0, 50)
THETA = np.array([2.0, 0.7])
FREE = np.full(2, np.inf)
NOISE = np.full(TIMES.size, 1e-9)


def decay(thetas: Floats) -> Floats:
    return np.array([a * np.exp(-k * TIMES) for a, k in thetas])


def slopes(theta: Floats) -> Floats:
    a, k = theta
    return np.array([np.exp(-k * TIMES), -a * TIMES * np.exp(-k * TIMES)])


class Model:
    """Gives its derivatives so many times, then refuses."""

    def __init__(self, times: int) -> None:
        self.left, self.said = times, list[str]()
        differences = FiniteDifferences(BoundedFunction(decay, -FREE, FREE, np.abs, decay), NOISE, 1.0, -2.0)
        self.own = ModelSensitivities(self.derivatives, differences, self.said.append)

    def derivatives(self, theta: Floats) -> Floats:
        self.left -= 1
        if self.left < 0:
            raise SensitivityUnavailableError("no derivatives today")
        return slopes(theta)


def test_what_the_model_gives_is_weighted() -> None:
    model, base = Model(9), decay(THETA[None])[0]
    np.testing.assert_allclose(model.own.jacobian(THETA, base, central=False), -2.0 * slopes(THETA), rtol=1e-14)
    error = model.own.error(THETA, central=True)
    np.testing.assert_allclose(error, RELATIVE_ERROR * 2.0 * np.linalg.norm(slopes(THETA), axis=1))
    # three times the weight, three times the noise of what is weighted: its error too
    other = model.own.weighted(-6.0, 3.0 * NOISE)
    np.testing.assert_allclose(other.error(THETA, central=True), 3.0 * error)
    np.testing.assert_allclose(other.jacobian(THETA, base, central=True), -6.0 * slopes(THETA), rtol=1e-14)
    np.testing.assert_allclose(other.error(THETA, central=True), 3.0 * error)
    assert model.said == []


def test_parameter_acts_where_its_effect_exceeds_the_noise() -> None:
    model, base = Model(9), decay(THETA[None])[0]
    assert model.own.first_jacobian(THETA, base)[1].tolist() == [True, True]
    drowned = model.own.renoised(np.full(TIMES.size, 1e6), 1.0)
    assert drowned.first_jacobian(THETA, base)[1].tolist() == [False, False]


@pytest.mark.parametrize("times", [0, 1])
def test_a_model_that_refuses_is_differentiated_from_then_on(times: int) -> None:
    model, base = Model(times), decay(THETA[None])[0]
    for _ in range(3):
        found = model.own.jacobian(THETA, base, central=True)
        np.testing.assert_allclose(found, -2.0 * slopes(THETA), rtol=1e-5, atol=1e-8)
    assert model.said == ["no derivatives today"]  # asked once more by nobody
    assert model.left == -1
    np.testing.assert_allclose(model.own.first_jacobian(THETA, base)[0], -2.0 * slopes(THETA), rtol=1e-2, atol=1e-4)
    error = model.own.error(THETA, central=True)
    assert not np.allclose(error, RELATIVE_ERROR * 2.0 * np.linalg.norm(slopes(THETA), axis=1))
