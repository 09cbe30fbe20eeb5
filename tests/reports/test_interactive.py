"""Interactive figures: what they show is read back from the data of their glyphs."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from bokeh.models import Axis, BoxAnnotation, Legend, Plot, Span

from fmuid.data import evenly, extremes
from fmuid.reports.interactive import style
from tests.support import records
from tests.support.live_figures import fit, residuals, search
from tests.support.plots import bands, drawn, entries, labels, marks, plots

Array = npt.NDArray[np.float64]


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
    assert entries(upper) == ["measured", f"simulated, fit {given.fit[0]:.4g} %"]


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


def test_outputs_and_experiments_of_the_least_fit() -> None:
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
