"""Figures: what they show is read back from their axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from matplotlib.figure import Figure

from fmuid import plots
from fmuid.report import Fit

Array = npt.NDArray[np.float64]


def record(samples: int = 600, outputs: int = 2, name: str = "run", noise: float = 0.1) -> Fit:
    """Return a fit with known noise; the first 50 samples do not count and one output lacks some."""
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 1e-3 * (samples - 1), samples)
    simulated = np.stack([np.sin(20 * times * (k + 1)) for k in range(outputs)], axis=1)
    measured = simulated + noise * rng.normal(size=simulated.shape)
    measured[100:110, 0] = np.nan
    counted = ~np.isnan(measured)
    counted[:50] = False
    names = tuple(f"y{k}" for k in range(outputs))
    return Fit(name, times, names, ("A",) * outputs, measured, simulated, counted)


def search(names: tuple[str, ...] = ("R", "L")) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the trace of a search of five iterations, the third rejected, and its estimates."""
    values = {name: [5.0, 4.5, 9.0, 4.1, 4.0] for name in names}
    trace = pd.DataFrame(
        {
            "round": [1, 1, 1, 1, 2],
            "iteration": range(5),
            "criterion": [900.0, 500.0, 700.0, 110.0, 100.0],
            "lambda": [np.nan, 1.0, 0.1, 1.0, np.nan],
            "accepted": [True, True, False, True, True],
            **values,
        }
    )
    estimates = pd.DataFrame({"parameter": names, "value": 4.0, "std": 0.1, "start": 5.0, "unit": "Ohm"})
    return trace, estimates.assign(prior_mean=np.nan, prior_std=np.nan)


def texts(figure: Figure) -> set[str]:
    """Return the titles and labels of a figure."""
    found = set()
    for axes in figure.axes:
        found |= {axes.get_title(loc) for loc in ("left", "right")} | {axes.get_xlabel(), axes.get_ylabel()}
    return found


def test_parameters() -> None:
    trace, estimates = search()
    estimates.loc[0, ["prior_mean", "prior_std"]] = [4.2, 0.05]
    figure = plots.parameters(trace, estimates)
    assert {"R", "L", "4.00 ± 0.10 Ohm", "Ohm", "iteration"} <= texts(figure)
    path = figure.axes[0].get_lines()[-2].get_xydata()
    np.testing.assert_array_equal(path, [[0, 5], [1, 4.5], [3, 4.1], [4, 4]])
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert labels == {"estimate ± 2 std", "prior ± 2 std", "accepted steps", "start"}


def test_parameters_undetermined_and_still() -> None:
    """Neither an infinite deviation nor a parameter that never moved spoils the axes."""
    trace, estimates = search(("R",))
    trace["R"] = 0.0
    estimates.loc[0, ["value", "std"]] = [0.0, np.inf]
    low, high = plots.parameters(trace, estimates).axes[0].get_ylim()
    assert low < 0 < high
    assert np.isfinite([low, high]).all()


def test_parameters_are_capped() -> None:
    trace, estimates = search(tuple(f"p{k}" for k in range(40)))
    assert len(plots.parameters(trace, estimates).axes) == plots.MAX_PARAMETERS


def test_criterion() -> None:
    trace, _ = search()
    above, below = plots.criterion(trace).axes
    accepted, rejected, renewed, second = above.get_lines()
    np.testing.assert_array_equal(accepted.get_xydata(), [[0, 900], [1, 500], [3, 110]])
    np.testing.assert_array_equal(rejected.get_xydata(), [[2, 700]])
    np.testing.assert_array_equal(np.asarray(renewed.get_xydata())[:, 0], 4)
    np.testing.assert_array_equal(second.get_xydata(), [[4, 100]])
    assert above.get_yscale() == "log"
    np.testing.assert_allclose(np.asarray(below.get_lines()[0].get_xydata()), [[1, 0], [3, 0]])  # the decades of λ = 1
    assert below.yaxis.get_major_formatter()(-2.0, 0) == "0"
    assert (above.get_ylabel(), below.get_ylabel(), below.get_xlabel()) == ("criterion", "λ", "iteration")


def test_fit() -> None:
    figure = plots.fit(record())
    assert len(figure.axes) == 2 * 2 * 2
    assert {"y0 (A)", "y1 (A)", "time (s)", "residual\n(A)", "zoom"} <= texts(figure)
    misfit = record().misfit
    assert f"y0, misfit {100 * misfit[0]:.3g} %" in texts(figure)


