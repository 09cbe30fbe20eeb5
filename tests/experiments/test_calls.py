"""Campaigns of calls: what is shared between records is what each would give by itself, and pages show the counts."""

from __future__ import annotations

import math
import re
from decimal import Context, Decimal
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import fmuid
from experiments import calls, pages
from experiments.coil import calls as coil
from experiments.coil import squared, study
from experiments.machine_faults import calls as machine
from experiments.machine_faults import detectable, neighbours
from experiments.machine_faults.machine import TURNS
from fmuid.diagnosis import ChangeEvidence
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import fit
from fmuid.diagnosis.information_matrix import ScoreStatistics


def test_a_record_of_the_campaign_is_as_by_itself(tmp_path: Path) -> None:
    """Linearised anew where it is estimated, beside an identification of its healthy record: `fmuid.diagnose`."""
    case = "turns, ΔR = 1 Ω"
    campaign = calls.Campaign(coil.setting(), tmp_path / "calls.csv")
    for k in range(2):  # the second one is near the first
        campaign.examined(case, np.random.default_rng([1, k]))
    found = campaign.examined(case, np.random.default_rng([1, 2]))
    rng = np.random.default_rng([1, 2])
    healthy, new = (calls.noisy(coil.clean(off), rng, coil.STD, 0.0) for off in (coil.SOUND, coil.CASES[case].new))
    known = study.identify(healthy.frame)
    inflate = {n: math.hypot(1.0, d / float(known.std[known.names.index(n)])) for n, d in coil.DRIFT.items()}
    turns = fmuid.Fault(
        study.models()[1], {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": known["L"] / known["R"]}
    )
    baseline = fmuid.Baseline(known, inflate, records=[healthy])
    alone = fmuid.diagnose(new, baseline, {"turns": turns}, study.models()[0]).evidence
    assert isinstance(alone, ChangeEvidence)
    change = alone.explanations[0].changes[0]
    best = found.naming.named[0]
    assert (change.label, len(alone.explanations)) == (best.names[0], len(found.naming.named))
    assert best.fit.sizes[0] == pytest.approx(change.value, abs=0.3 * change.std)
    assert math.sqrt(best.fit.covariance[0, 0]) == pytest.approx(change.std, rel=0.1)
    assert found.evidence.remainder.probability == pytest.approx(alone.remainder.probability, abs=0.05)


@pytest.mark.slow
def test_columns_in_phases_are_differences() -> None:
    """Of what sensors and supply do to the readings, and of the faults, in the stator's axes."""
    setting = machine.setting()
    model, point = setting.machine("white noise", False), setting.coordinates.healthy.copy()
    names = [each.name for each in setting.coordinates.each]
    point[names.index("gain(ia)")] = 0.02
    point[names.index("stator.fault.eta_b")] = 0.004
    _, columns = model.linearize(point)
    for name, step in (("Rs", 0.02), ("stator.fault.eta_a", 1e-4), ("input gain(uc)", 1e-3), ("delay(ia)", 1e-5)):
        i = names.index(name)
        ends = [model.linearize(point + sign * step * np.eye(point.size)[i])[0] for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(columns[:, :, i] - slope).max() < 2e-3 * np.abs(slope).max(), name


def test_the_models_give_the_machine_s_currents() -> None:
    """Healthy, with errors of sensors and supply, and with few turns shorted: within a share of the noise."""
    setting = machine.setting()
    for case, most in (("white noise", 0.01), ("sensors and supply off in both", 0.02), ("2 turns of a", 0.3)):
        model, point = setting.machine(case, True), setting.coordinates.healthy.copy()
        names = [each.name for each in setting.coordinates.each]
        off = machine.CASES[case].new
        sizes = machine.Case(off).right
        for name, size in sizes.items():
            point[names.index(name)] = size
        left = model.experiment.output_values - model.linearize(point)[0]
        assert left.std() < most * machine.STD, case
    assert sizes == {"stator.fault.eta_a": 2 / TURNS}


def test_rates_have_their_exact_intervals() -> None:
    low, high = calls.interval(4, 400)
    assert stats.binom.sf(3, 400, low / 100) == pytest.approx(0.025, rel=1e-6)
    assert stats.binom.cdf(4, 400, high / 100) == pytest.approx(0.025, rel=1e-6)
    assert calls.interval(0, 10)[0] == 0.0
    assert calls.interval(10, 10)[1] == 100.0
    assert [calls.rate(each) for each in ([True, False], [True], [])] == ["50.0 (1.3–98.7)", "100", ""]


@pytest.mark.slow
@pytest.mark.parametrize("module", [detectable, neighbours])
def test_the_page_shows_how_few_turns_are_called_and_which_bars(module: ModuleType) -> None:
    page = (module.HERE / "README.md").read_text(encoding="utf-8")
    now = pages.insert(page, {module.__name__.rsplit(".")[-1]: module.shown()})
    number = r"\d+\.\d+(?:e[-+]\d+)?"
    assert re.sub(number, "", now) == re.sub(number, "", page)
    for shown, kept in zip(re.findall(number, now), re.findall(number, page), strict=True):
        digits = len(Decimal(kept).as_tuple().digits)  # the last one is the processor's
        step = Decimal(kept).next_plus(Context(prec=digits)) - Decimal(kept)
        assert abs(Decimal(shown) - Decimal(kept)) <= step, (shown, kept)


def test_one_test_of_some_sizes_that_are_not_negative() -> None:
    """Beside the fit of causes with signs, which goes another way."""
    random = np.random.default_rng(3)
    factor = random.standard_normal((3, 3))
    information, scores = factor @ factor.T, random.standard_normal((50, 3))
    signed = [Cause(name, (i,), 1.0, 1) for i, name in enumerate("abc")]
    alone = [fit(ScoreStatistics(information, score), signed).statistic for score in scores]
    assert detectable.fallen(scores, information) == pytest.approx(np.array(alone))


@pytest.mark.slow
@pytest.mark.parametrize(("module", "case"), [(coil, "sensor's delay, 1 ms"), (machine, "sensor a, gain + 3 %")])
def test_the_committed_records_are_these(module: ModuleType, case: str, tmp_path: Path) -> None:
    found = pd.read_csv(module.HERE / "calls.csv", keep_default_na=False)
    there = found[(found["case"] == case) & (found["record"] == 0)].iloc[0]
    again = calls.Campaign(module.setting(), tmp_path / "none.csv").row(case, module.KEYS[case], 0)
    assert again["named"] == there["named"]
    assert again["D"] == pytest.approx(float(there["D"]), rel=1e-3)


def test_a_quarter_of_the_turns_is_seen_by_the_model_with_their_square(tmp_path: Path) -> None:
    off = {}
    for kind, unit in (("exact", 1.0), ("linear", -study.R)):
        found = calls.Campaign(squared.setting(kind), tmp_path / "none.csv").examined("0.25", np.random.default_rng(5))
        size = found.naming.named[0].fit
        off[kind] = (size.sizes[0] / unit - 0.25) / abs(size.covariance[0, 0] ** 0.5 / unit)
    assert abs(off["exact"]) < 2.0
    assert off["linear"] < -1.5
