"""Summaries of batches: numbers against plainly computed ones, words on made-up cases, figures read back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.patches import Rectangle
from scipy import stats

from fmuid.batches.dataset import Dataset
from fmuid.batches.run_case import directions_of, directions_text
from fmuid.batches.statistics import Columns, EstimateDoubt, estimates, optimum_numbers, statistics
from fmuid.batches.summary import MAX_LEVELS, Summary, condensed, summarize
from fmuid.estimation.covariance import Determined, Direction
from fmuid.reports.batch_words import noted, summary_words, write_summary
from fmuid.reports.console.batch import show_batch
from fmuid.reports.figures import batch as figures_batch
from fmuid.reports.figures import style as plots

Array = npt.NDArray[np.float64]

TRUTH = {"R": 4.0, "L": 0.1}
UNITS = {"R": "Ohm", "L": "H", "N": "1"}
STD = {"R": 0.05, "L": 0.002}


def batch(
    settings: Mapping[str, object], spread: float = 1.0, seed: int = 7, noise: Array | float = 0.01, cases: int = 0
) -> pd.DataFrame:
    """Return the frame of a batch whose estimates scatter around the truth by `spread` times their stated std."""
    rng = np.random.default_rng(seed)
    cases = cases or max(len(np.atleast_1d(np.asarray(column))) for column in settings.values())
    frame = pd.DataFrame({"case": np.arange(cases), **settings, "status": "converged", "message": "converged"})
    for name, true in TRUTH.items():
        scatter = rng.normal(size=cases)
        if cases > 2:  # exactly centred and scaled, so that the words to expect are known
            scatter = (scatter - scatter.mean()) / scatter.std(ddof=1)
        frame[f"value.{name}"] = true + spread * STD[name] * scatter
    for name, std in STD.items():
        frame[f"std.{name}"] = std
    return frame.assign(**{"noise.i": noise, "criterion": 1000.0, "iterations": 5, "simulations": 30, "rejected": 0})


def fail(frame: pd.DataFrame, rows: list[int], messages: list[str], status: str = "failed") -> pd.DataFrame:
    """Return the frame with failed cases."""
    frame = frame.copy()
    estimated = [str(name).startswith(("value.", "std.", "noise.", "criterion")) for name in frame]
    frame.loc[rows, estimated] = np.nan
    frame.loc[rows, "status"], frame.loc[rows, "message"] = status, messages
    return frame


def row(summary: Summary, name: str) -> Mapping[Any, Any]:
    """Return the row of one parameter."""
    (found,) = noted(summary.parameters[summary.parameters["parameter"] == name]).to_dict("records")
    return found


def doubts(table: pd.DataFrame, name: str) -> list[tuple[EstimateDoubt, ...]]:
    """Return what is doubted of one parameter, a tuple a row."""
    found: list[tuple[EstimateDoubt, ...]] = table.loc[table["parameter"] == name, "doubts"].tolist()
    return found


# --- numbers


def test_numbers() -> None:
    """Every figure of the table is what numpy and scipy say."""
    frame = fail(batch({"draw": range(200)}, spread=1.3), [4, 9], ["no", "no"])
    summary = summarize(frame, TRUTH, UNITS)
    values = np.delete(frame["value.R"].to_numpy(np.float64), [4, 9])
    found = row(summary, "R")
    assert (found["cases"], found["unit"], found["undetermined"]) == (198, "Ohm", 0)
    assert found["mean"] == pytest.approx(np.mean(values), rel=1e-14)
    assert found["median"] == pytest.approx(np.median(values), rel=1e-14)
    assert found["spread"] == pytest.approx(np.std(values, ddof=1), rel=1e-13)
    assert found["stated_std"] == pytest.approx(0.05, rel=1e-14)
    assert found["ratio"] == pytest.approx(np.std(values, ddof=1) / 0.05, rel=1e-13)
    chi2 = stats.chi2(197)
    assert found["ratio_p"] == pytest.approx(2 * chi2.sf(197 * found["ratio"] ** 2), rel=1e-4)
    t_test = stats.ttest_1samp(values, 4.0)
    assert found["bias"] == pytest.approx(np.mean(values) - 4.0, rel=1e-12)
    assert found["bias_std"] == pytest.approx(stats.sem(values), rel=1e-13)
    assert found["bias_p"] == pytest.approx(t_test.pvalue, rel=1e-10)
    assert found["rms_error"] == pytest.approx(np.sqrt(np.mean((values - 4.0) ** 2)), rel=1e-13)
    held = int(np.sum(np.abs(values - 4.0) <= stats.norm.ppf(0.975) * 0.05))
    exact = stats.binomtest(held, 198).proportion_ci(0.95, method="exact")
    assert found["coverage"] == held / 198
    assert (found["coverage_lower"], found["coverage_upper"]) == pytest.approx(tuple(exact), rel=1e-10)
    assert found["coverage_p"] == pytest.approx(2 * stats.binom.cdf(held, 198, 0.95), rel=1e-10)


def test_limits_of_coverage_at_its_ends() -> None:
    for off, lower, upper in ((0.0, 0.025 ** (1 / 8), 1.0), (1.0, 0.0, 1.0 - 0.025 ** (1 / 8))):
        found = statistics(np.full(8, 4.0 + off), np.full(8, 0.05), 4.0, repeated=True)
        assert (found["coverage_lower"], found["coverage_upper"]) == pytest.approx((lower, upper), rel=1e-10)


@pytest.mark.parametrize(("cases", "freedom"), [(5, None), (100, None), (100, 30)])
def test_a_false_word_is_as_rare_as_stated(cases: int, freedom: int | None) -> None:
    """Where the stated std is right, probabilities below 5 % come in 5 % of all batches, also if the std scatters."""
    rng = np.random.default_rng(11)
    below = np.zeros(2)
    for _ in range(1500):
        stds = 0.05 * np.sqrt(rng.chisquare(freedom, cases) / freedom) if freedom else np.full(cases, 0.05)
        found = statistics(4.0 + 0.05 * rng.normal(size=cases), stds, 4.0, repeated=True)
        below += [found["ratio_p"] < 0.05, found["bias_p"] < 0.05]
    low, high = stats.binom.interval(0.999, 1500, 0.05)
    assert (below <= high).all()
    assert (below >= low).all()


def test_unequal_stds() -> None:
    """Cases of two precisions: the rule for equal ones would take this spread for impossible too often."""
    rng = np.random.default_rng(12)
    stds = np.repeat([0.01, 0.2], [90, 10])
    draws = [statistics(4 + stds * rng.normal(size=100), stds, 4.0, repeated=True)["ratio_p"] for _ in range(1500)]
    low, high = stats.binom.interval(0.999, 1500, 0.05)
    assert low * 0.5 <= np.sum(np.array(draws) < 0.05) <= high


def test_undetermined_estimates_are_left_out() -> None:
    frame = batch({"draw": range(50)})
    frame.loc[3, "std.R"], frame.loc[3, "value.R"] = np.nan, 1e6
    found = row(summarize(frame), "R")
    assert (found["cases"], found["undetermined"], found["note"]) == (49, 1, "not determined in 1")
    assert found["mean"] == pytest.approx(frame["value.R"].drop(3).mean(), rel=1e-13)


def test_without_a_truth_nothing_is_said_of_it() -> None:
    summary = summarize(batch({"draw": range(10)}), {"other": 1.0})
    assert not summary.has_truth
    assert "coverage_p" not in summary.parameters


# --- words


@pytest.mark.parametrize(("spread", "word"), [(2.0, "std 2 x too small"), (0.5, "std 2 x too large"), (1.0, "")])
def test_stated_std_against_spread(spread: float, word: str) -> None:
    summary = summarize(batch({"draw": range(300)}, spread=spread), TRUTH, UNITS)
    assert row(summary, "R")["note"] == word
    assert ("that is" in " ".join(summary_words(summary))) == bool(word)
    kinds = {
        2.0: [EstimateDoubt.STD_TOO_SMALL, EstimateDoubt.COVERAGE_OFF],
        0.5: [EstimateDoubt.STD_TOO_LARGE],
        1.0: [],
    }
    assert set(kinds[spread]) <= set(doubts(summary.parameters, "R")[0]) <= {*kinds[spread], EstimateDoubt.COVERAGE_OFF}


def test_stated_std_half_the_spread_in_words() -> None:
    frame = batch({"draw": range(300)}, spread=2.0)
    words = summary_words(summarize(frame, TRUTH, UNITS))
    assert words[0].startswith("R: varies 2 times as much from case to case (0.10 Ohm) as its stated std (0.050 Ohm)")
    held = np.mean(np.abs(frame["value.R"] - 4.0) <= stats.norm.ppf(0.975) * 0.05)
    assert held < 0.75
    assert words[1].startswith(f"R: the 95 % intervals hold the truth in {100 * held:.3g} % (")


def test_bias_in_words() -> None:
    frame = batch({"draw": range(300)})
    frame["value.L"] += 0.001
    summary = summarize(frame, TRUTH, UNITS)
    assert (row(summary, "R")["note"], row(summary, "L")["note"]) == ("", "biased")
    (first, *_) = summary_words(summary)
    assert first.startswith("L: biased by 0.00100 ± 0.00012 H, 0.5 times its stated std")


def test_a_difference_too_small_to_matter_is_left_out() -> None:
    """A hundred thousand cases make everything significant; 2 % of a standard deviation is still nothing."""
    frame = batch({"draw": range(100_000)}, spread=1.02)
    summary = summarize(frame, TRUTH)
    assert row(summary, "R")["ratio_p"] < 1e-9
    assert summary_words(summary) == []


def test_tables_that_differ() -> None:
    """Between records of several machines a large spread is no proof of wrong intervals, and says so."""
    frame = batch({"table": [f"machine {k}" for k in range(40)]}, spread=5.0)
    words = " ".join(summary_words(summarize(frame)))
    assert "from table to table" in words
    assert "what was measured differs, or the stated std is too small" in words


def test_few_cases() -> None:
    one, seven = (summarize(batch({"draw": range(count)}), TRUTH) for count in (1, 7))
    assert np.isnan(row(one, "R")["spread"])
    assert summary_words(one) == ["one estimate has no spread: nothing can be said of how sure the stated std are"]
    # 1/sqrt(2·6)
    assert summary_words(seven)[0] == "7 cases are few: their spread is itself uncertain by 29 %"


# --- failures


def test_failures_are_grouped() -> None:
    said = [
        "simulation of M2.fmu failed at t = 0.25 s with R = -3e-05, phase[1] = 1: error 3",
        "simulation of M2.fmu failed at t = 12 s with R = 4.5, phase[2] = 1: error 3",
        "record-004.csv: no column i2",
        "records 5.csv: no column i2",
    ]
    frame = batch({"table": [f"record-{k:03d}.csv" for k in range(20)]})
    frame.loc[19, "table"] = "records 5.csv"
    frame = fail(frame, [2, 7, 4, 19], said)
    frame = fail(frame, [11], ["the search did not converge in 50 iterations"], "not converged")
    summary = summarize(frame)
    assert summary.statuses["cases"].tolist() == [15, 1, 4]
    assert summary.failures.to_dict("list") == {
        "status": ["failed", "failed", "not converged"],
        "message": [
            "simulation of M2.fmu failed at t = # s with R = #, phase[#] = #: error #",
            "#: no column i2",
            "the search did not converge in # iterations",
        ],
        "undetermined": [(), (), ()],
        "cases": [2, 2, 1],
        "first": [2, 4, 11],
    }
    assert (
        summary_words(summary)[0]
        == "15 of 20 cases converged, 1 did not converge and 4 failed and are left out of what follows"
    )


def test_what_is_not_determined_is_told_by_its_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same parameters are one line whatever their numbers; others are another one."""
    frame = fail(batch({"draw": np.arange(20)}), [3, 5, 8], ["undetermined"] * 3, "not converged")
    frame = fail(frame, [9, 11], ["iteration_limit"] * 2, "not converged")
    values = (4.0, 0.1)
    apart = [Direction(Determined.NOT, ("R", "L"), (1.0, 0.1), math.inf, values, values)]
    single = [Direction(Determined.NOT_IN_EFFECT, ("L",), (1.0,), 30.0, values[1:], values[1:])]
    other = [replace(apart[0], coefficients=(1.0, -7.0))]
    frame["undetermined"] = ""
    frame.loc[[3, 5, 8], "undetermined"] = [directions_text(each) for each in (apart, single, other)]
    summary = summarize(frame)
    assert summary.failures["undetermined"].tolist() == [
        ((Determined.NOT, ("R", "L")),),
        (),
        ((Determined.NOT_IN_EFFECT, ("L",)),),
    ]
    assert summary.failures["cases"].tolist() == [2, 2, 1]
    write_summary(summary, tmp_path)
    told = pd.read_csv(tmp_path / "failures.csv")
    assert list(told) == ["status", "message", "cases", "first"]
    assert told["message"].tolist() == [
        "undetermined: R and L cannot be told apart",
        "stopped at the iteration limit: raise max_iterations or start nearer",
        "undetermined: L is not determined in effect",
    ]
    show_batch(summary)
    assert "R and L cannot be told apart" in " ".join(capsys.readouterr().out.split())
    assert directions_of(frame["undetermined"][8]) == tuple(other)


