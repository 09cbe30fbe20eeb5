"""Monitoring in windows: against diagnoses, weighted least squares and the binomial; a coil that warms up and fails."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil
from fmuid.cli.app import run
from fmuid.diagnosis.monitoring.alarms import SOMETHING_ELSE, Rule, alarm_rate, alarms
from fmuid.diagnosis.monitoring.monitor import Monitor
from fmuid.reports.words.monitoring import gap_words, monitoring_words
from fmuid.studies.monitoring import design_of, monitor_of, rule_of
from tests.support.exported import export_text
from tests.support.interrupting import SIGNALS, command, killing
from tests.support.plate import COLUMNS, PHASES, PLATE, STD, TRUTH, identified
from tests.support.plate import record as plate_record

RULE = Rule(window=1.0, transient=0.2)


def warming(
    seconds: int, to: float, fails: float = math.inf, size: float = 0.5, seed: int = 0, noise: float = 1.0
) -> pd.DataFrame:
    """Return a record of the coil whose R rises from 4 Ω second by second, with ΔR = size from a time on; exact."""
    rng = np.random.default_rng(seed)
    samples = 1000 * seconds
    voltage = np.repeat(rng.choice([-1.0, 1.0], samples // coil.BIT + 1), coil.BIT)[:samples]
    current, state = np.empty(samples), 0.02
    for k in range(seconds):
        fault = size if k >= fails else 0.0
        resistance = coil.R + (to - coil.R) * k / seconds + fault
        decay = math.exp(-resistance / (coil.L + 2 * coil.TAU * fault) * coil.STEP)
        part = slice(1000 * k, 1000 * (k + 1))
        driven = lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage[part])
        current[part] = driven + state * decay ** np.arange(1000)
        state = current[part][-1] * decay + (1.0 - decay) / resistance * voltage[part][-1]
    current += noise * math.sqrt(coil.NOISE_VARIANCE) * rng.standard_normal(samples)
    return pd.DataFrame({"time": coil.STEP * np.arange(samples), "u": voltage, "i": current})


@pytest.fixture(scope="module")
def healthy() -> fmuid.Result:
    return fmuid.Result.from_json(coil.HERE / "healthy" / "result.json")


def watch(healthy: fmuid.Result, rule: Rule = RULE) -> Monitor:
    fault = fmuid.Fault(coil.models()[1], {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": 0.02497})
    return Monitor(fmuid.Baseline(healthy, coil.INFLATE), {"turns": fault}, rule)


# --- the coil ---------------------------------------------------------------------------


def test_a_fault_is_found_soon_and_a_warm_winding_is_none(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    found.add(coil.experiment(warming(40, to=5.0, fails=30)))
    table = found.table
    assert len(table) == 40
    assert list(table["samples"]) == [800] + [1000] * 39  # only the first has nothing before it
    (alarm,) = found.alarms
    assert (alarm.fault, alarm.time, alarm.last) == ("turns", 33.0, 39)  # the third window with the fault
    assert table["turns.dR"][30:].mean() == pytest.approx(0.5, abs=0.05)
    truth = coil.R + (5.0 - coil.R) * np.arange(40) / 40
    assert (np.abs(table["turns.R"] - truth) < 4 * table["turns.R.std"]).all()
    assert monitoring_words(found).startswith("Fault: turns, from 33 s of experiment on, dR = 0.")
    assert table["turns.ended"].all()


@pytest.mark.parametrize("forgetting", [0.0, 0.8])
def test_nothing_is_found_where_nothing_is(healthy: fmuid.Result, forgetting: float) -> None:
    found = watch(healthy, replace(RULE, forgetting=forgetting))
    found.add(coil.experiment(warming(60, to=4.8, seed=2)))
    assert not found.alarms
    assert monitoring_words(found).startswith("No alarm: ")
    assert (found.table["significant"] != "").mean() < 0.06
    off = found.table["turns.dR"] / found.table["turns.dR.std"]
    # what the noise makes is less than what the healthy record's errors and the noise make
    assert off.std() < math.sqrt(1 - found.table["turns.share"].min()) * 1.3


# D is that of the parabola at the minimum, which differs from the criterion itself where the fault is large
@pytest.mark.parametrize(("number", "close"), [(1, 0.3), (2, 0.05), (3, 0.1)])
def test_a_window_says_what_a_diagnosis_says(number: int, close: float) -> None:
    study = fmuid.Study.read(coil.HERE / "test.toml", [f"experiments.0.table=test{number}.csv"])
    expected = study.diagnose()["turns"]
    found = monitor_of(study, rule_of(study))
    found.add(study.tables[0])
    row = found.table.iloc[0]
    assert row["turns.dR"] == pytest.approx(expected["dR"].value, abs=0.02 * expected["dR"].std)
    assert row["turns.dR.std"] == pytest.approx(expected["dR"].std, rel=0.01)
    assert row["turns.colour"] == pytest.approx(expected.colour, rel=0.01)
    assert row["turns.D"] == pytest.approx(expected.statistic, rel=close)
    assert (row["significant"] == "turns") == (number != 2)


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
    fault = watch(healthy).models[0].fault
    found = Monitor(fmuid.Baseline(healthy, math.inf), {"turns": fault}, RULE)
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
    assert "no sample counts from 1 s on" in gap_words(found.gaps[0])


def test_coloured_noise_is_no_fault(healthy: fmuid.Result) -> None:
    """Noise of a correlation time of 10 samples makes the estimates scatter more; white noise would be surprised."""
    table = warming(60, to=4.0, seed=3, noise=0.0)
    noise = lfilter([math.sqrt(1 - 0.9**2)], [1.0, -0.9], np.random.default_rng(9).standard_normal(len(table)))
    table["i"] += math.sqrt(coil.NOISE_VARIANCE) * noise
    watched = watch(healthy)
    watched.add(coil.experiment(table))
    found = watched.table
    assert (found["turns.colour"] > 1.25).all()
    naive = found["turns.dR"].abs() / found["turns.dR.std"] * found["turns.colour"]
    assert (naive > 2.58).mean() > 0.08
    assert (found["significant"] != "").mean() < 0.05


@pytest.mark.slow
def test_a_weak_colour_counts_too(healthy: fmuid.Result) -> None:
    """Estimates scatter over the windows as they are said to, less what the healthy record's errors share."""
    table = warming(200, to=4.0, seed=5, noise=0.0)
    noise = lfilter([math.sqrt(1 - 0.18**2)], [1.0, -0.18], np.random.default_rng(7).standard_normal(len(table)))
    table["i"] += math.sqrt(coil.NOISE_VARIANCE) * noise
    watched = watch(healthy)
    watched.add(coil.experiment(table))
    found = watched.table
    assert 1.1 < found["turns.colour"].mean() < 1.25
    stated = (found["turns.dR.std"] ** 2 * (1.0 - found["turns.share"])).mean() ** 0.5
    assert found["turns.dR"].std() == pytest.approx(stated, rel=0.11)


