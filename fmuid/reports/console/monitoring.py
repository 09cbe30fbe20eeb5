"""What `fmuid monitor` prints: the verdict, the alarms, and what was found in the windows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape

from fmuid.formatting import rounded, unit_text, with_std
from fmuid.reports.console.layout import TERMINAL_ROWS, console, show_remarks, table_of_rows
from fmuid.reports.messages.diagnosis import basis_notes
from fmuid.reports.messages.monitoring import alarm_words, gap_words, monitoring_words

if TYPE_CHECKING:
    from fmuid.runs import MonitoringRun


def show_monitoring(found: MonitoringRun) -> None:
    """Print the verdict, the alarms, the last window, and the notes."""
    out = console()
    out.print()
    colour = "red" if found.alarms else "yellow" if found.undetermined else "green"
    out.print(f"[bold {colour}]{escape(monitoring_words(found))}[/]", soft_wrap=True)
    out.print()
    if found.alarms:
        _show_alarms(found)
    _show_parameters(found)
    show_remarks([*basis_notes(found.basis), *gap_words(found.gaps)])


def _show_alarms(found: MonitoringRun) -> None:
    numbers = ("alarm (s)", "to (s)", "windows")
    windows, rows = found.table, []
    for alarm in found.alarms[:TERMINAL_ROWS]:
        last = windows.loc[alarm.last]
        until = f"{last['end']:g}" + ("" if last["record"] == alarm.record else f" of {last['record']}")
        count = str(alarm.last - alarm.first + 1)
        rows.append((alarm.fault, *alarm_words(alarm), alarm.record, f"{alarm.time:g}", until, count))
    console().print(table_of_rows("Alarms", ("what", "since", "size", "record", *numbers), rows, numbers))
    console().print()


def _show_parameters(found: MonitoringRun) -> None:
    """Print each parameter in the first and in the last window, and what it was in between."""
    numbers = ("first", "least", "greatest")
    frame, rows = found.table, []
    columns = [(name, size) for name, sizes in found.sizes.items() for size in sizes]
    columns += [("", name) for name in found.common]
    before = ""
    for fault, name in columns:
        values, std = frame[name], frame[f"{name}.std"].tolist()
        cells = [rounded(float(each), std[-1]) for each in (values.iloc[0], values.min(), values.max())]
        last = with_std(float(values.iloc[-1]), std[-1]) if math.isfinite(std[-1]) else "not determined"
        said = (fault if fault != before else "", name.removeprefix(f"{fault}."))
        rows.append((*said, *cells, last, unit_text(found.units.get(name))))
        before = fault
    console().print(table_of_rows("Windows", ("fault", "parameter", *numbers, "last", "unit"), rows, numbers))
    console().print()