def test_a_summary_of_parts_is_that_of_all_rows(tmp_path: Path) -> None:
    """Groups, several starts and failures; the parts come in no order, and one case twice."""
    settings = {"table": np.repeat([f"r{k}" for k in range(30)], 4), "set.M": np.tile([0.4, 0.4, 0.5, 0.5], 30)}
    frame = batch({**settings, "start.R": np.tile([1.0, 2.0], 60)})
    frame = fail(frame, list(range(8)), [f"r{k // 4}: it failed at {k}" for k in range(8)])
    frame = fail(frame, [100, 110, 111], ["after 30 steps"] * 3, "not converged")
    kinds = {"object": "string", "str": "string"}
    frame = frame.assign(elapsed_s=0.1, finished=pd.Timestamp("2026-01-01", tz="UTC"), worker="w")
    types = {str(name): kinds.get(str(kind), str(kind)) for name, kind in frame.dtypes.items()}
    dataset = Dataset(tmp_path, types | {"finished": "datetime64[us, UTC]"})
    dataset.cases.mkdir(parents=True)
    rows: list[Any] = frame.to_dict("records")
    for part in (rows[70:], rows[:40], rows[35:70]):
        dataset.append(part)
    lean, failures = condensed(dataset)
    assert not {"message", "worker", "finished", "simulations"} & set(lean)
    found, right = summarize(lean, TRUTH, UNITS, failures=failures), summarize(frame, TRUTH, UNITS)
    assert len(right.failures) == 2
    for name in ("statuses", "failures", "parameters", "groups", "optima"):
        pd.testing.assert_frame_equal(getattr(found, name), getattr(right, name), check_exact=True)
    assert summary_words(found) == summary_words(right)
    empty, none = condensed(Dataset(tmp_path / "none", types | {"finished": "datetime64[us, UTC]"}))
    assert empty.empty
    assert none.empty


