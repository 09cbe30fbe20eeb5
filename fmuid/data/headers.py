"""Headers of data files: first row, names and units."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from itertools import accumulate
from typing import TYPE_CHECKING, Any

from fmuid.data.cells import MISSING, Cell, is_missing, is_number
from fmuid.data.said_values import rows_said, step_said
from fmuid.data.time_names import TIME_NAMES, counts_part, is_time_name, plain_name
from fmuid.errors import InputError
from fmuid.units import SECONDS, parse_unit, time_unit, unit_in_name

if TYPE_CHECKING:
    import pandas as pd

_WITH_UNIT = re.compile(
    r"(?P<name>.*?\S)(?P<gap>\s*)(\((?P<round>[^()]*(\([^()]*\)[^()]*)*)\)|\[(?P<square>[^\[\]]*)\])"
)
_AFTER_WORD = re.compile(r"(?P<name>.*\S)(?:,? in | ?/ |, )(?P<unit>\S.*)")
_AFTER_SLASH = re.compile(r"(?P<name>[^/]*[^/\s])/(?P<unit>[^/\s]+|rad/s|1/min)")
_SLASH_UNITS = {
    "s", "sec", "Sec", "ms", "µs", "us", "min", "h", "Hz", "kHz", "V", "mV", "kV", "A", "mA", "kA", "Ohm", "ohm", "Ω",
    "mOhm", "W", "kW", "deg", "°", "rad", "rpm", "rad/s", "1/min", "N", "Nm", "N.m", "°C", "\ufffdC", "degC", "%", "K",
}  # fmt: skip
"""Units after a slash without spaces, as in DIN 1313; other slashes are ratios."""
_RATES, _RATIOS = re.compile(r"([mk]?m|rad|deg|°|U|k?g|[lL]|1|rev|n|r)/(s|min|h)"), re.compile(r"m?[VA]|[WN]")
"""Headers, and names before a slash, that are units."""
_ALTERED = re.compile(
    r"[kmµun]?(V|A|W|Hz|Nm|N|Pa|bar)([_ ]?(eff|rms|RMS|pk|pp|ac|dc|AC|DC|avg|peak|mean|p-p|x?\d+))", re.ASCII
)
"""Units with an addition that changes their meaning."""
_FACTOR = re.compile(r"(?:[*×/]|\bx)\s*10+\b")
"""Factor in a name, ``P*10``: its column is refused where it is used."""
_SCALED = re.compile(r"(\D+?)\s*[x×*]\s*[\d.,]+|[x×*]?\s*[\d.,]+\s*[x×*]?\s*(\D+)")
"""Units with a factor: ``V x 0.1``, ``10 A``."""
_EITHER = ("MV", "MA", "MOHM")
"""Units whose first letter may be a small one where all headers are in capitals."""
_UNIT_LENGTH = 12
_NAME_KEYS = (
    "tag",
    "tracename",
    "trace name",
    "channel name",
    "signal name",
    "label",
    "source",
    "signal",
    "channel",
    "name",
)
_UNIT_KEYS = ("vunit", "vertical units", "y_unit_label", "unit", "units", "einheit", "einheiten")
"""First cells of the lines above a header that say names and units."""
_MARKED = re.compile(r"\s*[\[{<]")
"""Begin of lines such as ``[Data]``."""
_NO_NAME = re.compile(r"[\d:./\s-]*")
"""Dates and times in the place of names."""
_FORM = re.compile(r"(?:[dDMyYhHmsSfT]{1,4}[./: -]){2,}[dDMyYhHmsSf]{1,6}")
"""Formats of dates and times: ``dd.MM.yyyy HH:mm``."""
_RUN = re.compile(r"(?P<name>.+?) \((?P<unit>[^()]+)\) (?P<run>(?:Run|Set|Lauf) ?#?\d+)")
"""Headers with a unit before the number of a run."""
_INDEX = re.compile(r"[\d\s,:]*")
_NODES, _NODE = (
    ("V", "I", "v", "i", "Ix", "Id", "Ig", "Is", "Ic", "Ib", "Ie"),
    re.compile(r"[A-Za-z]\w*\d(:\w+)?|\w+,\w+"),
)
"""Names and arguments of SPICE: ``V(out1)``, ``I(L1)``."""


@dataclass(frozen=True)
class RawTable:
    """Data file before its times are known.

    `units` are as written, `time` is the format's own time column, `days` are columns that may be pandas durations.
    `clocks` are the time columns of columns, where the format says them; `left_out` names what was not read, and why.
    `step` is the time between samples, s, and `rows` their number, where the lines above the header say them.
    """

    frame: pd.DataFrame
    units: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    days: frozenset[str] = frozenset()
    clocks: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    step: float | None = None
    rows: int | None = None


def with_columns(frame: pd.DataFrame, change: Callable[[pd.Series[Any]], pd.Series[Any]]) -> pd.DataFrame:
    """Return a frame with changed columns; others are not copied."""
    changed = {name: new for name, column in frame.items() if (new := change(column)) is not column}
    return frame.assign(**{str(name): new for name, new in changed.items()}) if changed else frame


@dataclass(frozen=True)
class TableHeader:
    """Header cells, unit cells and the first row of samples; time between samples, s, and their number."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int
    step: float | None = None
    rows: int | None = None


