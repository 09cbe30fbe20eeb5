"""Progress of long work on standard error: live on a terminal, elsewhere as lines with ``--verbose``."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from fmuid.events import (
    EVENTS,
    BatchStep,
    Event,
    FaultStep,
    GlobalStep,
    MapStep,
    ProfileStep,
    SamplingStep,
    SearchStep,
    WindowStep,
    to_line,
)
from fmuid.reports.render.console import screen

LINE_VALUES = 6  # values on a line; of more parameters only the first ones fit
KEEPS = "Ctrl-C: stop and keep the results so far"


class Display(contextlib.AbstractContextManager["Display"]):
    """Progress display: a context, called with each event."""

    PARTS = 10  # lines of a task without a terminal
    EVERY = 10.0  # seconds between lines of a batch without a terminal

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty() and not screen().quiet
        self._live: Live | None = None
        self._best: Mapping[str, float] = {}
        self._said: tuple[str, int] | None = None
        self._next = time.monotonic() + self.EVERY
        self._told = os.environ.get(EVENTS)

    def __exit__(self, *_ended: object) -> None:
        self.pause()

    def pause(self) -> None:
        """Remove the live display until the next event."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def __call__(self, event: Event, /) -> None:
        """Show an event."""
        if self._told:
            with contextlib.suppress(OSError), Path(self._told).open("a", encoding="utf-8") as file:
                file.write(to_line(event))  # a full disk ends no search
        if isinstance(event, SearchStep):
            self._best = event.values if event.accepted else self._best
        if not self._terminal:
            if screen().verbose and self._due(event):
                print(_line(event), file=sys.stderr, flush=True)
            return
        if self._live is None:
            self._live = Live(console=Console(stderr=True, highlight=False), refresh_per_second=8, transient=True)
            self._live.start()
        self._live.update(self._drawn(event), refresh=isinstance(event, SearchStep))

    def _due(self, event: Event) -> bool:
        """Return whether an event is worth a line."""
        if isinstance(event, BatchStep):
            if time.monotonic() < self._next:
                return False
            self._next = time.monotonic() + self.EVERY
        elif isinstance(event, GlobalStep | MapStep | ProfileStep | SamplingStep):
            part = int(event.share * self.PARTS)
            if self._said == (event.task, part):
                return False
            self._said = (event.task, part)
        return isinstance(event, SearchStep | GlobalStep | MapStep | ProfileStep | SamplingStep | BatchStep)

    def _drawn(self, event: Event) -> RenderableType:
        if isinstance(event, SearchStep):
            return Text(_line(replace(event, values=self._best)), no_wrap=True, overflow="ellipsis")
        bar = Table.grid(padding=(0, 2))
        if isinstance(event, BatchStep):
            bar.add_row(ProgressBar(event.total, event.done, width=30), event_words(event))
            return Group(bar, Text(f"{KEEPS}; the same command resumes", style="dim"))
        if math.isnan(event.share) or isinstance(event, FaultStep | WindowStep):
            return Spinner("dots", escape(event_words(event)))
        bar.add_row(event.task, ProgressBar(1.0, event.share, width=30), escape(event_words(event)))
        return Group(bar, Text(KEEPS, style="dim"))


def _line(event: Event) -> str:
    if isinstance(event, SearchStep):
        more = "  ..." if len(event.values) > LINE_VALUES else ""
        return f"{_head(event)}  {_listed(event.values)}{more}"
    if isinstance(event, BatchStep):
        return event_words(event)
    return f"{event.task:<10} {100 * event.share:3.0f} %  {event_words(event)}"


def _head(step: SearchStep) -> str:
    renewed = math.isnan(step.damping) and step.number > 0
    what = "noise variances updated" if renewed else f"iteration {step.number}"
    damping = "" if math.isnan(step.damping) else f"{step.damping:.3g}"
    fate = "" if step.accepted else "rejected"
    return f"{what:<23}  cost {step.cost:<11.6g}  damping {damping:<9} {fate:<8}"


def _listed(values: Mapping[str, float]) -> str:
    return "  ".join(f"{name} {value:.5g}" for name, value in list(values.items())[:LINE_VALUES])


def event_words(event: Event) -> str:
    """Return the state of a task as text."""
    match event:
        case GlobalStep():
            best = _listed(event.values)
            return f"{event.done} of {event.total}, {event.simulations} simulations, best: {best}"
        case MapStep():
            return f"cost over {event.first} and {event.second}"
        case ProfileStep():
            rise = f"cost + {event.rise:.3g} of {event.threshold:.3g}"
            return f"{event.name} = {event.value:.6g}: {rise}"
        case SamplingStep() if not math.isnan(event.effective_size):
            return f"step {event.step}, {event.effective_size:.0f} of {event.wanted} independent samples"
        case SamplingStep():
            return f"step {event.step}"
        case FaultStep():
            return f"fit of {event.fault or 'the healthy machine'}"
        case WindowStep():
            return f"{event.record}: window {event.number + 1} of {event.total}"
        case BatchStep():
            return _batch(event)
        case _:
            return event.task


def _batch(step: BatchStep) -> str:
    words = [f"{step.done} of {step.total} cases"]
    words += [f"{step.failed} failed"] if step.failed else []
    if step.done < step.total:
        if not step.threads:
            words.append("waiting for workers")
        elif math.isfinite(step.left):
            left = timedelta(seconds=math.ceil(step.left)) if step.left < timedelta.max.total_seconds() else "ages"
            words.append(f"{step.rate:.3g} a second, {left} left")
    return ", ".join(words)
