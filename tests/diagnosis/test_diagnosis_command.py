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
from tests.support.plate import Look, record
from tests.support.results import RESULT

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
    assert "FAULT: rotor" in (results / "report.html").read_text(encoding="utf-8")
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
