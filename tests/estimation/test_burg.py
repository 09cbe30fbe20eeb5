"""Burg's recursion over all columns at once, against the plain one sample by sample."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from fmuid.array_types import Floats
from fmuid.estimation.noise import autoregression


def plain_burg(columns: Floats, weights: Floats, there: NDArray[np.bool_], orders: int) -> list[float]:
    """Return the reflection coefficients of Burg's recursion, sample by sample of every segment without gaps."""
    ahead = [dict(enumerate(column)) for column in columns.tolist()]
    behind, found = [dict(column) for column in ahead], []
    for order in range(1, orders + 1):
        ends = [t for t in range(order, there.size) if there[t - order : t + 1].all()]
        cross = sum(w * f[t] * b[t - 1] for w, f, b in zip(weights, ahead, behind, strict=True) for t in ends)
        power = sum(
            w * (f[t] ** 2 + b[t - 1] ** 2) for w, f, b in zip(weights, ahead, behind, strict=True) for t in ends
        )
        k = 2.0 * cross / power
        found.append(k)
        pairs = [
            {t: (f[t] - k * b[t - 1], b[t - 1] - k * f[t]) for t in ends} for f, b in zip(ahead, behind, strict=True)
        ]
        ahead = [{t: each for t, (each, _) in pair.items()} for pair in pairs]
        behind = [{t: each for t, (_, each) in pair.items()} for pair in pairs]
    return found


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("share", [1.0, 0.97])
def test_burg_is_the_plain_recursion_of_all_columns(share: float, order: Literal["C", "F"]) -> None:
    rng = np.random.default_rng(21)
    there = rng.random(150) < share
    columns = np.array(lfilter([1.0], [1.0, -1.6, 0.9], rng.standard_normal((5, 150))) * there, order=order)
    weights = np.array([1.0, 0.1, -0.1, 0.1, -0.1])
    found, scores = autoregression._burg(columns, weights, there, 8)
    assert len(scores) == 8
    np.testing.assert_allclose(found, plain_burg(columns, weights, there, 8), rtol=1e-9, atol=1e-12)