def split_header(header: str) -> tuple[str, str | None]:
    """Return name and unit of a header: ``w (rpm)``, ``U / V``, ``t/s``, ``n in 1/min``, but not ``der(y)``.

    Brackets that hold no known unit but look like one are units, too: their column is refused where it is used.
    """
    header = " ".join(header.split())
    found = _WITH_UNIT.fullmatch(header)
    run = _RUN.fullmatch(header)
    if run is not None and is_unit(run["unit"]):
        return f"{run['name']} {run['run']}", run["unit"]
    if found is None and header.startswith("in ") and is_unit(header[3:]):
        return header, header[3:]
    if found is None:
        words = _AFTER_WORD.fullmatch(header)
        if words is not None and (is_unit(words["unit"]) or words["unit"].startswith(("1/", "min"))):
            return words["name"], words["unit"]
        words = _AFTER_SLASH.fullmatch(header)
        if words is None or not _after_slash(words["name"], words["unit"]) or _RATES.fullmatch(header):
            return header, None
        quantity, _, part = words["name"].rpartition(" ")
        if quantity and words["unit"] in SECONDS and not (is_time_name(part) or counts_part(words["name"])):
            return quantity, f"{part}/{words['unit']}"  # a flow in smL/min
        return (header, None) if _RATIOS.fullmatch(words["name"]) else (words["name"], words["unit"])
    unit = without_remark((found["round"] if found["round"] is not None else found["square"]).strip())
    call = found["name"] == "der" or (found["name"] in _NODES and _is_node(unit, found["name"]))
    if not found["gap"] and (call or _INDEX.fullmatch(unit)):
        return header, None
    if not is_unit(unit) and (inner := split_header(found["name"]))[1]:  # a remark after the unit
        return inner
    spaced = found["square"] is not None and bool(found["gap"]) and len(unit) <= _UNIT_LENGTH
    return (found["name"], unit) if is_unit(unit) or (unit and (spaced or _like_unit(unit))) else (header, None)


def _after_slash(name: str, unit: str) -> bool:
    """Return whether a text after a slash is a unit."""
    return unit in _SLASH_UNITS or (len(unit) > 1 and is_unit(unit) and not is_unit(name))


def without_remark(unit: str) -> str:
    """Return a unit without a remark in brackets: ``V (Voltage)``."""
    found = re.fullmatch(r"(\S+) \([^()]*\)", unit)
    return found[1] if found and is_unit(found[1]) and not is_unit(unit) else unit


def _is_node(text: str, quantity: str) -> bool:
    """Return whether a text names a node of a circuit: ``V(U)``, but not ``V(mV)``, ``v(kmh)``."""
    unit = parse_unit(text) if text.isidentifier() else None
    own = [parse_unit(each) for each in (("A",) if quantity[0] in "Ii" else ("V", "m/s", "m3"))]
    foreign = unit is not None and all(each is None or each.exponents != unit.exponents for each in own)
    return foreign or _NODE.fullmatch(text) is not None