def test_something_else_is_an_alarm_too(healthy: fmuid.Result) -> None:
    table = warming(6, to=4.0)
    table["i"] += np.where(table["time"] >= 2.0, 0.05, 0.0)
    found = watch(healthy)
    found.add(coil.experiment(table))
    assert [alarm.fault for alarm in found.alarms] == [SOMETHING_ELSE]
    assert monitoring_words(found).startswith("Something else is wrong, from 5 s")


def test_with_forgetting_a_small_fault_is_found(healthy: fmuid.Result) -> None:
    """0.11 Ω are 3 standard deviations of a window, of which the healthy record's errors are constant."""
    long = coil.experiment(warming(40, to=4.2, fails=12, size=0.14, seed=4))
    hits, stds = [], []
    for forgetting in (0.0, 0.8):
        found = watch(healthy, replace(RULE, forgetting=forgetting))
        found.add(long)
        table = found.table
        assert not (table["alarm"][:12] != "").any()
        hits.append((table["significant"][20:] != "").mean())
        stds.append(table["turns.dR.std"].iloc[-1])
    assert hits[1] > hits[0] + 0.2
    assert stds[1] < 0.85 * stds[0]


# --- a machine that least squares solve exactly -----------------------------------------


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(export_text(tmp_path_factory.mktemp("plate"), PLATE))


