"""How far work is, as it is shown: live on a terminal, in lines elsewhere."""

from __future__ import annotations

import math
import sys

import pytest

from fmuid.events import Event, FaultStep, GlobalStep, MapStep, ProfileStep, SamplingStep, SearchStep, WindowStep
from fmuid.reports.render.progress import Display

STEP = SearchStep(number=3, criterion=12.5, damping=0.1, accepted=True, values={"R": 4.25, "L": 0.1})
EVENTS = [
    (STEP, "iteration 3              criterion 12.5         λ 0.1                 R 4.25  L 0.1"),
    (
        GlobalStep(task="fits", done=1, total=4, criterion=2.0, values={"R": 4.0}, simulations=30),
        "fits        25 %  1 of 4, 30 simulations, best: R 4",
    ),
    (MapStep(share=0.5, first="R", second="L"), "map         50 %  criterion over R and L"),
    (
        ProfileStep(share=0.0, name="R", value=4.5, rise=1.0, threshold=3.84),
        "profile      0 %  R = 4.5: criterion risen by 1 of 3.84",
    ),
    (
        SamplingStep(step=50, steps=1000, effective_size=math.nan, wanted=200, acceptance=0.3),
        "posterior    5 %  step 50",
    ),
    (
        SamplingStep(step=50, steps=1000, effective_size=150.0, wanted=200, acceptance=0.3),
        "posterior   75 %  step 50, worth 150 of 200 independent samples",
    ),
    (FaultStep(share=0.0, fault=None), ""),
    (WindowStep(record="run1", number=0, total=3), ""),
    (Event(task="uncertainty", share=0.0), ""),
]


@pytest.mark.parametrize(("event", "line"), EVENTS)
def test_lines(event: Event, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with Display() as display:
        display(event)
    assert capsys.readouterr().out == (f"{line}\n" if line else "")


def test_long_work_has_a_line_a_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    with Display() as display:
        for k in range(1000):
            display(MapStep(share=k / 1000, first="R", second="L"))
    assert len(capsys.readouterr().out.splitlines()) == 10


def test_a_terminal_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Every event can be drawn, nothing is printed as lines, and the display can pause for other words."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with Display() as display:
        for event, _ in EVENTS:
            display(event)
        display.pause()
        print("other words")
        display(STEP)
    out = capsys.readouterr().out
    assert "other words" in out
    assert out.count(EVENTS[2][1]) == 0
