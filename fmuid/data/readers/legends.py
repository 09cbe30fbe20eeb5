"""Legends above and below a table: lines that begin with a column's name and say its unit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from fmuid.data.headers import is_unit
from fmuid.data.time_names import is_time_name

_NUMBERED = re.compile(r"^\d+[.)]\s+")
_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]+)[\])]")


def units_in_legend(lines: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """Return the units that lines such as ``# w [rpm]: speed`` or ``T2m: temperature (degC)`` say."""
    found: dict[str, str] = {}
    for line in lines:
        text = _NUMBERED.sub("", line.strip("#%;/*'\" \t\r\n"))
        for name in names:
            rest = text.removeprefix(name).lstrip()
            if name and rest != text and rest[:1] in tuple(":=[(-.") and not is_time_name(name):
                units = [each.strip() for each in _IN_BRACKETS.findall(rest)]
                if unit := next(filter(is_unit, units), ""):
                    found.setdefault(name, unit)
    return found
