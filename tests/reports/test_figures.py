"""Figures: what they show is read back from their axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from matplotlib.figure import Figure

from fmuid.assessment.profile import Profile
from fmuid.reports.drawn import FORMATS, KINDS, clear_figures
from fmuid.reports.figures import fit as figures_fit
from fmuid.reports.figures import search as figures_search
from fmuid.reports.figures import style as plots
from fmuid.reports.figures import uncertainty as figures_uncertainty
from fmuid.simulation.fit import Fit
from tests.support.records import record, search

Array = npt.NDArray[np.float64]


def texts(figure: Figure) -> set[str]:
    """Return the titles and labels of a figure."""
    found = set()
    for axes in figure.axes:
        found |= {axes.get_title(loc) for loc in ("left", "right")} | {axes.get_xlabel(), axes.get_ylabel()}
    return found


def test_parameters() -> None:
    trace, estimates = search()
    estimates.loc[0, ["prior_mean", "prior_std"]] = [4.2, 0.05]
    figure = figures_search.parameters(trace, estimates)
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
    low, high = figures_search.parameters(trace, estimates).axes[0].get_ylim()
    assert low < 0 < high
    assert np.isfinite([low, high]).all()


def test_parameters_are_capped() -> None:
    trace, estimates = search(tuple(f"p{k}" for k in range(40)))
    assert len(figures_search.parameters(trace, estimates).axes) == plots.MAX_PARAMETERS


def test_criterion_of_gauss_newton_steps_has_no_panel_of_lambda() -> None:
    trace = pd.DataFrame(
        {
            "round": [1, 1, 1],
            "iteration": [0, 1, 2],
            "criterion": [900.0, 500.0, 100.0],
            "lambda": [np.nan, 0.0, 0.0],
            "accepted": [True, True, True],
        }
    )
    (above,) = figures_search.criterion(trace).axes
    assert (above.get_ylabel(), above.get_xlabel()) == ("criterion", "iteration")


def test_criterion() -> None:
    trace, _ = search()
    above, below = figures_search.criterion(trace).axes
    accepted, rejected, renewed, second = above.get_lines()
    np.testing.assert_array_equal(accepted.get_xydata(), [[0, 900], [1, 500], [3, 110]])
    np.testing.assert_array_equal(rejected.get_xydata(), [[2, 700]])
    np.testing.assert_array_equal(np.asarray(renewed.get_xydata())[:, 0], 4)
    np.testing.assert_array_equal(second.get_xydata(), [[4, 100]])
    assert above.get_yscale() == "log"
    np.testing.assert_allclose(np.asarray(below.get_lines()[0].get_xydata()), [[1, 0], [3, 0]])  # the decades of λ = 1
    assert below.yaxis.get_major_formatter()(-2.0, 0) == "0"
    assert (above.get_ylabel(), below.get_ylabel(), below.get_xlabel()) == ("criterion", "λ", "iteration")


def test_rounds() -> None:
    """Against the repetition stand the variance that the search began with, and what each round's residual gave."""
    found = pd.DataFrame(
        {
            "round": [1, 2, 3],
            "iterations": [5, 7, 8],
            "criterion": [900.0, 1000.0, 1000.0],
            "used.ids": [1e-3, 0.05, 0.0461],
            "used.iqs": [0.046, 0.0462, 0.0463],
            "estimated.ids": [0.05, 0.0461, 0.0462],
            "estimated.iqs": [0.0462, 0.0463, 0.0464],
        }
    )
    figure = figures_search.rounds(found, {"ids": "A", "iqs": None})
    wide, narrow = figure.axes
    np.testing.assert_array_equal(wide.get_lines()[1].get_xydata(), [[0, 1e-3], [1, 0.05], [2, 0.0461], [3, 0.0462]])
    assert (wide.get_yscale(), narrow.get_yscale()) == ("log", "linear")
    assert {"ids", "iqs", "0.0462", "0.0464", "variance (A²)", "variance", "round of the search"} <= texts(figure)


