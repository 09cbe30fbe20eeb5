"""What was done with a table first is written beside the results and drawn in the report, by its data."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import codec
from fmuid.diagnosis import BaselineSource
from fmuid.reports.chart import LIMITS
from fmuid.reports.documents import document
from fmuid.reports.topics.preprocessing import preparation_words, preprocessing_charts, preprocessing_sections
from fmuid.runs import MonitoringRun, read_diagnosis, read_identification, read_monitoring
from fmuid.runs import log_follower as follower
from fmuid.runs.faults import MonitoredTables
from fmuid.runs.folder import MONITORING_SCHEMA
from fmuid.runs.preprocessing import prepared
from fmuid.runs.provenance import made_now
from fmuid.studies import ExperimentSettings, Study
from tests.support.charts import drawn
from tests.support.coil_study import COIL, coil_table
from tests.support.running import run_diagnosis, run_following, run_monitoring, run_study

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
name = "cut"
data = "run.csv"
inputs = ["u"]
outputs = {{ i = "current" }}
interpolation = "zoh"
[experiments.preprocess]
computed_columns = {{ current = "shunt / 50" }}
start_time = 0.1
end_time = 0.4
[[experiments]]
name = "whole"
data = "run.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
[[experiments]]
name = "mean"
data = "run.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
[experiments.preprocess]
detrend = {{ i = "mean" }}
[parameters]
R = {{ start = 4.0, min = 0.0 }}
L = {{ start = 0.1, min = 1e-4 }}
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    folder = tmp_path_factory.mktemp("prepared")
    coil_table(folder / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(folder / "run.csv")
    frame.assign(shunt=frame["i"] * 50.0).to_csv(folder / "run.csv", index=False)
    (folder / "study.toml").write_text(STUDY.format(fmu=COIL.as_posix()))
    return Study.read(folder / "study.toml")


@pytest.fixture(scope="module")
def raw(study: Study) -> pd.DataFrame:
    return pd.read_csv(study.path.parent / "run.csv")


def rows(table: pd.DataFrame, column: str, stage: str) -> pd.DataFrame:
    return table[(table["column"] == column) & (table["stage"] == stage)]


def test_only_what_was_changed_or_made_is_kept(study: Study, raw: pd.DataFrame) -> None:
    cut, mean = prepared(study)
    assert (cut.experiment, mean.experiment) == ("cut", "mean")
    assert cut.words == {"computed_columns": {"current": "shunt / 50"}, "start_time": 0.1, "end_time": 0.4}
    assert set(cut.table["column"]) == {"u", "current"}
    assert set(mean.table["column"]) == {"i"}  # the input is as it was
    assert not len(rows(cut.table, "current", "before"))  # it was made
    kept = raw[(raw["time"] > 0.0995) & (raw["time"] < 0.4005)]
    np.testing.assert_array_equal(rows(cut.table, "current", "after")["time"], kept["time"])
    np.testing.assert_allclose(rows(cut.table, "current", "after")["value"], kept["i"], rtol=1e-12)
    np.testing.assert_array_equal(rows(cut.table, "u", "before")["value"], raw["u"])
    np.testing.assert_array_equal(rows(cut.table, "u", "after")["value"], kept["u"])
    np.testing.assert_array_equal(rows(mean.table, "i", "before")["value"], raw["i"])
    np.testing.assert_allclose(rows(mean.table, "i", "after")["value"], raw["i"] - raw["i"].mean(), atol=1e-12)


def test_pieces_of_a_long_record_are_thinned_and_the_record_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.arange(50_000) * 1e-3
    spike = np.where(np.arange(times.size) == 20_011, 7.0, 0.0)
    pd.DataFrame({"time": times, "u": spike, "i": np.sin(times)}).to_csv(tmp_path / "run.csv", index=False)
    text = STUDY.format(fmu=COIL.as_posix()).split("[[experiments]]\n")
    one = text[2].replace('name = "whole"', "") + "[experiments.preprocess]\nsegments = [[0.0, 10.0], [10.0, 40.0]]\n"
    (tmp_path / "study.toml").write_text(f"{text[0]}[[experiments]]\n{one}{text[3][text[3].index('[param') :]}")
    read = Study.read(tmp_path / "study.toml")
    assert len(read.tables) == 2
    times_read: list[Path] = []
    original = ExperimentSettings.read_frame

    def read_frame(given: ExperimentSettings, table: Path) -> pd.DataFrame:
        times_read.append(table)
        return original(given, table)

    monkeypatch.setattr(ExperimentSettings, "read_frame", read_frame)
    _, second = prepared(read)
    assert len(times_read) == 1
    before = rows(second.table, "u", "before")
    assert len(before) < 5000
    assert before["value"].max() == 7.0  # what is least and greatest stays


def test_the_report_draws_it_and_says_what_was_done(study: Study, tmp_path: Path) -> None:
    found = run_study(study, tmp_path, report=True)
    assert tmp_path / "preparation.csv" in found.files
    cut, mean = preprocessing_sections(read_identification(tmp_path).prepared, several=True)
    assert (cut.heading, cut.key) == ("What was done with the table first: cut", "preparation")
    assert (mean.heading, mean.key) == ("What was done with the table first: mean", "preparation-2")
    said = "The table was given the columns current = shunt / 50 and cut from 0.1 s to 0.4 s."
    assert cut.caption.startswith(said)
    assert mean.caption == "The table was detrended (i: mean)."
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert said in page
    assert 'id="preparation-2"' in page


def test_the_pages_of_a_diagnosis_and_of_a_monitoring_draw_it_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    run_study(Study.of(coil.study, tmp_path / "coil.toml"), tmp_path / "healthy")
    faults = {"turns": {"fmu": str(test.fmu), "parameters": {"dR": {"nominal": 1.0}}}}
    known = {"baseline": str(tmp_path / "healthy" / "result.json"), "faults": faults}
    record = {**test.study["experiments"][0], "preprocess": {"start_time": 0.1}}
    words = coil.study | {"experiments": [record], "parameters": {}, "diagnosis": known}
    found = run_diagnosis(Study.of(words, tmp_path / "test.toml"), tmp_path / "out")
    assert tmp_path / "out" / "diagnosis-preparation.csv" in found.files
    shown = {each.key: each for each in document(read_diagnosis(tmp_path / "out")).sections}
    assert shown["prepared"].caption.startswith("The table was cut from 0.1 s.")
    study = Study.of(words | {"monitoring": {"false_alarm_rate": 0.01}}, tmp_path / "test.toml")
    second = shutil.copy(test.path, tmp_path / "second.csv")
    for tables in ([test.path], [test.path, second]):
        watched = run_monitoring(study, tables, tmp_path / "out", append=len(tables) > 1)
        assert tmp_path / "out" / "monitoring-preparation.csv" in watched.files
    shown = {each.key: each for each in document(read_monitoring(tmp_path / "out")).sections}
    assert shown["monitored"].caption.startswith("The table was cut from 0.1 s.")
    assert shown["monitored-2"].heading.endswith("second")
    monkeypatch.setattr(follower, "SETTLED", 0.0)
    read, original = list[Path](), ExperimentSettings.read_frame

    def read_frame(given: ExperimentSettings, path: Path, *more: Any) -> pd.DataFrame:
        read.append(path)
        return original(given, path, *more)

    monkeypatch.setattr(ExperimentSettings, "read_frame", read_frame)
    (tmp_path / "records").mkdir()
    for name in ("faulty-coil", "second"):  # in two runs, the later of which goes on
        shutil.copy(test.path, tmp_path / "records" / f"{name}.csv")
        run_following(study, tmp_path / "records", tmp_path / "follow", until=lambda watching: watching.idle)
    assert [path.stem for path in read if path.parent.name == "records"] == ["faulty-coil", "second"]  # each once
    shown = {each.key: each for each in document(read_monitoring(tmp_path / "follow")).sections}
    assert shown["monitored"].caption.startswith("The table was cut from 0.1 s.")
    assert shown["monitored-2"].heading.endswith("second")
    once, followed = (pd.read_csv(tmp_path / name / "monitoring-preparation.csv") for name in ("out", "follow"))
    pd.testing.assert_frame_equal(once.drop(columns="experiment"), followed.drop(columns="experiment"))


class Silent(fmuid.Monitor):
    """A monitor that writes nothing."""

    def __init__(self) -> None:
        pass

    def write(self, *_: Any, **__: Any) -> list[Path]:
        return []


NOTHING = MonitoringRun(pd.DataFrame(), (), fmuid.Rule(), (), {}, (), {}, BaselineSource.RECORDS)


def test_a_record_that_grows_is_drawn_once_and_thin(tmp_path: Path) -> None:
    coil = fmuid.datasets.coil().study
    words = coil | {"experiments": [{**coil["experiments"][0], "preprocess": {"computed_columns": {"v": "2 * u"}}}]}
    (given,) = Study.of(words, tmp_path / "coil.toml").experiments
    times = 1e-3 * np.arange(30_000)
    raw = pd.DataFrame({"time": times, "u": np.sin(times), "i": np.cos(times)})

    def begun(*, append: bool) -> MonitoredTables:
        return MonitoredTables(tmp_path, given, append=append)

    def add(kept: MonitoredTables, first: int, end: int) -> pd.DataFrame:
        piece = raw.iloc[first:end].reset_index(drop=True)
        kept.add(given.model_copy(update={"name": "log"}).experiment(piece, "log.csv"), piece)
        codec.write(tmp_path / "monitoring.json", MONITORING_SCHEMA, kept.write(NOTHING, Silent(), made_now()))
        return pd.read_csv(tmp_path / "monitoring-preparation.csv")

    kept = begun(append=False)
    add(kept, 0, 500)
    add(kept, 400, 1000)  # its first rows were there before
    table = add(begun(append=True), 900, 2000)
    assert [each.experiment for each in kept.prepared] == ["log"]
    np.testing.assert_allclose(table["time"], times[:2000])
    np.testing.assert_allclose(table["value"], 2 * np.sin(times[:2000]))
    assert set(table["column"] + table["stage"]) == {"vafter"}
    table = add(begun(append=True), 1900, 30_000)
    assert len(table) <= 2 * LIMITS.rows
    np.testing.assert_allclose(table["time"].iloc[[0, -1]], times[[0, -1]])
    begun(append=False).write(NOTHING, Silent(), made_now())
    assert not (tmp_path / "monitoring-preparation.csv").exists()


def test_the_figure_shows_before_in_grey_and_after(study: Study, raw: pd.DataFrame) -> None:
    cut, _ = prepared(study)
    u, current = preprocessing_charts(cut.table, {"u": "V"}).charts
    assert u.y.label == "u (V)"
    assert [len(each.layers) for each in (u, current)] == [2, 1]
    (before,), (after,) = drawn(u, "line", "as recorded"), drawn(u, "line", "as used")
    np.testing.assert_array_equal(before["x"], raw["time"])
    assert (after["x"][0], after["x"][-1]) == pytest.approx((0.1, 0.4))
    assert u.layers[0].color == "grey"
    assert u.x.linked == current.x.linked
    assert (u.x.shown, current.x.shown) == (False, True)


def test_every_word_is_said() -> None:
    axes = [{"source": ["a", "b", "c"], "target": ["d", "q"], "angle": "t"}]
    words = {
        "fill_missing": {"u": "zoh"},
        "max_gap": 0.05,
        "park": axes,
        "lowpass_frequency": 60.0,
        "end_time": 2.0,
        "resample_interval": 0.01,
        "detrend": "linear",
    }
    assert preparation_words(words) == (
        "The table was filled over gaps of at most 0.05 s (u: zoh), "
        "turned from a, b, c to d, q, low-passed at 60 Hz, without a shift in time, cut to 2 s, "
        "resampled in steps of 0.01 s and detrended (linear)"
    )
