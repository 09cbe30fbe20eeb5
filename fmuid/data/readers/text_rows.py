"""Rows of delimited text."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import IO

from fmuid.data.cells import is_missing, is_number
from fmuid.data.headers import split_header
from fmuid.data.readers.cell_units import number_in
from fmuid.data.time_names import is_time_name

SPACES = r"\s+"
"""Separator of cells by any spaces."""
_QUOTED = re.compile(r'(?<=")[^"\s][^"]*(?=")|[^"\s]+')
_COMMENT = ("#", "%", "//", "!")
_KEYED = re.compile(r"(?:names|columns|fields|variables|channels|signals|units|einheiten)\s*[:=]?\s*", re.IGNORECASE)
"""Begin of commented lines that name columns or units: ``# Units: s V A``."""
_FIRST_OF_R = re.compile(r'^"1"[\s,;]', re.MULTILINE)
_RULE = re.compile(r"[\s|+:]*(?:[-=]{3,}[\s|+:]*)+")
"""Line between header and rows, as databases and Markdown draw it."""
_COMMENTS = "Comment"
"""Last header of LabVIEW, above cells that are often left out."""


def rows_of(lines: Iterator[str] | IO[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield each non-blank row with its line number."""
    if separator == SPACES:
        for number, line in enumerate(lines, start=1):
            if row := _QUOTED.findall(line.strip().strip("()")) if '"' in line else line.split():
                yield number, row
        return
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    yield from ((reader.line_num, row) for row in reader if len(row) > 1 or "".join(row).strip())


def without_blank_ends(rows: list[list[str]]) -> tuple[list[list[str]], int]:
    """Return rows without always empty last cells, and their count."""
    usual = Counter(map(len, rows)).most_common(1)
    length = usual[0][0] if usual else 0
    rows = [row[:length] if len(row) == length + 1 and row[-1].strip() in ("", _COMMENTS) else row for row in rows]
    regular, ends = [row for row in rows if len(row) == length], 0
    while ends < length - 1 and not any(row[-1 - ends].strip().removeprefix(_COMMENTS) for row in regular):
        ends += 1
    return [row[: length - ends] if len(row) == length else row for row in rows] if ends else rows, ends


def plain_row(row: list[str], separator: str) -> list[str]:
    """Return a row without a leading comment mark."""
    first = row[0].strip()
    for mark in _COMMENT:
        if first.startswith(mark):
            rest = first[len(mark) :].strip()
            return _without_key([rest, *row[1:]] if rest or separator != SPACES else row[1:])
    return row


def _without_key(row: list[str]) -> list[str]:
    """Return a commented row without a key such as ``Units:``."""
    found = _KEYED.match(row[0]) if len(row) > 2 else None
    if found is None:
        return row
    rest = row[0][found.end() :]
    return [rest, *row[1:]] if rest and found[0].strip()[-1:] in ":=" else row if rest else row[1:]


Rows = list[tuple[int, list[str]]]


def with_spaced_names(read: Rows, text: str) -> Rows:
    """Return rows with names that have single blanks: ``Elapsed Time   u``."""
    lines = text.splitlines()
    for k in range(1, len(read) - 1):
        count = len(read[k][1])
        if count < 2 or any(len(row) != count or not all(map(is_number, row)) for _, row in read[k : k + 2]):
            continue
        for place in range(max(k - 2, 0), k):
            line, row = read[place]
            names = re.split(r"\s{2,}|\t", lines[line - 1].strip())
            if len(row) != count == len(names) and not any(map(is_number, names)):
                read = [*read[:place], (line, names), *read[place + 1 :]]
        break
    return read


def without_rules(read: Rows) -> Rows:
    """Return rows without lines such as ``----+----`` between header and samples."""
    found: Rows = []
    for line, row in read:
        if found and _RULE.fullmatch(" ".join(row)):
            found[-1] = line, found[-1][1]  # samples begin below it
        else:
            found.append((line, row))
    return found


def as_written(read: Rows, _text: str) -> Rows:
    """Return rows unchanged."""
    return read


def with_row_numbers(read: Rows, text: str) -> Rows:
    """Name quoted row numbers that have no header, as of R."""
    if _FIRST_OF_R.search(text) is None:
        return read
    for k in range(len(read) - 2):
        (line, names), *rows = read[k : k + 3]
        if (
            [row[0] for _, row in rows] == ["1", "2"]
            and all(len(row) == len(names) + 1 for _, row in rows)
            and not any(map(is_number, names))
        ):
            return [*read[:k], (line, ["", *names]), *read[k + 1 :]]
    return read


def with_listed_names(read: Rows, _text: str) -> Rows:
    """Return rows whose header is a line per name, the time first."""
    for k in range(2, len(read) - 2):
        count = len(read[k][1])
        if count < 2 or any(len(row) != count or not all(map(is_number, row)) for _, row in read[k : k + 3]):
            continue
        above = [(line, " ".join(row).strip()) for line, row in read[max(k - count, 0) : k]]
        if len(above) == count and is_time_name(split_header(above[0][1])[0]):
            return [(above[-1][0], [name for _, name in above]), *read[k:]]
        return read
    return read


def without_cell_units(read: Rows, _text: str) -> Rows:
    """Return rows with numbers in place of cells such as ``12.1 V``."""
    return [(line, [number_in(cell) or cell for cell in row]) for line, row in read]


def is_text_row(row: Sequence[str], decimal: str) -> bool:
    """Return whether a row has no number and is mostly text."""
    texts = sum(not is_missing(cell) for cell in row)
    return 2 * texts > len(row) and not any(is_number(number_in(cell) or cell, decimal) for cell in row)
