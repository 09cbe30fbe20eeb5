"""Interactive figures: what they show is read back from the data of their glyphs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from bokeh.models import Axis, BoxAnnotation, Legend, Plot, Span

from fmuid.assessment import CriterionMap
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.reports.interactive import style
from fmuid.reports.thinning import evenly, extremes
from tests.support import records
from tests.support.live_figures import comparison, estimates, fit, residuals, search, uncertainty

Array = npt.NDArray[np.float64]


def plots(model: Any) -> list[Any]:
    """Return the plots of a figure in their order."""
    return [plot for plot, *_ in sorted(model.children, key=lambda child: child[1:])]


def drawn(plot: Any, glyph: str) -> list[dict[str, Any]]:
    """Return the data of all glyphs of a kind: what its x, y and so on are, fields looked up."""
    found = []
    for renderer in plot.renderers:
        if type(renderer.glyph).__name__ == glyph:
            data, values = renderer.data_source.data, {}
            for key in ("x", "y", "left", "right", "top", "x0", "x1", "y1"):
                field = getattr(renderer.glyph, key, None)
                values[key] = np.asarray(data[field]) if isinstance(field, str) else field
            found.append(values)
    return found


def marks(plot: Any, kind: type) -> list[Any]:
    """Return what lies over a plot, without the tools' own."""
    return [each for each in plot.center if isinstance(each, kind)]


def labels(plot: Any) -> tuple[str, str]:
    return plot.xaxis.axis_label, plot.yaxis.axis_label


def entries(plot: Any) -> list[str]:
    return [item.label["value"] for legend in plot.above if isinstance(legend, Legend) for item in legend.items]


def bands(plot: Any) -> Iterator[tuple[float, float]]:
    for box in marks(plot, BoxAnnotation):
        if isinstance(box.bottom, float) and math.isfinite(box.bottom):
            yield box.bottom, box.top


def result(rho: float = 0.6) -> Result:
    """Return a result of two parameters with known noise, 4 ± 0.1 and 0.1 ± 0.002."""
    std = np.array([0.1, 0.002])
    covariance = np.outer(std, std) * np.array([[1.0, rho], [rho, 1.0]])
    empty, free = np.full(2, np.nan), np.full(2, np.inf)
    from fmuid.estimation import Outcome

    return Result(
        Outcome.CONVERGED, ("R", "L"), np.array([4.0, 0.1]), np.array([5.0, 0.2]), -free, free,
        empty, empty, covariance, covariance, free, {}, {"i": 1.0}, 10.0, 0.0, math.inf, 3, 9, 0.1, (), (), (), (), "0",
    )  # fmt: skip


# --- thinning


def test_extremes_keep_the_least_and_greatest_of_every_column() -> None:
    rng = np.random.default_rng(7)
    columns = rng.normal(size=(50_000, 3))
    columns[777, 1], columns[31_000, 2] = 20.0, -30.0
    columns[5:2000, 0] = np.nan
    kept = extremes(columns, 1000)
    assert 300 < len(kept) <= 1100
    assert {0, 777, 31_000, 49_999} <= set(kept.tolist())
    assert (np.diff(kept) > 0).all()
    assert len(extremes(columns[:900], 1000)) == 900


def test_dots_are_thinned_evenly() -> None:
    """As many of the noise's middle are left as of its borders."""
    values = np.random.default_rng(8).normal(size=100_000)
    kept = evenly(values.size, 4000)
    assert len(kept) == 4000
    assert set(np.diff(kept).tolist()) <= {25, 26}
    assert np.std(values[kept]) == pytest.approx(1.0, abs=0.04)
    assert evenly(3, 4000).tolist() == [0, 1, 2]


# --- the fit


