"""Lines of alarms, and what the console shows of them: each said once, when it is new."""

from __future__ import annotations

import io
import json
import sys
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from rich.console import Console
from rich.text import Text

from fmuid.diagnosis import Alarm
from fmuid.reports.render import following
from fmuid.reports.render.following import FollowingDisplay
from fmuid.reports.topics.monitoring import alarm_sentence
from fmuid.runs.follow import AlarmLines, FollowStatus


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
