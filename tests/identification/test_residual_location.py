"""Location of the residual in time: bursts are found, noise is none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fmuid.identification import residual_stretch
from tests.support import records


@pytest.mark.parametrize(("begin", "is_first"), [(50, True), (300, False)])
def test_a_burst_is_found(begin: int, is_first: bool) -> None:
    given = records.record()
    given.measured[begin : begin + 20, 1] += 3.0
    found = residual_stretch(given)
    assert found is not None
    assert found.start >= given.times[begin] - 1e-9
    assert found.end <= given.times[begin + 19] + 1e-9
    assert found.settled == pytest.approx(given.times[80] if is_first else math.nan, abs=2e-3, nan_ok=True)
    squares = np.where(given.counted, (given.measured - given.simulated) ** 2, np.nan)
    shares = np.nansum(squares / np.nanmedian(squares, axis=0), axis=1)
    shares /= shares.sum()
    rows = (given.times >= found.start) & (given.times <= found.end)
    assert found.share == pytest.approx(shares[rows].sum()) and found.share >= 0.5


def test_noise_and_few_samples_have_none() -> None:
    assert residual_stretch(records.record()) is None
    few = records.record(samples=90)
    few.measured[60, 1] += 9.0
    assert residual_stretch(few) is None
    assert residual_stretch(replace(records.record(), kind="steady")) is None
