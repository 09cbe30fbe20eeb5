"""What `fmuid monitor` prints: the verdict, the alarms, what was found in the mean, and how often an alarm is false."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape

from fmuid.reports.console.layout import TERMINAL_ROWS, console, table_of, unit_text
from fmuid.reports.words.monitoring import gap_words, monitoring_words
from fmuid.text import rounded, with_std

if TYPE_CHECKING:
    from fmuid.diagnosis import Monitor


def show_monitoring(found: Monitor) -> None:
    """Print the verdict, the alarms, the last window, the rate of false alarms, and the notes."""
    out = console()
    out.print()
    colour = "red" if found.alarms else "yellow" if found.undetermined else "green"
    out.print(f"[bold {colour}]{escape(monitoring_words(found))}[/]", soft_wrap=True)
    out.print()
    if found.alarms:
        _show_alarms(found)
    _show_parameters(found)
    independent, limit = found.false_alarm_rates()
    rule = found.rule
    said = f"at most {100 * limit:.2g} %"
    if not math.isnan(independent):
        said = f"{100 * independent:.2g} % over all healthy records, {said} whatever the windows share"
    out.print(
        f"False alarms, {rule.needed} of {rule.among} windows at {100 * rule.level:g} %: a window of a healthy machine "
        f"is in alarm with a probability of {said}",
        soft_wrap=True,
    )
    for gap in found.gaps:
        out.print(f"[yellow]note:[/] {escape(gap_words(gap))}", soft_wrap=True)


def _show_alarms(found: Monitor) -> None:
    numbers = ("from (s)", "to (s)", "windows")
    table = table_of("Alarms", ["fault", "record", *numbers], right=numbers)
    ends, records = found.table["end"].tolist(), found.table["record"].tolist()
    for alarm in found.alarms[:TERMINAL_ROWS]:
        until = f"{ends[alarm.last]:g}" + ("" if records[alarm.last] == alarm.record else f" of {records[alarm.last]}")
        cells = (alarm.fault, alarm.record, f"{alarm.time:g}", until, str(alarm.last - alarm.first + 1))
        table.add_row(*(escape(cell) for cell in cells))
    console().print(table)
    console().print()


def _show_parameters(found: Monitor) -> None:
    """Print each parameter in the first and in the last window, and what it was in between."""
    numbers = ("first", "least", "greatest")
    table = table_of("Windows", ["fault", "parameter", *numbers, "last", "unit"], right=numbers)
    frame = found.table
    for model in found.models:
        for name in (*model.fault.sizes, *model.names[: model.first]):
            values, std = frame[f"{model.name}.{name}"], frame[f"{model.name}.{name}.std"].tolist()
            cells = [rounded(float(each), std[-1]) for each in (values.iloc[0], values.min(), values.max())]
            last = with_std(float(values.iloc[-1]), std[-1]) if math.isfinite(std[-1]) else "not determined"
            first = model.name if name == model.fault.sizes[0] else ""
            table.add_row(*(escape(each) for each in (first, name, *cells, last, unit_text(model.system.unit(name)))))
    console().print(table)
    console().print()
