"""Charts of results and batches: their data are what was computed."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from fmuid import Document, InputError, Result
from fmuid.identification import CostMap
from fmuid.reports import chart
from fmuid.reports.publish import write_figures
from fmuid.reports.render.html import page
from fmuid.reports.topics import batch as topic
from fmuid.reports.topics import case_charts, estimates, fit, optimization, prior_and_data, residual_analysis
from fmuid.reports.topics import uncertainty_charts as uncertainty
from fmuid.reports.topics.batch_tables import tables_of
from fmuid.runs.batch.summary import summarize
from fmuid.simulation import InputSignals
from tests.support import records
from tests.support.charts import area_of, drawn, labels, layers, legend, places
from tests.support.drawn_batches import TRUTH, UNITS, batch, fail, show_batch
from tests.support.results import made_up

near = np.testing.assert_allclose


def result(rho: float = 0.6) -> Result:
    """Return a result of two parameters with known noise, 4 ± 0.1 and 0.1 ± 0.002."""
    std = np.array([0.1, 0.002])
    covariance = np.outer(std, std) * np.array([[1.0, rho], [rho, 1.0]])
    return made_up(("R", "L"), np.array([4.0, 0.1]), np.array([5.0, 0.2]), covariance)


def test_fit_with_band() -> None:
    given = records.record()
    charts = fit.fit_charts(given).charts
    upper, lower, *_ = charts
    assert [each.y.label for each in charts] == [
        "y0 (A)",
        "residual (A)",
        "y1 (A)",
        "residual (A)",
        "residual² (%)",
    ]
    assert [each.x.shown for each in charts] == [False, False, False, False, True]
    assert {(each.x.label, each.x.linked) for each in charts} == {("time (s)", "time")}
    (dots,), (line,), (rest,) = drawn(upper, "points"), drawn(upper, "line"), drawn(lower, "line")
    near(dots["y"], given.measured[:, 0], rtol=1e-6)
    near(line["y"], given.simulated[:, 0], rtol=1e-6, atol=1e-7)
    near(rest["y"], given.measured[:, 0] - given.simulated[:, 0], rtol=1e-4, atol=1e-6)
    (grey,) = drawn(upper, "zone")
    assert grey["right"] == given.times[50]
    assert legend(upper) == ["measured", f"simulated, fit {given.fit[0]:.4g} %"]
    upper, lower, *_ = fit.fit_charts(given, (np.full(given.simulated.shape, 0.5), 0.9)).charts
    assert "90 % band" in legend(upper)
    for each, middle in ((upper, given.simulated[:, 0]), (lower, 0.0 * given.simulated[:, 0])):
        (band,) = drawn(each, "band")
        near([band["y0"], band["y1"]], [middle - 0.5, middle + 0.5], atol=1e-6)


def test_inputs_and_location_of_the_residual_are_drawn() -> None:
    given = records.record()
    inputs = np.stack([np.sign(given.times - 0.2), given.times, 2.0 * given.times], axis=1)
    signals = InputSignals(("a", "b", "w"), ("V", "V", "rad/s"), (True, False, False), inputs)
    *_, located, volts, speed = fit.fit_charts(replace(given, inputs=signals)).charts
    (shares,) = drawn(located, "step")
    squares = np.where(given.counted, (given.measured - given.simulated) ** 2, np.nan)
    shown = np.nansum(squares / np.nanmedian(squares, axis=0), axis=1)
    shown *= 100.0 / shown.sum()
    near(shares["y"][:-1], shown.reshape(20, 30).sum(axis=1), rtol=1e-6)
    (held,), (ramp,), (turn,) = drawn(volts, "step"), drawn(volts, "line"), drawn(speed, "line")
    near([held["y"], ramp["y"], turn["y"]], inputs.T, rtol=1e-6)
    assert [volts.y.label, speed.y.label] == ["inputs (V)", "w (rad/s)"]


def test_forest_of_estimates() -> None:
    section = estimates.forest_section(result(), 0.95, ())
    (forest,) = section.charts
    assert isinstance(forest, chart.Chart)
    (bars,) = drawn(forest, "segments")
    near(bars["x1"], 100.0 * 1.959964 * np.array([0.1 / 4.0, 0.002 / 0.1]), rtol=1e-6)
    near(bars["x0"], -bars["x1"])
    assert bars["y0"] == ("R", "L")


def test_worst_outputs_and_experiments_are_shown() -> None:
    many = records.record(outputs=chart.LIMITS.outputs + 1)
    many.simulated[:, 0] = many.measured[:, 0]
    many.simulated[np.isnan(many.simulated)] = 0.0
    found = {each.y.label for each in fit.fit_charts(many).charts}
    assert "y1 (A)" in found and "y0 (A)" not in found
    several = [records.record(name=str(k), noise=0.01 * (k + 1)) for k in range(chart.LIMITS.experiments + 2)]
    sections = fit.fit_sections(several)
    assert [each.heading[-1] for each in sections] == [str(k) for k in range(2, chart.LIMITS.experiments + 2)]
    assert str(len(several)) in sections[0].caption
    assert [each.key for each in sections[:2]] == ["fit", "fit-2"]


def test_residuals() -> None:
    lags = np.arange(1, 6)
    columns = {"experiment": "run", "output": "y0", "lag": lags, "time": 0.1 * lags, "band": 0.1}
    own = pd.DataFrame(columns | {"with": "y0", "correlation": 0.5**lags})
    other = pd.DataFrame(columns | {"with": "u", "correlation": -0.02 * lags})
    found: Any = residual_analysis.residual_section([records.record(outputs=1)], pd.concat([own, other])).charts
    histogram, auto, crossed = found
    (stems,), (bars,) = drawn(auto, "segments"), drawn(histogram, "cells")
    near(stems["y1"], [0.5, 0.25, 0.125, 0.0625, 0.03125])
    assert drawn(auto, "zone") == [{"bottom": -0.1, "top": 0.1}]
    assert auto.y.reach[1] > 0.5
    assert legend(crossed) == ["u"]
    assert drawn(crossed, "line")[0]["y"].min() == -0.1
    assert crossed.y.reach == pytest.approx((-0.345, 0.345))  # of what is harmless the scale says so
    assert area_of(bars) == pytest.approx(1.0)


def searched(trace: pd.DataFrame, table: pd.DataFrame, **more: Any) -> dict[str, tuple[Any, ...]]:
    found: Any = SimpleNamespace(trace=trace, history=SimpleNamespace(rounds=more.get("rounds", ())))
    sections = optimization.optimization_sections(found, table, more.get("optima", pd.DataFrame()), {"i": "A"})
    return {each.key: each.charts for each in sections}


def test_parameters_over_iterations() -> None:
    trace, table = records.search()
    table.loc[0, ["prior_mean", "prior_std"]] = [4.2, 0.05]
    first, second = searched(trace, table)["parameters"]
    assert labels(first) == ("iteration", "R (Ohm)")
    (line,) = drawn(first, "line")
    assert (line["x"].tolist(), line["y"].tolist()) == ([0, 1, 3, 4], [5.0, 4.5, 4.1, 4.0])
    near(sorted([each["bottom"], each["top"]] for each in drawn(first, "zone")), [(3.8, 4.2), (4.1, 4.3)])
    assert drawn(second, "zone") == [{"bottom": 3.8, "top": 4.2}]
    assert first.y.reach[0] < 4.0 < 5.0 < first.y.reach[1]
    assert first.x.linked == second.x.linked != ""
    trace["R"] = 0.0  # one that stood still has a scale
    table.loc[0, ["value", "std", "lower", "upper"]] = 0.0, np.inf, -np.inf, np.inf
    table.loc[0, ["prior_mean", "prior_std"]] = np.nan
    still, _ = searched(trace, table)["parameters"]
    assert still.y.reach == (-1.0, 1.0)
    assert drawn(still, "zone") == []


def test_parabolas_of_prior_data_and_both() -> None:
    """Of one parameter the third is the sum of the other two, (1.57)."""
    std = 1.0 / math.hypot(1 / 0.2, 1 / 0.1)
    mean = std**2 * (4.2 / 0.2**2 + 3.9 / 0.1**2)
    row = {"parameter": "R", "prior": 4.2, "prior_std": 0.2, "data": 3.9, "data_std": 0.1, "combined": mean}
    row |= {"combined_std": std, "conflict": -0.3 / math.hypot(0.2, 0.1)}
    free = row | {"parameter": "L", "prior": np.nan, "prior_std": np.nan, "conflict": np.nan}
    table = pd.DataFrame([row, free])
    (plot,) = prior_and_data.parabola_charts(table, units={"R": "Ohm"})
    assert plot.x.label == "R (Ohm)"
    prior, data, both = drawn(plot, "line")
    near(prior["y"], ((prior["x"] - 4.2) / 0.2) ** 2)
    near(both["y"], prior["y"] + data["y"])
    (alone,) = prior_and_data.parabola_charts(table, ["L"])
    assert len(legend(alone)) == 2
    with pytest.raises(InputError, match="'Q'"):
        list(prior_and_data.parabola_charts(table, ["Q"]))
    beliefs, unknown = prior_and_data._beliefs(table, {"R": "Ohm"})
    for line, (center, width) in zip(drawn(beliefs, "line"), ((4.2, 0.2), (3.9, 0.1), (mean, std)), strict=True):
        assert line["x"][np.argmax(line["y"])] == pytest.approx(center)
        assert line["y"].max() == pytest.approx(1.0 / (width * math.sqrt(2 * math.pi)))
    assert legend(unknown) == legend(alone)


def test_correlation_and_ellipses() -> None:
    """Every point of an ellipse has (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) = χ²(2) = −2 ln 0.05."""
    found = result()
    (section,) = estimates.correlation_sections(found, {"R": "Ohm"})
    matrix, plot = section.charts
    assert isinstance(matrix, chart.Chart) and isinstance(plot, chart.Chart)
    (cells,), (line,) = drawn(matrix, "cells"), drawn(plot, "line")
    shown = dict(zip(zip(cells["x"], cells["y"], strict=True), cells["value"], strict=True))
    assert shown == pytest.approx({("R", "R"): 1.0, ("L", "L"): 1.0, ("R", "L"): 0.6, ("L", "R"): 0.6})
    assert sorted(cells["text"]) == ["+0.60", "+0.60", "1", "1"]
    away = np.stack([line["x"], line["y"]]) - found.values[:, None]
    near(np.einsum("ik,ij,jk->k", away, np.linalg.inv(found.covariance), away), -2.0 * math.log(0.05))
    half = 1.959964 * found.std
    near([places(plot, "x"), places(plot)], [[4 - half[0], 4 + half[0]], [0.1 - half[1], 0.1 + half[1]]], rtol=1e-6)


def profiled(values: Any, cost: Any, ends: tuple[float, float]) -> Any:
    table = pd.DataFrame({"R": values, "cost": cost})
    return SimpleNamespace(name="R", table=table, lower=ends[0], upper=ends[1], threshold=3.84, level=0.95)


def test_profile() -> None:
    values = np.linspace(3.7, 4.3, 9)
    found = profiled(values, 50.0 + ((values - 4.0) / 0.1) ** 2, (3.804, 4.196))
    plot = uncertainty._profile(found, result(), {"R": "Ohm"})
    assert plot.x.label == "R (Ohm)"
    curve, parabola, border = drawn(plot, "line")
    assert list(border["y"]) == [3.84, 3.84]
    for line in (parabola, curve):
        near(line["y"], ((line["x"] - 4.0) / 0.1) ** 2, atol=1e-6)
    assert drawn(plot, "zone") == [{"left": 3.804, "right": 4.196}]
    open_ = profiled(np.array([1.0, 4.0, 9.0]), np.array([50.2, 50.0, 50.1]), (-math.inf, math.inf))
    assert uncertainty._profile(open_, result(), {}).x.reach == (1.0, 9.0)


def test_cost_map() -> None:
    first, second = np.linspace(3.5, 4.5, 5), np.geomspace(0.05, 0.2, 3)
    table = pd.DataFrame([(a, b) for a in first for b in second], columns=["R", "L"])
    table["cost"] = 10.0 + 100.0 * (table["R"] - 4.0) ** 2 + np.log(table["L"] / 0.1) ** 2
    table.loc[0, "cost"] = np.nan
    covariance, center = result().covariance, np.array([4.0, 0.1])
    given = CostMap(("R", "L"), table, (5, 3), (False, True), center, 10.0, covariance, 1.0, math.inf, {})
    plot = uncertainty._map(given, {"L": "H"}, pd.DataFrame({"R": [4.0, 3.6], "L": [0.1, 0.1]}))
    assert (*labels(plot), plot.y.kind) == ("R", "L (H)", "log")
    (cells,) = drawn(plot, "cells")
    near(cells["value"][1:], np.maximum(table["cost"][1:] - 10.0, 1e-300))
    assert np.isnan(cells["value"][0])
    near(np.unique(cells["top"] / cells["bottom"]), 2.0)  # equal ratios on a logarithmic axis
    assert "95 % ellipse" in legend(plot)
    assert [3.6] in [each["x"].tolist() for each in drawn(plot, "points")]


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