def _like_unit(text: str) -> bool:
    """Return whether an unknown text is written as units are: ``Aeff``, ``A*10``."""
    marked = re.search(r"[/*·^%°²³⁻¹Ωµμ\ufffd]", text) is not None and " " not in text and len(text) <= _UNIT_LENGTH
    scaled = _SCALED.fullmatch(text)
    return (
        text == "C"
        or marked
        or _ALTERED.fullmatch(text) is not None
        or (scaled is not None and is_unit(scaled[1] or scaled[2]))
    )


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit."""
    text = text.strip()
    # rows of samples are asked too where decimals are not those of the table
    number = text != "1" and (is_number(text) or is_number(text, ","))
    return text in SECONDS or (not number and parse_unit(text) is not None)


def named(headers: Sequence[str], units: Sequence[str] = ()) -> tuple[list[str], dict[str, str]]:
    """Return the names and units of columns; names that differ in the unit only keep it."""
    split = _split_alike(headers)
    alike = [name for name, _ in split]
    names = [
        name if alike.count(name) == 1 or headers.count(header) > 1 else header.strip()
        for (name, _), header in zip(split, headers, strict=True)
    ]
    names = _numbered(names)
    bare = (cell.strip().strip("[]()").strip() if cell.strip()[:1] in ("[", "(") else cell.strip() for cell in units)
    below = [*map(without_remark, bare)] or [""] * len(names)
    said = {name: below[k] or split[k][1] for k, name in enumerate(names)}
    factors = {name: found[0] for name in names if (found := _FACTOR.search(name))}
    said |= {name: f"{factor} {said[name] or unit_in_name(name) or ''}" for name, factor in factors.items()}
    if not any(map(str.islower, "".join((*headers, *units)))):
        said = {name: f"{unit} or m{unit[1:]}" if unit in _EITHER else unit for name, unit in said.items()}
    return names, {name: unit for name, unit in said.items() if unit}


def _split_alike(headers: Sequence[str]) -> list[tuple[str, str | None]]:
    """Return names and units: where other headers are ``w[rpm]``, ``q[ccps]`` has an unknown unit."""
    split = [split_header(header) for header in headers]
    found = [_WITH_UNIT.fullmatch(" ".join(header.split())) for header in headers]
    for style, share in (("square", 0.0), ("round", 0.5)):
        alike = [each for each in found if each and each[style] and not (style == "square" and each["gap"])]
        known = sum(unit is not None for each, (_, unit) in zip(found, split, strict=True) if each in alike)
        split = [
            (each["name"], each[style].strip())
            if unit is None and each in alike and known >= max(share * len(alike), 1) and _may_be_unit(each[style])
            else (name, unit)
            for each, (name, unit) in zip(found, split, strict=True)
        ]
    return split


def _may_be_unit(text: str) -> bool:
    known_name = text == "dB" or is_time_name(text)
    return len(text) <= _UNIT_LENGTH and not _INDEX.fullmatch(text) and not known_name


def _numbered(names: list[str]) -> list[str]:
    """Return names of which several equal ones have numbers; the first time column keeps its name."""
    found: list[str] = []
    for k, name in enumerate(names):
        number = names[: k + 1].count(name)
        own = names.count(name) == 1 or not name or (number == 1 and is_time_name(name))
        found.append(name if own else f"{name} {number}")
    return found


def check_once(source: str, names: Sequence[str]) -> None:
    """Refuse columns of one name."""
    for name in names:
        if names.count(name) > 1:
            if name:
                raise InputError(f"{source}: column {name!r} occurs twice. Rename or remove one.")
            places = ", ".join(str(k) for k, each in enumerate(names, start=1) if not each)
            raise InputError(f"{source}: columns {places} have no name. Name them in the header.")


def find_head(rows: Sequence[Sequence[Cell]], decimal: str = ".") -> TableHeader | None:
    """Return the header above most numeric rows of its length, if any."""
    numeric = [any(is_number(cell, decimal) for cell in row) for row in rows]
    heads = {k: _above(rows, k) for k in range(1, len(rows)) if numeric[k]}
    begins = [
        k for k, a in heads.items() if not numeric[a] and len(rows[k]) == len(rows[a]) and any(map(_there, rows[a]))
    ]
    if not begins:
        return None
    ends = [*begins[1:], len(rows)]
    lengths = [
        sum(len(rows[k]) == len(rows[a]) and numeric[k] for k in range(a, b)) for a, b in zip(begins, ends, strict=True)
    ]
    first = begins[lengths.index(max(lengths))]
    header = above = heads[first]
    while above >= 0 and not numeric[above] and len(rows[above]) == len(rows[first]):
        above -= 1
    top = _texts(rows[above + 1])
    index, *others = _texts(rows[header])
    if plain_name(index) in TIME_NAMES and not any(others) and all(top):  # pandas names an index below
        return TableHeader((index, *top[1:]), (), first)
    made = partial(TableHeader, first=first, step=step_said(rows[:first], decimal), rows=rows_said(rows[:first]))
    keyed = (_of_one_key(row) for row in rows[header + 1 : first])
    if units := next((cells for key, cells in keyed if key in _UNIT_KEYS), ()):
        return made(_texts(rows[header]), units)
    for k in range(above + 2, header + 1):
        if _are_units(rows[k]):
            names, units = _with_names_above(rows[above + 1 : k], rows[k])
            timed = [
                _texts(row) for row in rows[above + 1 : k] if any(plain_name(str(cell)) in TIME_NAMES for cell in row)
            ]
            if (
                "" not in names and len(timed) == 1 and all(timed[0]) and len({*timed[0]}) == len(names)
            ):  # others describe columns
                names = timed[0]
            if k + 1 == header and "" in names and all(below := _texts(rows[header])):  # units stand above names
                names = below
            return made(names, units)
    names = _with_names_beside(_texts(rows[header]), rows[first])
    if header > above + 1 and all(is_unit(text.strip("[]() ")) for text in _texts(rows[header - 1])):
        return made(names, _texts(rows[header - 1]))
    if "" in names[1:] or len({*names}) < len(names):  # as how each column was made: Avg, Smp
        for k in range(header - 1, above, -1):
            if all(each := _texts(rows[k])) and len({*each}) == len(each) and any(map(is_unit, _texts(rows[k + 1]))):
                return made(each, _texts(rows[k + 1]))
        if len(names) > 1 == len({*names}) < len({*(each := _texts(rows[header - 1]))}) == len(names) and all(each):
            names = each  # above types
    alike = [_texts(row) for row in rows[:header] if len(row) == len(names)]
    said = {each[0].lower(): each for each in reversed(alike)}
    above_names = next((said[key] for key in _NAME_KEYS if key in said), ())
    if above_names and (_are_units(rows[header]) or all(_NO_NAME.fullmatch(name) for name in names[1:])):
        names = above_names
    elif alike and _are_units(rows[header]) and all(names[1:]):  # names are numbers of channels
        return made(alike[-1], names)
    units = _units_said(rows[:header], names)
    if above_names and len({*names}) < len(names) == len(above_names):  # Min and Max of each channel
        begins = [*accumulate((k if own else 0 for k, own in enumerate(above_names)), max)]
        names = tuple(f"{above_names[a]} {name}" if a else name for a, name in zip(begins, names, strict=True))
        units = tuple(unit or units[a] for a, unit in zip(begins, units, strict=True)) if units else ()
    return made(names, units)


def _above(rows: Sequence[Sequence[Cell]], first: int) -> int:
    """Return the row above samples, beyond remarks and rows of one key."""
    k = first - 1
    while k > 0 and (
        _of_one_key(rows[k])[0]
        or (len(rows[k]) == 1 and (_MARKED.match(str(rows[k][0])) or len(rows[k - 1]) == len(rows[first]) > 1))
    ):
        k -= 1
    return k


def _of_one_key(row: Sequence[Cell]) -> tuple[str, tuple[str, ...]]:
    """Return key and texts of a row such as ``Units: V, Units: A``; no key if they have none in common."""
    texts = _texts(row)
    keys = {text.partition(":")[0].strip().lower() if ":" in text else "" for text in texts if text}
    key = keys.pop() if len(keys) == 1 else ""
    return ("", ()) if _NO_NAME.fullmatch(key) else (key, tuple(text.partition(":")[2].strip() for text in texts))


def _with_names_beside(names: Sequence[str], row: Sequence[Cell]) -> tuple[str, ...]:
    """Return names; one above dates is that of the unnamed numbers beside them."""
    found = [*names]
    for k in range(1, len(found)):
        dated = isinstance(row[k - 1], datetime) or ":" in str(row[k - 1])
        if not found[k] and found[k - 1] and dated and not is_time_name(found[k - 1]):
            found[k - 1 : k + 1] = [f"time {found[k - 1]}", found[k - 1]]
    return tuple(found)


def _with_names_above(rows: Sequence[Sequence[Cell]], units: Sequence[Cell]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names, those missing from rows further up, and units; words for time among units are names."""
    names, *more = [_texts(row) for row in reversed(rows)]
    if more and len({*names}) < len(names) == len({*more[0]}) and all(more[0][1:]):  # below the names are types
        names, *more = more
    below = _texts(units)
    if "" in names[1:]:
        more = [*more, tuple("" if is_unit(text) else text for text in below)]
        names = tuple(next((row[k] for row in (names, *more) if row[k]), "") for k in range(len(names)))
    return names, tuple(
        "" if text == name or _is_clock(text) else text for name, text in zip(names, below, strict=True)
    )