# --- groups


def test_groups_of_a_sweep() -> None:
    levels = np.repeat([0.4, 0.436, 0.47], 60)
    frame = batch({"set.M": levels, "draw": np.tile(np.arange(60), 3)})
    frame["value.R"] += 10.0 * (levels - 0.436)
    summary = summarize(fail(frame, [0, 1], ["no", "no"]), TRUTH, UNITS)
    assert summary.settings == ("set.M",)
    groups = summary.groups[summary.groups["parameter"] == "R"]
    plain = frame.drop([0, 1]).groupby("set.M")["value.R"]
    np.testing.assert_allclose(groups["mean"], plain.mean(), rtol=1e-13)
    np.testing.assert_allclose(groups["spread"], plain.std(ddof=1), rtol=1e-12)
    assert groups[["cases", "failed"]].to_numpy().tolist() == [[58, 2], [60, 0], [60, 0]]
    # over all levels together the spread is the sweep's, which no std is held against
    assert np.isnan(row(summary, "R")["ratio"])
    assert groups["ratio"].between(0.8, 1.25).all()
    both = (EstimateDoubt.BIASED, EstimateDoubt.COVERAGE_OFF)
    assert doubts(summary.groups, "R") == [both, (), both]
    words = " ".join(summary_words(summary))
    assert "R depends on what is set: its mean goes from" in words
    assert "(M = 0.4)" in words
    assert "R: it is biased in 2 of 3 groups" in words
    assert "L depends" not in words


