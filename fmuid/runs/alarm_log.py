"""The lines of ``alarms.jsonl``: when an alarm is raised, when it is called otherwise, when it has ended."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.codec import as_json

if TYPE_CHECKING:
    from fmuid.diagnosis import Alarm, Monitor

RAISED, CHANGED, ENDED = "raised", "changed", "ended"
"""What a line tells of an alarm."""


@dataclass
class AlarmLines:
    """Tells what is new of the alarms of a monitoring.

    Attributes
    ----------
    study : str
        Its title.
    say : callable
        Makes the sentence of a line, of the alarm and the units of its columns.
    count : int
        Of the alarms so far, the last of which has this number.
    first : int
        The row of the table with which the last one began, -1 before any.
    fault : str
        What it is called, "" once it has ended.
    """

    study: str
    say: Callable[[Alarm, Mapping[str, str]], str]
    count: int = 0
    first: int = -1
    fault: str = ""

    @property
    def state(self) -> dict[str, Any]:
        """What another run needs to go on."""
        return {"study": self.study, "count": self.count, "first": self.first, "fault": self.fault}

    def new(self, monitor: Monitor) -> list[str]:
        """Return the lines that are new, after windows were examined."""
        return [json.dumps(as_json(each), ensure_ascii=False) for each in self._new(monitor)]

    def _new(self, monitor: Monitor) -> Iterator[Mapping[str, Any]]:
        if not monitor.windows:
            return
        for alarm in monitor.alarms:
            goes_on = alarm.last == monitor.windows - 1
            if alarm.first > self.first:
                self.count, self.first, self.fault = self.count + 1, alarm.first, alarm.fault
                yield self._line(RAISED, monitor, alarm)
            elif alarm.first == self.first and self.fault and alarm.fault != self.fault:
                self.fault = alarm.fault
                yield self._line(CHANGED, monitor, alarm)
            if alarm.first == self.first and self.fault and not goes_on:
                self.fault = ""
                yield self._line(ENDED, monitor, alarm)

    def _line(self, event: str, monitor: Monitor, alarm: Alarm) -> Mapping[str, Any]:
        table, row = monitor.table, alarm.first if event == RAISED else alarm.last
        end, statistic = (table[name].to_numpy(np.float64)[row - table.index[0]] for name in ("end", "statistic"))
        at = monitor.moment(str(table["record"][row]), float(end))
        return {
            "id": self.count,
            "event": event,
            "fault": alarm.fault,
            "record": at.record,
            "time": at.time,
            "date": at.date,
            "statistic": float(statistic),
            "explanations": [
                {
                    "odds": each.odds,
                    "changes": [
                        {
                            "name": change.label,
                            "kind": change.kind,
                            "value": change.value,
                            "std": change.std,
                            "interval": change.interval(),
                            "unit": change.unit,
                        }
                        for change in each.changes
                    ],
                }
                for each in alarm.explanations
            ],
            "onset": alarm.onset,
            "trend": alarm.trend,
            "words": self.say(alarm, monitor.units),
            "study": self.study,
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
        }