def _is_clock(text: str) -> bool:
    """Return whether a text names a time or its format."""
    return (is_time_name(text) and time_unit(text) is None) or _FORM.fullmatch(text) is not None


def _units_said(rows: Sequence[Sequence[Cell]], names: Sequence[str]) -> tuple[str, ...]:
    """Return the units said above the header; of another length than `names` if they do not fit."""
    for row in rows:
        key, *units = [*_texts(row), ""]
        while units and not units[-1]:
            units.pop()
        if len(of_blocks := _units_of_blocks(key, units, names)) == len(names):
            return of_blocks
        known = sum(is_unit(unit) for unit in units if unit)
        if key.lower() not in _UNIT_KEYS or known == 0:
            continue
        places = [k for k, name in enumerate(names) if k and name and not is_time_name(name)]
        own = len(row) == len(names) and not any(row[k] for k in range(1, len(names)) if k not in places)
        places = places if len(units) == len(places) and not own else [*range(1, len(names))]
        if len(units) == len(places) or len(units) < len(names) <= len(row):
            said = dict(zip(places, units, strict=False))
            return tuple(said.get(k, "") for k in range(len(names)))
        if known > 1:
            return "", *units
        if len(units) == 1:  # of all signals
            return tuple(units[0] if k in places else "" for k in range(len(names)))
    return ()


