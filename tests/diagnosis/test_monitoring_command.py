"""The command that watches records, what it keeps, and what it refuses."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.coil import study as coil
from fmuid.apps.cli.app import run
from fmuid.data.npz import read_arrays, write_arrays
from fmuid.diagnosis.alarms import Rule
from fmuid.diagnosis.window_evaluation import WindowEvaluation
from fmuid.runs.faults import design_of, rule_of
from tests.support.coil_records import warming
from tests.support.interrupting import SIGNALS, command, killing
from tests.support.running import run_monitoring

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


@pytest.mark.slow
def test_appending_gives_what_one_run_gives(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = told(window_length=1, warmup=0.2)
    study, records = str(folder / "study.toml"), folder / "records"
    assert run(["monitor", study, str(records), *words, "--no-report", "-o", str(folder / "whole")]) == 1
    alarm = "ALARM turns since 0 s (95 %: 3.95 s of day1 to 0.25 s) of day2, raised at 1 s."
    assert alarm in capsys.readouterr().out
    grown = ["-o", str(folder / "grown"), "--figures", "png", "--no-report"]
    assert run(["monitor", study, str(records / "day0.csv"), str(records / "day1.csv"), *words, *grown]) == 0
    assert "NO ALARM" in capsys.readouterr().out
    assert run(["monitor", study, str(records), *words, *grown, "--resume"]) == 1
    assert written(folder / "grown") == written(folder / "whole")
    assert (folder / "grown" / "figures" / "timeline.png").stat().st_size > 10_000
    other = [*told(window_length=1, warmup=0.3), *grown, "--resume"]
    capsys.readouterr()
    assert run(["monitor", study, str(records), *other]) == 2
    assert "another rule" in capsys.readouterr().err
    table, state = folder / "grown" / "monitoring.csv", folder / "grown" / "monitoring.npz"
    whole = {path: path.read_bytes() for path in (table, state)}
    arrays = read_arrays(state)
    later = json.loads(arrays.pop("text").tobytes())

    def saying(content: object) -> bytes:
        text = np.frombuffer(json.dumps(content).encode(), np.uint8)
        return write_arrays(folder / "made.npz", {"text": text, **arrays}).read_bytes()

    for path, spoilt, said in (
        (table, whole[table][:-400], "is not of fmuid monitor, or not whole"),
        (table, b"\n".join(whole[table].split(b"\n")[:4]), "it has not the 12 windows"),
        (table, b"time,u\n0,1\n", "is not of fmuid monitor"),
        (table, b"", "is not of fmuid monitor"),
        (state, whole[state][:-400], "is not of fmuid monitor, or not whole"),
        (state, saying({}), "has no 'same'"),
        (state, saying({k: v for k, v in later.items() if k != "windows"}), "has no 'windows'"),
        (state, saying(later | {"records": [1]}), "records[0]: the value should be an object, not 1"),
    ):
        path.write_bytes(spoilt)
        assert run(["monitor", study, str(records), *words, *grown, "--resume"]) == 2
        error = capsys.readouterr().err
        assert said in error and str(path) in error and "monitor without appending" in error and error.count("\n") == 1
        path.write_bytes(whole[path])
    table.write_bytes(whole[table] + b"rows of a run that was killed before it had written its state")
    assert run(["monitor", study, str(records), *words, *grown, "--resume"]) == 1
    assert table.read_bytes() == whole[table]


def written(folder: Path) -> tuple[bytes, dict[str, Any]]:
    """Return the content of the files of a monitoring, but for the date and the order of their origin."""
    content = json.loads((folder / "monitoring.json").read_text(encoding="utf-8"))
    assert content["origin"]["files"]
    content["origin"]["date"] = ""
    return (folder / "monitoring.csv").read_bytes(), content


@pytest.mark.slow
def test_from_python_it_is_what_the_command_does(folder: Path) -> None:
    """The same files and verdict; what comes before a record that is wrong is written, and can be gone on with."""
    study, records, mine = folder / "study.toml", folder / "records", folder / "mine"
    words = ["monitoring.window_length=1", "monitoring.warmup=0.2"]
    theirs = ["--no-report", "-o", str(folder / "theirs")]
    assert run(["monitor", str(study), str(records), *told(window_length=1, warmup=0.2), *theirs]) == 1
    read = fmuid.Study.read(study, words)
    (folder / "wrong.csv").write_text("time,nothing\n0,1\n1,1\n", encoding="utf-8")
    with pytest.raises(fmuid.InputError, match="wrong"):
        run_monitoring(read, [records / "day0.csv", folder / "wrong.csv"], mine)
    found = run_monitoring(read, [records], mine, figures="png", append=True)
    assert not found.healthy
    assert {path.name for path in found.files} == {"document.json", "monitoring.csv", "monitoring.json", "timeline.png"}
    assert written(mine) == written(folder / "theirs")
    alone = run_monitoring(read, [records / "day0.csv"])
    assert (alone.healthy, alone.files) == (True, ())
    with pytest.raises(fmuid.InputError, match="in a folder"):
        run_monitoring(read, [records], append=True)


@pytest.mark.parametrize("number", SIGNALS)
def test_interrupted_inside_a_record(
    folder: Path, number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The records before it are kept, which is told, and appending examines the whole of it."""
    words: list[str | Path] = [folder / "study.toml", folder / "records"]
    words += told(window_length=1, warmup=0.2)

    def when(seen: WindowEvaluation) -> bool:
        return (seen.now.records[-1].name, seen.sums.window.number) == ("day1", 2)

    with monkeypatch.context() as disturbed:
        disturbed.setattr(WindowEvaluation, "row", killing(number, when, WindowEvaluation.row))
        assert command("monitor", *words, "-o", folder / "grown") == 1
    out, error = capsys.readouterr()
    saying = "interrupted: saving the records examined so far, with which --resume goes on"
    assert error.splitlines() == [saying, "error: interrupted"]
    assert "monitoring.csv" in out
    assert set(pd.read_csv(folder / "grown" / "monitoring.csv")["record"]) == {"day0"}
    for name, more in (("grown", ["--resume"]), ("whole", [])):
        assert command("monitor", *words, "-o", folder / name, *more, "--no-report") == 1
    assert written(folder / "grown") == written(folder / "whole")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            told(window_length=0.1, warmup=0.2),
            "monitoring: windows of 0.1 s are not longer than the transient of 0.2",
        ),
        (told(window_length=0.1, warmup=0.02), "day0.csv: the transient lasts longer than 0.02 s"),
        (told(window_length=1), "monitoring: missing key 'warmup'"),
        (told(window_length=9, warmup=0.2), "shorter than a window of 9 s"),
        (told(window_length=-1, warmup=0.2), "monitoring.window_length: must be a number above 0, not -1"),
        (told(warmup=-1), "monitoring.warmup: must be a number, 0 or above, not -1"),
        (told(warmup=9), "leaves no window"),
        (told(false_alarm_horizon=0), "monitoring.false_alarm_horizon: must be a number above 0, not 0"),
        (told(size_limits=1), "monitoring.size_limits: must be { fault.size = number }"),
        (told(needed=3), "monitoring: unknown key 'needed'"),
        (told(false_alarm_rate=2), "monitoring.false_alarm_rate: must be a number between 0 and 1, not 2"),
        (told(windows=1), "monitoring: unknown key 'windows' (did you mean 'window_length'?)"),
        (["--resume"], "no earlier run to append to"),
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
    plain = fmuid.Study.read(path, ["experiments.0.warmup=0.3", "diagnosis.false_alarm_rate=0.05"])
    assert rule_of(plain) == Rule(None, 0.3, 0.05)
    with path.open("a", encoding="utf-8") as file:
        file.write(
            "[monitoring]\nwindow_length = 2\nwarmup = 0.5\nfalse_alarm_rate = 0.02\n"
            'false_alarm_horizon = 60\nsize_limits = { "turns.dR" = 1 }\n'
        )
    assert rule_of(fmuid.Study.read(path)) == Rule(2.0, 0.5, 0.02, 60.0, {"turns.dR": 1.0})
    assert (plain.monitoring.place.file, plain.monitoring.place.keys) == (f"{path} with --set", ("monitoring",))


def test_wrong_records_are_one_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, words = str(folder / "study.toml"), told(window_length=1, warmup=0.2)
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
    assert run(["monitor", study, str(folder / "records"), *told(window_length=1, warmup=0.02)]) == 2
    assert len(pd.read_csv(folder / "results" / "monitoring.csv")) == 4


def test_a_study_without_diagnosis_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    path = coil.HERE / "healthy.toml"
    assert run(["monitor", str(path), str(coil.HERE / "test1.csv")]) == 2
    assert "no [diagnosis]" in capsys.readouterr().err
    with pytest.raises(fmuid.InputError, match="has no fault 'bars', only turns"):
        design_of(fmuid.Study.read(coil.HERE / "test.toml"), "bars")
