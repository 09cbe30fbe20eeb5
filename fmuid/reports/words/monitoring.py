"""What monitoring found, in a sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmuid.diagnosis import SOMETHING_ELSE
from fmuid.reports.words.diagnosis import size_words
from fmuid.text import listed

if TYPE_CHECKING:
    from fmuid.diagnosis import Gap, Monitor


def monitoring_words(found: Monitor) -> str:
    """Return what was found, in a sentence."""
    table, rule, alarms = found.table, found.rule, found.alarms
    if table.empty:
        return "No window has been examined."
    hits = int((table["significant"] != "").sum())
    counted = f"{hits} of {len(table)} windows are significant at a level of {100 * rule.level:g} %"
    if not alarms:
        if found.undetermined:
            return f"Whether there is a fault stays open: no window determines {listed(found.undetermined)}."
        return f"No alarm: {counted}, never {rule.needed} of {rule.among} in a row."
    first = alarms[0]
    at = f"from {first.time:g} s of {first.record} on"
    if first.fault == SOMETHING_ELSE:
        return f"Something else is wrong, {at}: the residual is larger than the noise; {counted}."
    sizes = listed([size_words(each, located=False) for each in found.standing_out(first)])
    return f"Fault: {first.fault}, {at}, {sizes} in the last window of it; {counted}."


def gap_words(gap: Gap) -> str:
    """Return which window is left out."""
    return f"{gap.source}: no sample counts from {gap.time:.9g} s on for a window"
