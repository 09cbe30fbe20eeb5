"""Linear models of operating points: against the derivatives of the equations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fmuid import Numerics, System
from fmuid.array_types import Floats
from fmuid.simulation.point_model import ModelOfPoints, PointModel
from tests.support.packing import changed
from tests.support.resting import KINKED, SATURATED

STATES = np.array([[0.05, 50.0], [0.2, 80.0]])
THETA = np.array([[0.6, 1.1]])
INPUTS = {"u": np.array([24.0, 48.0]), "load": np.array([0.2, 1.0])}


def model_of(path: Path, parameters: tuple[str, ...], inputs: dict[str, Floats], outputs: list[str]) -> PointModel:
    system = System(path, numerics=Numerics("model-exchange"))
    return PointModel(ModelOfPoints(system, parameters, {}, "points"), inputs, tuple(inputs), outputs, {})


def saturated(r: float, k: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return A, B, C, D of the saturated motor at its states (psi, w)."""
    found = []
    for psi, w in STATES:
        slope, i = 1.0 / 0.02 + 2700.0 * psi**2, psi / 0.02 + 900.0 * psi**3
        rates = [[-r * slope - k * w, -k * psi], [100.0 * k * (i + psi * slope), -0.2]]
        found.append((rates, [[1.0, 0.0], [0.0, -100.0]], [[slope, 0.0], [0.0, 1.0]], np.zeros((2, 2))))
    a, b, c, d = (np.array(each) for each in zip(*found, strict=True))
    return a, b, c, d


@pytest.mark.parametrize(("stated", "close"), [(True, 1e-13), (False, 1e-6)], ids=["directional", "differences"])
def test_linear_models_are_those_of_the_equations(
    made: Callable[[str], Path], tmp_path: Path, stated: bool, close: float
) -> None:
    path = made(SATURATED)
    path = path if stated else changed(path, tmp_path, 'providesDirectionalDerivative="true"', "")
    model = model_of(path, ("R", "k"), INPUTS, ["i", "w"])
    order = [model.states.index(name) for name in ("psi", "w")]
    found = model.at(STATES[:, np.argsort(order)], THETA)
    a, b, c, d = saturated(*THETA[0])
    for own, right in zip((found.a[0][:, order][..., order], found.b[0][:, order]), (a, b), strict=True):
        np.testing.assert_allclose(own, right, rtol=close, atol=close * np.abs(right).max())
    for own, right in zip((found.c[0][..., order], found.d[0]), (c, d), strict=True):
        np.testing.assert_allclose(own, right, rtol=close, atol=close * np.abs(c).max())


def test_derivatives_that_differences_contradict_are_not_used(made: Callable[[str], Path]) -> None:
    """At a kink the FMU gives the slope of one side."""
    model = model_of(made(KINKED), ("a",), {"u": np.array([0.5])}, ["x"])
    for _ in range(2):
        found = model.at(np.array([[1.0]]), np.array([[1.0]]))
        np.testing.assert_allclose(found.a, [[[[-1.5]]]], rtol=1e-9)
        np.testing.assert_allclose(found.b, [[[[1.0]]]], rtol=1e-9)
        np.testing.assert_allclose(found.rates, [[[0.5]]], rtol=1e-12)
