"""What is written, printed and drawn of a batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.reports.publish import write_figures
from fmuid.reports.topics.batch import charts_of
from fmuid.reports.topics.batch_tables import write_tables
from fmuid.runs.batch.statistics import BatchColumns
from fmuid.runs.batch.summary import summarize
from tests.support.drawn_batches import TRUTH, UNITS, batch, fail, show_batch

# --- files and the console


def test_files(tmp_path: Path) -> None:
    (tmp_path / "groups.csv").write_text("old")
    (tmp_path / "mine.csv").write_text("the user's")
    summary = summarize(fail(batch({"draw": range(40)}), [1], ["no"]), TRUTH, UNITS)
    assert [path.name for path in write_tables(summary, tmp_path)] == ["summary.csv", "failures.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["failures.csv", "mine.csv", "summary.csv"]
    back = pd.read_csv(tmp_path / "summary.csv", keep_default_na=False, na_values=[""], dtype={"note": str})
    np.testing.assert_array_equal(back["mean"], summary.parameters["mean"])


def test_console(capsys: pytest.CaptureFixture[str]) -> None:
    levels = np.repeat([0.4, 0.47], 40)
    frame = batch({"set.M": levels, "draw": np.tile(np.arange(40), 2)}, spread=2.0)
    show_batch(summarize(fail(frame, [0], ["[bad] at t = 3 s"]), TRUTH, UNITS))
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 140
    for words in (
        "Estimates over all cases",
        "Estimates and true values",
        "By setting: mean ± spread",
        "[bad] at t = # s",
    ):
        assert words in said
    assert "80 cases, 79 converged, 1 failed" in said


def test_console_says_median_and_least_fit(capsys: pytest.CaptureFixture[str]) -> None:
    frame = batch({"draw": range(40)})
    fits = np.linspace(90.0, 99.0, 40)
    output = BatchColumns.of(frame).outputs[0]
    frame[f"fit.{output}"] = np.where(np.arange(40) == 7, np.nan, fits)
    summary = summarize(frame, TRUTH, UNITS)
    show_batch(summary)
    (row,) = summary.fits.to_dict("records")
    assert row == {"output": output, "median": np.nanmedian(frame[f"fit.{output}"]), "least": 90.0, "case": 0}
    said = f"Fit (NRMSE) of {output}: median {row['median']:.4g} %, minimum 90 % (case 0)"
    assert said in capsys.readouterr().out


def test_console_of_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    frame = batch({"draw": range(2)})
    show_batch(summarize(frame.iloc[:0], TRUTH))
    show_batch(summarize(fail(frame, [0, 1], ["no", "no"]), TRUTH))
    said = capsys.readouterr().out
    assert "no case has finished" in said
    assert "2 cases, 2 failed" in said


# --- figures


@pytest.mark.slow
@pytest.mark.parametrize(
    "frame",
    [
        batch({"draw": range(1)}),
        batch({"draw": range(2)}),
        batch({"set.M": [1.0]}),
        batch({"set.M": [1.0, 2.0, 3.0], "set.N": [1.0, 1.0, 2.0]}),
        batch({"set.M": np.linspace(0, 1, 3000), "set.N": np.linspace(1, 0, 3000)}),
        batch({"set.on": [True, False]}),
        batch({"free": ["R", "R L"]}),
        batch({"table": [f"a very long name of a record of a machine {k}.csv" for k in range(5)]}),
        batch({"table": np.repeat(["a", "b"], 5), "draw": np.tile(np.arange(5), 2)}),
        batch({"start.R": [1.0]}),
        batch({"start.R": [1.0, 2.0, 3.0]}, spread=0.0),
        batch({"draw": range(40)}, spread=0.0),
        fail(batch({"draw": range(3000)}), list(range(1, 3000)), ["no"] * 2999),
        fail(batch({"start.R": [1.0, 2.0]}), [0], ["no"]),
        fail(batch({"start.R": [1.0, 200.0] * 500, "free": ["R", "L"] * 500}), list(range(400)), ["no"] * 400),
        batch({"draw": range(30)}).assign(**{"std.R": np.nan}),
        batch({}, cases=1),
    ],
)
def test_figures_without_a_warning(frame: pd.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = summarize(frame, TRUTH, UNITS)
    sections = charts_of(frame, summary, TRUTH, {**UNITS}, given_noise=False)
    assert sections
    assert len(write_figures(tmp_path, sections, "png")) == len(sections)
    show_batch(summary)
    assert capsys.readouterr().out


def test_nothing_to_draw() -> None:
    frame = batch({"draw": range(3)})
    for none in (frame.iloc[:0], fail(frame, [0, 1, 2], ["no"] * 3)):
        keys = [each.key for each in charts_of(none, summarize(none, TRUTH), TRUTH, {}, given_noise=False)]
        assert keys == (["failures"] if len(none) else [])
