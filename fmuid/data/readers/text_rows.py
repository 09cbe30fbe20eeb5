"""Rows of delimited text."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import IO

from fmuid.data.cells import is_missing, is_number

SPACES = r"\s+"
"""Separator of cells by any spaces."""
_QUOTED = re.compile(r'(?<=")[^"\s][^"]*(?=")|[^"\s]+')
_COMMENT = ("#", "%", "//")
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
            return [rest, *row[1:]] if rest or separator != SPACES else row[1:]
    return row


def is_text_row(row: Sequence[str], decimal: str) -> bool:
    """Return whether a row has no number and is mostly text."""
    texts = sum(not is_missing(cell) for cell in row)
    return 2 * texts > len(row) and not any(is_number(cell, decimal) for cell in row)
