"""The command that diagnoses, and its study file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.codec import as_json
from fmuid.events import Event
from tests.support.diagnosis_studies import Look
from tests.support.plate import (
    record,
)
from tests.support.results import RESULT
from tests.support.running import run_diagnosis

# --- study file and command -------------------------------------------------------------

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


@pytest.fixture
def study(tmp_path: Path, plate: fmuid.System, healthy: fmuid.Result) -> Path:
    (tmp_path / "Plate.fmu").write_bytes(plate.components[""].fmu.path.read_bytes())
    (tmp_path / "result.json").write_text(json.dumps(RESULT | as_json(healthy)), encoding="utf-8")
    record(np.random.default_rng(20), size=0.08, angle=1.0).frame.to_csv(tmp_path / "table.csv", index=False)
    record(np.random.default_rng(21)).frame.to_csv(tmp_path / "sound.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path / "study.toml"


def test_the_command_says_what_it_found(study: Path, look: Look, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(study), "--figures", "png"]) == 1
    out = capsys.readouterr().out
    assert "FAULT: rotor, size = 0.0" in out
    read = fmuid.Diagnosis.from_json(study.parent / "results" / "diagnosis.json")
    direct = look(record(np.random.default_rng(20), size=0.08, angle=1.0))
    assert read["rotor.size"].value == pytest.approx(direct["rotor.size"].value, rel=1e-6)
    figures = {path.stem for path in (study.parent / "results" / "figures").glob("*.png")}
    assert figures == {"causes", "changes", "explained"}
    assert "FAULT: rotor" in (study.parent / "results" / "report.html").read_text(encoding="utf-8")
    explained = pd.read_csv(study.parent / "results" / "diagnosis-residuals.csv")
    assert explained.filter(like="fault.").std().mean() < explained.filter(like="healthy.").std().mean()
    table = pd.read_csv(study.parent / "results" / "diagnosis.csv")
    assert list(table["cause"]) == ["stator.ea", "stator.eb", "stator.ec", "rotor.size"]


@pytest.mark.slow
def test_from_python_it_is_what_the_command_does(study: Path) -> None:
    """The same files and verdict; without a folder the verdict alone, told before it is returned."""
    drawn = ["--figures", "png", "--no-report"]
    assert run(["diagnose", str(study), "--no-isolation", "-o", str(study.parent / "theirs"), *drawn]) == 1
    mine = study.parent / "mine"
    found = run_diagnosis(study, mine, figures="png")
    assert not found.healthy
    assert {path.relative_to(mine) for path in found.files} == files_in(study.parent / "theirs") == files_in(mine)
    assert (mine / "diagnosis.csv").read_bytes() == (study.parent / "theirs" / "diagnosis.csv").read_bytes()
    one, other = (json.loads((path / "diagnosis.json").read_text()) for path in (mine, study.parent / "theirs"))
    one["origin"]["date"] = other["origin"]["date"]
    assert one == other
    before, events = files_in(study.parent), list[Event]()
    again = run_diagnosis(fmuid.Study.read(study), progress=events.append)
    assert (again.files, files_in(study.parent)) == ((), before)
    assert again.healthy is False
    assert {event.task for event in events} == {"diagnosis"}
    with pytest.raises(fmuid.InputError, match="in a folder"):
        fmuid.run(study, command="diagnose", figures="png")


def files_in(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}


def test_the_command_finds_nothing_in_a_sound_machine(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study.write_text(STUDY.replace("angle = { nominal = 1, ", "angle = { "), encoding="utf-8")  # angles need none
    assert run(["diagnose", str(study), "--set", "experiments.0.data=sound.csv"]) == 0
    assert "NO FAULT at 1 % false-alarm rate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('baseline = "result.json"', "", "missing key 'baseline'"),
        ('baseline = "result.json"', 'baseline = "none.json"', "not found"),
        ('baseline = "result.json"', 'baseline = "table.csv"', "is not JSON"),
        ("ea = { nominal = 0.01, min = 0 }", "ea = { min = 0 }", "diagnosis.faults.stator.parameters.ea:"),
        ("ea = { nominal = 0.01", "ea = { start = 0.01", "start"),
        ('angles = ["angle"]', 'angles = ["angel"]', "diagnosis.faults.rotor: the angle 'angel'"),
        ('angles = ["angle"]', "angles = { angle = { period = 3.14 } }", "missing key 'magnitude'"),
        ('angles = ["angle"]', 'inputs = { q = "none" }', "'none'"),
        ('angles = ["angle"]', "step_sise = 1", "did you mean 'step_size'"),
        ("[diagnosis.faults.stator]", "[diagnosis.faults.stator]\nstep_size = 1", "step_size: needs a model"),
        ("ea = {", "dR = {", "has no variable 'dR'"),
        ("std_factor = { g = 5, h = 5 }", "std_factor = { g = -5 }", "a number above 0"),
        ("[diagnosis]", '[estimation]\nloss = "huber"\n[diagnosis]', 'cannot be combined with loss = "huber"'),
        ("[diagnosis]", "[noise]\nrelative_std = 0.1\n[diagnosis]", "leave noise.relative_std out"),
        (STUDY[STUDY.index("[diagnosis.faults.stator]") :], "", "diagnosis: no faults"),
        (STUDY[STUDY.index("[diagnosis]") :], "", "no [diagnosis]"),
    ],
)
def test_a_wrong_study_is_one_sentence(
    study: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    assert old in STUDY
    study.write_text(STUDY.replace(old, new), encoding="utf-8")
    assert run(["diagnose", str(study)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_fault_without_parameters_is_refused(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study.write_text(
        STUDY[: STUDY.index("[diagnosis.faults.stator]")] + "[diagnosis.faults.stator]\n", encoding="utf-8"
    )
    assert run(["diagnose", str(study)]) == 2
    assert "diagnosis.faults.stator: no fault parameters" in capsys.readouterr().err
