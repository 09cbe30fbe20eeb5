"""Summaries of batches: numbers against plainly computed ones, words on made-up cases, groups, optima."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from fmuid.estimation import IdentifiabilityLevel, WeakDirection
from fmuid.reports.topics.batch_tables import write_tables
from fmuid.runs import EstimateWarning, estimates, optimum_numbers
from fmuid.runs.batch.case import directions_of, directions_text
from fmuid.runs.batch.statistics import statistics
from fmuid.runs.batch.summary import MAX_LEVELS, summarize
from tests.support.drawn_batches import TRUTH, UNITS, batch, doubts, fail, row, show_batch, starts, summary_words

# --- numbers


def test_numbers() -> None:
    """Every number of the table is that of numpy and scipy."""
    frame = fail(batch({"draw": range(200)}, spread=1.3), [4, 9], ["no", "no"])
    found = row(summarize(frame, TRUTH, UNITS), "R")
    values = np.delete(frame["value.R"].to_numpy(np.float64), [4, 9])
    ratio, held = np.std(values, ddof=1) / 0.05, int(np.sum(np.abs(values - 4.0) <= stats.norm.ppf(0.975) * 0.05))
    low, high = stats.binomtest(held, 198).proportion_ci(0.95, method="exact")
    assert (found["cases"], found["unit"], found["undetermined"], found["coverage"]) == (198, "Ohm", 0, held / 198)
    expected = {
        "mean": np.mean(values),
        "median": np.median(values),
        "spread": np.std(values, ddof=1),
        "stated_std": 0.05,
        "ratio": ratio,
        "bias": np.mean(values) - 4.0,
        "bias_std": stats.sem(values),
        "bias_p": stats.ttest_1samp(values, 4.0).pvalue,
        "rms_error": np.sqrt(np.mean((values - 4.0) ** 2)),
        "coverage_lower": low,
        "coverage_upper": high,
        "coverage_p": 2 * stats.binom.cdf(held, 198, 0.95),
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-10)
    assert found["ratio_p"] == pytest.approx(2 * stats.chi2(197).sf(197 * ratio**2), rel=1e-4)


def test_limits_of_coverage_at_its_ends() -> None:
    for off, lower, upper in ((0.0, 0.025 ** (1 / 8), 1.0), (1.0, 0.0, 1.0 - 0.025 ** (1 / 8))):
        found = statistics(np.full(8, 4.0 + off), np.full(8, 0.05), 4.0, repeated=True)
        assert (found["coverage_lower"], found["coverage_upper"]) == pytest.approx((lower, upper), rel=1e-10)


@pytest.mark.parametrize("draws", [500, pytest.param(3000, marks=pytest.mark.campaign)])
@pytest.mark.parametrize(("cases", "freedom"), [(5, None), (100, 30)])
def test_false_warnings_are_as_rare_as_stated(cases: int, freedom: int | None, draws: int) -> None:
    """Where the stated std is right, probabilities below 5 % come in 5 % of all batches, also if the std scatters."""
    rng = np.random.default_rng(11)
    below = np.zeros(2)
    for _ in range(draws):
        stds = 0.05 * np.sqrt(rng.chisquare(freedom, cases) / freedom) if freedom else np.full(cases, 0.05)
        found = statistics(4.0 + 0.05 * rng.normal(size=cases), stds, 4.0, repeated=True)
        below += [found["ratio_p"] < 0.05, found["bias_p"] < 0.05]
    low, high = stats.binom.interval(0.999, draws, 0.05)
    assert ((low <= below) & (below <= high)).all()


def test_unequal_stds() -> None:
    """Cases of two precisions: the rule for equal ones would take this spread for impossible too often."""
    rng, stds = np.random.default_rng(12), np.repeat([0.01, 0.2], [90, 10])
    draws = [statistics(4 + stds * rng.normal(size=100), stds, 4.0, repeated=True)["ratio_p"] for _ in range(500)]
    low, high = stats.binom.interval(0.999, 500, 0.05)
    assert low * 0.5 <= np.sum(np.array(draws) < 0.05) <= high


def test_undetermined_estimates_are_left_out() -> None:
    frame = batch({"draw": range(50)})
    frame.loc[3, "std.R"], frame.loc[3, "value.R"] = np.nan, 1e6
    found = row(summarize(frame), "R")
    assert (found["cases"], found["undetermined"], found["note"]) == (49, 1, "not identifiable in 1")
    assert found["mean"] == pytest.approx(frame["value.R"].drop(3).mean(), rel=1e-13)


# --- words


TOO_SMALL, TOO_LARGE, OFF = EstimateWarning.STD_TOO_SMALL, EstimateWarning.STD_TOO_LARGE, EstimateWarning.COVERAGE_OFF


@pytest.mark.parametrize(
    ("spread", "word", "kinds"),
    [(2.0, "σ 2 × too small", [TOO_SMALL, OFF]), (0.5, "σ 2 × too large", [TOO_LARGE]), (1.0, "", [])],
)
def test_stated_std_against_spread(spread: float, word: str, kinds: list[EstimateWarning]) -> None:
    frame = batch({"draw": range(300)}, spread=spread)
    summary = summarize(frame, TRUTH, UNITS)
    words = summary_words(summary)
    assert row(summary, "R")["note"] == word
    assert ("stated σ" in " ".join(words)) == bool(word)
    assert set(kinds) <= set(doubts(summary.parameters, "R")[0]) <= {*kinds, OFF}
    if spread > 1:
        assert words[0].startswith("R: spread 0.10 Ohm is 2 × the stated σ (0.050 Ohm)")
        held = np.mean(np.abs(frame["value.R"] - 4.0) <= stats.norm.ppf(0.975) * 0.05)
        assert words[1].startswith(f"R: {100 * held:.3g} % of the 95 % intervals contain")


def test_bias_in_words() -> None:
    frame = batch({"draw": range(300)})
    frame["value.L"] += 0.001
    summary = summarize(frame, TRUTH, UNITS)
    assert (row(summary, "R")["note"], row(summary, "L")["note"]) == ("", "biased")
    (first, *_) = summary_words(summary)
    assert first.startswith("L: biased by 0.00100 ± 0.00012 H (0.5 × the stated σ)")


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
    assert summary_words(summary)[0].startswith("15 of 20 cases converged;")


def test_non_identifiable_parameters_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same parameters are one line whatever their numbers; others are another one."""
    frame = fail(batch({"draw": np.arange(20)}), [3, 5, 8], ["undetermined"] * 3, "not converged")
    frame = fail(frame, [9, 11], ["iteration_limit"] * 2, "not converged")
    values = (4.0, 0.1)
    apart = [WeakDirection(IdentifiabilityLevel.NOT, ("R", "L"), (1.0, 0.1), math.inf, values, values)]
    single = [WeakDirection(IdentifiabilityLevel.NOT_IN_EFFECT, ("L",), (1.0,), 30.0, values[1:], values[1:])]
    other = [replace(apart[0], coefficients=(1.0, -7.0))]
    frame["undetermined"] = ""
    frame.loc[[3, 5, 8], "undetermined"] = [directions_text(each) for each in (apart, single, other)]
    summary = summarize(frame)
    assert summary.failures["undetermined"].tolist() == [
        ((IdentifiabilityLevel.NOT, ("R", "L")),),
        (),
        ((IdentifiabilityLevel.NOT_IN_EFFECT, ("L",)),),
    ]
    assert summary.failures["cases"].tolist() == [2, 2, 1]
    write_tables(summary, tmp_path)
    told = pd.read_csv(tmp_path / "failures.csv")
    assert list(told) == ["status", "message", "cases", "first"]
    for message, part in zip(told["message"], ("R and L", "iteration limit", "L is"), strict=True):
        assert part in message
    show_batch(summary)
    assert "R and L" in " ".join(capsys.readouterr().out.split())
    assert directions_of(frame["undetermined"][8]) == tuple(other)


