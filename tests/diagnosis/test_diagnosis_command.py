"""fmuid diagnose and fmuid monitor from end to end."""

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
from fmuid import Rule
from fmuid.apps.cli.app import run
from fmuid.codec import as_json
from fmuid.data import read_arrays, write_arrays
from fmuid.diagnosis.window_evaluation import WindowEvaluation
from fmuid.runs.faults import rule_of
from tests.support.coil_records import warming
from tests.support.interrupting import SIGNALS, command, killing
from tests.support.plate import Look, record
from tests.support.results import RESULT
from tests.support.running import run_monitoring

STUDY = """
[model]
fmu = "Plate.fmu"
[[experiments]]
data = "table.csv"
inputs = ["ux", "uy", "vx", "vy"]
outputs = ["x", "y"]
[diagnosis]
baseline = "result.json"
std_factor = { g = 5, h = 5 }
[diagnosis.faults.stator]
parameters = { ea = { nominal = 0.01, min = 0 }, eb = { nominal = 0.01, min = 0 }, ec = { nominal = 0.01, min = 0 } }
[diagnosis.faults.rotor]
fmu = "Plate.fmu"
parameters = { size = { nominal = 0.01, min = 0 }, angle = { nominal = 1, min = 0, max = 3.141592653589793 } }
angles = ["angle"]
"""
STATOR, ANGLES = STUDY.index("[diagnosis.faults.stator]"), 'angles = ["angle"]'


@pytest.fixture
def study(tmp_path: Path, plate: fmuid.System, sound: fmuid.Result) -> Path:
    (tmp_path / "Plate.fmu").write_bytes(plate.components[""].fmu.path.read_bytes())
    (tmp_path / "result.json").write_text(json.dumps(RESULT | as_json(sound)), encoding="utf-8")
    record(np.random.default_rng(20), size=0.08, angle=1.0).frame.to_csv(tmp_path / "table.csv", index=False)
    record(np.random.default_rng(21)).frame.to_csv(tmp_path / "sound.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path / "study.toml"


@pytest.mark.usefixtures("blank_figures")
def test_command(study: Path, look: Look, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(study), "--figures", "png"]) == 1
    results = study.parent / "results"
    assert "FAULT: rotor, size = 0.0" in capsys.readouterr().out
    read = fmuid.Diagnosis.from_json(results / "diagnosis.json")
    direct = look(record(np.random.default_rng(20), size=0.08, angle=1.0))
    assert read["rotor.size"].value == pytest.approx(direct["rotor.size"].value, rel=1e-6)
    assert {path.stem for path in (results / "figures").glob("*.png")} == {"causes", "changes", "explained"}
    assert "FAULT: rotor" in (results / "document.json").read_text(encoding="utf-8")
    explained = pd.read_csv(results / "diagnosis-residuals.csv")
    assert explained.filter(like="fault.").std().mean() < explained.filter(like="healthy.").std().mean()
    causes = list(pd.read_csv(results / "diagnosis.csv")["cause"])
    assert causes == ["stator.ea", "stator.eb", "stator.ec", "rotor.size"]


