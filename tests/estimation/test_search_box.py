"""The box that a global search draws from."""

from __future__ import annotations

import numpy as np
import pytest

from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from tests.support.sinusoids import box


def test_box_is_logarithmic_over_decades() -> None:
    found = box(
        wide=Parameter(1.0, min=0.1, max=10.0),
        narrow=Parameter(1.0, min=1.0, max=9.0),
        signed=Parameter(1.0, min=-10.0, max=10.0),
        zero=Parameter(1.0, min=0.0, max=10.0),
    )
    assert found.logarithmic.tolist() == [True, False, False, False]
    np.testing.assert_allclose(found.thetas(np.full((1, 4), 0.5)), [[1.0, 5.0, 0.0, 5.0]])
    corners = found.thetas(np.array([np.zeros(4), np.ones(4)]))
    np.testing.assert_allclose(corners, [found.lower, found.upper], rtol=1e-15)
    assert (corners >= found.lower).all()
    assert (corners <= found.upper).all()
    units = np.random.default_rng(0).uniform(size=(50, 4))
    np.testing.assert_allclose(found.units(found.thetas(units)), units, atol=1e-12)
    np.testing.assert_array_equal(found.units(np.array([[100.0, -1.0, -11.0, 5.0]])), [[1.0, 0.0, 0.0, 0.5]])


def test_box_from_a_prior() -> None:
    found = box(a=Parameter(1.0, prior=Normal(2.0, 0.1)), b=Parameter(1.0, min=0.0, prior=Normal(2.0, 1.0)))
    np.testing.assert_allclose(found.lower, [1.5, 0.0])
    np.testing.assert_allclose(found.upper, [2.5, 7.0])


def test_box_needs_bounds() -> None:
    for loose, word in ((Parameter(1.0, min=0.0), "max"), (Parameter(1.0, max=9.0), "min")):
        with pytest.raises(InputError, match=f"'Lf'.*{word}"):
            box(Rs=Parameter(1.0, min=0.0, max=2.0), Lf=loose)