@pytest.fixture(scope="module")
def sound(plate: fmuid.System) -> fmuid.Result:
    return identified(plate, plate_record(np.random.default_rng(0)))


def test_forgetting_is_weighted_least_squares(plate: fmuid.System, sound: fmuid.Result) -> None:
    """Windows count by powers of the factor, the healthy record once; the noise of the estimate counts them squared."""
    forgetting, inflate, few = 0.7, 5.0, 40
    # 20 samples of each output, never at the same time: they tell nothing of a colour
    counted = np.array([[True, False], [False, True]] * (few // 2))
    fault = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, nominal=0.01)})
    found = Monitor(fmuid.Baseline(sound, inflate), {"stator": fault}, Rule(forgetting=forgetting))
    own = COLUMNS[: 2 * few, :3][counted.ravel()] / STD
    scale = STD**2 / sound.variance["x"], STD**2 / sound.variance["y"]
    weight = np.tile(scale, len(own) // 2)
    vector = np.zeros(3)
    prior = np.diag([*((inflate * sound.normal(name).std) ** -2.0 for name in sound.names), 0.0])
    information, scatter = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(4):
        record = plate_record(np.random.default_rng(40 + k), ea=0.02 * k)
        frame = record.frame.iloc[:few].copy()
        frame[["x", "y"]] = frame[["x", "y"]].where(counted)
        window = replace(record, frame=frame, name=f"record {k}")
        found.add(window)
        vector = forgetting * vector + own.T @ (weight * window.output_values[counted] / STD)
        information = forgetting * information + own.T @ (weight[:, None] * own)
        scatter = forgetting**2 * scatter + own.T @ (weight[:, None] * own)
        total = information + prior
        expected = np.linalg.solve(total, vector + prior @ [*sound.values, 0.0])
        covariance = np.linalg.inv(total) @ (prior + scatter) @ np.linalg.inv(total)
        row = found.table.iloc[-1]
        assert [row[f"stator.{name}"] for name in ("g", "h", "ea")] == pytest.approx(expected, abs=1e-5)
        assert row["stator.ea.std"] == pytest.approx(math.sqrt(covariance[2, 2]), rel=1e-4)
        assert row["stator.D"] == pytest.approx(expected[2] ** 2 / covariance[2, 2], rel=1e-2, abs=1e-2)


@pytest.mark.parametrize("faults", [{}, {"eb": 0.05}, {"size": 0.06, "angle": 2.0}])
def test_bounds_and_angles_are_those_of_a_diagnosis(
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
    baseline = fmuid.Baseline(sound, 5.0)
    expected = fmuid.diagnose(record, baseline, hypotheses, plate)
    found = Monitor(baseline, hypotheses, Rule(needed=1, among=1))
    found.add(record)
    row = found.table.iloc[0]
    for name, sizes in (("stator", PHASES), ("rotor", ("size",))):
        hypothesis = expected[name]
        # a diagnosis divides by the largest factor of all directions, a window each direction by its own
        assert row[f"{name}.D"] == pytest.approx(hypothesis.statistic, rel=0.25, abs=1e-3)
        probability = hypothesis.reference.probability(row[f"{name}.D"])
        assert row[f"{name}.probability"] == pytest.approx(probability, rel=0.05)
        for size in sizes:
            assert row[f"{name}.{size}"] == pytest.approx(hypothesis[size].value, abs=2e-5)
    assert row["significant"] == (expected.named[0] if expected.named else "")
    assert [each.fault for each in found.alarms] == list(expected.named)
    if "angle" in faults:
        assert row["rotor.angle"] == pytest.approx(expected["rotor"]["size"].angle_value, abs=1e-3)
        assert row["rotor.angle.std"] == pytest.approx(expected["rotor"]["size"].angle_std, rel=0.02)


@pytest.mark.slow
def test_the_level_is_met_over_healthy_records(plate: fmuid.System, sound: fmuid.Result) -> None:
    rng, level, count = np.random.default_rng(8), 0.1, 300
    fault = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, nominal=0.01)})
    hits = 0
    for _ in range(count):
        known = replace(sound, values=np.array(list(TRUTH.values())) + sound.std * rng.standard_normal(2))
        baseline = fmuid.Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
        found = Monitor(baseline, {"a": fault}, Rule(level=level))
        found.add(plate_record(rng))
        hits += found.table["significant"][0] == "a"
    assert hits / count == pytest.approx(level, abs=3 * math.sqrt(level * (1 - level) / count))