def test_optima() -> None:
    """Optima stand at their values, the best apart, those that did not converge as crosses."""
    table = pd.DataFrame(
        {
            "criterion": [10.0, 40.0, 90.0],
            "hits": [8, 2, 1],
            "converged": [True, True, False],
            "R": [4.0, 2.0, 1.0],
            "L": [0.1, 0.2, 0.3],
        }
    )
    figure = figures_search.optima(table, {"R": "Ohm"})
    assert {"R (Ohm)", "L", "criterion"} <= texts(figure)
    left, _ = figure.axes
    sure, best = left.collections
    np.testing.assert_array_equal(sure.get_offsets(), [[4.0, 10.0], [2.0, 40.0]])
    np.testing.assert_array_equal(best.get_offsets(), [[4.0, 10.0]])
    (crosses,) = left.get_lines()
    np.testing.assert_array_equal(crosses.get_xydata(), [[1.0, 90.0]])
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"optimum", "best", "not converged"}


def test_profile_of_which_only_the_estimate_is_known() -> None:
    table = pd.DataFrame({"R": [4.0], "criterion": [10.0]})
    profile = Profile("R", 4.0, 0.1, 0.1, 0.95, -np.inf, np.inf, 10.0, 3.84, (), interrupted=False, table=table)
    (axes,) = figures_uncertainty.profiles([profile], {"R": "Ohm"}).axes
    assert axes.get_title("right") == "−∞ to ∞ Ohm"


def test_fit() -> None:
    figure = figures_fit.fit(record())
    assert len(figure.axes) == 2 * 2 * 2
    assert {"y0 (A)", "y1 (A)", "time (s)", "residual\n(A)", "zoom"} <= texts(figure)
    misfit = record().misfit
    assert f"y0, misfit {100 * misfit[0]:.3g} %" in texts(figure)


def test_fits_of_several_experiments() -> None:
    """The worst are drawn, in the order of the study, under names that are file names."""
    records = [record(name=f"run {k}/a", noise=0.01 * (k + 1)) for k in range(plots.MAX_EXPERIMENTS + 2)]
    names = list(figures_fit.fits(records))
    assert names[0] == "fit-run_2_a"
    assert len(names) == plots.MAX_EXPERIMENTS


def test_outputs_are_capped_to_the_worst() -> None:
    many = record(outputs=plots.MAX_OUTPUTS + 1)
    many.simulated[:, 0] = many.measured[:, 0]
    many.simulated[np.isnan(many.simulated)] = 0.0
    assert "y0 (A)" not in texts(figures_fit.fit(many))
    assert "y1 (A)" in texts(figures_fit.fit(many))


def test_zoom_finds_the_step() -> None:
    times = np.arange(2000.0)
    simulated = np.where(times > 1200, 1 - np.exp(-(times - 1200) / 20), 0.0)[:, None]
    start, stop = figures_fit.zoom(simulated, np.ones(2000, bool))
    assert start <= 1201 < stop
    assert stop - start == figures_fit.ZOOM_SAMPLES
    assert figures_fit.zoom(simulated[:50], np.ones(50, bool)) == (0, 50)


def test_zoom_ignores_what_does_not_count() -> None:
    simulated = np.zeros((2000, 1))
    simulated[10] = 100.0
    simulated[1500] = 1.0
    counted = np.ones(2000, bool)
    counted[:100] = False
    start, stop = figures_fit.zoom(simulated, counted)
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


def test_save_replaces_the_figures_of_an_earlier_run(tmp_path: Path) -> None:
    for kind in KINDS:
        for form in FORMATS:
            (tmp_path / f"{kind}-old.{form}").write_text("old")
    (tmp_path / "mine.png").write_text("the user's")
    clear_figures(tmp_path)
    paths = plots.save(figures_fit.fits([record()]), tmp_path)
    assert [path.name for path in paths] == ["fit.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.png", "mine.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "head"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_figures_for_print_are_the_same_file_each_time(tmp_path: Path, kind: str, head: bytes) -> None:
    once, again = (plots.save({"fit": figures_fit.fit(record())}, tmp_path / n, kind)[0] for n in "ab")
    assert once.name == f"fit.{kind}"
    assert once.read_bytes().startswith(head)
    assert once.read_bytes() == again.read_bytes()


def test_the_least_that_an_experiment_can_have(tmp_path: Path) -> None:
    """Two samples are drawn without warnings."""
    values = np.ones((2, 1))
    fit = Fit("tiny", np.array([0.0, 1.0]), ("y",), (None,), values, 0 * values, np.ones((2, 1), bool))
    assert len(plots.save(figures_fit.fits([fit]), tmp_path)) == 1
