"""What runs shows how far it is: live on a terminal; elsewhere a line an iteration, or a line a tenth of long work."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from fmuid.reports.console.layout import console

if TYPE_CHECKING:
    from fmuid.assessment import Step
    from fmuid.batches import BatchStep
    from fmuid.estimation import GlobalStep, Iteration

# More parameters than these would push the first lines off the terminal.
LIVE_ROWS = 20
LINE_VALUES = 6
"""Values on a plain line; of more parameters only the first ones fit."""


class _Shown:
    """A context with a live display on a terminal, and none elsewhere."""

    def __init__(self, live: Callable[[], Live]) -> None:
        self._live = live() if sys.stdout.isatty() else None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, traceback)


class Progress(_Shown):
    """Shows the iterations of a search; used as a context and called with each iteration.

    Parameters
    ----------
    names : sequence of str
        The parameters.
    start : (N,) array
        Their starts.
    """

    def __init__(self, names: Sequence[str], start: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
        self._names, self._start = tuple(names), start
        self._best: Iteration | None = None
        super().__init__(lambda: Live(console=console(), auto_refresh=False, transient=True))

    def __call__(self, iteration: Iteration) -> None:
        """Show one iteration."""
        if iteration.accepted:
            self._best = iteration
        if self._live is None:
            print(self._line(iteration), flush=True)
        else:
            self._live.update(Group(Text(self._head(iteration)), self._table()), refresh=True)

    def _head(self, iteration: Iteration) -> str:
        renewed = math.isnan(iteration.damping) and iteration.number > 0
        what = "noise variances renewed" if renewed else f"iteration {iteration.number}"
        damping = "" if math.isnan(iteration.damping) else f"{iteration.damping:.3g}"
        fate = "" if iteration.accepted else "rejected"
        return f"{what:<23}  criterion {iteration.criterion:<11.6g}  λ {damping:<9} {fate:<8}"

    def _line(self, iteration: Iteration) -> str:
        pairs = list(zip(self._names, iteration.theta, strict=True))
        values = "  ".join(f"{name} {value:.5g}" for name, value in pairs[:LINE_VALUES])
        return f"{self._head(iteration)}  {values}{'  ...' if len(pairs) > LINE_VALUES else ''}"

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 3))
        best = self._best.theta if self._best is not None else self._start
        for name, start, value in list(zip(self._names, self._start, best, strict=True))[:LIVE_ROWS]:
            table.add_row(f"  {escape(name)}", f"{value:.6g}", f"[dim]start {start:.6g}[/]")
        if len(self._names) > LIVE_ROWS:
            table.add_row(f"  [dim]and {len(self._names) - LIVE_ROWS} more[/]")
        return table


class Work(_Shown):
    """Shows how far long work is, and that it may be interrupted; used as a context.

    Parameters
    ----------
    names : sequence of str
        The parameters.
    """

    # Off a terminal, a line each time so many of these parts of a task are done.
    PARTS = 10

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._said: tuple[str, int] | None = None
        super().__init__(lambda: Live(console=console(), refresh_per_second=8, transient=True))

    def __call__(self, step: Step) -> None:
        """Show how far a task is."""
        if self._live is not None:
            bar = Table.grid(padding=(0, 2))
            bar.add_row(step.task, ProgressBar(1.0, step.share, width=30), escape(step.text))
            self._live.update(Group(bar, Text("Ctrl-C ends it and keeps what there is", style="dim")))
            return
        part = int(step.share * self.PARTS)
        if self._said != (step.task, part):
            self._said = (step.task, part)
            print(f"{step.task:<10} {100 * step.share:3.0f} %  {step.text}", flush=True)

    def searched(self, step: GlobalStep) -> None:
        """Show how far a global search is."""
        from fmuid.assessment import Step

        values = "  ".join(
            f"{name} {value:.5g}" for name, value in list(zip(self._names, step.theta, strict=True))[:LINE_VALUES]
        )
        text = f"{step.done} of {step.total}, {step.simulations} simulations, best: {values}"
        self(Step(step.phase, text, step.done / step.total))


class BatchProgress(_Shown):
    """Shows how far a batch is; used as a context and called with each `BatchStep`."""

    # Off a terminal, a line so often, s.
    EVERY = 10.0

    def __init__(self) -> None:
        self._next = time.monotonic() + self.EVERY
        super().__init__(lambda: Live(console=console(), refresh_per_second=4, transient=True))

    def __call__(self, step: BatchStep) -> None:
        """Show how far the batch is."""
        if self._live is not None:
            bar = Table.grid(padding=(0, 2))
            bar.add_row(ProgressBar(step.total, step.done, width=30), self._text(step))
            words = "Ctrl-C ends it and keeps what there is; the same command goes on"
            self._live.update(Group(bar, Text(words, style="dim")))
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + self.EVERY
            print(self._text(step), flush=True)

    @staticmethod
    def _text(step: BatchStep) -> str:
        words = [f"{step.done} of {step.total} cases"]
        words += [f"{step.failed} failed"] if step.failed else []
        if step.done < step.total:
            if not step.threads:
                words.append("waiting for workers")
            elif math.isfinite(step.left):
                left = timedelta(seconds=math.ceil(step.left)) if step.left < timedelta.max.total_seconds() else "ages"
                words.append(f"{step.rate:.3g} a second, {left} left")
        return ", ".join(words)