def test_a_group_in_which_all_failed_is_there() -> None:
    frame = batch({"free": np.repeat(["R", "R L"], 3), "draw": np.tile(np.arange(3), 2)})
    summary = summarize(fail(frame, [3, 4, 5], ["no"] * 3))
    assert summary.groups[["free", "cases", "failed"]].drop_duplicates().to_numpy().tolist() == [
        ["R", 3, 0],
        ["R L", 0, 3],
    ]


def test_settings_of_many_levels_are_no_groups() -> None:
    count = MAX_LEVELS + 1
    frame = batch({"set.M": np.linspace(0, 1, count)})
    frame["value.R"] += np.linspace(0, 1, count)
    summary = summarize(frame)
    assert summary.groups.empty
    assert summary_words(summary)[0].startswith("R varies ")
    assert summary_words(summary)[0].endswith("over what is set")


def test_a_parameter_that_is_held_in_some_cases() -> None:
    frame = batch({"free": ["R", "R", "R L", "R L"]})
    frame.loc[:1, ["value.L", "std.L"]] = np.nan
    summary = summarize(frame, TRUTH)
    assert row(summary, "L")["cases"] == 2
    assert row(summary, "L")["undetermined"] == 0


# --- starts


def starts() -> pd.DataFrame:
    """Return two data sets with ten starts each; small starts end elsewhere, where the noise looks larger."""
    begin = np.tile(np.linspace(0.5, 9.5, 10), 2)
    draw = np.repeat([0, 1], 10)
    elsewhere = begin < 3.0
    frame = batch({"start.R": begin, "draw": draw}, spread=0.0, noise=np.where(elsewhere, 0.04, 0.01))
    frame["value.R"] = np.where(elsewhere, 2.0, 4.0 + 0.1 * draw)
    # estimated variances: the criterion of each search is measured with variances of its own
    frame["criterion"] = np.where(elsewhere, 10.0, 500.0)
    return frame


