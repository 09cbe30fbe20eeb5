"""Display of a monitoring that follows a folder."""

from __future__ import annotations

import json
import math
import sys
import time
from contextlib import AbstractContextManager

from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from fmuid.diagnosis import SkippedWindow
from fmuid.formatting import unit_text, with_std
from fmuid.reports.document import Remark
from fmuid.reports.render.console import console, show_remarks
from fmuid.reports.topics.monitoring import alarm_words, gap_remarks
from fmuid.runs import FollowStatus

SILENT_SECONDS = 5.0  # silence of the recordings that is displayed
COLORS = {"raised": "bold red", "changed": "red", "ended": "green"}


class FollowingDisplay(AbstractContextManager["FollowingDisplay"]):
    """Display of a monitoring that follows a folder."""

    def __init__(self) -> None:
        self._console = console()
        live = Live(console=self._console, refresh_per_second=4, transient=True)
        self._live = live if sys.stdout.isatty() else None
        self._windows, self._since = -1, 0.0

    def __exit__(self, *_ended: object) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, watching: FollowStatus) -> None:
        """Print new alarms and remarks; update the display."""
        for line in watching.lines:
            said = json.loads(line)
            when = said["date"][:19].replace("T", " ") or f"{said['time']:.6g} s of {said['record']}"
            text = f"{when}: alarm {said['id']} {said['event']}: {said['words']}"
            self._console.print(f"[{COLORS[said['event']]}]{escape(text)}[/]", soft_wrap=True)
        gaps = [each for each in watching.remarks if isinstance(each, SkippedWindow)]
        show_remarks(Remark(each, "doubt") for each in watching.remarks if isinstance(each, str))
        show_remarks(gap_remarks(gaps))
        if self._live is None:
            sys.stdout.flush()
        else:
            if watching.monitor.windows != self._windows:
                self._windows, self._since = watching.monitor.windows, time.monotonic()
            silent = time.monotonic() - self._since
            self._live.start()
            hint = Text("Ctrl-C: stop; the same command resumes", style="dim")
            self._live.update(Group(state(watching, silent), hint))


def state(watching: FollowStatus, silent: float) -> Table:
    """Return the last window, its alarm and the sizes."""
    found = watching.monitor
    table = Table.grid(padding=(0, 3))
    if not found.windows:
        table.add_row("waiting for data")
        return table
    row = found.table.iloc[-1]
    at = found.moment(str(row["record"]), float(row["end"]))
    when = f"{row['record']}, {row['end']:.6g} s" + (f", {at.date[:19].replace('T', ' ')}" if at.date else "")
    table.add_row("evaluated", f"{found.windows} windows, up to {escape(when)}{'' if watching.idle else ' ...'}")
    if watching.idle and silent >= SILENT_SECONDS:
        table.add_row("", f"[yellow]no new window for {silent:.0f} s[/]")
    table.add_row("now", f"[bold red]ALARM: {escape(row['alarm'])}[/]" if row["alarm"] else "[green]no alarm[/]")
    if row["alarm"] and found.alarms[-1].onset is not None:
        onset, sizes = alarm_words(found.alarms[-1])
        table.add_row("onset", escape(onset))
        table.add_row("current size", escape(sizes))
    table.add_row("last window", "")
    columns = [f"{name}.{size}" for name, fault in found.faults.items() for size in fault.sizes]
    for name in [*columns, *found.baseline.common]:
        std = float(row[f"{name}.std"])
        size = with_std(float(row[name]), std) if math.isfinite(std) else "unknown"
        table.add_row(escape(f"  {name}"), f"{size} {escape(unit_text(found.units.get(name)))}")
    return table
