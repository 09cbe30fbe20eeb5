"""Names of time columns."""

from __future__ import annotations

import re

from fmuid.units import SECONDS

TIME_NAMES = (
    "time", "t", "zeit", "timestamp", "timestamps", "time stamp", "zeitstempel", "datetime", "uhrzeit", "heure",
    "hora", "date", "date/time", "date time", "datum", "datum/zeit", "datum zeit", "temps", "tiempo", "tempo", "tijd",
    "tid", "czas", "čas", "zaman", "время", "時間", "时间", "時刻", "elapsed time", "relative time", "rel. time",
    "test time", "seconds", "second", "sekunden", "x value", "x-axis", "zeitachse", "elapsed", "utc", "ts", "tout",
    "date&time", "date & time", "date and time", "run time", "total time", "cumulative time", "testtime", "uts",
    "stamp", "timestring", "uptime", "ticks", "aika", "last changed", "last updated",
    "zeitpunkt", "laufzeit", "messzeit", "testzeit", "dauer", "시간", "ora", "godzina", "saat",
    "測定時間", "経過時間", "日時", "测试时间", "记录时间", "总时间", "日期",
)  # fmt: skip
"""What tables call their time, in small letters, in the order of preference."""

_OF_PARTS = {"step", "cycle", "cyc", "schritt", "load", "set", "half", "duration", "minutes"}
"""Words beside time that count from the begin of a part."""
_DECORATED = re.compile(r"^[%~#\s]+|\s*\([^()]*\)$|, (gmt|utc)\S*$")
_TIME_WORDS = (
    "time",
    "t",
    "zeit",
    "timestamp",
    "datetime",
    "temps",
    "tiempo",
    "tempo",
    "zeitstempel",
    "clock",
    "ts",
    "secs",
    "epoch",
    "время",
)
_UNIT_WORDS = {
    **{each: each for each in SECONDS if len(each) > 1 and each not in ("day", "days", "tage")},
    **dict.fromkeys(("millis", "msecs", "millisec"), "ms"),
    **dict.fromkeys(("micros", "usecs", "microsec"), "us"),
    **dict.fromkeys(("nanos", "nsecs", "nanosec"), "ns"),
}
_BESIDE_UNITS = {
    "time", "t", "zeit", "elapsed", "since", "start", "begin", "total", "run", "test", "clock", "timestamp",
}  # fmt: skip
"""Words beside a unit in names of times: ``elapsedMillis``, ``seconds_since_start``."""


def _words(name: str) -> list[str]:
    """Return the words of a name: ``ObservationTime``, ``t_slow``."""
    return re.findall(r"[^\W\d_]+", re.sub(r"(?<=[^\W\d_A-Z])(?=[A-Z])", " ", name))


def unit_in_time_name(name: str) -> str | None:
    """Return the unit among the words of a time's name: ``TimeMs``, ``Time:ms``, ``millis``."""
    return next((_UNIT_WORDS[word] for word in map(str.lower, reversed(_words(name))) if word in _UNIT_WORDS), None)


def is_unit_of_time(name: str) -> bool:
    """Return whether a name is a unit of time; ``Min`` is no minute."""
    words = {*map(str.lower, _words(name))}
    units = words & _UNIT_WORDS.keys()
    return words != {"min"} and len(units) == 1 and words - units <= _BESIDE_UNITS


def plain_name(name: str) -> str:
    """Return a name in small letters without marks and remarks."""
    return _DECORATED.sub("", name.lower().replace("_", " ")).strip() or name.strip().lower()


def counts_part(name: str) -> bool:
    """Return whether a name is one of times that begin again: ``step time``, ``StepTime``."""
    return not _OF_PARTS.isdisjoint(re.findall(r"[^\W\d_]+", name.replace("Time", " ").lower()))


def is_time_name(name: str) -> bool:
    """Return whether a name is one of time, perhaps with an addition: ``t_slow``, ``Time 2``, ``u time``."""
    words = _words(_DECORATED.sub("", name)) or _words(name)
    if not words or "T" in (words[0], words[-1]):  # a temperature
        return False
    if counts_part(name):
        return False
    return plain_name(name) in TIME_NAMES or any(word.lower() in _TIME_WORDS for word in (words[0], words[-1]))
