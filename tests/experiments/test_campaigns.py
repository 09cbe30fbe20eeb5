"""Campaigns whose counts the pages state: far starts, coverage of intervals, monitoring windows without a change."""

import math

import pytest
from scipy import stats

from experiments.coil import onsets
from experiments.coverage.colored_noise import LEVEL, count
from experiments.starts import study as starts

pytestmark = pytest.mark.campaign
COLORED = ["white", "AR(1) 0.2", "AR(1) 0.5", "AR(1) 0.8", "AR(2), oscillating"]


@pytest.mark.parametrize("case", starts.CASES)
def test_all_machines_are_found_from_far_starts(case: str) -> None:
    kind, least, most = starts.CASES[case]
    found = [starts.searched(kind, seed, least, most, remedies=True) for seed in range(2000, 2040)]
    assert [each["seed"] for each in found if not each["found"]] == []


@pytest.mark.parametrize("samples", [200, 1000])
@pytest.mark.parametrize("case", [*COLORED, "two outputs, crossed", "AR(1) 0.5, a third missing"])
def test_intervals_contain_the_true_value_as_often_as_stated(case: str, samples: int) -> None:
    draws = 400
    held = count(case, samples, draws).local / draws
    assert held == pytest.approx(LEVEL, abs=3.0 * math.sqrt(LEVEL * (1.0 - LEVEL) / draws))


@pytest.mark.parametrize("case", ["nothing", "nothing, all causes"])
def test_ten_thousand_windows_without_a_change(case: str) -> None:
    """In recordings of 24 windows, at a false-alarm rate of 1 % per recording."""
    draws = 420
    alarms = sum(int(onsets.drawn(case, 1000 + draw)["alarm"]) for draw in range(draws))
    assert alarms <= stats.binom.ppf(0.999, draws, 0.01)
