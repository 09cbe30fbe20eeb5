"""Charts and lines of diagnosis and monitoring: what layers hold, and what the console says once."""

import io
import json
import math
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from rich.text import Text

from fmuid.diagnosis import (
    Alarm,
    BaselineSource,
    CauseKind,
    CauseScore,
    ChangeEvidence,
    Coverage,
    EstimatedChange,
    Explanation,
    Trend,
)
from fmuid.diagnosis.unexplained_residual import NOTHING_LEFT
from fmuid.reports.render import following
from fmuid.reports.render.following import FollowingDisplay
from fmuid.reports.topics import diagnosis, monitoring
from fmuid.reports.topics.monitoring import alarm_sentence
from fmuid.runs import FollowStatus
from fmuid.runs.follow import AlarmLines
from tests.support.charts import drawn, places


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


def test_causes_are_ordered_by_probability(news: ChangeEvidence) -> None:
    plot = diagnosis.cause_evidence(news)
    assert plot.y.names[::-1] == ("turns (dR)", "gain of sensor i", "offset of sensor i")
    red, grey = drawn(plot, "bars")
    assert (red["x"].tolist(), grey["x"].tolist()) == ([41.0, 38.0], [diagnosis.MIN_STATISTIC])
    assert red["near"] == ("gain(i), 5°", "turns.dR, 5°")
    assert red["size"][0] == "0.300 ± 0.050 Ohm"


@pytest.fixture
def windows() -> pd.DataFrame:
    """Windows of 2 s in three records, in each of which the time begins anew."""
    count, start = 12, np.tile([0.0, 2.0, 4.0, 6.0], 3)
    columns = {"start": start, "end": start + 2.0, "record": np.repeat(["a", "b", "c"], 4), "variance_ratio": 1.0}
    sizes = {"turns.dR": np.arange(12.0), "turns.dR.std": 0.1, "R": 4.0, "R.std": [math.inf] + [0.1] * 11}
    return pd.DataFrame(columns | sizes | {"significant": [""] * 9 + ["turns", "turns", "other"]}, range(count))


def test_timeline(windows: pd.DataFrame) -> None:
    units = {"R": "Ohm", "turns.dR": ""}
    alarm = Alarm("turns", "c", 4.0, 10, 11)
    found: Any = SimpleNamespace(
        table=windows, sizes={"turns": ("turns.dR",)}, common=("R",), units=units, alarms=(alarm,)
    )
    size, common, noise = monitoring._timeline(found, "turns").charts
    assert [each.y.label for each in (size, common, noise)] == ["dR", "R (Ohm)", "variance / noise"]
    (dots,) = drawn(size, "points", "significant")
    np.testing.assert_array_equal(dots["x"], [19.0, 21.0])
    (bars,), (points,) = drawn(common, "segments"), drawn(common, "points")
    assert math.isnan(points["y"][0])  # what is not determined is not drawn
    np.testing.assert_allclose((bars["y1"] - points["y"])[1:], 0.196)
    (ground,) = drawn(size, "zone")
    assert (ground["left"].tolist(), ground["right"].tolist()) == ([20.0], [24.0])
    assert size.x.reach == (0.0, 24.0)
    assert sorted([*places(noise), *places(noise, "x")]) == [1.0, 8.0, 16.0, 22.0]


@pytest.mark.parametrize(
    ("kind", "explanations", "basis", "said"),
    [
        ("fault", 1, BaselineSource.RECORDS, "FAULT: turns, dR = 0.300 ± 0.050 Ohm (p = 1e-09)."),
        ("ambiguous", 2, BaselineSource.RECORDS, "CHANGE, indistinguishable: turns, dR = 0.300 ± 0.050 Ohm or gain"),
        ("unexplained", 0, BaselineSource.RESULT, "UNEXPLAINED CHANGE: residual variance is 1.9 ×"),
        ("unexplained", 1, BaselineSource.RECORDS, "UNEXPLAINED CHANGE, closest: turns"),
        ("undecided", 0, BaselineSource.RECORDS, "UNDECIDED: turns.dR indistinguishable"),
        ("healthy", 0, BaselineSource.RECORDS, "HEALTHY at 1 % false-alarm rate (p = 1e-09); most likely: turns"),
    ],
)
def test_diagnosis_verdict(
    news: ChangeEvidence, kind: str, explanations: int, basis: BaselineSource, said: str
) -> None:
    alarm = kind in ("fault", "ambiguous")
    evidence = replace(news, explanations=news.explanations[:explanations], basis=basis, alarm=alarm, steady=False)
    left = SimpleNamespace(ratio=1.9, probability=1e-3)
    found: Any = SimpleNamespace(kind=kind, evidence=evidence, unexplained=left, level=0.01, undetermined=("turns.dR",))
    found.is_partial, found.detectable = True, {}
    found.coverage = Coverage(1, {"rms(u)": (1.0, 2.0)}, ())
    assert diagnosis.verdict(found).text.startswith(said)
    found.deviation, found.fitted, found.accuracy, found.mismatched = None, (), None, ("turns",)
    notes = [each.message.partition(".")[2] for each in diagnosis.diagnosis_notes(found)]
    expected = [*["CHECK"] * alarm, "COVERED", "MISMATCHED", *["PARTLY"] * alarm]
    assert notes == [*expected, *["NOT_TESTED"] * (basis is BaselineSource.RESULT), *["UNSTEADY"] * alarm]


