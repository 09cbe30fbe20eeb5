"""Parameters that change nothing where the search begins: friction at rest, a dead zone, and what acts nowhere."""

from typing import Any

import numpy as np
import pytest

from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.data import Parameter
from fmuid.errors import InputError
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.local_search import Marquardt
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.identification import identify

TIMES = np.arange(0.0, 6.0, 0.01)
SLIDE = {"m": 0.8, "Fc": 1.0, "d": 0.4}
DRIVE = 2.0 * np.sin(TIMES) + np.sin(3.1 * TIMES)


def slide(theta: Floats) -> Floats:
    """A mass with Coulomb and viscous friction under a force of at most 4, by an implicit step that sticks exactly."""
    m, dry, viscous = theta.tolist()
    out, v = np.empty(TIMES.size), 0.0
    for i, t in enumerate(TIMES.tolist()):
        out[i] = v
        free = v + 0.01 * (3.0 * np.sin(1.5 * t) + np.sin(4.0 * t) - viscous * v) / m
        stop = 0.01 * dry / m
        v = max(free - stop, 0.0) + min(free + stop, 0.0)
    return out


def dead_zone(theta: Floats) -> Floats:
    gain, width, drift = theta[:3]
    return np.asarray(gain * (np.maximum(DRIVE - width, 0.0) + np.minimum(DRIVE + width, 0.0)) + drift * TIMES)


def noisy(y: Floats) -> Floats:
    return np.asarray(y + 0.02 * np.random.default_rng(1).standard_normal(y.size))


def check(result: Result, truth: list[float]) -> None:
    assert result.converged, result.outcome
    assert (np.abs(result.values - truth) < 4.0 * result.std).all()
    assert result.history.simulations < 400


@pytest.mark.parametrize(
    ("bounds", "start"),
    [
        ({}, (2.0, 8.0, 1.0)),
        ({"min": 0.0, "max": 20.0}, (2.0, 8.0, 1.0)),
        pytest.param({"min": 0.0}, (0.5, 5.0, 0.1), marks=pytest.mark.slow),
    ],
)
def test_friction_at_rest(bounds: dict[str, Any], start: tuple[float, ...]) -> None:
    """Nothing moves at the start: neither friction nor mass shows until the Coulomb friction is less."""
    parameters = {name: Parameter(value, **bounds) for name, value in zip(SLIDE, start, strict=True)}
    assert not slide(np.array(start)).any()
    problem = LeastSquares.from_function(slide, noisy(slide(np.array(list(SLIDE.values())))), parameters)
    result = identify(problem)
    check(result, list(SLIDE.values()))
    replaced = result.identifiability.replaced_initial_guess
    assert "Fc" in replaced
    assert result.estimates.start[1] < 4.0
    assert as_json(result)["identifiability"]["replaced_initial_guess"] == list(replaced)
    if not bounds:  # the same points every time
        assert identify(problem).values.tolist() == result.values.tolist()


@pytest.mark.parametrize(("bounds", "fragile"), [({}, False), ({"min": 0.0, "max": 10.0}, True)])
def test_dead_zone_that_nothing_leaves(bounds: dict[str, Any], fragile: bool) -> None:
    """Points of the box that cannot be simulated are no reason to refuse."""

    def function(theta: Floats) -> Floats:
        if fragile and theta[1] < 0.5:
            raise ZeroDivisionError
        return dead_zone(theta)

    parameters = {"gain": Parameter(1.0), "width": Parameter(6.0, **bounds), "drift": Parameter(0.2)}
    result = identify(LeastSquares.from_function(function, noisy(dead_zone(np.array([1.5, 0.9, 0.1]))), parameters))
    check(result, [1.5, 0.9, 0.1])
    assert result.identifiability.replaced_initial_guess == ("width",)
    assert result.estimates.start[[0, 2]].tolist() == [1.0, 0.2]


def test_parameter_without_effect_anywhere_is_refused() -> None:
    parameters = {"gain": Parameter(1.0), "width": Parameter(6.0), "drift": Parameter(0.2), "idle": Parameter(3.0)}
    problem = LeastSquares.from_function(dead_zone, noisy(dead_zone(np.array([1.5, 0.7, 0.1]))), parameters)
    with pytest.raises(InputError, match=r"'idle'.*40 "):
        Marquardt().search(evaluator := Evaluator(problem))
    assert evaluator.simulations < 120