# --- alarms -----------------------------------------------------------------------------


def test_an_alarm_takes_some_of_the_last_windows() -> None:
    rule = Rule(needed=2, among=3)
    seen = ["a", "", "", "a", "", "b", "b", "", "", ""]
    assert alarms(seen, [False] * 10, rule) == ["", "", "", "", "", "b", "b", "b", "", ""]
    odd = [False, True, True, False, False]
    assert alarms([""] * 5, odd, rule) == ["", "", SOMETHING_ELSE, SOMETHING_ELSE, ""]
    assert alarms(["a", "a", "", "", ""], odd, rule)[:3] == ["", "a", "a"]


def test_the_rate_of_false_alarms() -> None:
    assert alarm_rate(0.01, 3, 4) == pytest.approx(stats.binom.sf(2, 4, 0.01), rel=1e-6)
    assert alarm_rate(0.05, 1, 1, share=0.6) == pytest.approx(0.05, rel=1e-3)
    assert alarm_rate(0.05, 1, 1, share=0.6, two_sided=False) == pytest.approx(0.05, rel=1e-3)
    rng, count, share = np.random.default_rng(5), 200_000, 0.5
    common, own = rng.standard_normal((count, 1)), rng.standard_normal((count, 4))
    values = math.sqrt(share) * common + math.sqrt(1 - share) * own
    for two_sided, off in ((True, np.abs(values)), (False, values)):
        bound = stats.norm.isf(0.05 / (2 if two_sided else 1))
        rate = float(((off > bound).sum(axis=1) >= 3).mean())
        expected = alarm_rate(0.05, 3, 4, share=share, two_sided=two_sided)
        assert rate == pytest.approx(expected, abs=4 * math.sqrt(expected / count))
        assert expected < 0.05 * 4 / 3


def test_the_rates_of_a_run(healthy: fmuid.Result) -> None:
    found = watch(healthy)
    found.add(coil.experiment(warming(3, to=4.0)))
    rate, limit = found.false_alarm_rates()
    assert stats.binom.sf(2, 4, 0.01) < rate < limit == pytest.approx(0.04 / 3)
    assert math.isnan(watch(healthy, replace(RULE, forgetting=0.5)).false_alarm_rates()[0])


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


