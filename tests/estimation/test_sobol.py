"""Sobol sequences: those of scipy, bit for bit, without its import."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import qmc

from fmuid.estimation import sobol_points
from fmuid.estimation.starting_points import MAX_DIMENSIONS


@pytest.mark.parametrize("dimensions", [1, 7, MAX_DIMENSIONS, MAX_DIMENSIONS + 1])
@pytest.mark.parametrize("count", [1, 300])
def test_points_are_those_of_scipy(dimensions: int, count: int) -> None:
    own, other = np.random.default_rng(4), np.random.default_rng(4)
    whole = qmc.Sobol(dimensions, rng=other).random_base2(9)
    np.testing.assert_array_equal(sobol_points(dimensions, count, own), whole[:count])
    assert own.random() == other.random()
    whole = qmc.Sobol(dimensions, seed=0).random_base2(9)
    np.testing.assert_array_equal(sobol_points(dimensions, count, 0), whole[:count])


COLD = """
import sys
import fmuid
found = fmuid.identify(fmuid.datasets.coil().problem(), start=[400.0, 1e-4])
assert any(each.remedy.name == "SOBOL" for each in found.history.restarts), found.history.restarts
assert "scipy.stats" not in sys.modules
"""


def test_searches_from_points_import_no_scipy_stats() -> None:
    done = subprocess.run([sys.executable, "-c", COLD], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