def test_command_on_a_sound_machine(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study.write_text(STUDY.replace("angle = { nominal = 1, ", "angle = { "), encoding="utf-8")  # angles need none
    assert run(["diagnose", str(study), "--set", "experiments.0.data=sound.csv", "--no-report"]) == 0
    assert "HEALTHY at 1 % false-alarm rate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('baseline = "result.json"', "", "missing key 'baseline'"),
        ('"result.json"', '"table.csv"', "is not JSON"),
        ("ea = { nominal = 0.01, min = 0 }", "ea = { min = 0 }", "diagnosis.faults.stator.parameters.ea:"),
        ("ea = { nominal = 0.01", "ea = { start = 0.01", "start"),
        (ANGLES, 'angles = ["angel"]', "diagnosis.faults.rotor: unknown angle 'angel'"),
        (ANGLES, "angles = { angle = { period = 3.14 } }", "missing key 'magnitude'"),
        ("[diagnosis.faults.stator]", "[diagnosis.faults.stator]\nstep_size = 1", "step_size: needs a model"),
        ("ea = {", "dR = {", "has no variable 'dR'"),
        ("g = 5, h = 5", "g = -5", "a number above 0"),
        ("[diagnosis]", '[estimation]\nloss = "huber"\n[diagnosis]', 'cannot be combined with loss = "huber"'),
        (STUDY[STATOR:], "", "diagnosis: no faults"),
        (STUDY[STATOR:], "[diagnosis.faults.stator]\n", "diagnosis.faults.stator: no fault parameters"),
        (STUDY[STUDY.index("[diagnosis]") :], "", "no [diagnosis]"),
    ],
)
def test_wrong_studies(study: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str) -> None:
    assert old in STUDY
    study.write_text(STUDY.replace(old, new), encoding="utf-8")
    assert run(["diagnose", str(study)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def told(**words: float) -> list[str]:
    """Return the options that set keys of [monitoring]."""
    return [option for key, value in words.items() for option in ("--set", f"monitoring.{key}={value}")]


WINDOWS = told(window_length=1, warmup=0.2)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with records of a coil that is sound, then warm, then faulty, and a study beside it."""
    folder = tmp_path_factory.mktemp("template")
    (folder / "records").mkdir()
    for k in range(3):
        table = warming(4, to=4.4, fails=0 if k == 2 else math.inf, seed=10 + k)
        table.to_csv(folder / "records" / f"day{k}.csv", index=False)
    shutil.copytree(coil.HERE / "healthy", folder / "healthy")
    text = (coil.HERE / "test.toml").read_text(encoding="utf-8")
    text = text.replace("../../fmus", coil.FMUS.as_posix()).replace("test1.csv", "records/day0.csv")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def folder(template: Path, tmp_path: Path) -> Path:
    return shutil.copytree(template, tmp_path / "coil")


def monitor(folder: Path, output: str, *words: str, data: str = "records") -> int:
    paths = [str(folder / each) for each in data.split()]
    return run(
        ["monitor", str(folder / "study.toml"), *paths, *(words or WINDOWS), "--no-report", "-o", str(folder / output)]
    )


def written(folder: Path) -> tuple[bytes, dict[str, Any]]:
    """Return the content of the files of a monitoring, but for the date and the order of their origin."""
    content = json.loads((folder / "monitoring.json").read_text(encoding="utf-8"))
    assert content["origin"]["files"]
    content["origin"]["date"] = ""
    return (folder / "monitoring.csv").read_bytes(), content


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_resuming_gives_the_result_of_one_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the command and in Python; findings before a wrong record are written, and can be resumed."""
    records, mine, grown = folder / "records", folder / "mine", folder / "grown"
    assert monitor(folder, "whole") == 1
    alarm = "ALARM turns since 0 s (95 %: 3.95 s of day1 to 0.25 s) of day2, raised at 1 s."
    assert alarm in capsys.readouterr().out
    assert monitor(folder, "grown", *WINDOWS, "--figures", "png", data="records/day0.csv records/day1.csv") == 0
    assert "NO ALARM" in capsys.readouterr().out
    assert monitor(folder, "grown", *WINDOWS, "--figures", "png", "--resume") == 1
    assert (grown / "figures" / "timeline.png").is_file()
    capsys.readouterr()
    assert monitor(folder, "grown", *told(window_length=1, warmup=0.3), "--resume") == 2
    assert "another rule" in capsys.readouterr().err
    read = fmuid.Study.read(folder / "study.toml", ["monitoring.window_length=1", "monitoring.warmup=0.2"])
    (folder / "wrong.csv").write_text("time,nothing\n0,1\n1,1\n", encoding="utf-8")
    with pytest.raises(fmuid.InputError, match="wrong"):
        run_monitoring(read, [records / "day0.csv", folder / "wrong.csv"], mine)
    found = run_monitoring(read, [records], mine, figures="png", append=True)
    assert not found.healthy
    assert {path.name for path in found.files} == {"document.json", "monitoring.csv", "monitoring.json", "timeline.png"}
    assert written(mine) == written(grown) == written(folder / "whole")
    alone = run_monitoring(read, [records / "day0.csv"])
    assert (alone.healthy, alone.files) == (True, ())
    with pytest.raises(fmuid.InputError, match="needs the folder"):
        run_monitoring(read, [records], append=True)


@pytest.mark.slow
def test_damaged_files_are_not_resumed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert monitor(folder, "out") == 1
    table, state = folder / "out" / "monitoring.csv", folder / "out" / "monitoring.npz"
    whole = {path: path.read_bytes() for path in (table, state)}
    arrays = read_arrays(state)
    later = json.loads(arrays.pop("text").tobytes())

    def state_of(content: object) -> bytes:
        text = np.frombuffer(json.dumps(content).encode(), np.uint8)
        return write_arrays(folder / "made.npz", {"text": text, **arrays}).read_bytes()

    for path, damaged, said in (
        (table, whole[table][:-400], "no complete file of fmuid monitor"),
        (table, b"\n".join(whole[table].split(b"\n")[:4]), "not the 12 windows"),
        (table, b"", "no complete file"),
        (state, whole[state][:-400], "no complete file"),
        (state, state_of({}), "no 'same'"),
        (state, state_of(later | {"records": [1]}), "records[0]: the value should be an object, not 1"),
    ):
        path.write_bytes(damaged)
        capsys.readouterr()
        assert monitor(folder, "out", *WINDOWS, "--resume") == 2
        error = capsys.readouterr().err
        assert said in error and str(path) in error and "without --resume" in error and error.count("\n") == 1
        path.write_bytes(whole[path])
    table.write_bytes(whole[table] + b"rows of a run that was killed before it had written its state")
    assert monitor(folder, "out", *WINDOWS, "--resume") == 1
    assert table.read_bytes() == whole[table]


@pytest.mark.parametrize("number", SIGNALS)
def test_an_interruption_inside_a_record(
    folder: Path, number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The records before it are kept, and --resume examines the whole of it."""

    def when(seen: WindowEvaluation) -> bool:
        return (seen.now.records[-1].name, seen.sums.window.number) == ("day1", 2)

    words: list[str | Path] = ["monitor", folder / "study.toml", folder / "records", *WINDOWS, "--no-report", "-o"]
    with monkeypatch.context() as disturbed:
        disturbed.setattr(WindowEvaluation, "row", killing(number, when, WindowEvaluation.row))
        assert command(*words, folder / "grown") == 1
    out, error = capsys.readouterr()
    told, said = error.splitlines()
    assert told.startswith("interrupted: saving") and "--resume" in told and said == "error: interrupted"
    assert "monitoring.csv" in out
    assert set(pd.read_csv(folder / "grown" / "monitoring.csv")["record"]) == {"day0"}
    assert command(*words, folder / "grown", "--resume") == command(*words, folder / "whole") == 1
    assert written(folder / "grown") == written(folder / "whole")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (told(window_length=0.1, warmup=0.2), "not longer than the warm-up of 0.2 s"),
        (told(window_length=0.1, warmup=0.02), "day0.csv: warm-up of 0.02 s too short"),
        (told(window_length=1), "monitoring: missing key 'warmup'"),
        (told(window_length=9, warmup=0.2), "shorter than a window of 9 s"),
        (told(window_length=-1, warmup=0.2), "monitoring.window_length: must be a number above 0, not -1"),
        (told(warmup=9), "no window has samples"),
        (told(size_limits=1), "monitoring.size_limits: must be { fault.size = number }"),
        (told(windows=1), "monitoring: unknown key 'windows' (did you mean 'window_length'?)"),
        (["--resume"], "no earlier run to resume"),
        (["--set", "noise.variance=0"], "variance"),
    ],
)
def test_wrong_words(template: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert monitor(template, "results", *words) == 2
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


def test_wrong_records(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warming(2, to=4.0).rename(columns={"u": "v"}).to_csv(folder / "other.csv", index=False)
    (folder / "empty").mkdir()
    shutil.copy(folder / "records" / "day0.csv", folder / "empty" / "day0.bak")
    shutil.copy(folder / "records" / "day0.csv", folder / "day0.csv")
    for data, said in (
        ("other.csv", "'u'"),
        ("empty", "empty"),
        ("records day0.csv", "has the same name"),
        ("day0.csv day0.csv", "given twice"),
        ("none.csv", "none.csv"),
    ):
        assert monitor(folder, "results", data=data) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1
    # what came before is kept
    assert monitor(folder, "results", data="records/day0.csv other.csv") == 2
    assert monitor(folder, "results", *told(window_length=1, warmup=0.02)) == 2
    assert len(pd.read_csv(folder / "results" / "monitoring.csv")) == 4
    assert run(["monitor", str(coil.HERE / "healthy.toml"), str(coil.HERE / "test1.csv")]) == 2
    assert "no [diagnosis]" in capsys.readouterr().err
