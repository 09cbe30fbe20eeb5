"""Figures of a batch and its page: what they show is read back from the data of their glyphs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bokeh.models import Span
from scipy import stats

from fmuid.errors import InputError
from fmuid.reports import write_report
from fmuid.reports.interactive import style
from tests.support.begun_batch import write_part
from tests.support.live_figures import batch, starts


def cases(count: int, **columns: Any) -> pd.DataFrame:
    """Return a batch of R = 4 ± 0.1 and L = 0.1 ± 0.002 whose last case failed."""
    rng = np.random.default_rng(6)
    status = np.array(["converged"] * (count - 1) + ["failed"])
    good = np.where(status == "converged", 1.0, np.nan)
    values = {"value.R": good * rng.normal(4.0, 0.1, count), "value.L": good * rng.normal(0.1, 0.002, count)}
    stds = {"std.R": good * 0.1, "std.L": good * 0.002, "criterion": 1.0, "noise.i": 1.0}
    return pd.DataFrame({"case": range(count), **columns, "status": status, **values, **stds})


def glyphs(plot: Any, kind: str) -> list[dict[str, Any]]:
    return [each.data_source.data for each in plot.renderers if type(each.glyph).__name__ == kind]


def said(plot: Any) -> list[str]:
    return [item.label["value"] for each in plot.above for item in each.items]


def test_over_cases() -> None:
    """Few have their intervals, those that miss the truth in red; failed ones are marked; many are thinned."""
    frame = cases(20)
    frame.loc[2, "value.R"] = 4.25
    few, _ = batch.over_cases(frame, {"R": 4.0}, {"R": "Ohm"})
    bars, missing = glyphs(few, "Segment")
    missed = np.abs(frame["value.R"] - 4.0) > stats.norm.ppf(0.975) * 0.1
    assert [len(bars["case"]), list(missing["case"])] == [19 - missed.sum(), list(np.flatnonzero(missed))]
    np.testing.assert_allclose(bars["high"] - bars["low"], 2 * 1.959964 * 0.1, rtol=1e-6)
    assert list(glyphs(few, "Scatter")[1]["case"]) == [19]
    assert said(few) == ["estimate", "interval of 95 %", "misses the truth", "failed"]
    assert [each.location for each in few.center if isinstance(each, Span)] == [4.0]
    assert few.yaxis.axis_label == "R (Ohm)"
    some, _ = batch.over_cases(cases(style.MAX_DOTS), {}, {})
    assert glyphs(some, "Segment") == []
    assert len(glyphs(some, "Scatter")[0]["case"]) == style.MAX_DOTS - 1
    many, _ = batch.over_cases(cases(30_000), {}, {})
    (cells,) = glyphs(many, "Quad")
    assert cells["count"].sum() == 29_999
    assert len(cells["count"]) < style.MAX_ROWS
    assert cells["full"].max() == 1.0


def test_values_far_from_all_others_are_counted_instead_of_drawn() -> None:
    frame = cases(3000)
    frame.loc[:99, "value.R"] = 400.0
    plot, _ = batch.over_cases(frame, {}, {})
    assert said(plot)[0].endswith(" outside")
    assert plot.y_range.end < 10.0


def test_few_tables_are_named_at_the_axis() -> None:
    plot, _ = batch.over_cases(cases(3, table=["a.csv", "b.csv", "c.csv"]), {}, {})
    assert plot.x_range.factors == ["a.csv", "b.csv", "c.csv"]
    assert list(glyphs(plot, "Scatter")[0]["case"]) == ["a.csv", "b.csv"]


def test_where_searches_ended() -> None:
    """In order above: thirteen at the best optimum, six that leave twice the residual; one did not end."""
    frame = cases(20, **{"start.R": np.linspace(1.0, 200.0, 20)})
    frame["noise.i"] = np.where(np.arange(20) < 6, 4.0, 1.0)
    frame["value.R"], frame["value.L"] = np.where(np.arange(20) < 6, 2.0, 4.0), 0.1
    frame.loc[19, ["value.R", "value.L"]] = np.nan
    above, ends = starts.over_starts(frame, {"R": 4.0}, {})
    worse, best = (data["y"] for data in glyphs(above, "Scatter"))
    np.testing.assert_allclose(worse, np.full(6, 100.0))
    np.testing.assert_allclose(best, np.full(13, 0.01))  # the floor
    assert above.xaxis.axis_label == "searches, the best first; 1 did not converge"
    assert ends.xaxis.axis_label == "start of R"
    assert type(ends.x_scale).__name__ == "LogScale"


def test_distributions_are_densities_beside_what_the_std_promises() -> None:
    found = cases(4001).iloc[:-1]
    plot, _ = batch.distributions(found, {"R": 4.0}, {}, repeated=True)
    (bars,) = glyphs(plot, "Quad")
    assert np.sum(bars["top"] * (bars["right"] - bars["left"])) == pytest.approx(1.0)
    (curve,) = glyphs(plot, "Line")
    np.testing.assert_allclose(curve["y"], stats.norm.pdf(curve["x"], 4.0, 0.1))
    assert said(plot) == ["estimates", "as the stated std says"]
    alone, _ = batch.distributions(found, {}, {}, repeated=False)
    assert said(alone) == ["estimates"]


def test_each_setting_has_an_outline_of_its_own() -> None:
    found = cases(401, **{"set.M": [1.0, 2.0] * 200 + [1.0]}).iloc[:-1]
    plot, _ = batch.distributions(found, {}, {}, repeated=False)
    assert said(plot) == ["M = 1", "M = 2"]
    looks = {(each.glyph.line_color, each.glyph.line_dash_offset) for each in plot.renderers}
    assert len(looks) == 2


def test_spread_has_the_band_of_chance() -> None:
    """(n − 1) s²/σ² is χ² of n − 1 degrees of freedom."""
    summary = pd.DataFrame({"parameter": ["R", "L"], "cases": [11, 101], "ratio": [1.3, 0.9]})
    plot = batch.spread(summary)
    (band,) = glyphs(plot, "HBar")
    np.testing.assert_allclose(stats.chi2.cdf(band["low"] ** 2 * [10, 100], [10, 100]), 0.025)
    np.testing.assert_allclose(stats.chi2.cdf(band["high"] ** 2 * [10, 100], [10, 100]), 0.975)


def test_over_a_setting() -> None:
    found = cases(301, **{"set.M": np.repeat([1.0, 2.0, 3.0], [100, 100, 101])}).iloc[:-1]
    plot, _ = batch.over_setting(found, "set.M", {}, {"M": "H"})
    assert plot.xaxis.axis_label == "M (H)"
    (line,) = glyphs(plot, "Line")
    np.testing.assert_allclose(line["y"], found.groupby("set.M")["value.R"].mean())
    spread = stats.norm.ppf(0.975) * found.groupby("set.M")["value.R"].std().to_numpy()
    np.testing.assert_allclose(line["s1"] - line["s0"], 2 * spread)
    np.testing.assert_allclose(line["p1"] - line["p0"], 2 * stats.norm.ppf(0.975) * 0.1)
    words, _ = batch.over_setting(found.assign(table=["a", "b"] * 150), "table", {}, {})
    assert words.x_range.factors == ["a", "b"]


FROM = ("2026-01-02T03:04", "draws.toml, SHA-256 abc", "SHA-256 def")


def test_the_page_of_a_batch(tmp_path: Path) -> None:
    (tmp_path / "cases").mkdir()
    write_part(tmp_path, 0, cases(40, draw=range(40)).assign(message="long"))
    row = {"parameter": "R", "cases": 39, "mean": 4.01, "spread": 0.11, "stated_std": 0.1, "ratio": 1.1, "unit": "Ohm"}
    pd.DataFrame([row | {"note": ""}, row | {"parameter": "held", "cases": 0}]).to_csv(tmp_path / "summary.csv")
    failed = {"status": "failed", "message": "fmi2Error <b>", "cases": 1, "first": 39}
    pd.DataFrame([failed]).to_csv(tmp_path / "failures.csv", index=False)
    content = {"title": "Draws", "words": ["R: it is <biased>"], "statuses": {"converged": 39, "failed": 1}}
    told = content | {"truth": {"R": 4.0}, "units": {"R": "Ohm"}, "given_noise": False}
    told |= {"date": "2026-01-02T03:04", "study": {"file": "draws.toml", "digest": "abc"}, "files": {"a.csv": "def"}}
    (tmp_path / "summary.json").write_text(json.dumps(told))
    text = write_report(tmp_path).read_text(encoding="utf-8")
    for words in ("39 of 40 cases converged", "R: it is &lt;biased&gt;", "Draws", "Without an estimate", "1.1", *FROM):
        assert words in text, words
    assert "held" not in text
    assert text.count("data-root-id") == 2 + 2 + 1 + 1
    (tmp_path / "summary.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="no whole results of fmuid batch"):
        write_report(tmp_path)
