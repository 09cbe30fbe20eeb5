"""Monitoring in windows: against diagnoses, weighted least squares and the binomial; a coil that warms up and fails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil
from fmuid.data import BEGIN
from fmuid.data.npz import read_arrays
from fmuid.diagnosis import OnsetShape, SkippedWindow
from fmuid.diagnosis.alarms import SOMETHING_ELSE, Rule, Trend
from fmuid.diagnosis.monitor import Monitor
from fmuid.reports.topics.monitoring import MonitoringMessage, gap_remarks, monitoring_document, monitoring_remarks
from fmuid.runs.faults import build_monitor, findings_of, rule_of
from tests.support.coil_records import warming
from tests.support.exported import export_text
from tests.support.plate import COLUMNS, PHASES, PLATE, STD, TRUTH, identified
from tests.support.plate import record as plate_record
from tests.support.results import changed

RULE = Rule(window=1.0, transient=0.2)


def told(found: Monitor) -> str:
    """Return the verdict of a monitoring."""
    return " ".join(each.text for each in monitoring_remarks(findings_of(found)))


@pytest.fixture(scope="module")
def healthy() -> fmuid.Result:
    return fmuid.Result.from_json(coil.HERE / "healthy" / "result.json")


FAULT = {"turns": fmuid.Fault(coil.models()[1], {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": 0.02497})}


def watch(healthy: fmuid.Result, rule: Rule = RULE, records: Sequence[fmuid.Experiment] = ()) -> Monitor:
    return Monitor(fmuid.Baseline(healthy, coil.INFLATE, records=records), FAULT, coil.models()[0], rule)


# --- the coil ---------------------------------------------------------------------------


def test_a_fault_is_found_soon_and_a_warm_winding_is_none(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    found.add(coil.experiment(warming(40, to=5.0, fails=30)))
    table = found.table
    assert len(table) == 40
    assert list(table["samples"]) == [800] + [1000] * 39  # only the first has nothing before it
    (alarm,) = found.alarms
    assert (alarm.fault, alarm.time, alarm.last) == ("turns", 31.0, 39)  # the first window with the fault
    assert alarm.onset is not None
    assert alarm.onset.likely.time == pytest.approx(30.0, abs=0.06)
    assert table["turns.dR"][30:].mean() == pytest.approx(0.5, abs=0.05)
    truth = coil.R + (5.0 - coil.R) * np.arange(40) / 40
    assert (np.abs(table["R"] - truth) < 4 * table["R.std"]).all()
    said = told(found)
    assert said.startswith("ALARM turns since 30 s (95 %: 29.9")
    assert "raised at 31 s. Size at the alarm: turns.dR = " in said and "Current size: turns, dR = 0.5" in said


def test_nothing_is_found_where_nothing_is(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    found.add(coil.experiment(warming(60, to=4.8, seed=2)))
    assert not found.alarms
    assert told(found) == "NO ALARM in 60 windows at 1 % false-alarm rate per recording."
    assert (found.table["significant"] != "").mean() < 0.06
    # from a result alone, which has no noise model
    assert MonitoringMessage.WHITE_NOISE.text in [each.text for each in monitoring_document(findings_of(found)).remarks]


# D is that of one linearisation at the estimate without the fault; the sizes are those where the fault is
@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_window_says_what_a_diagnosis_says(number: int) -> None:
    study = fmuid.Study.read(coil.HERE / "test.toml", [f"experiments.0.data=test{number}.csv"])
    expected = study.diagnose()["turns.dR"]
    found = build_monitor(study, rule_of(study))
    found.add(study.tables[0])
    row = found.table.iloc[0]
    assert row["turns.dR"] == pytest.approx(expected.value, abs=0.1 * expected.std)
    assert row["turns.dR.std"] == pytest.approx(expected.std, rel=0.1)
    assert row["alarm"] == ("turns" if number != 2 else "")
    if number != 2:
        (alarm,) = found.alarms
        (change,) = alarm.explanations[0].changes
        assert change.value == pytest.approx(row["turns.dR"], abs=0.2 * change.std)


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_an_onset_is_dated_within_its_window(healthy: fmuid.Result, size: float) -> None:
    """The window 7–8 s has the fault in a part of it: it says since when, and the size is that of the windows after."""
    found = watch(healthy)
    found.add(coil.experiment(warming(14, to=4.0, fails=7.4, size=size, seed=3)))
    (alarm,) = found.alarms
    onset = alarm.onset
    assert onset is not None
    assert onset.shape is OnsetShape.STEP
    assert onset.likely.time == pytest.approx(7.4, abs=0.1)
    assert onset.first.time <= 7.4 <= onset.last.time
    assert onset.last.time - onset.first.time < 0.6
    assert alarm.time <= 9.0
    (change,) = alarm.explanations[0].changes
    assert abs(change.value - size) < 2.5 * change.std
    assert found.table["variance_ratio"][9:].max() < 1.2  # the models are linearised where the fault is


def test_a_size_that_grows_has_a_trend_and_a_limit(healthy: fmuid.Result) -> None:
    table = warming(20, to=4.0, fails=8.0, size=0.05, seed=7, grows=0.05)
    found = watch(healthy, replace(RULE, limits={"turns.dR": 1.0}))
    found.add(coil.experiment(table))
    (alarm,) = found.alarms
    assert alarm.onset is not None
    assert alarm.onset.shape is OnsetShape.RAMP
    assert abs(alarm.onset.likely.time - 8.0) < 1.5
    trend = alarm.trend
    assert trend is not None
    assert trend.grows
    assert abs(trend.rate - 0.05) < 3.0 * trend.rate_std
    likely, early, late = trend.reached
    assert early < (1.0 - 0.6) / 0.05 < late
    assert early < likely < late
    assert "turns.dR reaches its limit 1 Ohm in " in told(found)


def test_a_trend_is_a_line_of_least_squares() -> None:
    random = np.random.default_rng(1)
    clock, stds = np.arange(20.0), random.uniform(0.5, 2.0, 20)
    values = 3.0 + 0.2 * clock + stds * random.standard_normal(20)
    found = Trend.of("x", clock, values, stds, limit=10.0)
    assert found is not None
    line, covariance = np.polyfit(clock, values, 1, w=1.0 / stds, cov="unscaled")
    assert (found.rate, found.rate_std) == pytest.approx((line[0], covariance[0, 0] ** 0.5))
    assert (found.value, found.std) == pytest.approx(
        (np.polyval(line, 19.0), (np.array([19.0, 1.0]) @ covariance @ np.array([19.0, 1.0])) ** 0.5)
    )
    assert found.reached[0] == pytest.approx((10.0 - found.value) / found.rate)
    assert Trend.of("x", clock[:3], values[:3], stds[:3]) is None
    reached = Trend.of("x", clock, values, stds, limit=2.0)
    assert reached is not None and reached.reached == (0.0, 0.0, 0.0)
    other = Trend.of("x", clock, -values, stds, limit=10.0)
    assert other is not None and other.reached[0] == math.inf


def test_dates_of_a_table_are_those_of_an_onset(healthy: fmuid.Result) -> None:
    table = warming(6, to=4.0, fails=3.0, size=1.0)
    table.attrs[BEGIN] = pd.Timestamp("2024-05-06 07:08:09")
    found = watch(healthy)
    found.add(coil.experiment(table))
    onset = found.alarms[0].onset
    assert onset is not None
    assert abs(pd.Timestamp(onset.likely.date) - pd.Timestamp("2024-05-06 07:08:12")) < pd.Timedelta(seconds=0.1)
    assert "2024-05-06 07:08:1" in told(found)


def test_windows_without_voltage_say_nothing(healthy: fmuid.Result) -> None:
    table = warming(4, to=4.0)
    at_rest = table["time"] >= 1.6
    table.loc[at_rest, "u"] = 0.0
    table.loc[at_rest, "i"] = 1e-3
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert np.isinf(found.table["turns.dR.std"][3]) and found.table["probability"][3] == 1.0
    assert not found.alarms


def test_without_prior_it_stays_open(healthy: fmuid.Result) -> None:
    """∂i/∂ΔR = ∂i/∂R + 2τ ∂i/∂L: the windows alone cannot tell."""
    found = Monitor(fmuid.Baseline(healthy, math.inf), FAULT, coil.models()[0], RULE)
    found.add(coil.experiment(warming(4, to=4.0, fails=2)))
    assert not found.alarms
    assert found.undetermined == ("turns",)
    assert told(found) == "UNDECIDED: no window determines turns."


def test_a_gap_is_passed_over(healthy: fmuid.Result) -> None:
    table = warming(4, to=4.0)
    table.loc[table["time"].between(0.9, 2.1), "i"] = np.nan
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert found.table["start"].tolist() == pytest.approx([0.0, 2.0, 3.0])
    assert found.table["samples"].tolist() == [700, 899, 1000]
    assert [gap.time for gap in found.gaps] == pytest.approx([1.0])
    (said,) = gap_remarks(found.gaps)
    assert "windows from 1 s skipped" in said.text
    (many,) = gap_remarks([SkippedWindow("a", float(k)) for k in range(8)])
    assert "from 0 s, 1 s, 2 s, 3 s, 4 s and 3 more skipped" in many.text


def test_coloured_noise_is_no_fault(healthy: fmuid.Result) -> None:
    """Noise of a correlation time of 10 samples: as the healthy record has it, it is no news."""

    def coloured(seconds: int, seed: int) -> fmuid.Experiment:
        table = warming(seconds, to=4.0, seed=seed, noise=0.0)
        noise = lfilter(
            [math.sqrt(1 - 0.9**2)], [1.0, -0.9], np.random.default_rng(9 + seed).standard_normal(len(table))
        )
        table["i"] += math.sqrt(coil.NOISE_VARIANCE) * noise
        return coil.experiment(table)

    found = watch(healthy, records=[coloured(10, 4)])
    found.add(coloured(60, 3))
    assert (found.table["significant"] != "").mean() < 0.05
    assert not found.alarms
    assert MonitoringMessage.WHITE_NOISE.text not in [
        each.text for each in monitoring_document(findings_of(found)).remarks
    ]


def test_something_else_is_an_alarm_too(healthy: fmuid.Result) -> None:
    table = warming(6, to=4.0)
    table["i"] += np.where(table["time"] >= 2.0, 0.05, 0.0)
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert [alarm.fault for alarm in found.alarms] == [SOMETHING_ELSE]
    assert found.alarms[0].first == 2
    assert told(found).startswith("ALARM unexplained change")


def test_a_small_fault_is_found_over_many_windows(healthy: fmuid.Result) -> None:
    """0.14 Ω are 3 standard deviations of a window: hardly one of them is significant by itself at this level."""
    found = watch(healthy)
    found.add(coil.experiment(warming(40, to=4.2, fails=12, size=0.14, seed=4)))
    (alarm,) = found.alarms
    assert alarm.fault == "turns" and 13.0 <= alarm.time < 25.0
    assert alarm.onset is not None
    assert alarm.onset.first.time <= 12.0 <= alarm.onset.last.time
    (change,) = alarm.explanations[0].changes
    assert abs(change.value - 0.14) < 3 * change.std
    assert change.std < 0.8 * found.table["turns.dR.std"].iloc[-1]


# --- a machine that least squares solve exactly -----------------------------------------


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(export_text(tmp_path_factory.mktemp("plate"), PLATE))


@pytest.fixture(scope="module")
def sound(plate: fmuid.System) -> fmuid.Result:
    return identified(plate, plate_record(np.random.default_rng(0)))


@pytest.mark.parametrize("faults", [{}, {"eb": 0.1}, {"size": 0.06, "angle": 2.0}])
def test_each_size_alone_is_one_of_least_squares(
    plate: fmuid.System, sound: fmuid.Result, faults: dict[str, float]
) -> None:
    ratio = fmuid.Parameter(0.0, min=0.0, nominal=0.01)
    hypotheses = {
        "stator": fmuid.Fault(plate, dict.fromkeys(PHASES, ratio)),
        "rotor": fmuid.Fault(
            plate,
            {"size": ratio, "angle": fmuid.Parameter(0.0, nominal=1.0)},
            angles={"angle": fmuid.diagnosis.FaultAngle("size", math.pi)},
        ),
    }
    record = plate_record(np.random.default_rng(50), **faults)
    found = Monitor(fmuid.Baseline(sound, 5.0), hypotheses, plate)
    found.add(record)
    row = found.table.iloc[0]
    std = 5.0 * sound.std
    noise = np.tile([sound.fit.variance["x"] ** 0.5, sound.fit.variance["y"] ** 0.5], len(COLUMNS) // 2)
    own = COLUMNS / noise[:, None]
    data = record.output_values.ravel() / noise
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
    assert row["alarm"] == ("" if not faults else "stator" if "eb" in faults else "rotor")


@pytest.mark.slow
def test_the_level_is_met_over_healthy_records(plate: fmuid.System, sound: fmuid.Result) -> None:
    rng, level, count = np.random.default_rng(8), 0.1, 300
    fault = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, nominal=0.01)})
    hits = 0
    for _ in range(count):
        known = changed(sound, values=np.array(list(TRUTH.values())) + sound.std * rng.standard_normal(2))
        baseline = fmuid.Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
        found = Monitor(baseline, {"a": fault}, plate, Rule(level=level))
        found.add(plate_record(rng))
        hits += bool(found.alarms)
    assert hits / count == pytest.approx(level, abs=3 * math.sqrt(level * (1 - level) / count))


def test_a_name_that_is_a_formula_reads_back(healthy: fmuid.Result, tmp_path: Path) -> None:
    found = watch(healthy)
    found.add(replace(coil.experiment(warming(2, to=4.0)), name="=1+1"))
    found.write(tmp_path)
    assert [line.split(",")[0] for line in (tmp_path / "monitoring.csv").read_text().split()[1:]] == ["'=1+1"] * 2
    again = watch(healthy)
    again.resume(tmp_path)
    pd.testing.assert_frame_equal(again.table, found.table, check_exact=True)


def test_a_run_that_is_resumed_and_written_without_a_record_stays_whole(healthy: fmuid.Result, tmp_path: Path) -> None:
    """As where the first record after a restart is refused."""
    day = [replace(coil.experiment(warming(2, to=4.0, seed=k)), name=f"day{k}") for k in range(2)]
    first = watch(healthy)
    first.add(day[0])
    first.write(tmp_path / "a")
    found = read_arrays(tmp_path / "a" / "monitoring.npz")
    said = (tmp_path / "a" / "monitoring.json").read_bytes()
    again = watch(healthy)
    again.resume(tmp_path / "a")
    again.write(tmp_path / "a")
    kept = read_arrays(tmp_path / "a" / "monitoring.npz")
    assert {name: each.tolist() for name, each in kept.items()} == {name: each.tolist() for name, each in found.items()}
    assert (tmp_path / "a" / "monitoring.json").read_bytes() == said
    third = watch(healthy)
    third.resume(tmp_path / "a")
    for each in (first, third):
        each.add(day[1])
    pd.testing.assert_frame_equal(third.table, first.table)


def test_a_record_counts_once(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    record = coil.experiment(warming(2, to=4.0))
    found.add(record)
    with pytest.raises(fmuid.InputError, match="monitored already"):
        found.add(record)
    with pytest.raises(fmuid.InputError, match="no fault to look for"):
        Monitor(healthy, {}, coil.models()[0], RULE)
