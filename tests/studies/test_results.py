"""The study that a result was made by, kept in its file; records read like it; cross-validation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.runs import cross_validate, made_from, predict_with, records_like, study_of
from fmuid.studies import Study
from tests.support.coil_study import STUDY, coil_table
from tests.support.results import result as written

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
    return written(folder, {"R": (4.0, 0.01), "L": (0.1, 0.001)}, origin=made_from(study, folder=folder))


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
    written(folder, {"R": (4.0, 0.01)}, origin=origin)
    with pytest.raises(InputError, match=said):
        study_of(folder, in_place=folder / "second.csv")


def test_records_are_read_with_the_words_of_an_experiment(folder: Path) -> None:
    study = Study.read(folder / "study.toml")
    ((record, _),) = records_like(study, [folder / "second.csv"])
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
    (plain, _), (milli, _) = records_like(study, [folder / "third.csv", folder / "milli.csv"])
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
    ((record, _),) = records_like(study, [folder / "second.csv"])
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
