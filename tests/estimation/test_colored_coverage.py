"""Coverage of intervals, and rejections by tests, under colored noise: the study of experiments/coverage."""

import math

import numpy as np
import pytest

from experiments.coverage.colored_noise import LEVEL, count

CHECKED = {
    "AR(1) 0.8": 200,
    "AR(1) 0.5, a third missing": 200,
    "AR(1) 0.5": 40,
    "truth on a bound": 200,
    "white and slow": 1500,
    "white": 200,
}
MANY = [pytest.param(case, 200, marks=pytest.mark.campaign) for case in CHECKED]
FEW = [pytest.param(case, 50, marks=pytest.mark.slow) for case in ("AR(1) 0.5", "white")]


@pytest.mark.parametrize(("case", "draws"), FEW + MANY)
def test_intervals_and_tests_hold_under_colored_noise(case: str, draws: int) -> None:
    """By four standard errors of the draws."""
    found = count(case, CHECKED[case], draws, 25)
    assert found.local / draws > LEVEL - 4.0 * math.sqrt(LEVEL * (1.0 - LEVEL) / draws)
    assert found.plain / draws < 0.85 or case == "white"
    assert np.median(found.wider) < 1.05 or case != "white"
    assert min(found.profile, found.posterior) / found.more > 0.7
    assert max(found.ratio, found.wald) / draws < 0.06
