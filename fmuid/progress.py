"""The search while it runs: a live table on a terminal, one line an iteration elsewhere."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from fmuid.console import console

if TYPE_CHECKING:
    from fmuid.estimators.marquardt import Iteration

# More parameters than these would push the first lines off the terminal.
LIVE_ROWS = 20
LINE_VALUES = 6
"""Values on a plain line; of more parameters only the first ones fit."""


class Progress:
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
        self._live = Live(console=console(), auto_refresh=False, transient=True) if sys.stdout.isatty() else None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, traceback)

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