def test_summary_counts_the_reasons_of_verdicts() -> None:
    frame = fail(batch({"draw": range(20)}), [7], ["no"])
    frame["reasons"] = ["at_bound poor_fit", "at_bound", *[""] * 18]
    frame.loc[7, "reasons"] = "not_converged"
    found = summarize(frame)
    assert found.reasons == {"at_bound": 2, "poor_fit": 1}
    assert "2 of 19 cases (10.5 %) are DOUBTFUL: at bound." in summary_words(found)


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
    both = (EstimateWarning.BIASED, EstimateWarning.COVERAGE_OFF)
    assert doubts(summary.groups, "R") == [both, (), both]
    words = " ".join(summary_words(summary))
    assert "R depends on the settings: mean" in words
    assert "(M = 0.4)" in words
    assert "R: biased in 2 of 3 groups" in words
    assert "L depends" not in words


def test_settings_of_many_levels_are_no_groups() -> None:
    count = MAX_LEVELS + 1
    frame = batch({"set.M": np.linspace(0, 1, count)})
    frame["value.R"] += np.linspace(0, 1, count)
    summary = summarize(frame)
    assert summary.groups.empty
    assert summary_words(summary)[0].startswith("R varies ")
    assert summary_words(summary)[0].endswith("over the settings.")


def test_one_estimate_a_data_set() -> None:
    """Starts are not repetitions: they share the noise."""
    frame = fail(starts(), [9], ["no"])
    found = estimates(frame, given_noise=False)
    assert found["value.R"].tolist() == [4.0, 4.1]
    assert estimates(frame, given_noise=True)["value.R"].tolist() == [2.0, 2.0]
    summary = summarize(frame, TRUTH)
    assert (summary.cases, summary.data_sets, row(summary, "R")["cases"]) == (20, 2, 2)
    assert "the best of all starting points for each of 2 data sets" in " ".join(summary_words(summary))


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
    assert "6 of 19 converged cases found another optimum than the best." in summary_words(summary)


def test_optima_of_different_settings_have_no_common_values() -> None:
    summary = summarize(starts().rename(columns={"draw": "set.M"}))
    assert summary.optima["cases"].tolist() == [14, 6]
    assert "R" not in summary.optima
    show_batch(summary)


def test_all_starts_lead_to_one_optimum() -> None:
    frame = batch({"start.R": np.linspace(1, 9, 5)}, spread=1e-6)
    assert "All 5 converged cases found the same optimum." in summary_words(summarize(frame))


def test_optima_that_fit_equally_well() -> None:
    frame = batch({"start.R": np.linspace(1, 9, 6)}, spread=0.0)
    frame["value.R"] = [-4.0, -4.0, 4.0, 4.0, 4.0, 4.0]
    assert any("fit equally well" in sentence for sentence in summary_words(summarize(frame)))
