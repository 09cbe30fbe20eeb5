"""Results: the study they keep, records that they predict, and values that later studies take from them."""

from __future__ import annotations

import json
import math
import pickle
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import FMU, InputError, Result, Study
from fmuid.apps.cli.options import DONE
from fmuid.codec import as_json
from fmuid.identification import ModelReference, predict_by_model
from fmuid.runs import cross_validate, fits_at, made_from, predict_with, records_like, study_of
from tests.support.coil_study import COIL, STUDY, coil_table, fmuid_
from tests.support.paths import FMUS
from tests.support.results import RESULT, result
from tests.support.running import run_study

OWN_START = "i_start = { start = 0.0, nominal = 0.1, per_experiment = true }\n"
MORE = """[[experiments]]
data = "{0}.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k, name in enumerate(("first", "second", "third")):
        coil_table(tmp_path / f"{name}.csv", 0.1 * k, seed=k)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def kept(study: Study, folder: Path) -> Path:
    """Write a result that keeps its study."""
    folder.mkdir(exist_ok=True)
    return result(folder, {"R": (4.0, 0.01), "L": (0.1, 0.001)}, origin=made_from(study, folder=folder))


def test_a_result_keeps_its_study(folder: Path) -> None:
    study = Study.read(folder / "study.toml", ["parameters.R.max=inf", "parameters.L.start=0.07"])
    path = kept(study, folder / "results")
    (folder / "study.toml").unlink()  # what was run counts, not what the file has become
    found = study_of(path)
    assert found.path == folder / "study.toml"
    assert found.data == study.data
    assert (found.parameters["R"].max, found.parameters["L"].start) == (math.inf, 0.07)
    assert study_of(path.parent, ["parameters.R.start=9"]).parameters["R"].start == 9.0


def test_a_table_that_is_gone_needs_another_in_its_place(folder: Path) -> None:
    path = kept(Study.read(folder / "study.toml"), folder)
    (folder / "first.csv").unlink()
    with pytest.raises(InputError, match=r"first\.csv"):
        study_of(path)
    assert study_of(path, in_place=folder / "second.csv").experiments[0].data == folder / "second.csv"


@pytest.mark.parametrize(
    ("origin", "said"),
    [
        (None, "--study"),
        ({"study": {}}, r"origin\.study\.file"),
        ({"study": {"content": True}}, r"origin\.study\.content: the value should be"),
        ({"study": {"content": {"experiments": 3}}}, r"s\.toml: .*experiments"),
        ({"study": {"content": {"experiments": [3]}}}, r"s\.toml: .*experiments"),
    ],
)
def test_a_file_without_a_study_is_refused(folder: Path, origin: dict[str, Any] | None, said: str) -> None:
    if origin is not None:
        origin |= {"version": "0", "date": ""}
        if origin["study"]:
            origin["study"] |= {"file": "s.toml", "digest": "", "text": "", "changed": False}
    result(folder, {"R": (4.0, 0.01)}, origin=origin)
    with pytest.raises(InputError, match=said):
        study_of(folder, in_place=folder / "second.csv")


def test_records_are_read_with_the_words_of_an_experiment(folder: Path) -> None:
    study = Study.read(folder / "study.toml")
    (record,) = records_like(study, [folder / "second.csv"])
    assert record.name == "second"
    assert record.held.all()
    with pytest.raises(InputError, match=r"unknown experiment 'firts' \(did you mean 'first'\?\)"):
        list(records_like(study, [folder / "second.csv"], "firts"))
    text = (folder / "second.csv").read_text().replace("time,u,i", "time,v,i")
    (folder / "other.csv").write_text(text)
    with pytest.raises(InputError, match=r"other\.csv: .*'u'.*\(inputs and outputs are those of experiment 'first' of"):
        list(records_like(study, [folder / "other.csv"]))


def test_records_in_other_units_and_variables_estimated_again(folder: Path) -> None:
    study = Study.read(folder / "study.toml")
    result, table = study.identify(), pd.read_csv(folder / "third.csv")
    table.assign(i=1e3 * table["i"]).rename(columns={"i": "i [mA]"}).to_csv(folder / "milli.csv", index=False)
    plain, milli = records_like(study, [folder / "third.csv", folder / "milli.csv"])
    one, other = predict_with(study, result, plain), predict_with(study, result, milli)
    assert other.scores[0].unit == "mA"
    assert other.scores[0].rmse == pytest.approx(1e3 * one.scores[0].rmse)
    np.testing.assert_allclose(other.half_width, 1e3 * one.half_width, rtol=1e-6)
    assert other.scores[0].ratio == pytest.approx(one.scores[0].ratio) and one.scores[0].ratio > 1.1
    again = predict_with(study, result, plain, free=["i_start"])
    assert again.estimated is not None
    assert abs(again.estimated["i_start"] - 0.2) < 4 * again.estimated.std[0]
    with pytest.raises(InputError, match="i_stat"):
        predict_with(study, result, plain, free=["i_stat"])


def test_a_parameter_without_a_value_is_refused(folder: Path) -> None:
    study = Study.read(folder / "study.toml", ["parameters.i_start={start=0.0, nominal=0.1}"])
    result = Result.from_json(kept(study, folder))
    (record,) = records_like(study, [folder / "second.csv"])
    with pytest.raises(InputError, match=r"i_start: the result has no value.*--refit"):
        predict_with(study, result, record)
    assert predict_with(study, result, record, free=["i_start"]).estimated is not None


def test_each_part_is_predicted_from_the_others(folder: Path) -> None:
    text = STUDY + OWN_START + MORE.format("second") + MORE.format("third")
    (folder / "study.toml").write_text(text)
    study = Study.read(folder / "study.toml")
    folds, predictions = cross_validate(study, 3)
    assert [fold.left_out for fold in folds] == [("first",), ("second",), ("third",)]
    for fold, found in zip(folds, predictions, strict=True):
        assert found.scores[0].ratio == pytest.approx(1.0, abs=0.1)
        assert not any(series.experiment == found.fit.experiment for series in fold.result.setup.data)
        assert {series.samples for series in fold.result.setup.data} == {600}
    pairs, _ = cross_validate(study, 2)
    assert [len(fold.left_out) for fold in pairs] == [2, 1]
    alone = Study.read(folder / "study.toml", ['experiments=[{data="first.csv", outputs=["i"], inputs=["u"]}]'])
    with pytest.raises(InputError, match=r"2 folds of 1 experiments.*cannot be cross-validated"):
        cross_validate(alone, 2)


DRIVE = FMUS / "PositionDrive/PositionDrive.fmu"


@pytest.fixture
def fixed(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    text = STUDY.replace("[[experiments]]", 'fixed.L = { result = "result.json" }\n[[experiments]]')
    (tmp_path / "study.toml").write_text("".join(line for line in text.splitlines(True) if not line.startswith("L =")))
    return tmp_path


def of_coil(folder: Path, **values: float) -> Path:
    models = {"": {"name": "Coil", "digest": FMU(COIL).digest}}
    return result(folder, {name: (value, 0.01) for name, value in values.items()}, models=models)


def test_a_variable_is_fixed_at_an_estimate(fixed: Path) -> None:
    path = of_coil(fixed, R=4.0, L=0.11)
    study = Study.read(fixed / "study.toml")
    assert (study.model.values, study.notes, path in study.files()) == ({"L": 0.11}, (), True)
    of_coil(fixed, R=4.0, l=0.1)
    study = Study.read(fixed / "study.toml", ['model.fixed.L={result="result.json", name="l"}'])
    assert study.model.values == {"L": 0.1}


def test_wrong_results_are_refused(fixed: Path) -> None:
    of_coil(fixed, R=4.0)
    with pytest.raises(InputError, match=r"model.fixed.L: .* has no parameter 'L'.*It has R"):
        Study.read(fixed / "study.toml")
    (fixed / "result.json").write_text("{}")
    with pytest.raises(InputError, match=r"model.fixed.L: .*result.json.*schema.* run fmuid identify again"):
        Study.read(fixed / "study.toml")
    result(fixed, {"L": (0.1, 0.01)}, models={"": {"name": "Motor", "digest": "0"}})
    with pytest.raises(InputError, match="of another model, Motor"):
        _ = Study.read(fixed / "study.toml").notes


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
def test_simulate_at_a_result(fixed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (fixed / "study.toml").write_text(STUDY)
    path = of_coil(fixed, R=4.0, L=0.1)
    study = Study.read(fixed / "study.toml")
    (at,) = fits_at(study, Result.from_json(path))
    (start,) = study.fits()
    assert 100.0 - at.fit[0] < 0.5 * (100.0 - start.fit[0])
    code = fmuid_("simulate", fixed / "study.toml", "--result", fixed, "-o", fixed / "out", "--no-isolation")
    assert code == DONE
    assert f"{at.fit[0]:.4g} %" in capsys.readouterr().out


def test_a_result_predicts_by_the_model_that_it_was_made_with() -> None:
    coil = fmuid.datasets.coil()
    held = fmuid.Problem(coil.fmu, coil.experiment, {"R": coil.parameters["R"]}, values={"L": 0.2}, step_size=1e-3)
    result = fmuid.identify(held)
    known = ModelReference(fmuid.System.of(coil.fmu), {"L": 0.2}, step_size=1e-3)
    expected = predict_by_model(known, result, coil.experiment)
    found = fmuid.predict(result, coil.experiment)
    np.testing.assert_array_equal(found.fit.simulated, expected.fit.simulated)
    np.testing.assert_array_equal(found.half_width, expected.half_width)
    other = fmuid.predict(result, coil.experiment, values={"L": 0.05})
    assert not np.allclose(other.fit.simulated, expected.fit.simulated)
    given = fmuid.predict(result, coil.experiment, coil.fmu)  # which holds nothing: L is the FMU's own
    assert given.fit.simulated == pytest.approx(predict_by_model(coil.fmu, result, coil.experiment).fit.simulated)
    again = fmuid.predict(result, coil.experiment, free="R").estimated
    assert again is not None and again["R"] == pytest.approx(result["R"], rel=1e-3)
    assert again.estimates.lower == [0.0]  # its bound there was


def test_so_does_one_of_a_study_and_one_of_a_file(tmp_path: Path) -> None:
    coil = fmuid.datasets.coil()
    study = fmuid.Study.of(coil.study | {"model": {"fmu": str(coil.fmu), "fixed": {"i_start": 0.0}}}, tmp_path / "s")
    findings = run_study(study, tmp_path)
    expected = predict_by_model(coil.fmu, findings.result, coil.experiment).scores[0].rmse
    for each in (findings.result, fmuid.Result.from_json(tmp_path / "result.json")):
        assert fmuid.predict(each, coil.experiment).scores[0].rmse == pytest.approx(expected, rel=1e-6)
        assert fmuid.predict(each, coil.experiment, free=["i_start"]).estimated is not None


def test_one_that_knows_no_model_asks_for_it(tmp_path: Path) -> None:
    coil = fmuid.datasets.coil()
    result = fmuid.identify(coil.problem())
    sent = pickle.loads(pickle.dumps(result))
    with pytest.raises(fmuid.InputError, match="No model recorded"):
        fmuid.predict(sent, coil.experiment)
    assert fmuid.predict(sent, coil.experiment, coil.fmu).fit.outputs == ("i",)
    (tmp_path / "result.json").write_text(json.dumps(RESULT | as_json(result)))
    with pytest.raises(fmuid.InputError, match=r"no study recorded.*, or pass model="):
        fmuid.predict(fmuid.Result.from_json(tmp_path / "result.json"), coil.experiment)
