"""One record written in drawn combinations of encoding, separator, decimals, header, units, clock and gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np
import pandas as pd

from tests.support.table_variants import BEGIN, FRAME

ROWS = 60
STEP = 0.01
ENCODINGS = {
    "utf-8": "",
    "utf-8-sig": "Größe",
    "utf-16": "Größe",
    "utf-16-le": "Größe",
    "cp1252": "Größe µ",
    "cp932": "電圧 電流",
    "gb18030": "电压 电流",
    "cp1251": "напряжение",
}
"""Encodings, and words in the file that need them."""
UNITS = {
    "u": {"": 1.0, "V": 1.0, "mV": 1e3, "kV": 1e-3, "Volt": 1.0},
    "i": {"": 1.0, "A": 1.0, "mA": 1e3, "Amps": 1.0, "kA": 1e-3},
    "w": {"": 1.0, "rad/s": 1.0, "rpm": 30 / np.pi, "1/min": 30 / np.pi, "deg/s": 180 / np.pi, "rps": 0.5 / np.pi},
}
UNKNOWN = ("Aeff", "A*10", "A_rms", "mApk")
TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "min": 1 / 60, "h": 1 / 3600}
FORMS: dict[str, Callable[[pd.Timestamp], str]] = {
    "iso": lambda date: date.strftime("%Y-%m-%dT%H:%M:%S.%f"),
    "iso with a zone": lambda date: date.strftime("%Y-%m-%d %H:%M:%S.%f+01:00"),
    "of Germany": lambda date: date.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "of the US": lambda date: date.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    "of the day": lambda date: date.strftime("%H:%M:%S.%f"),
}
CLOCKS = (*TIMES, *FORMS, "epoch", "second", "rounded", "no", "s", "ms", "s")
GAPS = ("", "", "", "empty", "NaN", "-", "OL", "#VALUE!", "9.9E+37", "-9999", "∞")
HEADS = ("[]", "()", "/", "in", "row", "row []", "lines", "two", "preamble", "comment", "[]", "row")


@dataclass(frozen=True)
class Written:
    """A table, and what it says: times (s) from the first and samples in SI of each column; `unknown` units."""

    content: bytes
    choices: dict[str, Any]
    times: dict[str, np.ndarray]
    values: dict[str, np.ndarray]
    unknown: dict[str, str] = field(default_factory=dict)


def drawn(seed: int) -> Written:
    """Return a combination."""
    rng = Random(seed)
    separator = rng.choice([",", ";", "\t", "|", "  "])
    decimal = "." if separator == "," else rng.choice(".,")
    encoding, head, clock = rng.choice([*ENCODINGS]), rng.choice(HEADS), rng.choice(CLOCKS)
    spaced = separator == "  "
    if spaced:  # one word a header, quotes are no quotes
        head = {"[]": "[] tight", "()": "[] tight", "row []": "row []", "row": "row"}.get(head, "row")
        clock = clock if clock not in FORMS else "s"
    unit = {name: rng.choice([*each]) for name, each in UNITS.items()}
    unknown = {"i": rng.choice(UNKNOWN)} if rng.random() < 0.08 and head in ("[]", "row", "row []") else {}
    gap, digits = rng.choice(GAPS), rng.choice([5, 7, 10, 17])
    gap = "NaN" if (spaced and gap == "empty") or (gap == "∞" and not encoding.startswith("utf")) else gap
    frame = FRAME[:ROWS].reset_index(drop=True)
    texts, times = _clock(rng, clock, decimal)
    columns, values = dict(texts), dict[str, np.ndarray]()
    for name in "uiw":
        scaled = frame[name].to_numpy() * UNITS[name][unit[name]]
        cells = [f"{x:.{digits}g}" for x in scaled]
        values[name] = np.array([float(each) for each in cells]) / UNITS[name][unit[name]]
        if rng.random() < 0.1:
            cells = [f"{float(each):.{digits - 1}E}" for each in cells]
        columns[name] = [each.replace(".", decimal) for each in cells]
    if gap:
        for row in rng.sample(range(3, ROWS - 3), 3):
            columns["w"][row] = gap.replace("empty", "").replace(".", decimal if gap[0].isdigit() else ".")
            values["w"] = values["w"].copy()
            values["w"][row] = np.nan
    order = [*texts, *"uiw"]
    if clock == "second":
        order = ["time", "u", "i", "time_w", "w"]
    said = {name: unknown.get(name, unit.get(name, "")) for name in order}
    for name in texts:
        said[name] = clock if clock in TIMES else "s" if clock in ("second", "rounded") else ""
    lines = _head(rng, head, order, said, separator)
    if clock == "no":
        lines = [f"Sample Interval{separator}{STEP}" if not spaced else f"Sample_Interval={STEP}", *lines]
    quote = rng.random() < 0.15 and not spaced
    rows = [
        separator.join(f'"{columns[name][k]}"' if quote else columns[name][k] for name in order) for k in range(ROWS)
    ]
    end = separator if rng.random() < 0.1 and not spaced else ""
    if word := ENCODINGS[encoding]:
        lines = [f"# {word}", *lines] if rng.random() < 0.5 or spaced else _with_word(lines, rows, separator, word)
    body = [f"{each}{end}" for each in lines[-1:] + rows]
    text = rng.choice(["\n", "\r\n", "\n", "\r"]).join([*lines[:-1], *body, *rng.choice([[], [""], ["", ""]])])
    choices: dict[str, Any] = {
        "seed": seed,
        "separator": separator,
        "decimal": decimal,
        "encoding": encoding,
        "head": head,
        "clock": clock,
    }
    choices |= {"unit": unit, "gap": gap, "digits": digits, "quote": quote, "end": end}
    own = {name: times["time_w" if clock == "second" and name == "w" else "time"] for name in "uiw"}
    return Written(text.encode(encoding), choices, own, values, unknown)


def _clock(rng: Random, clock: str, decimal: str) -> tuple[dict[str, list[str]], dict[str, np.ndarray]]:
    """Return the cells of time columns, and their times, s."""
    regular = STEP * np.arange(ROWS)
    plain = [f"{x:.9g}".replace(".", decimal) for x in regular]
    if clock in TIMES:
        cells = [f"{x * TIMES[clock]:.12g}" for x in regular]
        return {"time": [x.replace(".", decimal) for x in cells]}, {"time": regular}
    if clock in FORMS:
        dates = [BEGIN + pd.Timedelta(x, "s") for x in regular]
        return {"time": [FORMS[clock](each).replace(".", ".") for each in dates]}, {"time": regular}
    if clock == "epoch":
        return {"timestamp": [f"{1795200000000 + 10 * k}" for k in range(ROWS)]}, {"time": regular}
    if clock == "second":
        other = regular + 2.1e-3
        cells = [f"{x:.9g}".replace(".", decimal) for x in other]
        return {"time": plain, "time_w": cells}, {"time": regular, "time_w": other}
    if clock == "rounded":
        true = regular * rng.choice([0.7, 0.8, 0.9])
        return {"time": [f"{x:.2f}".replace(".", decimal) for x in np.floor(true / STEP) * STEP]}, {"time": true}
    return {}, {"time": regular}


def _head(rng: Random, head: str, order: list[str], said: dict[str, str], separator: str) -> list[str]:
    """Return the lines of a header, the last that of the columns."""
    forms = {"[]": "{0} [{1}]", "()": "{0} ({1})", "/": "{0} / {1}", "in": "{0} in {1}", "lines": '"{0}\n[{1}]"'}
    forms |= {"[] tight": "{0}[{1}]", "preamble": "{0} [{1}]", "comment": "{0} [{1}]"}
    if head in forms:
        names = [forms[head].format(name, said[name]) if said[name] else name for name in order]
        line = separator.join(names)
        above = ["Rig;4", "Operator: B", ""] if head == "preamble" else []
        return [*above, f"# {line}" if head == "comment" else line]
    columns = separator.join(order)
    units = [f"[{said[name]}]" if head == "row []" else said[name] or "-" for name in order]
    if head == "two":
        return [separator.join(rng.choice(["Drive", "Rig"]) for _ in order), columns, separator.join(units)]
    return [columns, separator.join(units)]


def _with_word(lines: list[str], rows: list[str], separator: str, word: str) -> list[str]:
    """Return header lines with one more column, whose name has the word; rows get ones."""
    rows[:] = [f"{row}{separator}1" for row in rows]
    last = len(lines) - 1 - (len(lines) > 1 and lines[-1].count(separator) == lines[-2].count(separator) > 0)
    return [
        f"{line}{separator}{word}" if k == last else f"{line}{separator}-" if k > last else line
        for k, line in enumerate(lines)
    ]