def test_fit() -> None:
    given = records.record()
    upper, lower, *_ = found = plots(fit.fit(given))
    assert len(found) == 4
    assert labels(upper)[1] == "y0 (A)"
    assert labels(lower)[1] == "residual (A)"
    assert labels(found[-1])[0] == "time (s)"
    assert len({id(plot.x_range) for plot in found}) == 1
    (dots,), (line,) = drawn(upper, "Scatter"), drawn(upper, "Line")
    np.testing.assert_allclose(dots["y"], given.measured[:, 0], rtol=1e-6)
    np.testing.assert_allclose(line["y"], given.simulated[:, 0], rtol=1e-6, atol=1e-7)
    (rest,) = drawn(lower, "Line")
    np.testing.assert_allclose(rest["y"], given.measured[:, 0] - given.simulated[:, 0], rtol=1e-4, atol=1e-6)
    (grey,) = marks(upper, BoxAnnotation)
    assert grey.right == given.times[50]
    assert entries(upper) == ["measured", f"simulated, misfit {100 * given.misfit[0]:.3g} %"]


def test_the_band_of_a_prediction() -> None:
    """It lies around the simulated line above, around zero below."""
    given = records.record()
    half = np.full(given.simulated.shape, 0.5)
    upper, lower, *_ = plots(fit.fit(given, half, 0.9))
    assert entries(upper)[2:] == ["90 % band"]
    for plot, middle in ((upper, given.simulated[:, 0]), (lower, 0.0 * given.simulated[:, 0])):
        (area,) = [each for each in plot.renderers if type(each.glyph).__name__ == "VArea"]
        low, high = (area.data_source.data[getattr(area.glyph, key)] for key in ("y1", "y2"))
        np.testing.assert_allclose(low, middle - 0.5, atol=1e-6)
        np.testing.assert_allclose(high, middle + 0.5, atol=1e-6)


def test_a_long_record_is_thinned() -> None:
    """Lines keep their extremes, dots their density; neither is longer than a screen shows."""
    given = records.record(samples=200_000)
    given.simulated[123_457, 1] = 40.0
    upper = plots(fit.fit(given))[2]
    (dots,), (line,) = drawn(upper, "Scatter"), drawn(upper, "Line")
    assert len(dots["x"]) <= style.MAX_DOTS
    assert len(line["x"]) < 1.2 * style.MAX_ROWS
    assert np.nanmax(line["y"]) == 40.0
    assert np.ptp(np.diff(dots["x"])) < 2e-3


def test_outputs_and_experiments_of_the_greatest_misfit() -> None:
    many = records.record(outputs=style.MAX_OUTPUTS + 1)
    many.simulated[:, 0] = many.measured[:, 0]
    many.simulated[np.isnan(many.simulated)] = 0.0
    found = {labels(plot)[1] for plot in plots(fit.fit(many))}
    assert "y1 (A)" in found
    assert "y0 (A)" not in found
    several = [records.record(name=str(k), noise=0.01 * (k + 1)) for k in range(style.MAX_EXPERIMENTS + 2)]
    assert [each.experiment for each in fit.worst(several)] == [str(k) for k in range(2, style.MAX_EXPERIMENTS + 2)]


# --- residuals


def correlations() -> pd.DataFrame:
    lags = np.arange(1, 6)
    columns = {"lag": lags, "time": 0.1 * lags, "band": 0.1}
    own = pd.DataFrame({"with": "y", "correlation": 0.5**lags} | columns)
    other = pd.DataFrame({"with": "u", "correlation": -0.02 * lags} | columns)
    return pd.concat([own, other], ignore_index=True)


def test_residuals() -> None:
    table = correlations()
    plot = residuals.autocorrelation(table[table["with"] == "y"], "y")
    (stems,) = drawn(plot, "Segment")
    np.testing.assert_allclose(stems["y1"], [0.5, 0.25, 0.125, 0.0625, 0.03125])
    assert list(bands(plot)) == [(-0.1, 0.1)]
    assert plot.y_range.end > 0.5
    crossed = residuals.with_inputs(table[table["with"] == "u"], "y")
    assert entries(crossed) == ["u"]
    assert drawn(crossed, "Line")[0]["y"].min() == -0.1
    assert crossed.y_range.end >= 3 * 0.1  # of what is harmless the scale says so