def test_one_estimate_a_data_set() -> None:
    """Starts are not repetitions: they share the noise."""
    frame = fail(starts(), [9], ["no"])
    found = estimates(frame, given_noise=False)
    assert found["value.R"].tolist() == [4.0, 4.1]
    assert estimates(frame, given_noise=True)["value.R"].tolist() == [2.0, 2.0]
    summary = summarize(frame, TRUTH)
    assert (summary.cases, summary.data_sets, row(summary, "R")["cases"]) == (20, 2, 2)
    assert "of each of the 2 data sets the one that fits best is counted" in " ".join(summary_words(summary))


def test_optima() -> None:
    frame = fail(starts(), [9], ["no"])
    expected = np.where(frame["start.R"] < 3.0, 2, 1)
    expected[9] = 0
    np.testing.assert_array_equal(optimum_numbers(frame, given_noise=False), expected)
    summary = summarize(frame)
    table = summary.optima.set_index("optimum")
    assert table["cases"].tolist() == [13, 6]
    assert table["data_sets"].tolist() == [2, 2]
    # σ is twice as large where σ² is four times
    np.testing.assert_allclose(table["residual"], [1.0, 2.0], rtol=1e-12)
    assert table["R"].tolist() == [4.1, 2.0]
    assert "of 19 searches that converged, 6 ended at another optimum than the best" in summary_words(summary)


def test_optima_of_different_settings_have_no_common_values() -> None:
    summary = summarize(starts().rename(columns={"draw": "set.M"}))
    assert summary.optima["cases"].tolist() == [14, 6]
    assert "R" not in summary.optima
    show_batch(summary)


def test_all_starts_lead_to_one_optimum() -> None:
    frame = batch({"start.R": np.linspace(1, 9, 5)}, spread=1e-6)
    assert "all 5 searches that converged ended at the same optimum" in summary_words(summarize(frame))


def test_optima_that_fit_equally_well() -> None:
    frame = batch({"start.R": np.linspace(1, 9, 6)}, spread=0.0)
    frame["value.R"] = [-4.0, -4.0, 4.0, 4.0, 4.0, 4.0]
    assert any("fit equally well" in sentence for sentence in summary_words(summarize(frame)))


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