@pytest.mark.parametrize(
    ("reached", "said"),
    [
        ((0.0, 0.0, 0.0), "has reached its limit 1 Ohm."),
        ((math.inf, math.inf, math.inf), "stays below its limit 1 Ohm."),
        ((math.inf, 9.0, math.inf), "does not reach its limit 1 Ohm at this rate (95 %: 9 s to never)."),
        ((12.0, 9.0, 20.0), "reaches its limit 1 Ohm in 12 s (95 %: 9 s to 20 s)."),
    ],
)
def test_trend_and_its_limit(reached: tuple[float, float, float], said: str) -> None:
    trend = Trend("turns.dR", 0.3, 0.01, 0.05, 0.01, 1.0, reached)
    rate, limit = monitoring.trend_remarks(trend, "Ohm")
    assert rate.text == "turns.dR changes by 0.050 ± 0.010 Ohm/s."
    assert limit.text == f"turns.dR {said}"


def monitor(*alarms: Alarm, windows: int) -> Any:
    """Return a monitor that has examined windows of 1 s of one record and raised these alarms."""
    table = pd.DataFrame({"record": "run", "end": [k + 1.0 for k in range(windows)], "statistic": 25.0, "alarm": ""})
    return SimpleNamespace(
        windows=windows,
        alarms=alarms,
        table=table,
        units={},
        faults={},
        baseline=SimpleNamespace(common={}),
        moment=lambda record, time: SimpleNamespace(record=record, time=time, date="2026-03-01T12:00:05+00:00"),
    )


def alarm(fault: str, first: int, last: int) -> Alarm:
    return Alarm(fault, "run", first + 1.0, first, last)


def test_an_alarm_is_told_when_it_is_raised_called_otherwise_and_ended() -> None:
    lines, told = AlarmLines("Rig", alarm_sentence), []
    for found in (
        monitor(windows=0),
        monitor(windows=1),
        monitor(alarm("turns", 1, 1), windows=2),
        monitor(alarm("turns", 1, 2), windows=3),  # goes on
        monitor(alarm("something else", 1, 3), windows=4),
        monitor(alarm("something else", 1, 3), windows=5),
        monitor(alarm("something else", 1, 3), windows=6),  # is over
        monitor(alarm("something else", 1, 3), alarm("bars", 6, 6), windows=8),  # begins and ends between two looks
    ):
        told += [json.loads(line) for line in lines.new(found)]
    assert [(each["id"], each["event"], each["fault"], each["time"]) for each in told] == [
        (1, "raised", "turns", 2.0),
        (1, "changed", "something else", 4.0),
        (1, "ended", "something else", 4.0),
        (2, "raised", "bars", 7.0),
        (2, "ended", "bars", 7.0),
    ]
    assert {each["study"] for each in told} == {"Rig"}
    assert "unexplained change" in told[1]["words"]


@pytest.mark.parametrize("terminal", [False, True])
def test_the_console_says_each_line_once(monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    out = io.StringIO()
    monkeypatch.setattr(following, "console", lambda: Console(file=out, width=100, force_terminal=terminal))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal, raising=False)
    found = monitor(alarm("turns", 1, 1), windows=2)
    with FollowingDisplay() as display:
        display(FollowStatus(found, (), tuple(AlarmLines("Rig", alarm_sentence).new(found)), idle=True))
        display(FollowStatus(monitor(windows=0), (), (), idle=True))
    said = Text.from_ansi(out.getvalue()).plain
    assert said.count("2026-03-01 12:00:05: alarm 1 raised: ALARM turns") == 1
    assert ("Ctrl-C: stop" in said) == terminal
