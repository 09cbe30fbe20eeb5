"""Charts of a batch, and its page."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from fmuid.reports import chart
from fmuid.reports.document import Document
from fmuid.reports.render.html import page
from fmuid.reports.topics import batch as topic
from fmuid.reports.topics import case_charts as batch
from fmuid.reports.topics.batch_tables import tables_of
from fmuid.runs.batch.summary import summarize
from tests.support.charts import layers, legend, rules


def cases(count: int, **columns: Any) -> pd.DataFrame:
    """Return a batch of R = 4 ± 0.1 and L = 0.1 ± 0.002 whose last case failed."""
    rng = np.random.default_rng(6)
    status = np.array(["converged"] * (count - 1) + ["failed"])
    good = np.where(status == "converged", 1.0, np.nan)
    values = {"value.R": good * rng.normal(4.0, 0.1, count), "value.L": good * rng.normal(0.1, 0.002, count)}
    stds = {"std.R": good * 0.1, "std.L": good * 0.002, "criterion": 1.0, "noise.i": 1.0}
    return pd.DataFrame({"case": range(count), **columns, "status": status, **values, **stds})


def test_over_cases() -> None:
    frame = cases(20)
    frame.loc[2, "value.R"] = 4.25
    few, _ = batch.over_cases(frame, {"R": 4.0}, {"R": "Ohm"})
    bars, missing = layers(few, "segments")
    missed = np.abs(frame["value.R"] - 4.0) > stats.norm.ppf(0.975) * 0.1
    assert [len(bars["x0"]), list(missing["x0"])] == [19 - missed.sum(), list(np.flatnonzero(missed))]
    np.testing.assert_allclose(bars["y1"] - bars["y0"], 2 * 1.959964 * 0.1, rtol=1e-6)
    assert list(layers(few, "points")[1]["x"]) == [19]
    assert legend(few) == ["95 % interval", "misses the true value", "estimate", "failed"]
    assert rules(few) == [("y", 4.0)]
    assert few.y.label == "R (Ohm)"
    some, _ = batch.over_cases(cases(chart.LIMITS.dots), {}, {})
    assert layers(some, "segments") == []
    assert len(layers(some, "points")[0]["x"]) == chart.LIMITS.dots - 1
    many, _ = batch.over_cases(cases(30_000), {}, {})
    (cells,) = layers(many, "cells")
    assert cells["count"].sum() == 29_999
    assert len(cells["count"]) < chart.LIMITS.rows
    assert cells["alpha"].max() == 1.0


def test_values_far_from_all_others_are_counted_instead_of_drawn() -> None:
    frame = cases(3000)
    frame.loc[:99, "value.R"] = 400.0
    found, _ = batch.over_cases(frame, {}, {})
    assert legend(found)[0].endswith(" outside")
    assert found.y.reach[1] is not None
    assert found.y.reach[1] < 10.0


def test_few_tables_are_named_at_the_axis() -> None:
    found, _ = batch.over_cases(cases(3, table=["a.csv", "b.csv", "c.csv"]), {}, {})
    assert found.x.names == ("a.csv", "b.csv", "c.csv")
    assert layers(found, "points")[0]["x"] == ("a.csv", "b.csv")


def test_where_searches_ended() -> None:
    frame = cases(20, **{"start.R": np.linspace(1.0, 200.0, 20)})
    frame["noise.i"] = np.where(np.arange(20) < 6, 4.0, 1.0)
    frame["value.R"], frame["value.L"] = np.where(np.arange(20) < 6, 2.0, 4.0), 0.1
    frame.loc[19, ["value.R", "value.L"]] = np.nan
    above, ends = batch.over_starts(frame, {"R": 4.0}, {})
    worse, best = (data["y"] for data in layers(above, "points"))
    np.testing.assert_allclose(worse, np.full(6, 100.0))
    np.testing.assert_allclose(best, np.full(13, 0.01))  # the floor
    assert above.x.label == "cases, best first; 1 not converged"
    assert (ends.x.label, ends.x.kind) == ("initial guess of R", "log")


def test_distributions_are_densities_beside_what_the_std_promises() -> None:
    found = cases(4001).iloc[:-1]
    drawn, _ = batch.distributions(found, {"R": 4.0}, {}, repeated=True)
    (bars,) = layers(drawn, "cells")
    assert np.sum(bars["top"] * (bars["right"] - bars["left"])) == pytest.approx(1.0)
    (curve,) = layers(drawn, "line")
    np.testing.assert_allclose(curve["y"], stats.norm.pdf(curve["x"], 4.0, 0.1))
    assert legend(drawn) == ["estimates", "normal distribution of the stated σ"]
    alone, _ = batch.distributions(found, {}, {}, repeated=False)
    assert legend(alone) == ["estimates"]


def test_each_setting_has_an_outline_of_its_own() -> None:
    found = cases(401, **{"set.M": [1.0, 2.0] * 200 + [1.0]}).iloc[:-1]
    drawn, _ = batch.distributions(found, {}, {}, repeated=False)
    assert legend(drawn) == ["M = 1", "M = 2"]
    assert len({(each.color, each.dash) for each in drawn.layers}) == 2


def test_spread_has_the_band_of_chance() -> None:
    """(n − 1) s²/σ² is χ² of n − 1 degrees of freedom."""
    summary = pd.DataFrame({"parameter": ["R", "L"], "cases": [11, 101], "ratio": [1.3, 0.9]})
    (band,) = layers(batch.spread(summary), "bars")
    np.testing.assert_allclose(stats.chi2.cdf(band["x0"] ** 2 * [10, 100], [10, 100]), 0.025)
    np.testing.assert_allclose(stats.chi2.cdf(band["x"] ** 2 * [10, 100], [10, 100]), 0.975)


def test_over_a_setting() -> None:
    found = cases(301, **{"set.M": np.repeat([1.0, 2.0, 3.0], [100, 100, 101])}).iloc[:-1]
    drawn, _ = batch.over_setting(found, "set.M", {}, {"M": "H"})
    assert drawn.x.label == "M (H)"
    (line,) = layers(drawn, "line")
    np.testing.assert_allclose(line["y"], found.groupby("set.M")["value.R"].mean())
    spread = stats.norm.ppf(0.975) * found.groupby("set.M")["value.R"].std().to_numpy()
    (bars,) = layers(drawn, "segments")
    np.testing.assert_allclose(bars["y1"] - bars["y0"], 2 * spread)
    *_, low, high = layers(drawn, "points")
    np.testing.assert_allclose(high["y"] - low["y"], 2 * stats.norm.ppf(0.975) * 0.1)
    words, _ = batch.over_setting(found.assign(table=["a", "b"] * 150), "table", {}, {})
    assert words.x.names == ("a", "b")
    single, _ = batch.over_setting(cases(41, **{"set.M": np.arange(41.0)}).iloc[:-1], "set.M", {}, {})
    assert legend(single) == ["estimate"]  # a mean of one is the estimate itself


def test_the_page_of_a_batch() -> None:
    frame = cases(40, draw=range(40)).assign(message=["converged"] * 39 + ["fmi2Error <b>"])
    summary = summarize(frame, {"R": 4.0}, {"R": "Ohm"})
    sections = [*tables_of(summary), *topic.charts_of(frame, summary, {"R": 4.0}, {}, given_noise=False)]
    found = Document("batch", "Batch", "x", "doubt", tuple(topic.summary_remarks(summary)), tuple(sections))
    text = page("Draws", [found])
    for words in ("39 of 40 cases converged", "fmi2Error &lt;b&gt;", "Draws", "Cases without estimate", "Ohm"):
        assert words in text, words
    assert text.count("data-root-id") == 2 + 2 + 1 + 1
