"""What is written, printed and drawn of a batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.patches import Rectangle
from scipy import stats

from fmuid.batches.statistics import Columns
from fmuid.batches.summary import summarize
from fmuid.reports.batch_words import write_summary
from fmuid.reports.console.batch import show_batch
from fmuid.reports.figures import batch as figures_batch
from fmuid.reports.figures import style as plots
from tests.support.drawn_batches import TRUTH, UNITS, batch, fail, starts

# --- files and the console


def test_files(tmp_path: Path) -> None:
    (tmp_path / "groups.csv").write_text("old")
    (tmp_path / "mine.csv").write_text("the user's")
    summary = summarize(fail(batch({"draw": range(40)}), [1], ["no"]), TRUTH, UNITS)
    assert [path.name for path in write_summary(summary, tmp_path)] == ["summary.csv", "failures.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["failures.csv", "mine.csv", "summary.csv"]
    back = pd.read_csv(tmp_path / "summary.csv", keep_default_na=False, na_values=[""], dtype={"note": str})
    np.testing.assert_array_equal(back["mean"], summary.parameters["mean"])


def test_console(capsys: pytest.CaptureFixture[str]) -> None:
    levels = np.repeat([0.4, 0.47], 40)
    frame = batch({"set.M": levels, "draw": np.tile(np.arange(40), 2)}, spread=2.0)
    show_batch(summarize(fail(frame, [0], ["[bad] at t = 3 s"]), TRUTH, UNITS))
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 140
    for words in ("Estimates over the cases", "Against the truth", "By setting, mean ± spread", "[bad] at t = # s"):
        assert words in said
    assert "80 cases: 79 converged, 1 failed" in said


def test_console_of_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    frame = batch({"draw": range(2)})
    show_batch(summarize(frame.iloc[:0], TRUTH))
    show_batch(summarize(fail(frame, [0, 1], ["no", "no"]), TRUTH))
    said = capsys.readouterr().out
    assert "No case has finished" in said
    assert "2 cases: 2 failed" in said


# --- figures


def test_estimates_over_the_cases() -> None:
    """Each case has its interval, those that miss the truth in red; failed cases are marked."""
    frame = fail(batch({"draw": range(20)}), [5], ["no"])
    frame.loc[2, "value.R"] = 4.2
    figure = figures_batch.draw(frame, TRUTH, UNITS)["estimates"]
    first = figure.axes[0]
    missing = np.abs(frame["value.R"] - 4.0) > stats.norm.ppf(0.975) * 0.05
    counts = [len(each.get_segments()) for each in first.collections if isinstance(each, LineCollection)]
    assert counts == [19 - missing.sum(), missing.sum()]
    assert {text.get_text() for text in figure.legends[0].get_texts()} >= {"truth", "failed (1)", "misses the truth"}
    assert figure.axes[0].get_ylabel() == "R (Ohm)"


def test_many_cases_are_counted() -> None:
    frame = batch({"draw": range(30_000)})
    frame.loc[:99, "value.R"] = 400.0
    figures = figures_batch.draw(frame, TRUTH)
    (mesh,) = [each for each in figures["estimates"].axes[0].collections if isinstance(each, QuadMesh)]
    assert np.nansum(np.asarray(mesh.get_array())) == 29_900
    assert figures["estimates"].axes[0].get_title("right") == "100 outside"


def test_distributions() -> None:
    """The bars hold all estimates; the curve is the normal density of the stated std around the truth."""
    axes = figures_batch.draw(batch({"draw": range(500)}, spread=2.0), TRUTH)["distributions"].axes[0]
    assert sum(
        bar.get_width() * bar.get_height() for bar in axes.patches if isinstance(bar, Rectangle)
    ) == pytest.approx(1.0)
    (curve,) = [line for line in axes.get_lines() if line.get_label() == "as the stated std says"]
    x, y = np.asarray(curve.get_xydata()).T
    np.testing.assert_allclose(y, stats.norm.pdf(x, 4.0, 0.05), rtol=1e-9)
    assert axes.get_title("right").startswith("spread ")


def test_over_a_setting() -> None:
    levels = np.repeat([0.4, 0.436, 0.47], 30)
    frame = batch({"set.M": levels, "draw": np.tile(np.arange(30), 3)})
    axes = figures_batch.draw(frame, TRUTH | {"M": 0.436})["swept-M"].axes[0]
    (means,) = [line for line in axes.get_lines() if line.get_label() == "mean"]
    np.testing.assert_allclose(np.asarray(means.get_ydata()), frame.groupby("set.M")["value.R"].mean(), rtol=1e-13)
    assert {line.get_label() for line in axes.get_lines()} >= {"truth", "M is right"}


def test_starts_and_where_they_end() -> None:
    figure = figures_batch.draw(fail(starts(), [9], ["no"]), TRUTH)["starts"]
    above, ends = figure.axes[:2]
    heights = {line.get_label(): np.asarray(line.get_ydata()) for line in above.get_lines()}
    np.testing.assert_allclose(heights["best optimum"], np.zeros(13), atol=1e-12)
    np.testing.assert_allclose(heights["another optimum"], np.full(6, 100.0), rtol=1e-12)
    assert above.get_xlabel() == "searches, the best first; 1 did not converge"
    assert ends.get_xlabel() == "start of R"


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
    """Whatever there is of cases, they are drawn and summarized, and nothing warns."""
    figures = figures_batch.draw(frame, TRUTH, UNITS)
    assert "estimates" in figures
    assert len(plots.save(figures, tmp_path)) == len(figures)
    show_batch(summarize(frame, TRUTH, UNITS))
    assert capsys.readouterr().out


def test_starts_of_a_parameter_that_is_not_always_free() -> None:
    frame = batch({"start.R": [1.0, 200.0, 3.0, np.nan, np.nan], "free": ["R", "R", "R", "L", "L"]}, spread=0.0)
    _, ends = figures_batch.draw(fail(frame, [4], ["no"]), TRUTH)["starts"].axes
    assert ends.get_xscale() == "log"


def test_nothing_to_draw() -> None:
    frame = batch({"draw": range(3)})
    assert figures_batch.draw(frame.iloc[:0], TRUTH) == {}
    assert figures_batch.draw(fail(frame, [0, 1, 2], ["no"] * 3), TRUTH) == {}


def test_columns() -> None:
    frame = batch({"table": ["a"], "start.R": [1.0], "set.m.J": [2.0], "free": ["R"], "draw": [0]})
    columns = Columns.of(frame)
    assert (columns.parameters, columns.outputs, columns.starts) == (("R", "L"), ("i",), ("start.R",))
    assert (columns.design, columns.repeats) == (("set.m.J", "free"), ("table", "draw"))
