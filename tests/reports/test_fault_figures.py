"""Figures of diagnosis and monitoring: what they show is read back from the data of their glyphs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bokeh.models import BoxAnnotation, Span

from fmuid.diagnosis import BaselineSource, CauseScore, ChangeEvidence, EstimatedChange, Explanation, Rule
from fmuid.diagnosis.alarms import Alarm
from fmuid.diagnosis.causes import CauseKind
from fmuid.diagnosis.unexplained_residual import NOTHING_LEFT
from fmuid.runs import MonitoringRun
from tests.support.live_figures import diagnosis


def marks(plot: Any, kind: type) -> list[Any]:
    return [each for each in plot.center if isinstance(each, kind)]


@pytest.fixture
def news() -> ChangeEvidence:
    """Evidence of lost turns, beside which a gain of the sensor is not excluded."""
    turns = EstimatedChange(CauseKind("fault"), "dR", "turns", 0.3, 0.05, "Ohm")
    gain = EstimatedChange(CauseKind("gain"), "i", "", -0.02, 0.01, "")
    still = EstimatedChange(CauseKind("offset"), "i", "", 0.0, 0.1, "A")
    suspects = (
        CauseScore(still, 0.01, 0.9, "gain(i)", 1.5),
        CauseScore(turns, 41.0, 1e-9, "gain(i)", math.radians(5.0)),
        CauseScore(gain, 38.0, 1e-8, "turns.dR", math.radians(5.0)),
    )
    explanations = (Explanation((turns,), 1.0), Explanation((gain,), 0.2))
    return ChangeEvidence(1e-9, True, explanations, suspects, 0.05, 1.0, 1.0, 3.0, 600, True, NOTHING_LEFT)


def test_causes_stand_by_their_likelihood_with_the_angle_to_the_nearest(news: ChangeEvidence) -> None:
    plot = diagnosis.causes(news)
    assert plot.y_range.factors[::-1] == ["turns (dR)", "the gain of the sensor of i", "an offset of the sensor of i"]
    red, grey = (each.data_source.data for each in plot.renderers)
    assert (red["d"], grey["d"]) == ([41.0, 38.0], [diagnosis.LEAST_STATISTIC])
    assert red["near"] == ["gain(i), 5°", "turns.dR, 5°"]
    assert red["size"][0] == "0.300 ± 0.050 Ohm"


def test_changes_have_their_intervals_in_units_that_are_read(news: ChangeEvidence) -> None:
    turns, gain = diagnosis.changes(news)
    assert turns.xaxis.axis_label == "size, with its interval of 95 % (Ohm)"
    assert gain.xaxis.axis_label == "size, with its interval of 95 % (%)"
    data = gain.renderers[0].data_source.data
    assert [*data["value"], *data["low"], *data["high"]] == pytest.approx([-2.0, -3.96, -0.04], abs=1e-3)


def test_residuals_without_and_with_the_fault() -> None:
    rng = np.random.default_rng(1)
    table = pd.DataFrame(
        {"time": np.arange(500.0), "healthy.i": rng.normal(0, 2, 500), "fault.i": rng.normal(0, 1, 500)}
    )
    plot = diagnosis.residuals(table, "turns", {"i": "A"}).children[0][0]
    assert plot.yaxis.axis_label == "residual of i (A)"
    without, with_ = (each.data_source.data[each.glyph.y] for each in plot.renderers)
    np.testing.assert_allclose(without, table["healthy.i"], rtol=1e-6)
    np.testing.assert_allclose(with_, table["fault.i"], rtol=1e-6)
    said = [item.label["value"] for each in plot.above for item in each.items]
    std = math.sqrt(np.mean(table["fault.i"] ** 2))
    assert said[1] == f"with turns, std {std:.3g} A"


@pytest.fixture
def windows() -> pd.DataFrame:
    """Windows of 2 s in three records, in each of which the time begins anew."""
    count, start = 12, np.tile([0.0, 2.0, 4.0, 6.0], 3)
    columns = {"start": start, "end": start + 2.0, "record": np.repeat(["a", "b", "c"], 4), "variance_ratio": 1.0}
    sizes = {"turns.dR": np.arange(12.0), "turns.dR.std": 0.1, "R": 4.0, "R.std": [math.inf] + [0.1] * 11}
    return pd.DataFrame(columns | sizes | {"significant": [""] * 9 + ["turns", "turns", "other"]}, range(count))


def test_time_goes_on_from_record_to_record(windows: pd.DataFrame) -> None:
    clock, borders, _ = diagnosis.clock_of(windows)
    np.testing.assert_array_equal(clock, np.arange(1.0, 24.0, 2.0))
    assert borders == [8.0, 16.0]
    one = windows.iloc[:4]
    assert diagnosis.clock_of(one)[1:] == ([], "time (s)")


def test_timeline(windows: pd.DataFrame) -> None:
    sizes, units = {"turns": ("turns.dR",)}, {"R": "Ohm", "turns.dR": ""}
    alarms = (Alarm("turns", "c", 4.0, 10, 11),)
    found = MonitoringRun(windows, alarms, Rule(), (), sizes, ("R",), units, BaselineSource.RECORDS)
    figure = diagnosis.timeline(found, "turns")
    size, common, noise = (plot for plot, *_ in sorted(figure.children, key=lambda child: child[1:]))
    assert [each.yaxis.axis_label for each in (size, common, noise)] == ["dR", "R (Ohm)", "variance / noise"]
    _, dots = (each for each in size.renderers if type(each.glyph).__name__ == "Scatter")
    np.testing.assert_array_equal(dots.data_source.data["t"], [19.0, 21.0])
    data = common.renderers[0].data_source.data
    assert math.isnan(data["v1"][0])  # what is not determined is not drawn
    np.testing.assert_allclose(data["high0"] - data["v0"], 0.196)
    (band,) = marks(size, BoxAnnotation)
    assert (band.left, band.right) == (20.0, 24.0)
    assert (size.x_range.start, size.x_range.end) == (0.0, 24.0)
    assert sorted(each.location for each in marks(noise, Span)) == [1.0, 8.0, 16.0, 22.0]
