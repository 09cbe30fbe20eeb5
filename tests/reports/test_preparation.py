"""What was done with a table first is written beside the results and drawn in the report, by its data."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fmuid
from fmuid import Study
from fmuid.reports.documents import document
from fmuid.reports.topics.preprocessing import preparation_words, preprocessing_sections
from tests.support.coil_study import COIL, coil_table
from tests.support.running import run_diagnosis, run_study

STUDY = """
model.fmu = "{fmu}"
parameters = {{ R = {{ start = 4.0, min = 0.0 }}, L = {{ start = 0.1, min = 1e-4 }} }}
[[experiments]]
name = "cut"
data = "run.csv"
inputs = ["u"]
outputs = {{ i = "current" }}
interpolation = "zoh"
preprocess = {{ computed_columns = {{ current = "shunt / 50" }}, start_time = 0.1, end_time = 0.4 }}
[[experiments]]
name = "mean"
data = "run.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
preprocess.detrend = {{ i = "mean" }}
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    folder = tmp_path_factory.mktemp("prepared")
    coil_table(folder / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(folder / "run.csv")
    frame.assign(shunt=frame["i"] * 50.0).to_csv(folder / "run.csv", index=False)
    (folder / "study.toml").write_text(STUDY.format(fmu=COIL.as_posix()))
    return Study.read(folder / "study.toml")


def test_report_shows_preprocessing(study: Study, tmp_path: Path) -> None:
    found = run_study(study, tmp_path, report=True)
    assert tmp_path / "preparation.csv" in found.files
    cut, mean = preprocessing_sections(found.prepared, several=True)
    assert (cut.heading[-5:], cut.key, mean.key) == (": cut", "preparation", "preparation-2")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for caption, parts in ((cut.caption, ("current = shunt / 50", "0.1 s", "0.4 s")), (mean.caption, ("i: mean",))):
        assert all(part in caption for part in parts)
        assert caption in page
    assert 'id="preparation-2"' in page


def test_diagnosis_shows_preprocessing(tmp_path: Path) -> None:
    coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    run_study(Study.of(coil.study, tmp_path / "coil.toml"), tmp_path / "healthy")
    faults = {"turns": {"fmu": str(test.fmu), "parameters": {"dR": {"nominal": 1.0}}}}
    known = {"baseline": str(tmp_path / "healthy" / "result.json"), "faults": faults}
    record = {**test.study["experiments"][0], "preprocess": {"start_time": 0.1}}
    words = coil.study | {"experiments": [record], "parameters": {}, "diagnosis": known}

    def captions(found: Any) -> list[str]:
        return [each.caption for each in document(found).sections if each.key.startswith("prepared")]

    found = run_diagnosis(Study.of(words, tmp_path / "test.toml"), tmp_path / "out")
    assert tmp_path / "out" / "diagnosis-preparation.csv" in found.files
    (caption,) = captions(found)
    assert "0.1 s" in caption


def test_preprocessing_steps_are_named() -> None:
    words = {
        "fill_missing": {"u": "zoh"},
        "max_gap": 0.05,
        "park": [{"source": ["a", "b", "c"], "target": ["d", "q"], "angle": "t"}],
        "lowpass_frequency": 60.0,
        "end_time": 2.0,
        "resample_interval": 0.01,
        "detrend": "linear",
    }
    said = preparation_words(words)
    for part in ("0.05 s", "u: zoh", "a, b, c to d, q", "60 Hz", "2 s", "0.01 s", "linear"):
        assert part in said
