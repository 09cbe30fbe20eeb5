"""What experiments bring, and contradictions: closed forms of a straight line in two records."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.data import FrequencyExperiment, Response, SteadyExperiment
from fmuid.estimation import Reason
from fmuid.identification import find_contributions, judge
from tests.support.resting import three_tests

COIL = fmuid.datasets.coil()
LEVEL = 0.02


def table(resistance: float = 4.0, seed: int = 1) -> SteadyExperiment:
    voltages = np.linspace(2.0, 12.0, 6)
    current = voltages / resistance + LEVEL * np.random.default_rng(seed).normal(size=6)
    return SteadyExperiment(pd.DataFrame({"u": voltages, "i": current}), ["u"], ["i"], name="table")


def spectrum(inductance: float = 0.1) -> FrequencyExperiment:
    frequencies = np.logspace(-1, 2, 31)
    random = np.random.default_rng(2)
    noise = 0.01 * (random.normal(size=31) + 1j * random.normal(size=31))
    values = (4.0 + 2j * np.pi * frequencies * inductance) * (1.0 + noise)
    frame = pd.DataFrame({"f": frequencies, "re": values.real, "im": values.imag})
    response = {"Z": Response("u / i", real="re", imaginary="im")}
    return FrequencyExperiment(frame, frequency="f", responses=response, name="spectrum")


def problem(*experiments: fmuid.Experiment) -> fmuid.Problem:
    free = {"R": fmuid.Parameter(3.0, min=0.1), "L": fmuid.Parameter(0.2, min=0.01)}
    return fmuid.Problem(COIL.fmu, list(experiments), free)


def test_widening_is_that_of_fits_without_the_experiment() -> None:
    both = problem(table(), spectrum())
    result = fmuid.identify(both)
    found = find_contributions(both, result)
    assert found is not None
    alone = fmuid.identify(problem(spectrum()))
    first, second = found.parts
    assert (first.experiment, second.experiment) == ("table", "spectrum")
    assert first.widening[0] == pytest.approx(alone.std[0] / result.std[0], rel=0.1)
    assert first.widening[1] == pytest.approx(1.0, abs=0.01)
    assert second.widening[1] == np.inf  # steady states show no inductance
    assert first.degrees == second.degrees == 1
    assert first.probability == pytest.approx(second.probability)
    assert first.probability > 0.05
    assert not found.contradictions


@pytest.mark.parametrize(("resistance", "contradicts"), [(4.0, False), (4.4, True)])
def test_experiments_that_contradict_are_named(resistance: float, contradicts: bool) -> None:
    given = problem(table(resistance), spectrum())
    result = fmuid.identify(given)
    found = fmuid.assess(given, result)
    assert found.contributions is not None
    assert bool(found.contributions.contradictions) is contradicts
    reasons = [each.reason for each in judge(result, found).doubts]
    assert (Reason.EXPERIMENTS_CONFLICT in reasons) is contradicts


@pytest.mark.slow
def test_probabilities_are_uniform_without_contradiction() -> None:
    found = []
    for seed in range(30):
        given = problem(table(seed=100 + seed), spectrum())
        made = find_contributions(given, fmuid.identify(given))
        assert made is not None
        found.append(made.parts[0].probability)
    assert 0.3 < np.mean(found) < 0.7
    assert min(found) > 1e-3


def test_leverage_sums_to_the_parameters() -> None:
    given = problem(table(), spectrum())
    found = find_contributions(given, fmuid.identify(given))
    assert found is not None
    assert sum(float(np.nansum(each)) for each in found.leverage) == pytest.approx(2.0, rel=0.02)
    assert [each.shape for each in found.std] == [(6, 1), (31, 2)]


def test_one_experiment_in_time_has_none() -> None:
    given = problem(COIL.experiment)
    assert find_contributions(given, fmuid.identify(given)) is None


def test_an_empty_row_has_no_leverage() -> None:
    frame = three_tests()[["U"]].assign(i=lambda each: each["U"] / 4.0).rename(columns={"U": "u"})
    frame.loc[0, "i"] = np.nan
    given = problem(SteadyExperiment(frame, ["u"], ["i"]), spectrum())
    found = find_contributions(given, fmuid.identify(given))
    assert found is not None
    assert np.isnan(found.leverage[0][0, 0])
