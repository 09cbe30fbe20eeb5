"""A batch in files, on the console and in charts: their data are what was computed."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from fmuid import Document
from fmuid.reports.publish import write_figures
from fmuid.reports.render.html import page
from fmuid.reports.topics import batch as topic
from fmuid.reports.topics import case_charts
from fmuid.reports.topics.batch_tables import tables_of
from fmuid.runs.batch.summary import summarize
from tests.support.charts import layers, legend
from tests.support.drawn_batches import TRUTH, UNITS, batch, fail, show_batch

near = np.testing.assert_allclose
Z = stats.norm.ppf(0.975)


def cases(count: int, **columns: Any) -> pd.DataFrame:
    """Return a batch of R = 4 ± 0.1 and L = 0.1 ± 0.002 whose last case failed."""
    rng = np.random.default_rng(6)
    status = np.array(["converged"] * (count - 1) + ["failed"])
    good = np.where(status == "converged", 1.0, np.nan)
    values = {"value.R": good * rng.normal(4.0, 0.1, count), "value.L": good * rng.normal(0.1, 0.002, count)}
    stds = {"std.R": good * 0.1, "std.L": good * 0.002, "cost": 1.0, "noise.i": 1.0}
    return pd.DataFrame({"case": range(count), **columns, "status": status, **values, **stds})


def test_outliers_are_counted_and_data_files_named() -> None:
    frame = cases(3000)
    frame.loc[:99, "value.R"] = 400.0
    found, _ = case_charts.over_cases(frame, {}, {})
    assert legend(found)[0].endswith(" outside")
    assert found.y.reach[1] is not None and found.y.reach[1] < 10.0
    found, _ = case_charts.over_cases(cases(3, table=["a.csv", "b.csv", "c.csv"]), {}, {})
    assert found.x.names == ("a.csv", "b.csv", "c.csv")
    assert layers(found, "points")[0]["x"] == ("a.csv", "b.csv")


def test_starting_points_and_their_optima() -> None:
    """In order above: thirteen at the best optimum, six that leave twice the residual; one did not end."""
    frame, other = cases(20, **{"start.R": np.linspace(1.0, 200.0, 20)}), np.arange(20) < 6
    frame["noise.i"], frame["value.R"], frame["value.L"] = np.where(other, 4.0, 1.0), np.where(other, 2.0, 4.0), 0.1
    frame.loc[19, ["value.R", "value.L"]] = np.nan
    above, ends = case_charts.over_starts(frame, {"R": 4.0}, {})
    worse, best = (data["y"] for data in layers(above, "points"))
    near(worse, np.full(6, 100.0))
    near(best, np.full(13, 0.01))  # the floor
    assert above.x.label.endswith("1 not converged")
    assert (ends.x.label, ends.x.kind) == ("initial guess of R", "log")
    low, high = ends.y.reach
    assert low is not None and high is not None and low < 2.0 < 4.0 < high


def test_distributions_are_densities() -> None:
    drawn, _ = case_charts.distributions(cases(4001).iloc[:-1], {"R": 4.0}, {}, repeated=True)
    (bars,), (curve,) = layers(drawn, "cells"), layers(drawn, "line")
    assert np.sum(bars["top"] * (bars["right"] - bars["left"])) == pytest.approx(1.0)
    near(curve["y"], stats.norm.pdf(curve["x"], 4.0, 0.1))
    found = cases(401, **{"set.M": [1.0, 2.0] * 200 + [1.0]}).iloc[:-1]
    drawn, _ = case_charts.distributions(found, {}, {}, repeated=False)
    assert legend(drawn) == ["M = 1", "M = 2"]
    assert len({(each.color, each.dash) for each in drawn.layers}) == 2


def test_spread_has_the_band_of_chance() -> None:
    """(n − 1) s²/σ² is χ² of n − 1 degrees of freedom."""
    summary = pd.DataFrame({"parameter": ["R", "L"], "cases": [11, 101], "ratio": [1.3, 0.9]})
    (band,) = layers(case_charts.spread(summary), "bars")
    near(stats.chi2.cdf(band["x0"] ** 2 * [10, 100], [10, 100]), 0.025)
    near(stats.chi2.cdf(band["x"] ** 2 * [10, 100], [10, 100]), 0.975)


def test_over_a_setting() -> None:
    found = cases(301, **{"set.M": np.repeat([1.0, 2.0, 3.0], [100, 100, 101])}).iloc[:-1]
    drawn, _ = case_charts.over_setting(found, "set.M", {}, {"M": "H"})
    assert drawn.x.label == "M (H)"
    (line,), (bars,), (*_, low, high) = (layers(drawn, mark) for mark in ("line", "segments", "points"))
    groups = found.groupby("set.M")["value.R"]
    near(line["y"], groups.mean())
    near(bars["y1"] - bars["y0"], 2 * Z * groups.std().to_numpy())
    near(high["y"] - low["y"], 2 * Z * 0.1)
    words, _ = case_charts.over_setting(found.assign(table=["a", "b"] * 150), "table", {}, {})
    assert words.x.names == ("a", "b")
    many, _ = case_charts.over_setting(cases(3000, **{"set.M": np.linspace(0.0, 1.0, 3000)}), "set.M", {}, {})
    assert layers(many, "cells")[0]["count"].sum() == 2999
    single, _ = case_charts.over_setting(cases(41, **{"set.M": np.arange(41.0)}).iloc[:-1], "set.M", {}, {})
    assert legend(single) == ["estimate"]  # a mean of one is the estimate itself


def test_page_of_a_batch() -> None:
    frame = cases(40, draw=range(40)).assign(message=["converged"] * 39 + ["fmi2Error <b>"])
    summary = summarize(frame, {"R": 4.0}, {"R": "Ohm"})
    sections = [*tables_of(summary), *topic.charts_of(frame, summary, {"R": 4.0}, {}, given_noise=False)]
    text = page(
        "Draws", [Document("batch", "Batch", "x", "doubt", tuple(topic.summary_remarks(summary)), (*sections,))]
    )
    for words in ("39 of 40 cases converged", "fmi2Error &lt;b&gt;", "Draws", "Cases without estimate", "Ohm"):
        assert words in text, words
    assert text.count("data-root-id") == 2 + 2 + 1 + 1


def test_batch_without_estimates(capsys: pytest.CaptureFixture[str]) -> None:
    frame = batch({"draw": range(3)})
    for none, state in ((frame.iloc[:0], "no case has finished"), (fail(frame, [0, 1, 2], ["no"] * 3), "3 failed")):
        show_batch(summarize(none, TRUTH))
        assert state in capsys.readouterr().out
        keys = [each.key for each in topic.charts_of(none, summarize(none, TRUTH), TRUTH, {}, given_noise=False)]
        assert keys == (["failures"] if len(none) else [])


FRAMES = [
    batch({"draw": range(2)}),
    batch({"free": ["R", "R L"]}),
    batch({"set.M": [1.0, 2.0, 3.0], "set.N": [1.0, 1.0, 2.0]}),
    batch({"start.R": [1.0, 2.0, 3.0]}, spread=0.0),
    batch({"table": np.repeat(["a very long name of a recording of a machine.csv", "b"], 5), "draw": [*range(5)] * 2}),
    fail(batch({"start.R": [1.0, 200.0] * 500, "free": ["R", "L"] * 500}), list(range(400)), ["no"] * 400),
    batch({"draw": range(30)}).assign(**{"std.R": np.nan}),
    batch({}, cases=1),
]


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
def test_figures_without_a_warning(frame: pd.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = summarize(frame, TRUTH, UNITS)
    sections = topic.charts_of(frame, summary, TRUTH, {**UNITS}, given_noise=False)
    assert sections
    assert len(write_figures(tmp_path, sections, "png")) == len(sections)
    show_batch(summary)
    assert capsys.readouterr().out
