"""Monitoring in windows: against diagnoses and weighted least squares; a coil that warms up and fails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil
from fmuid import Monitor, Rule
from fmuid.data import BEGIN, read_arrays
from fmuid.diagnosis import SOMETHING_ELSE, Alarm, Onset, OnsetShape, SkippedWindow, Trend
from fmuid.reports.topics.monitoring import MonitoringMessage, gap_remarks, monitoring_document, monitoring_remarks
from fmuid.runs import findings_of
from fmuid.runs.faults import build_monitor, rule_of
from tests.support.coil_records import warming
from tests.support.plate import COLUMNS, PHASES, STD, TRUTH, Faults
from tests.support.plate import record as plate_record
from tests.support.results import changed

RULE = Rule(window=1.0, transient=0.2)
FAULT = {"turns": fmuid.Fault(coil.models()[1], {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": 0.02497})}


def told(found: Monitor) -> str:
    """Return the verdict of a monitoring."""
    return " ".join(each.text for each in monitoring_remarks(findings_of(found)))


def noise_is_taken_for_white(found: Monitor) -> bool:
    remarks = monitoring_document(findings_of(found)).remarks
    return MonitoringMessage.WHITE_NOISE.text in [each.text for each in remarks]


def watch(healthy: fmuid.Result, rule: Rule = RULE, records: Sequence[fmuid.Experiment] = ()) -> Monitor:
    return Monitor(fmuid.Baseline(healthy, coil.INFLATE, records=records), FAULT, coil.models()[0], rule)


def watched(healthy: fmuid.Result, table: pd.DataFrame, rule: Rule = RULE) -> Monitor:
    found = watch(healthy, rule)
    found.add(coil.experiment(table))
    return found


def only(found: Monitor) -> tuple[Alarm, Onset]:
    """Return the one alarm of a monitoring, and its onset."""
    (alarm,) = found.alarms
    assert alarm.onset is not None
    return alarm, alarm.onset


# --- the coil ---------------------------------------------------------------------------


def test_a_fault_is_found_and_a_warm_winding_is_none(healthy_coil: fmuid.Result) -> None:
    found = watched(healthy_coil, warming(30, to=4.75, fails=20))
    table = found.table
    assert list(table["samples"]) == [800] + [1000] * 29  # only the first has nothing before it
    alarm, onset = only(found)
    assert (alarm.fault, alarm.time, alarm.last) == ("turns", 21.0, 29)  # the first window with the fault
    assert onset.likely.time == pytest.approx(20.0, abs=0.06)
    assert table["turns.dR"][20:].mean() == pytest.approx(0.5, abs=0.05)
    truth = coil.R + (4.75 - coil.R) * np.arange(30) / 30
    assert (np.abs(table["R"] - truth) < 4 * table["R.std"]).all()
    said = told(found)
    assert said.startswith("ALARM turns since 20 s (95 %: 19.9")
    assert "raised at 21 s. Size at the alarm: turns.dR = " in said and "Current size: turns, dR = 0.49" in said


def test_a_fault_of_one_recording_ends_with_it(healthy_coil: fmuid.Result) -> None:
    """Recordings are the windows: the fault is in the second and the fifth; an alarm of one window ends, too."""
    found, rng = watch(healthy_coil, Rule()), np.random.default_rng(7)
    for number, size in enumerate((0.0, 0.5, 0.0, 0.0, 0.5, 0.0)):
        found.add(replace(coil.experiment(coil.record(coil.R, size, rng)), name=f"r{number}"))
    for alarm, first in zip(found.alarms, (1, 4), strict=True):
        assert (alarm.fault, alarm.record, alarm.first, alarm.last) == ("turns", f"r{first}", first, first)
        assert alarm.onset is not None and alarm.onset.last.record == f"r{first}"
        assert alarm.ended is not None and alarm.ended.record == f"r{first + 1}"
        (change,) = alarm.explanations[0].changes
        assert abs(change.value - 0.5) < 3 * change.std
    lines = [each.text for each in monitoring_remarks(findings_of(found))]
    for line, first in zip(lines, (1, 4), strict=True):
        assert line.startswith("ALARM turns since ") and f" s of r{first + 1}. Size until the end: turns, dR = " in line


def test_a_sound_machine(healthy_coil: fmuid.Result) -> None:
    found = watched(healthy_coil, warming(40, to=4.8, seed=2))
    assert told(found) == "NO ALARM in 40 windows at 1 % false-alarm rate per recording."
    assert (found.table["significant"] != "").mean() < 0.06
    assert noise_is_taken_for_white(found)


# D is that of one linearization at the estimate without the fault; the sizes are those where the fault is
@pytest.mark.parametrize("number", [1, 2])
def test_a_window_agrees_with_a_diagnosis(number: int) -> None:
    study = fmuid.Study.read(coil.HERE / "test.toml", [f"experiments.0.data=test{number}.csv"])
    expected = study.diagnose()["turns.dR"]
    found = build_monitor(study, rule_of(study))
    found.add(study.tables[0])
    row = found.table.iloc[0]
    assert row["turns.dR"] == pytest.approx(expected.value, abs=0.1 * expected.std)
    assert row["turns.dR.std"] == pytest.approx(expected.std, rel=0.1)
    assert row["alarm"] == ("turns" if number != 2 else "")
    if number != 2:
        change = found.alarms[0].explanations[0].changes[0]
        assert change.value == pytest.approx(row["turns.dR"], abs=0.2 * change.std)


def test_an_onset_within_a_window(healthy_coil: fmuid.Result) -> None:
    """The window 7–8 s has the fault in a part of it; the size is that of the windows after."""
    table = warming(12, to=4.0, fails=7.4, size=0.3, seed=3)
    table.attrs[BEGIN] = pd.Timestamp("2024-05-06 07:08:09")
    found = watched(healthy_coil, table)
    alarm, onset = only(found)
    assert onset.shape is OnsetShape.STEP
    assert onset.likely.time == pytest.approx(7.4, abs=0.1)
    assert onset.first.time <= 7.4 <= onset.last.time < onset.first.time + 0.6
    assert abs(pd.Timestamp(onset.likely.date) - pd.Timestamp("2024-05-06 07:08:16.4")) < pd.Timedelta(seconds=0.1)
    assert "2024-05-06 07:08:1" in told(found)
    assert alarm.time <= 9.0
    (change,) = alarm.explanations[0].changes
    assert abs(change.value - 0.3) < 2.5 * change.std
    assert found.table["variance_ratio"][9:].max() < 1.2  # the models are linearized where the fault is


@pytest.mark.slow
def test_a_size_that_grows(healthy_coil: fmuid.Result) -> None:
    table = warming(20, to=4.0, fails=8.0, size=0.05, seed=7, grows=0.05)
    found = watched(healthy_coil, table, replace(RULE, limits={"turns.dR": 1.0}))
    alarm, onset = only(found)
    assert onset.shape is OnsetShape.RAMP
    assert abs(onset.likely.time - 8.0) < 1.5
    trend = alarm.trend
    assert trend is not None and trend.grows
    assert abs(trend.rate - 0.05) < 3.0 * trend.rate_std
    likely, early, late = trend.reached
    assert early < (1.0 - 0.6) / 0.05 < late
    assert early < likely < late
    assert "turns.dR reaches its limit 1 Ohm in " in told(found)


def test_trend_is_weighted_least_squares() -> None:
    random = np.random.default_rng(1)
    clock, stds = np.arange(20.0), random.uniform(0.5, 2.0, 20)
    values = 3.0 + 0.2 * clock + stds * random.standard_normal(20)
    found, past, never = (
        Trend.of("x", clock, sign * values, stds, limit=limit) for sign, limit in ((1, 10.0), (1, 2.0), (-1, 10.0))
    )
    assert found is not None and past is not None and never is not None
    line, covariance = np.polyfit(clock, values, 1, w=1.0 / stds, cov="unscaled")
    end = np.array([19.0, 1.0])
    assert (found.rate, found.rate_std) == pytest.approx((line[0], covariance[0, 0] ** 0.5))
    assert (found.value, found.std) == pytest.approx((np.polyval(line, 19.0), (end @ covariance @ end) ** 0.5))
    assert found.reached[0] == pytest.approx((10.0 - found.value) / found.rate)
    assert past.reached == (0.0, 0.0, 0.0)
    assert never.reached[0] == math.inf
    assert Trend.of("x", clock[:3], values[:3], stds[:3]) is None


def test_windows_without_excitation(healthy_coil: fmuid.Result) -> None:
    table = warming(4, to=4.0)
    at_rest = table["time"] >= 1.6
    table.loc[at_rest, "u"] = 0.0
    table.loc[at_rest, "i"] = 1e-3
    found = watched(healthy_coil, table)
    assert np.isinf(found.table["turns.dR.std"][3]) and found.table["probability"][3] == 1.0
    assert not found.alarms


def test_without_prior_a_fault_stays_undetermined(healthy_coil: fmuid.Result) -> None:
    """∂i/∂ΔR = ∂i/∂R + 2τ ∂i/∂L: the windows alone cannot tell."""
    found = Monitor(fmuid.Baseline(healthy_coil, math.inf), FAULT, coil.models()[0], RULE)
    found.add(coil.experiment(warming(4, to=4.0, fails=2)))
    assert (found.alarms, found.undetermined) == ((), ("turns",))
    assert told(found) == "UNDECIDED: no window determines turns."


def test_a_gap_is_skipped(healthy_coil: fmuid.Result) -> None:
    table = warming(4, to=4.0)
    table.loc[table["time"].between(0.9, 2.1), "i"] = np.nan
    found = watched(healthy_coil, table)
    assert found.table["start"].tolist() == pytest.approx([0.0, 2.0, 3.0])
    assert found.table["samples"].tolist() == [700, 899, 1000]
    assert [gap.time for gap in found.gaps] == pytest.approx([1.0])
    assert "windows from 1 s skipped" in gap_remarks(found.gaps)[0].text
    many = gap_remarks([SkippedWindow("a", float(k)) for k in range(8)])[0].text
    assert "from 0 s, 1 s, 2 s, 3 s, 4 s and 3 more skipped" in many


@pytest.mark.slow
def test_colored_noise_is_no_fault(healthy_coil: fmuid.Result) -> None:
    """Noise of a correlation time of 10 samples, as in the healthy record."""

    def colored(seconds: int, seed: int) -> fmuid.Experiment:
        table = warming(seconds, to=4.0, seed=seed, noise=0.0)
        white = np.random.default_rng(9 + seed).standard_normal(len(table))
        table["i"] += math.sqrt(coil.NOISE_VARIANCE) * lfilter([math.sqrt(1 - 0.9**2)], [1.0, -0.9], white)
        return coil.experiment(table)

    found = watch(healthy_coil, records=[colored(10, 4)])
    found.add(colored(20, 3))
    assert (found.table["significant"] != "").mean() < 0.05
    assert not found.alarms
    assert not noise_is_taken_for_white(found)


def test_an_unexplained_change_is_an_alarm(healthy_coil: fmuid.Result) -> None:
    table = warming(6, to=4.0)
    table["i"] += np.where(table["time"] >= 2.0, 0.05, 0.0)
    found = watched(healthy_coil, table)
    assert [(alarm.fault, alarm.first) for alarm in found.alarms] == [(SOMETHING_ELSE, 2)]
    assert told(found).startswith("ALARM unexplained change")


def test_a_named_alarm_keeps_its_name_beside_one_unexplained_window(healthy_coil: fmuid.Result) -> None:
    """The fault ends after a window with much noise."""
    table, sound = warming(10, to=4.0, fails=2), warming(10, to=4.0)
    gone = table["time"] >= 7.0
    table.loc[gone, "i"] = sound["i"][gone]
    table["i"] += np.where((table["time"] >= 6.0) & ~gone, np.random.default_rng(8).normal(0.0, 0.2, len(table)), 0.0)
    found = watched(healthy_coil, table)
    alarm, onset = only(found)
    assert found.table["alarm"][6] == SOMETHING_ELSE
    assert (alarm.fault, onset.first.time <= 2.0 <= onset.last.time) == ("turns", True)
    assert alarm.ended is not None and alarm.ended.time == pytest.approx(7.0, abs=1.0)


@pytest.mark.slow
def test_a_small_fault_is_found_over_many_windows(healthy_coil: fmuid.Result) -> None:
    """0.14 Ω are 3 standard deviations of a window: hardly one of them is significant by itself at this level."""
    found = watched(healthy_coil, warming(30, to=4.15, fails=12, size=0.14, seed=4))
    alarm, onset = only(found)
    assert alarm.fault == "turns" and 13.0 <= alarm.time < 25.0
    assert onset.first.time <= 12.0 <= onset.last.time
    (change,) = alarm.explanations[0].changes
    assert abs(change.value - 0.14) < 3 * change.std
    assert change.std < 0.8 * found.table["turns.dR.std"].iloc[-1]


# --- a machine that least squares solve exactly -----------------------------------------


@pytest.mark.parametrize("off", [{}, {"eb": 0.1}, {"size": 0.06, "angle": 2.0}])
def test_each_size_alone_is_one_of_least_squares(
    plate: fmuid.System, sound: fmuid.Result, faults: Faults, off: dict[str, float]
) -> None:
    record = plate_record(np.random.default_rng(50), **off)
    found = Monitor(fmuid.Baseline(sound, 5.0), faults, plate)
    found.add(record)
    row, std = found.table.iloc[0], 5.0 * sound.std
    noise = np.tile([sound.fit.variance["x"] ** 0.5, sound.fit.variance["y"] ** 0.5], len(COLUMNS) // 2)
    own, data = COLUMNS / noise[:, None], record.output_values.ravel() / noise
    places = {f"stator.{phase}": [2 + k] for k, phase in enumerate(PHASES)} | {"rotor.size": [5, 6]}
    for name, columns in places.items():
        springs = np.hstack([np.diag(1.0 / std), np.zeros((2, len(columns)))])
        lines = np.vstack([own[:, [0, 1, *columns]], springs])
        exact = np.linalg.lstsq(lines, np.concatenate([data, sound.values / std]))[0]
        covariance = np.linalg.inv(lines.T @ lines)
        if len(columns) == 1:
            assert row[name] == pytest.approx(max(0.0, exact[2]), abs=1e-5)
            assert row[f"{name}.std"] == pytest.approx(covariance[2, 2] ** 0.5, rel=1e-3)
        else:
            assert row[name] == pytest.approx(np.hypot(*exact[2:]), rel=1e-3)
            assert row["rotor.angle"] == pytest.approx(np.arctan2(exact[3], exact[2]) / 2 % math.pi, abs=1e-3)
    assert row["alarm"] == ("" if not off else "stator" if "eb" in off else "rotor")


@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(300, marks=pytest.mark.campaign)]
)
def test_false_alarm_rate_over_draws(plate: fmuid.System, sound: fmuid.Result, draws: int) -> None:
    rng, level, hits = np.random.default_rng(8), 0.1, 0
    fault = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, nominal=0.01)})
    for _ in range(draws):
        known = changed(sound, values=np.array(list(TRUTH.values())) + sound.std * rng.standard_normal(2))
        baseline = fmuid.Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
        found = Monitor(baseline, {"a": fault}, plate, Rule(level=level))
        found.add(plate_record(rng))
        hits += bool(found.alarms)
    assert hits / draws == pytest.approx(level, abs=3 * math.sqrt(level * (1 - level) / draws))


# --- files ------------------------------------------------------------------------------


def test_resuming_without_a_record_changes_nothing(healthy_coil: fmuid.Result, tmp_path: Path) -> None:
    """As where the first record after a restart is refused; a name like a formula is text in the table."""
    day = [replace(coil.experiment(warming(2, to=4.0, seed=k)), name=f"={k}+1") for k in range(2)]
    first, again, third = (watch(healthy_coil) for _ in range(3))

    def files() -> tuple[dict[str, object], bytes]:
        kept = {name: each.tolist() for name, each in read_arrays(tmp_path / "monitoring.npz").items()}
        return kept, (tmp_path / "monitoring.json").read_bytes()

    first.add(day[0])
    first.write(tmp_path)
    assert [line.split(",")[0] for line in (tmp_path / "monitoring.csv").read_text().split()[1:]] == ["'=0+1"] * 2
    before = files()
    again.resume(tmp_path)
    again.write(tmp_path)
    assert files() == before
    pd.testing.assert_frame_equal(again.table, first.table, check_exact=True)
    third.resume(tmp_path)
    for each in (first, third):
        each.add(day[1])
    pd.testing.assert_frame_equal(third.table, first.table)


def test_a_record_counts_once(healthy_coil: fmuid.Result) -> None:
    found, record = watch(healthy_coil), coil.experiment(warming(2, to=4.0))
    found.add(record)
    with pytest.raises(fmuid.InputError, match="monitored already"):
        found.add(record)
    with pytest.raises(fmuid.InputError, match="window_length and false_alarm_horizon"):
        found.add(replace(record, name="other"), grows=True)
    with pytest.raises(fmuid.InputError, match="no fault given"):
        Monitor(healthy_coil, {}, coil.models()[0], RULE)


@pytest.mark.parametrize("words", [{"transient": -1.0}, {"window": 0.0}, {"horizon": math.inf}])
def test_wrong_rules(words: dict[str, Any]) -> None:
    with pytest.raises(fmuid.InputError, match="must be a finite time"):
        Rule(**words)
