"""Interactive figures of parameters and what is known of them: their data are what was computed."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from bokeh.models import BoxAnnotation, Span

from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.identification import CostMap
from tests.support import records
from tests.support.live_figures import comparison, estimates, search, uncertainty
from tests.support.plots import bands, drawn, entries, labels, marks, plots


def result(rho: float = 0.6) -> Result:
    """Return a result of two parameters with known noise, 4 ± 0.1 and 0.1 ± 0.002."""
    std = np.array([0.1, 0.002])
    covariance = np.outer(std, std) * np.array([[1.0, rho], [rho, 1.0]])
    empty, free = np.full(2, np.nan), np.full(2, np.inf)
    from fmuid.estimation import TerminationReason

    return Result(
        TerminationReason.CONVERGED, ("R", "L"), np.array([4.0, 0.1]), np.array([5.0, 0.2]), -free, free,
        empty, empty, covariance, covariance, free, {}, {"i": 1.0}, 10.0, 0.0, math.inf, 3, 9, 0.1, (), (), (), (), "0",
    )  # fmt: skip


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
    plot = comparison.bars(["a", "b"], np.array([0.5, 2.0]), "error")
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
    chart = CostMap(("R", "L"), table, (5, 3), (False, True), centre, 10.0, block, 1.0, math.inf, {})
    plot = uncertainty.criterion_map(chart, {"L": "H"})
    assert labels(plot) == ("R", "L (H)")
    data = next(each.data_source.data for each in plot.renderers if type(each.glyph).__name__ == "Quad")
    np.testing.assert_allclose(data["v"][1:], np.maximum(table["criterion"][1:] - 10.0, 1e-300))
    assert np.isnan(data["v"][0])
    np.testing.assert_allclose(np.unique(data["top"] / data["bottom"]), 2.0)  # equal ratios on a logarithmic axis
    assert "95 % ellipse" in entries(plot)
