"""Numbers that lines above a header say: time between samples, and how many there are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import takewhile

from fmuid.data.cells import Cell, is_number
from fmuid.units import SECONDS, time_unit

_STEP_KEY = re.compile(
    r"h ?resolution|delta ?[xt]|d[xt]|(wf|x|time|horizontal) ?(interval|increment|step)|interval|increment"
    r"|(sampl(e|ing)|scan) ?(interval|period|time|step|increment)|((data )?log(ging)?|recording|acquisition) interval"
    r"|abtast(intervall|zeit)|messintervall|采样(间隔|周期)"
)
_RATE_KEY = re.compile(
    r"(data )?(sampl(e|ing)|scan|acquisition|recording|logging)s? ?(rate|freq(uency)?)|rate|fs|abtast(rate|frequenz)"
    r"|采样(率|频率)|サンプリング周波数"
)
_COUNT_KEY = re.compile(
    r"block ?size|(wf )?samples|samples? (count|number)|record length|size|data (length|points)"
    r"|(number|no\.?)( of)? (samples|points|data( points)?|rows)"
)
_HERTZ = {"": 1.0, "Hz": 1.0, "hz": 1.0, "kHz": 1e3, "MHz": 1e6, "Sa/s": 1.0, "S/s": 1.0, "kS/s": 1e3, "MS/s": 1e6}
_VALUE = re.compile(
    r"\s*(?:[\[(]\s*(?P<inside>[^\[\]()]*)[\])])?\s*[:=]*\s*"
    r"(?P<number>\+?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?)\s*(?P<unit>[^\W\d]*(/s)?)(?=\s|$|;)"
)


def _said(rows: Sequence[Sequence[Cell]], key: re.Pattern[str], decimal: str) -> Iterator[tuple[float, str]]:
    """Yield number and unit of a key in lines above a header: ``Rate,100``, ``# Rate: 100 Hz``, ``Rate [kHz];1``."""
    for row in rows:
        line = " ".join(map(str, row)).replace("_", " ").replace('"', "").strip("#%/ ")
        named_by = key.match(line.lower())
        line = line.replace(decimal, ".")
        found = _VALUE.match(line, named_by.end()) if named_by else None
        others = takewhile(is_number, line[found.end() :].split()) if found else ()
        if found is not None and all(float(each) == float(found["number"]) for each in others):  # else of each channel
            yield float(found["number"]), found["unit"] or found["inside"] or ""


def rows_said(rows: Sequence[Sequence[Cell]]) -> int | None:
    """Return the number of samples that lines above the header say."""
    return next((int(number) for number, unit in _said(rows, _COUNT_KEY, ".") if not unit and number % 1 == 0), None)


def step_said(rows: Sequence[Sequence[Cell]], decimal: str) -> float | None:
    """Return the time between samples that lines above the header say, s."""
    steps = [
        number * SECONDS[time_unit(unit) or "s"]
        for number, unit in _said(rows, _STEP_KEY, decimal)
        if not unit or time_unit(unit)
    ]
    steps += [
        1.0 / (number * _HERTZ[unit])
        for number, unit in _said(rows, _RATE_KEY, decimal)
        if unit in _HERTZ and number > 0.0
    ]
    return next((step for step in steps if step > 0.0), None)


def interval_of(text: str) -> float | None:
    """Return a positive time such as ``10.0mS`` in s; None if it is none."""
    found = _VALUE.fullmatch(text)
    unit = None if found is None else time_unit(found["unit"] or "s")
    return None if found is None or unit is None else float(found["number"]) * SECONDS[unit] or None
