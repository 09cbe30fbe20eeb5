"""Monitoring in windows: against diagnoses, weighted least squares and the binomial; a coil that warms up and fails."""

from __future__ import annotations

import io
import json
import math
import shutil
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
from fmuid.cli.app import run
from fmuid.data import BEGIN
from fmuid.diagnosis import Gap, Shape
from fmuid.diagnosis.monitoring.alarms import SOMETHING_ELSE, Rule, Trend
from fmuid.diagnosis.monitoring.monitor import Monitor
from fmuid.diagnosis.monitoring.seeing import Seen
from fmuid.reports.words.monitoring import gap_words, monitoring_words
from fmuid.studies.monitoring import design_of, monitor_of, rule_of
from tests.support.coil_records import warming
from tests.support.exported import export_text
from tests.support.interrupting import SIGNALS, command, killing
from tests.support.plate import COLUMNS, PHASES, PLATE, STD, TRUTH, identified
from tests.support.plate import record as plate_record

RULE = Rule(window=1.0, transient=0.2)


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
    said = monitoring_words(found)
    assert said.startswith("Fault: turns, since 30 s of experiment (95 %: 29.9")
    assert "; alarm at 31 s of experiment; since then turns, dR = 0.5" in said


def test_nothing_is_found_where_nothing_is(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    found.add(coil.experiment(warming(60, to=4.8, seed=2)))
    assert not found.alarms
    assert monitoring_words(found) == "No alarm in 60 windows, at a level of 1 % for a false one in a record."
    assert (found.table["significant"] != "").mean() < 0.06


# D is that of one linearisation at the estimate without the fault; the sizes are those where the fault is
@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_window_says_what_a_diagnosis_says(number: int) -> None:
    study = fmuid.Study.read(coil.HERE / "test.toml", [f"experiments.0.table=test{number}.csv"])
    expected = study.diagnose()["turns"]
    found = monitor_of(study, rule_of(study))
    found.add(study.tables[0])
    row = found.table.iloc[0]
    assert row["turns.dR"] == pytest.approx(expected["dR"].value, abs=0.1 * expected["dR"].std)
    assert row["turns.dR.std"] == pytest.approx(expected["dR"].std / expected.colour, rel=0.05)
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
    assert onset.shape is Shape.STEP
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
    assert alarm.onset.shape is Shape.RAMP
    assert abs(alarm.onset.likely.time - 8.0) < 1.5
    trend = alarm.trend
    assert trend is not None
    assert trend.grows
    assert abs(trend.rate - 0.05) < 3.0 * trend.rate_std
    likely, early, late = trend.reached
    assert early < (1.0 - 0.6) / 0.05 < late
    assert early < likely < late
    assert "turns.dR reaches its limit of 1 Ohm in " in monitoring_words(found)


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
    assert "2024-05-06 07:08:1" in monitoring_words(found)


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
    assert monitoring_words(found) == "Whether there is a fault stays open: no window determines turns."


def test_a_gap_is_passed_over(healthy: fmuid.Result) -> None:
    table = warming(4, to=4.0)
    table.loc[table["time"].between(0.9, 2.1), "i"] = np.nan
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert found.table["start"].tolist() == pytest.approx([0.0, 2.0, 3.0])
    assert found.table["samples"].tolist() == [700, 899, 1000]
    assert [gap.time for gap in found.gaps] == pytest.approx([1.0])
    (said,) = gap_words(found.gaps)
    assert "the windows from 1 s on are left out" in said
    (many,) = gap_words([Gap("a", float(k)) for k in range(8)])
    assert "from 0 s, 1 s, 2 s, 3 s, 4 s and 3 more on are" in many


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


def test_something_else_is_an_alarm_too(healthy: fmuid.Result) -> None:
    table = warming(6, to=4.0)
    table["i"] += np.where(table["time"] >= 2.0, 0.05, 0.0)
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert [alarm.fault for alarm in found.alarms] == [SOMETHING_ELSE]
    assert found.alarms[0].first == 2
    assert monitoring_words(found).startswith("Something else is wrong: the residual is larger than the noise")


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
            angles={"angle": fmuid.Angle("size", math.pi)},
        ),
    }
    record = plate_record(np.random.default_rng(50), **faults)
    found = Monitor(fmuid.Baseline(sound, 5.0), hypotheses, plate)
    found.add(record)
    row = found.table.iloc[0]
    std = 5.0 * sound.std
    noise = np.tile([sound.variance["x"] ** 0.5, sound.variance["y"] ** 0.5], len(COLUMNS) // 2)
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
        known = replace(sound, values=np.array(list(TRUTH.values())) + sound.std * rng.standard_normal(2))
        baseline = fmuid.Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
        found = Monitor(baseline, {"a": fault}, plate, Rule(level=level))
        found.add(plate_record(rng))
        hits += bool(found.alarms)
    assert hits / count == pytest.approx(level, abs=3 * math.sqrt(level * (1 - level) / count))


# --- alarms -----------------------------------------------------------------------------


def told(**words: float) -> list[str]:
    """Return the options that set words of [monitoring]."""
    return [option for key, value in words.items() for option in ("--set", f"monitoring.{key}={value}")]


# --- files and command ------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with records of a coil that is sound, then warm, then faulty, and a study beside it."""
    records = tmp_path / "records"
    records.mkdir()
    for k in range(3):
        table = warming(4, to=4.4, fails=0 if k == 2 else math.inf, seed=10 + k)
        table.to_csv(records / f"day{k}.csv", index=False)
    shutil.copytree(coil.HERE / "healthy", tmp_path / "healthy")
    text = (coil.HERE / "test.toml").read_text(encoding="utf-8")
    text = text.replace("../../fmus", coil.FMUS.as_posix()).replace("test1.csv", "records/day0.csv")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    return tmp_path


def test_appending_gives_what_one_run_gives(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = told(window=1, transient=0.2)
    study, records = str(folder / "study.toml"), folder / "records"
    assert run(["monitor", study, str(records), *words, "--no-report", "-o", str(folder / "whole")]) == 1
    assert (
        "Fault: turns, since 0 s of day2 (95 %: 3.95 s of day1 to 0.25 s); alarm at 1 s of day2"
        in capsys.readouterr().out
    )
    grown = ["-o", str(folder / "grown"), "--figures", "png", "--no-report"]
    assert run(["monitor", study, str(records / "day0.csv"), str(records / "day1.csv"), *words, *grown]) == 0
    assert "No alarm" in capsys.readouterr().out
    assert run(["monitor", study, str(records), *words, *grown, "--append"]) == 1
    assert written(folder / "grown") == written(folder / "whole")
    assert (folder / "grown" / "figures" / "timeline.png").stat().st_size > 10_000
    other = [*told(window=1, transient=0.3), *grown, "--append"]
    capsys.readouterr()
    assert run(["monitor", study, str(records), *other]) == 2
    assert "another rule" in capsys.readouterr().err
    table, state = folder / "grown" / "monitoring.csv", folder / "grown" / "monitoring.npz"
    whole = {path: path.read_bytes() for path in (table, state)}
    with np.load(state) as file:
        arrays = dict(file)
    later = json.loads(arrays.pop("text").tobytes())

    def saying(content: object) -> bytes:
        made = io.BytesIO()
        np.savez(made, text=np.frombuffer(json.dumps(content).encode(), np.uint8), **arrays)
        return made.getvalue()

    for path, spoilt, said in (
        (table, whole[table][:-400], "is no table of fmuid monitor, or not whole"),
        (table, b"\n".join(whole[table].split(b"\n")[:4]), "it has not the 12 windows"),
        (table, b"time,u\n0,1\n", "is no table of fmuid monitor"),
        (table, b"", "is no table of fmuid monitor"),
        (state, whole[state][:-400], "is not of fmuid monitor, or not whole"),
        (state, saying({}), "give the monitoring.npz of fmuid monitor"),
        (state, saying({k: v for k, v in later.items() if k != "windows"}), "has no 'windows'"),
        (state, saying(later | {"records": [1]}), "has something in 'records'"),
    ):
        path.write_bytes(spoilt)
        assert run(["monitor", study, str(records), *words, *grown, "--append"]) == 2
        error = capsys.readouterr().err
        assert said in error and str(path) in error and "monitor without appending" in error and error.count("\n") == 1
        path.write_bytes(whole[path])
    table.write_bytes(whole[table] + b"rows of a run that was killed before it had written its state")
    assert run(["monitor", study, str(records), *words, *grown, "--append"]) == 1
    assert table.read_bytes() == whole[table]


def written(folder: Path) -> tuple[bytes, dict[str, Any]]:
    """Return the content of the files of a monitoring, but for the date and the order of their origin."""
    content = json.loads((folder / "monitoring.json").read_text(encoding="utf-8"))
    assert content["files"]
    return (folder / "monitoring.csv").read_bytes(), content | {"date": ""}


def test_from_python_it_is_what_the_command_does(folder: Path) -> None:
    """The same files and verdict; what comes before a record that is wrong is written, and can be gone on with."""
    study, records, mine = folder / "study.toml", folder / "records", folder / "mine"
    words = ["monitoring.window=1", "monitoring.transient=0.2"]
    theirs = ["--no-report", "-o", str(folder / "theirs")]
    assert run(["monitor", str(study), str(records), *told(window=1, transient=0.2), *theirs]) == 1
    read = fmuid.Study.read(study, words)
    (folder / "wrong.csv").write_text("time,nothing\n0,1\n1,1\n", encoding="utf-8")
    with pytest.raises(fmuid.InputError, match="wrong"):
        fmuid.run_monitoring(read, [records / "day0.csv", folder / "wrong.csv"], mine)
    found = fmuid.run_monitoring(read, [records], mine, figures="png", append=True)
    assert not found.healthy
    assert {path.name for path in found.files} == {"monitoring.csv", "monitoring.json", "timeline.png"}
    assert written(mine) == written(folder / "theirs")
    alone = fmuid.run_monitoring(read, [records / "day0.csv"])
    assert (alone.healthy, alone.files) == (True, ())
    with pytest.raises(fmuid.InputError, match="in a folder"):
        fmuid.run_monitoring(read, [records], append=True)


@pytest.mark.parametrize("number", SIGNALS)
def test_interrupted_inside_a_record(
    folder: Path, number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The records before it are kept, which is told, and appending examines the whole of it."""
    words: list[str | Path] = [folder / "study.toml", folder / "records"]
    words += told(window=1, transient=0.2)

    def when(seen: Seen) -> bool:
        return (seen.now.records[-1].name, seen.sums.window.number) == ("day1", 2)

    with monkeypatch.context() as disturbed:
        disturbed.setattr(Seen, "row", killing(number, when, Seen.row))
        assert command("monitor", *words, "-o", folder / "grown") == 1
    out, error = capsys.readouterr()
    saying = "interrupted: saving the records examined so far, with which --append goes on"
    assert error.splitlines() == [saying, "error: interrupted"]
    assert "monitoring.csv" in out
    assert set(pd.read_csv(folder / "grown" / "monitoring.csv")["record"]) == {"day0"}
    for name, more in (("grown", ["--append"]), ("whole", [])):
        assert command("monitor", *words, "-o", folder / name, *more, "--no-report") == 1
    assert written(folder / "grown") == written(folder / "whole")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (told(window=0.1, transient=0.2), "[monitoring]: windows of 0.1 s are not longer than the transient of 0.2 s"),
        (told(window=0.1, transient=0.02), "day0.csv: the transient lasts longer than 0.02 s"),
        (told(window=1), "[monitoring] needs the key 'transient': the study discards nothing"),
        (told(window=9, transient=0.2), "shorter than a window of 9 s"),
        (told(window=-1, transient=0.2), "[monitoring] window must be a number above 0, not -1"),
        (told(transient=-1), "[monitoring] transient must be a number, 0 or above, not -1"),
        (told(transient=9), "leaves no window"),
        (told(horizon=0), "[monitoring] horizon must be a number above 0, not 0"),
        (told(limits=1), "[monitoring] limits must be a table"),
        (told(needed=3), "[monitoring] has no key 'needed'"),
        (told(level=2), "[monitoring] level must be a number between 0 and 1, not 2"),
        (told(windows=1), "[monitoring] has no key 'windows' (did you mean 'window'?)"),
        (["--append"], "no earlier run to append to"),
        (["--set", "noise.variance=0"], "variance"),
    ],
)
def test_wrong_words_are_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert run(["monitor", str(folder / "study.toml"), str(folder / "records"), *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_the_table_of_a_study(folder: Path) -> None:
    """What the table does not say is as in the rest of the study, and what it says is its own."""
    path = folder / "study.toml"
    plain = fmuid.Study.read(path, ["experiments.0.discard=0.3", "diagnosis.level=0.05"])
    assert rule_of(plain) == Rule(None, 0.3, 0.05)
    with path.open("a", encoding="utf-8") as file:
        file.write(
            '[monitoring]\nwindow = 2\ntransient = 0.5\nlevel = 0.02\nhorizon = 60\nlimits = { "turns.dR" = 1 }\n'
        )
    assert rule_of(fmuid.Study.read(path)) == Rule(2.0, 0.5, 0.02, 60.0, {"turns.dR": 1.0})
    assert (plain.monitoring.place.file, plain.monitoring.place.keys) == (f"{path} with --set", ("monitoring",))


def test_wrong_records_are_one_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, words = str(folder / "study.toml"), told(window=1, transient=0.2)
    other = folder / "other.csv"
    warming(2, to=4.0).rename(columns={"u": "v"}).to_csv(other, index=False)
    (folder / "empty").mkdir()
    shutil.copy(folder / "records" / "day0.csv", folder / "empty" / "day0.bak")
    twice = shutil.copy(folder / "records" / "day0.csv", folder / "day0.csv")
    for paths, said in (
        ([other], "the input column 'u' is missing"),
        ([folder / "empty"], "has no table"),
        ([folder / "records", Path(twice)], "are of one name"),
        ([Path(twice), Path(twice)], "is given twice"),
        ([folder / "none.csv"], "none.csv"),
    ):
        assert run(["monitor", study, *map(str, paths), *words]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1
    # what came before is kept
    assert run(["monitor", study, str(folder / "records" / "day0.csv"), str(other), *words]) == 2
    assert len(pd.read_csv(folder / "results" / "monitoring.csv")) == 4
    assert run(["monitor", study, str(folder / "records"), *told(window=1, transient=0.02)]) == 2
    assert len(pd.read_csv(folder / "results" / "monitoring.csv")) == 4


def test_a_study_without_diagnosis_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    path = coil.HERE / "healthy.toml"
    assert run(["monitor", str(path), str(coil.HERE / "test1.csv")]) == 2
    assert "has no [diagnosis]" in capsys.readouterr().err
    with pytest.raises(fmuid.InputError, match="has no fault 'bars', only turns"):
        design_of(fmuid.Study.read(coil.HERE / "test.toml"), "bars")


def test_a_record_counts_once(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    record = coil.experiment(warming(2, to=4.0))
    found.add(record)
    with pytest.raises(fmuid.InputError, match="monitored already"):
        found.add(record)
    with pytest.raises(fmuid.InputError, match="no fault to look for"):
        Monitor(healthy, {}, coil.models()[0], RULE)