@pytest.mark.parametrize("forgetting", [0.0, 0.6])
def test_appending_gives_what_one_run_gives(
    folder: Path, forgetting: float, capsys: pytest.CaptureFixture[str]
) -> None:
    words = told(window=1, transient=0.2, forgetting=forgetting)
    study, records = str(folder / "study.toml"), folder / "records"
    assert run(["monitor", study, str(records), *words, "--no-report", "-o", str(folder / "whole")]) == 1
    assert "Fault: turns, from 3 s of day2 on" in capsys.readouterr().out
    grown = ["-o", str(folder / "grown"), "--figures", "png", "--no-report"]
    assert run(["monitor", study, str(records / "day0.csv"), str(records / "day1.csv"), *words, *grown]) == 0
    assert "No alarm" in capsys.readouterr().out
    assert run(["monitor", study, str(records), *words, *grown, "--append"]) == 1
    for name in ("monitoring.csv", "monitoring.json"):
        assert (folder / "grown" / name).read_bytes() == (folder / "whole" / name).read_bytes()
    assert (folder / "grown" / "figures" / "monitoring-turns.png").stat().st_size > 10_000
    other = [*told(window=1, transient=0.3), *grown, "--append"]
    capsys.readouterr()
    assert run(["monitor", study, str(records), *other]) == 2
    assert "another rule" in capsys.readouterr().err
    table, state = folder / "grown" / "monitoring.csv", folder / "grown" / "monitoring.json"
    whole = {path: path.read_text(encoding="utf-8") for path in (table, state)}
    later = json.loads(whole[state])
    for path, spoilt, said in (
        (table, whole[table][:-400], "is no table of fmuid monitor, or not whole"),
        (table, "\n".join(whole[table].split("\n")[:4]), "it has not the 12 windows"),
        (table, "time,u\n0,1\n", "is no table of fmuid monitor"),
        (table, "", "is no table of fmuid monitor"),
        (state, whole[state][:-400], "is not JSON"),
        (state, "{}", "give the monitoring.json of fmuid monitor"),
        (state, json.dumps({k: v for k, v in later.items() if k != "windows"}), "has no 'windows'"),
        (state, json.dumps(later | {"beliefs": []}), "has something in 'beliefs'"),
    ):
        path.write_text(spoilt, encoding="utf-8")
        assert run(["monitor", study, str(records), *words, *grown, "--append"]) == 2
        error = capsys.readouterr().err
        assert said in error and str(path) in error and "monitor without appending" in error and error.count("\n") == 1
        path.write_text(whole[path], encoding="utf-8")


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
    assert {path.name for path in found.files} == {"monitoring.csv", "monitoring.json", "monitoring-turns.png"}
    for name in ("monitoring.csv", "monitoring.json"):
        assert (mine / name).read_bytes() == (folder / "theirs" / name).read_bytes()
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
    words += told(window=1, transient=0.2, forgetting=0.6)

    def when(_: object, record: str, window: int, *__: object) -> bool:
        return (record, window) == ("day1", 2)

    with monkeypatch.context() as disturbed:
        disturbed.setattr(Monitor, "_row", killing(number, when, Monitor._row))
        assert command("monitor", *words, "-o", folder / "grown") == 1
    out, error = capsys.readouterr()
    saying = "interrupted: saving the records examined so far, with which --append goes on"
    assert error.splitlines() == [saying, "error: interrupted"]
    assert "monitoring.csv" in out
    assert set(pd.read_csv(folder / "grown" / "monitoring.csv")["record"]) == {"day0"}
    for name, more in (("grown", ["--append"]), ("whole", [])):
        assert command("monitor", *words, "-o", folder / name, *more, "--no-report") == 1
    for name in ("monitoring.csv", "monitoring.json"):
        assert (folder / "grown" / name).read_bytes() == (folder / "whole" / name).read_bytes()


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
        (told(needed=5), "[monitoring]: an alarm cannot take 5 of 4 windows"),
        (told(forgetting=1), "[monitoring]: forgetting must be 0 or more and below 1"),
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
        file.write("[monitoring]\nwindow = 2\ntransient = 0.5\nlevel = 0.02\nneeded = 2\namong = 5\nforgetting = 0.9\n")
    assert rule_of(fmuid.Study.read(path)) == Rule(2.0, 0.5, 0.02, 2, 5, 0.9)
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
        Monitor(healthy, {}, RULE)