def _units_of_blocks(key: str, cells: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return the units of blocks between empty columns; empty of others."""
    units = [after for each, after in zip(("", *cells), (*cells, ""), strict=False) if each == key] if key else []
    units = [cells[0], *units] if cells else []
    blocks = [*accumulate(int(not name) for name in names)]
    if key.lower() not in _UNIT_KEYS or len(units) < 2 or blocks[-1] + 1 != len(units):
        return ()
    said = ["" if units[block].lower() == "none" else units[block] for block in blocks]
    return tuple(unit if name and not is_time_name(name) else "" for unit, name in zip(said, names, strict=True))


def check_units(head: TableHeader, source: str) -> None:
    """Refuse units above the header that are no unit per column."""
    if head.units and len(head.units) != len(head.names):
        said = f"{len(head.units) - 1} units above the header, {len(head.names)} columns"
        raise InputError(f"{source}: {said}. Give each column one unit.")


def _there(cell: Cell) -> bool:
    return not (cell.strip().lower() in MISSING if isinstance(cell, str) else is_missing(cell))


def _are_units(row: Sequence[Cell]) -> bool:
    """Return whether cells are units; of three and more with a time, some may be unknown."""
    texts = [text.strip("[]() ") for text in _texts(row)]
    there = [text for text in texts if text not in ("", "-") and not _is_clock(text)]
    known = [
        text
        for text in there
        if is_unit(text)
        or ((text == texts[0] or text.lower().startswith(("sec", "sek"))) and time_unit(text) is not None)
    ]
    timed = len(there) > 2 and any(text in SECONDS or _is_clock(text) for text in texts)
    timed = timed and 2 * len(known) > len(there)
    alike = bool(known) and all(text in known or _like_unit(text) for text in there)
    return bool(there) and (
        len(known) == len(there) or alike or (timed and all(len(text) <= _UNIT_LENGTH for text in there))
    )


def _texts(row: Sequence[Cell]) -> tuple[str, ...]:
    return tuple(" ".join(str(cell).split()) if _there(cell) else "" for cell in row)
