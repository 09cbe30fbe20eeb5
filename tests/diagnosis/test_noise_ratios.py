"""Noise of a record beside that of healthy records: level, size, name; monitored windows."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import fmuid
from experiments.coil import study as coil
from fmuid.diagnosis.noise_ratios import NoiseRatios
from tests.support.operated_coil import FAULTS, SAMPLES, baseline, monitor, operated, record


def noisier(made: fmuid.Experiment, std: float, seed: int) -> fmuid.Experiment:
    """Return a record with more noise of its current."""
    frame = made.frame.copy()
    frame["i"] += std * np.random.default_rng(seed).standard_normal(len(frame))
    return replace(made, frame=frame)


def test_the_level_holds_between_records_of_unequal_noise() -> None:
    """Ten records and a new one of 500 samples, whose noise differs by 10 % of its variance between records."""
    rng = np.random.default_rng(1)

    def ratios(count: int) -> NoiseRatios:
        drawn = np.exp(0.1 * rng.standard_normal((count, 2))) * rng.chisquare(500, (count, 2)) / 500
        return NoiseRatios(drawn, np.full((count, 2), 500.0))

    chances = [new.probability for _ in range(300) for new in ratios(10).compared(ratios(1))]
    assert stats.kstest(chances, "uniform").pvalue > 0.01
    healthy = ratios(10)
    (doubled, same) = healthy.compared(NoiseRatios(np.array([[2.0, 1.0]]), np.full((1, 2), 500.0)))
    assert doubled.is_larger(1e-3)
    assert not same.is_larger(0.5)
    assert doubled.size[0] == pytest.approx(np.sqrt(2.0 / np.exp(np.mean(np.log(healthy.ratios[:, 0])))) - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("draws", [3, pytest.param(200, marks=pytest.mark.campaign)])
def test_a_noisier_sensor_is_named_and_hides_no_fault(draws: int) -> None:
    """Ten healthy records of other operating points; noise of 1, 1.5 and 3 times theirs, with and without a fault."""
    rng = np.random.default_rng([51, 0])
    healthy = baseline([operated(rng) for _ in range(10)])
    found: dict[tuple[float, float], Counter[str]] = {}
    inside = 0
    for factor, turns in ((1.0, 0.0), (1.5, 0.0), (3.0, 0.0), (1.5, 1.0), (3.0, 1.0)):
        for draw in range(draws):
            made = operated(np.random.default_rng([52, draw]), turns=turns)
            made = noisier(made, 0.01 * np.sqrt(factor**2 - 1.0), draw)
            seen = fmuid.diagnose(made, healthy, FAULTS, coil.models()[0])
            said = [each.label for one in seen.evidence.explanations for each in one.changes]
            found.setdefault((factor, turns), Counter())[f"{seen.kind} {' '.join(said)}".strip()] += 1
            low, high = seen["noise(i)"].interval()
            inside += low < factor - 1.0 < high
    print(found, inside)
    least = 0.95 * draws - 1
    assert found[1.0, 0.0]["healthy"] >= least
    assert min(found[factor, 0.0]["other noise(i)"] for factor in (1.5, 3.0)) >= least
    assert (
        min(
            found[factor, 1.0]["fault turns.dR noise(i)"] + found[factor, 1.0]["fault turns.dR"]
            for factor in (1.5, 3.0)
        )
        >= least
    )
    assert inside >= 0.92 * 5 * draws - 1


@pytest.mark.slow
@pytest.mark.parametrize("draws", [3, pytest.param(200, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("with_records", [False, True])
def test_a_noisier_sensor_is_no_fault_of_the_machine(with_records: bool, draws: int) -> None:
    found: Counter[str] = Counter()
    for draw in range(draws):
        rng = np.random.default_rng([53, draw])
        made = monitor(rng, "white", with_records=with_records)
        made.add(noisier(record(rng, "white", SAMPLES), 0.0224 * np.sqrt(3.0), draw))
        found.update({alarm.fault for alarm in made.alarms})
    print(found)
    assert found[fmuid.diagnosis.SOMETHING_ELSE] == draws
    assert found.total() - draws <= 0.03 * draws