def test_histogram_is_a_density_in_standard_deviations() -> None:
    values = np.random.default_rng(5).normal(3.0, 7.0, 20_000)
    values[::7] = np.nan
    (bars,) = drawn(residuals.histogram(values, "y"), "Quad")
    assert np.sum(bars["top"] * (bars["right"] - bars["left"])) == pytest.approx(1.0)
    middles = 0.5 * (bars["left"] + bars["right"])
    normal = np.exp(-(middles**2) / 2) / math.sqrt(2 * math.pi)
    np.testing.assert_allclose(bars["top"], normal, atol=0.03)


# --- the search


def test_parameters() -> None:
    trace, table = records.search()
    table.loc[0, ["prior_mean", "prior_std"]] = [4.2, 0.05]
    first, second = search.parameters(trace, table)
    assert labels(first) == ("iteration", "R (Ohm)")
    (line,) = drawn(first, "Line")
    np.testing.assert_array_equal(line["y"], [5.0, 4.5, 4.1, 4.0])
    np.testing.assert_array_equal(line["x"], [0, 1, 3, 4])
    np.testing.assert_allclose(sorted(bands(first)), [(3.8, 4.2), (4.1, 4.3)])
    assert list(bands(second)) == [(3.8, 4.2)]
    assert first.y_range.start < 4.0 < 5.0 < first.y_range.end
    assert first.x_range is second.x_range


def test_a_parameter_that_stood_still_has_a_scale() -> None:
    trace, table = records.search(("R",))
    trace["R"] = 0.0
    table.loc[0, ["value", "std", "lower", "upper"]] = [0.0, np.inf, -np.inf, np.inf]
    (plot,) = search.parameters(trace, table)
    assert (plot.y_range.start, plot.y_range.end) == (-1.0, 1.0)
    assert list(bands(plot)) == []


def test_criterion_and_lambda() -> None:
    trace, _ = records.search()
    above, below = search.criterion(trace)
    taken, rejected = drawn(above, "Line"), drawn(above, "Scatter")
    np.testing.assert_array_equal(taken[0]["y"], [900.0, 500.0, 110.0])
    np.testing.assert_array_equal(taken[1]["y"], [100.0])
    assert [700.0] in [each["y"].tolist() for each in rejected]
    assert entries(above) == ["accepted", "rejected trial"]
    assert [each.location for each in marks(above, Span)] == [4.0]
    np.testing.assert_array_equal(drawn(below, "Line")[0]["y"], [1.0, 1.0])


def test_without_damping_there_is_no_panel_of_it() -> None:
    trace, _ = records.search()
    assert len(search.criterion(trace.assign(**{"lambda": 0.0}))) == 1


def test_rounds_and_optima() -> None:
    table = pd.DataFrame({"round": [1, 2], "used.i": [1e-3, 0.05], "estimated.i": [0.05, 0.046]})
    (plot,) = search.rounds(table, {"i": "A"})
    assert labels(plot) == ("round of the search", "noise variance of i (A²)")
    np.testing.assert_array_equal(drawn(plot, "Line")[0]["y"], [1e-3, 0.05, 0.046])
    found = pd.DataFrame({"criterion": [10.0, 40.0, 90.0], "hits": [8, 2, 1], "converged": [True, True, False]})
    (plot,) = search.optima(found.assign(R=[4.0, 2.0, 1.0]), {"R": "Ohm"})
    assert labels(plot) == ("R (Ohm)", "criterion")
    assert sorted(each["x"].tolist() for each in drawn(plot, "Scatter")) == [[1.0], [2.0], [4.0]]
    assert entries(plot) == ["optimum", "not converged", "best"]


# --- estimates