def test_fits_of_several_experiments() -> None:
    """The worst are drawn, in the order of the study, under names that are file names."""
    records = [record(name=f"run {k}/a", noise=0.01 * (k + 1)) for k in range(plots.MAX_EXPERIMENTS + 2)]
    names = list(plots.fits(records, residuals=True))
    assert names[:2] == ["fit-run_2_a", "residuals-run_2_a"]
    assert len(names) == 2 * plots.MAX_EXPERIMENTS


def test_outputs_are_capped_to_the_worst() -> None:
    many = record(outputs=plots.MAX_OUTPUTS + 1)
    many.simulated[:, 0] = many.measured[:, 0]
    many.simulated[np.isnan(many.simulated)] = 0.0
    assert "y0 (A)" not in texts(plots.fit(many))
    assert "y1 (A)" in texts(plots.fit(many))


def test_zoom_finds_the_step() -> None:
    times = np.arange(2000.0)
    simulated = np.where(times > 1200, 1 - np.exp(-(times - 1200) / 20), 0.0)[:, None]
    start, stop = plots.zoom(simulated, np.ones(2000, bool))
    assert start <= 1201 < stop
    assert stop - start == plots.ZOOM_SAMPLES
    assert plots.zoom(simulated[:50], np.ones(50, bool)) == (0, 50)


def test_zoom_ignores_what_does_not_count() -> None:
    simulated = np.zeros((2000, 1))
    simulated[10] = 100.0
    simulated[1500] = 1.0
    counted = np.ones(2000, bool)
    counted[:100] = False
    start, stop = plots.zoom(simulated, counted)
    assert start <= 1500 < stop


def test_thin_keeps_extremes_gaps_and_ends() -> None:
    rng = np.random.default_rng(5)
    x = np.arange(100_001.0)
    y = rng.normal(size=x.size)
    y[1234], y[70_000] = 9.0, -9.0
    y[500:3000] = np.nan
    thin_x, thin_y = plots.thin(x, y)
    assert len(thin_x) < 2 * plots.MAX_POINTS
    assert (np.diff(thin_x) > 0).all()
    assert (thin_x[0], thin_x[-1]) == (0, 100_000)
    assert np.nanmin(thin_y) == -9
    assert np.isnan(thin_y[(thin_x > 600) & (thin_x < 2900)]).all()
    np.testing.assert_array_equal(y[thin_x.astype(int)], thin_y)
    short = plots.thin(x[:10], y[:10])
    assert len(short[0]) == 10


def test_autocorrelation_of_a_first_order_process() -> None:
    """An AR(1) process has autocorrelation a^lag; a white series stays in its band 95 % of the time."""
    rng = np.random.default_rng(7)
    white = rng.normal(size=20_000)
    coloured = np.zeros_like(white)
    for k in range(1, white.size):
        coloured[k] = 0.8 * coloured[k - 1] + white[k]
    lags, values, band = plots.autocorrelation(coloured)
    np.testing.assert_allclose(values[:6], 0.8 ** lags[:6], atol=0.04)
    _, values, band = plots.autocorrelation(white)
    assert band == pytest.approx(1.96 / np.sqrt(white.size))
    assert (np.abs(values[1:]) < band).mean() > 0.85
    gappy = coloured.copy()
    gappy[::7] = np.nan
    assert np.isfinite(plots.autocorrelation(gappy)[1]).all()


def test_save_replaces_the_figures_of_an_earlier_run(tmp_path: Path) -> None:
    (tmp_path / "fit-old.png").write_text("old")
    (tmp_path / "mine.png").write_text("the user's")
    figures: dict[str, Any] = plots.fits([record()], residuals=True)
    paths = plots.save(figures, tmp_path)
    assert [path.name for path in paths] == ["fit.png", "residuals.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.png", "mine.png", "residuals.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_the_least_that_an_experiment_can_have(tmp_path: Path) -> None:
    """Two samples and a constant residual are drawn without warnings."""
    values = np.ones((2, 1))
    fit = Fit("tiny", np.array([0.0, 1.0]), ("y",), (None,), values, 0 * values, np.ones((2, 1), bool))
    assert len(plots.save(plots.fits([fit], residuals=True), tmp_path)) == 2
