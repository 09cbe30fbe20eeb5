"""Variables fixed at the estimates of an earlier result, alone and in coupled systems."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from fmuid.apps.cli.options import DONE
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.models import FMU
from fmuid.runs import fits_at
from fmuid.studies import Study
from tests.support.coil_study import COIL, STUDY, coil_table, fmuid_
from tests.support.paths import FMUS
from tests.support.results import result

DRIVE = FMUS / "PositionDrive/PositionDrive.fmu"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    text = STUDY.replace("[[experiments]]", 'fixed.L = { result = "result.json" }\n[[experiments]]')
    (tmp_path / "study.toml").write_text("".join(line for line in text.splitlines(True) if not line.startswith("L =")))
    return tmp_path


def of_coil(folder: Path, **values: float) -> Path:
    models = {"": {"name": "Coil", "digest": FMU(COIL).digest}}
    return result(folder, {name: (value, 0.01) for name, value in values.items()}, models=models)


def test_a_variable_is_fixed_at_an_estimate(folder: Path) -> None:
    path = of_coil(folder, R=4.0, L=0.11)
    study = Study.read(folder / "study.toml")
    assert (study.model.values, study.notes, path in study.files()) == ({"L": 0.11}, (), True)
    of_coil(folder, R=4.0, l=0.1)
    study = Study.read(folder / "study.toml", ['model.fixed.L={result="result.json", name="l"}'])
    assert study.model.values == {"L": 0.1}


def test_wrong_results_are_refused(folder: Path) -> None:
    of_coil(folder, R=4.0)
    with pytest.raises(InputError, match=r"model.fixed.L: .* has no parameter 'L'.*It has R"):
        Study.read(folder / "study.toml")
    (folder / "result.json").write_text("{}")
    with pytest.raises(InputError, match=r"model.fixed.L: .*result.json.*schema.* run fmuid identify again"):
        Study.read(folder / "study.toml")
    result(folder, {"L": (0.1, 0.01)}, models={"": {"name": "Motor", "digest": "0"}})
    with pytest.raises(InputError, match="of another model, Motor"):
        _ = Study.read(folder / "study.toml").notes


def test_of_a_component_that_was_identified_alone(tmp_path: Path) -> None:
    result(tmp_path, {"M": (93.0, 1.0)}, models={"": {"name": "PositionDrive", "digest": FMU(DRIVE).digest}})
    emps = FMUS.parent / "experiments/emps/study.toml"
    data = tomllib.loads(emps.read_text(encoding="utf-8"))
    for each in data["model"]["components"]:
        each["fmu"] = str((emps.parent / each["fmu"]).resolve())
    data["model"]["fixed"]["drive.M"] = {"result": "result.json"}
    del data["parameters"]["drive.M"]
    (tmp_path / "table.csv").write_text("t,qg,vir\n0,0,0\n1,0,0\n")
    data["experiments"][0]["data"] = "table.csv"
    study = Study.of(data, tmp_path / "study.toml")
    assert study.model.values["drive.M"] == 93.0
    assert study.notes == ()


@pytest.mark.usefixtures("blank_figures")
def test_simulate_at_a_result(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "study.toml").write_text(STUDY)
    path = of_coil(folder, R=4.0, L=0.1)
    study = Study.read(folder / "study.toml")
    (at,) = fits_at(study, Result.from_json(path))
    (start,) = study.fits()
    assert 100.0 - at.fit[0] < 0.5 * (100.0 - start.fit[0])
    code = fmuid_("simulate", folder / "study.toml", "--result", folder, "-o", folder / "out", "--no-isolation")
    assert code == DONE
    assert f"{at.fit[0]:.4g} %" in capsys.readouterr().out