def test_belief_draws_densities_of_what_is_known() -> None:
    row = {"parameter": "R", "prior": 4.2, "prior_std": 0.2, "data": 3.9, "data_std": 0.1, "combined": 4.0}
    reading = pd.DataFrame(
        [row | {"combined_std": 0.05}, row | {"data": np.nan, "data_std": np.inf, "combined_std": 0.1}]
    )
    both, unknown = estimates.belief(reading, {"R": "Ohm"})
    assert labels(both)[0] == "R (Ohm)"
    for line, (mean, std) in zip(drawn(both, "Line"), ((4.2, 0.2), (3.9, 0.1), (4.0, 0.05)), strict=True):
        assert line["x"][np.argmax(line["y"])] == pytest.approx(mean)
        assert line["y"].max() == pytest.approx(1.0 / (std * math.sqrt(2 * math.pi)))
    assert entries(unknown) == ["prior", "both"]


def test_parabolas_of_prior_data_and_both() -> None:
    """Of one parameter the third is the sum of the other two, (1.57)."""
    std = 1.0 / math.hypot(1 / 0.2, 1 / 0.1)
    mean = std**2 * (4.2 / 0.2**2 + 3.9 / 0.1**2)
    row = {"parameter": "R", "prior": 4.2, "prior_std": 0.2, "data": 3.9, "data_std": 0.1, "combined": mean}
    row |= {"combined_std": std, "conflict": -0.3 / math.hypot(0.2, 0.1)}
    free = row | {"parameter": "L", "prior": np.nan, "prior_std": np.nan, "conflict": np.nan}
    reading = pd.DataFrame([row, free])
    (plot,) = estimates.parabolas(reading, units={"R": "Ohm"})
    assert labels(plot) == ("R (Ohm)", "criterion")
    prior, data, both = drawn(plot, "Line")
    assert prior["y"] == pytest.approx(((prior["x"] - 4.2) / 0.2) ** 2)
    assert both["y"] == pytest.approx(prior["y"] + data["y"])
    (alone,) = estimates.parabolas(reading, ["L"])
    assert entries(alone) == ["data alone", "both"]
    assert [np.min(line["y"]) for line in (prior, data, both)] == pytest.approx([0.0, 0.0, 1.8], abs=0.05)
    with pytest.raises(InputError, match="'Q' is not in the reading"):
        estimates.parabolas(reading, ["Q"])


def test_correlation() -> None:
    matrix = result().correlation
    plot = estimates.correlation(matrix)
    (cells,) = [each for each in plot.renderers if type(each.glyph).__name__ == "Rect"]
    table = pd.DataFrame({key: list(cells.data_source.data[key]) for key in ("x", "y", "v", "text")})
    assert table.set_index(["x", "y"])["v"].to_dict() == pytest.approx(
        {("R", "R"): 1.0, ("L", "L"): 1.0, ("R", "L"): 0.6, ("L", "R"): 0.6}
    )
    assert sorted(table["text"]) == ["+0.60", "+0.60", "1", "1"]


def test_the_ellipse_is_where_the_criterion_has_risen_by_chi_squared() -> None:
    """Every point of it has (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) = χ²(2) = −2 ln 0.05."""
    found = result()
    (plot,) = estimates.ellipses(found, {"R": "Ohm"})
    (line,) = drawn(plot, "Line")
    away = np.stack([line["x"], line["y"]]) - found.values[:, None]
    rise = np.einsum("ik,ij,jk->k", away, np.linalg.inv(found.covariance), away)
    np.testing.assert_allclose(rise, -2.0 * math.log(0.05))
    ends = sorted(each.location for each in marks(plot, Span))
    half = 1.959964 * found.std
    np.testing.assert_allclose(ends, sorted([*(found.values - half), *(found.values + half)]), rtol=1e-6)


def test_accuracy_marks_shifts_that_spoil_intervals() -> None:
    table = pd.DataFrame({"parameter": ["R", "L", "M"], "numerical_shift": [0.02, -0.5, np.nan]})
    plot = estimates.accuracy(table)
    small, large = drawn(plot, "Scatter")
    assert (small["x"].tolist(), large["x"].tolist()) == ([0.02], [-0.5])
    assert entries(plot) == ["harmless", "larger than a tenth"]


