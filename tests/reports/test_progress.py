"""Progress on standard error: live on a terminal, lines with --verbose, else nothing."""

import math
import sys

import pytest

from fmuid.events import Event, FaultStep, GlobalStep, MapStep, ProfileStep, SamplingStep, SearchStep, WindowStep
from fmuid.reports.render.console import Screen, showing
from fmuid.reports.render.progress import Display

STEP = SearchStep(number=3, cost=12.5, damping=0.1, accepted=True, values={"R": 4.25, "L": 0.1})
SAMPLING = SamplingStep(step=50, steps=1000, effective_size=math.nan, wanted=200, acceptance=0.3)
EVENTS = [
    (STEP, "iteration 3              cost 12.5         damping 0.1                 R 4.25  L 0.1"),
    (
        GlobalStep(task="fits", done=1, total=4, cost=2.0, values={"R": 4.0}, simulations=30),
        "fits        25 %  1 of 4, 30 simulations, best: R 4",
    ),
    (MapStep(share=0.5, first="R", second="L"), "map         50 %  cost over R and L"),
    (
        ProfileStep(share=0.0, name="R", value=4.5, rise=1.0, threshold=3.84),
        "profile      0 %  R = 4.5: cost + 1 of 3.84",
    ),
    (SAMPLING, "posterior    5 %  step 50"),
    (FaultStep(share=0.0, fault=None), ""),
    (WindowStep(record="run1", number=0, total=3), ""),
    (Event(task="uncertainty", share=0.0), ""),
]


@pytest.mark.parametrize("verbose", [True, False])
def test_lines(verbose: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with showing(Screen(verbose=verbose)), Display() as display:
        for event, _ in EVENTS:
            display(event)
        for k in range(1000):
            display(MapStep(share=k / 1000, first="R", second="L"))
    out, error = capsys.readouterr()
    lines = error.splitlines()
    assert out == ""
    assert lines[:5] == ([line for _, line in EVENTS if line] if verbose else [])
    assert len(lines) == (15 if verbose else 0)  # of long work one for each tenth


@pytest.mark.parametrize("quiet", [True, False])
def test_terminal_is_cleared(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quiet: bool) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with showing(Screen(quiet=quiet)), Display() as display:
        for event, _ in EVENTS:
            display(event)
        display.pause()
        print("other words")
        display(STEP)
    out, error = capsys.readouterr()
    assert out == "other words\n"
    assert bool(error) != quiet
    assert not any(line and f"{line}\n" in error for _, line in EVENTS[2:])
