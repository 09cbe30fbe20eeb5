"""Summaries of sweeps and of several starts."""

from __future__ import annotations

import numpy as np

from fmuid.runs.batch.statistics import EstimateWarning, estimates, optimum_numbers
from fmuid.runs.batch.summary import MAX_LEVELS, summarize
from tests.support.drawn_batches import TRUTH, UNITS, batch, doubts, fail, row, show_batch, starts, summary_words

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
    assert summary_words(summary)[0].endswith("over the settings.")


def test_a_parameter_that_is_held_in_some_cases() -> None:
    frame = batch({"free": ["R", "R", "R L", "R L"]})
    frame.loc[:1, ["value.L", "std.L"]] = np.nan
    summary = summarize(frame, TRUTH)
    assert row(summary, "L")["cases"] == 2
    assert row(summary, "L")["undetermined"] == 0


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