# --- what stands beside each other


def test_bars_are_of_one_scale_and_the_first_is_apart() -> None:
    plot = comparison.bars(["a", "b"], np.array([0.5, 2.0]), "misfit")
    assert plot.y_range.factors == ["b", "a"]
    assert plot.x_range.start == 0
    found = {str(each.glyph.fill_color): each.data_source.data["v"].tolist() for each in plot.renderers}
    assert list(found.values()) == [[0.5], [2.0]]


def test_estimates_that_only_one_result_has_are_left_out() -> None:
    row = {"result": "a", "parameter": "R", "unit": "Ohm", "value": 4.0, "lower": 3.8, "upper": 4.2}
    (plot,) = comparison.estimates(pd.DataFrame([row, row | {"result": "b"}, row | {"parameter": "L"}]))
    assert labels(plot)[0] == "R (Ohm)"
    assert plot.y_range.factors == ["b", "a"]


def test_sensitivities_of_those_that_do_most() -> None:
    times = np.linspace(0.0, 1.0, 50)
    table = pd.DataFrame({"time": times, **{f"i/p{k}": (k + 1.0) * times for k in range(12)}})
    (plot,) = plots(comparison.sensitivities(table, {"i": "A"}))
    assert labels(plot) == ("time (s)", "i (A)")
    assert entries(plot) == [f"p{k}" for k in range(4, 12)]
    np.testing.assert_allclose(drawn(plot, "Line")[-1]["y"], 12.0 * times, rtol=1e-6)


# --- uncertainty


def test_profile() -> None:
    values = np.linspace(3.7, 4.3, 9)
    points = pd.DataFrame({"value": values, "criterion": 50.0 + ((values - 4.0) / 0.1) ** 2})
    ends = {"lower": 3.804, "upper": 4.196, "threshold": 3.84}
    plot = uncertainty.profile(points, ends, (4.0, 0.1), "R (Ohm)", 0.95)
    assert labels(plot) == ("R (Ohm)", "rise of the criterion")
    border, parabola, curve = drawn(plot, "Line")
    assert list(border["y"]) == [3.84, 3.84]
    assert entries(plot)[2] == "95 % level: a rise of 3.84"
    np.testing.assert_allclose(parabola["y"], ((parabola["x"] - 4.0) / 0.1) ** 2)
    np.testing.assert_allclose(curve["y"], ((curve["x"] - 4.0) / 0.1) ** 2, atol=1e-6)
    (shade,) = marks(plot, BoxAnnotation)
    assert (shade.left, shade.right) == (3.804, 4.196)


def test_a_profile_without_ends_is_drawn_as_far_as_it_is_known() -> None:
    points = pd.DataFrame({"value": [1.0, 4.0, 9.0], "criterion": [50.2, 50.0, 50.1]})
    ends = {"lower": -math.inf, "upper": math.inf, "threshold": 3.84}
    plot = uncertainty.profile(points, ends, (4.0, math.inf), "R", 0.95)
    assert (plot.x_range.start, plot.x_range.end) == (1.0, 9.0)


def test_contours_hold_the_shares_of_the_samples() -> None:
    counts = np.random.default_rng(3).random((32, 32)) ** 4
    low, high = uncertainty.share_levels(counts)
    assert counts[counts >= low].sum() / counts.sum() == pytest.approx(0.95, abs=0.01)
    assert counts[counts >= high].sum() / counts.sum() == pytest.approx(0.68, abs=0.01)


