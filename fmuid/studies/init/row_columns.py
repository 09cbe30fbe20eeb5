"""Columns of tables without a time: supply and outputs of a machine, frequency and responses."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from fmuid.data import RESPONSE_FORMS
from fmuid.studies.init.column_matching import ColumnMatch, MatchReason, of_tables
from fmuid.units import parse_unit

if TYPE_CHECKING:
    from fmuid.models import Description

# Usual columns of each quantity, in English and German.
_SUPPLY = {
    "frequency": "f freq frequency frequenz hz",
    "voltage": "u us u1 v vs v1 uph vph voltage spannung",
    "line_voltage": "ull vll uline vline linevoltage",
    "slip": "s slip schlupf",
    "speed": "n speed drehzahl",
}
_FORMULAS = {
    "I_rms": "i is i1 irms current strom",
    "P": "p p1 pin power leistung",
    "Q": "q q1 reactivepower blindleistung",
    "S": "s1 sin apparentpower scheinleistung",
    "cos_phi": "cosphi cos pf powerfactor leistungsfaktor",
    "torque": "t m torque drehmoment",
    "efficiency": "eta efficiency wirkungsgrad",
}
_PARTS = {
    "real": "real re",
    "imaginary": "imaginary imag im",
    "magnitude": "magnitude mag abs gain mod modulus betrag",
    "decibel": "decibel db",
    "phase": "phase phi arg angle winkel phz",
}
_WORDS = "|".join(" ".join(_PARTS.values()).split())
_PART = tuple(
    re.compile(text)
    for text in (
        rf"(?P<name>\w{{0,3}}?|.*?[\W_])(?i:(?P<part>{_WORDS}))\)?",  # Zd_re, Zreal
        rf"(?i:(?P<part>{_WORDS}))[\s_(]*(?P<name>[A-Z]\w*)\)?",  # Re(Z), ReZ
        r"(?P<name>\w+)(?P<part>'{1,2})(\(\w\))?",  # Z', Z''
        r"(?P<name>)(?P<part>Rs?|Xs?)",
    )
)
_MARKS = {"'": "real", "''": "imaginary", "R": "real", "Rs": "real", "X": "imaginary", "Xs": "imaginary"}
_BARS = re.compile(r"\|(.+)\|")
SUPPLY_FREQUENCY = 50.0  # Hz, of a supply without a column
UNNAMED = "Z"  # response whose columns have no name of their own


def supply_columns(columns: Iterable[str]) -> Iterator[ColumnMatch]:
    """Yield the columns of a machine's supply and outputs."""
    plain = {column: _word(column) for column in columns}
    for role, known in (("frame", _SUPPLY), ("output", _FORMULAS)):
        for name, words in known.items():
            found = next((column for column, word in plain.items() if word in words.split()), None)
            if found is not None:
                yield ColumnMatch(name, role, found, MatchReason.QUANTITY)


def response_columns(columns: Sequence[str], units: Mapping[str, str]) -> Iterator[ColumnMatch]:
    """Yield the columns of frequency and responses, each in one form."""
    first = next((each for each in columns if _is_frequency(each, units.get(each))), None)
    if first is not None:
        unit = units.get(first) or ("rad/s" if _is_angular(first) else None)
        yield ColumnMatch("frequency", "frame", first, MatchReason.QUANTITY, "Hz", unit)
    others = ((column, _part(column.removeprefix("-"), units.get(column))) for column in columns if column != first)
    parts = [(column, *found) for column, found in others if found is not None]
    names = [name for _, name, _ in parts if name] or [UNNAMED]
    responses: dict[str, dict[str, str]] = {}
    for column, name, part in parts:
        responses.setdefault(name or names[0], {}).setdefault(part, column)
    for name, own in responses.items():
        form = max(RESPONSE_FORMS, key=lambda each: sum(part in own for part in each))
        for part in (each for each in form if each in own):
            yield ColumnMatch(f"{name}.{part}", "response", own[part], MatchReason.QUANTITY, None, units.get(own[part]))


def ratio_of(unit: str | None, description: Description) -> str:
    """Return the input–output ratio of a response's unit, else the first."""
    inputs, outputs = (of_tables(description, role) or [role] for role in ("input", "output"))
    wanted = None if unit is None else parse_unit(unit)
    pairs = [(a, b) for u in inputs for y in outputs for a, b in ((u, y), (y, u))]
    for above, below in pairs if wanted is not None else ():
        units = [description.variables[name].unit or "1" for name in (above, below) if name in description.variables]
        own = parse_unit(f"({units[0]})/({units[1]})") if len(units) == 2 else None
        if own is not None and wanted is not None and own.exponents == wanted.exponents:
            return f"{above} / {below}"
    return f"{pairs[0][0]} / {pairs[0][1]}"


def _is_frequency(column: str, unit: str | None) -> bool:
    known = _word(column) in _SUPPLY["frequency"].split() or _is_angular(column)
    return known or unit in ("Hz", "kHz", "rad/s")


def _is_angular(column: str) -> bool:
    return _word(column) in ("w", "omega")


def _word(column: str) -> str:
    return re.sub(r"[\W_]", "", column).casefold()


def _part(column: str, unit: str | None) -> tuple[str, str] | None:
    """Return name and part of a response's column, or None."""
    if (bars := _BARS.fullmatch(column)) is not None:
        return bars[1], "magnitude"
    if (found := next((match for each in _PART if (match := each.fullmatch(column))), None)) is not None:
        word = found["part"]
        part = next((part for part, words in _PARTS.items() if word.casefold() in words.split()), None)
        return found["name"].strip("|_ (-/"), part or _MARKS[word]
    return (column, "phase") if unit in ("deg", "rad") else None