def test_corner() -> None:
    found = result()
    samples = np.random.default_rng(4).multivariate_normal(found.values, found.covariance, 4000)
    corner = uncertainty.corner(pd.DataFrame(samples, columns=["R", "L"]), found, {"R": "Ohm"})
    first, pair, last = plots(corner)
    assert [labels(each) for each in (first, pair, last)] == [("", ""), ("R (Ohm)", "L"), ("L", "")]
    assert first.x_range is pair.x_range
    (bars,) = drawn(last, "Quad")
    assert np.sum(bars["top"] * (bars["right"] - bars["left"])) == pytest.approx(1.0)


def test_map() -> None:
    """Cells carry the excess of the criterion, the one that failed none."""
    first, second = np.linspace(3.5, 4.5, 5), np.geomspace(0.05, 0.2, 3)
    table = pd.DataFrame([(a, b) for a in first for b in second], columns=["R", "L"])
    table["criterion"] = 10.0 + 100.0 * (table["R"] - 4.0) ** 2 + np.log(table["L"] / 0.1) ** 2
    table.loc[0, "criterion"] = np.nan
    block, centre = result().covariance, np.array([4.0, 0.1])
    chart = CriterionMap(("R", "L"), table, (5, 3), (False, True), centre, 10.0, block, 1.0, math.inf, {})
    plot = uncertainty.criterion_map(chart, {"L": "H"})
    assert labels(plot) == ("R", "L (H)")
    data = next(each.data_source.data for each in plot.renderers if type(each.glyph).__name__ == "Quad")
    np.testing.assert_allclose(data["v"][1:], np.maximum(table["criterion"][1:] - 10.0, 1e-300))
    assert np.isnan(data["v"][0])
    np.testing.assert_allclose(np.unique(data["top"] / data["bottom"]), 2.0)  # equal ratios on a logarithmic axis
    assert "95 % ellipse" in entries(plot)


# --- the look


def test_names_that_look_like_mathematics_are_drawn_as_they_are() -> None:
    assert style.plain("R (Ohm)") == "R (Ohm)"
    found = style.plain("$$x$$ (A)")
    assert not isinstance(found, str)
    assert (found.kind, found.text) == ("PlainText", "$$x$$ (A)")


def test_names_never_become_columns_or_formats() -> None:
    name = "@{t}$x{{safe}}<b>"
    trace, table = records.search((name,))
    (plot,) = search.parameters(trace, table)
    for tool in plot.toolbar.tools:
        assert name not in str(getattr(tool, "tooltips", ""))
    assert all(name not in renderer.data_source.data for renderer in plot.renderers)


# Machado, Oliveira, Fernandes 2009: what protanopes and deuteranopes see, on linear RGB.
BLIND = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "all colours": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}


def lightness_and_hue(color: str, matrix: list[list[float]]) -> Array:
    """Return CIE L*a*b* of a colour as it is seen."""
    rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(matrix) @ linear, 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.maximum(np.array(to_xyz) @ seen / np.array([0.9505, 1.0, 1.089]), 0.008856))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("kind", BLIND)
@pytest.mark.parametrize("dark", [False, True])
def test_colours_are_told_apart_by_all_eyes(kind: str, dark: bool) -> None:
    """Lines of a figure, and each against the ground, differ by far more than the 2.3 that are just seen."""
    used = [style.BLUE, style.RED, style.AMBER, style.GREY, style.WHITE]
    seen = [lightness_and_hue(style.DARK[each] if dark else each, BLIND[kind]) for each in used]
    apart = [np.linalg.norm(one - other) for k, one in enumerate(seen) for other in seen[k + 1 :]]
    assert min(apart) > 14.0


def test_every_colour_has_its_twin() -> None:
    """What is drawn in a colour of the house can be drawn on a dark page too."""
    trace, table = records.search()
    figures = [*search.parameters(trace, table), *search.criterion(trace), fit.fit(records.record())]
    used = set()
    for figure in figures:
        for model in figure.references():
            for key, value in model.properties_with_values(include_defaults=False).items():
                if key.endswith("color") and isinstance(value, str) and isinstance(model, Plot | Axis | Span | Legend):
                    used.add(value)
    assert used <= set(style.DARK)
    assert len(used) >= 4
