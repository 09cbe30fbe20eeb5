"""Layout of delimited text: the separator that gives the most numeric columns, and the header."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice

from fmuid.data.cells import is_missing, is_number, may_be_number
from fmuid.data.headers import TableHeader, check_units, find_head
from fmuid.data.readers.row_checks import check_rows
from fmuid.data.readers.text_rows import (
    SPACES,
    Rows,
    as_written,
    is_text_row,
    plain_row,
    rows_of,
    with_listed_names,
    with_row_numbers,
    with_spaced_names,
    without_blank_ends,
    without_cell_units,
    without_rules,
)
from fmuid.errors import InputError

_SEPARATORS = (",", ";", "\t", "|", SPACES)
_DATA = re.compile(r"^\[data\][,;\s]*?\n", re.IGNORECASE | re.MULTILINE)
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}")
"""Begin of a date of ISO 8601 with its time."""
_REPAIRS: tuple[Callable[[Rows, str], Rows], ...] = (
    as_written,
    with_row_numbers,
    with_listed_names,
    without_cell_units,
)
"""How rows are read: as they are, else with what writers leave out or add."""


@dataclass(frozen=True)
class TextLayout:
    """Separators, header with its last line, cells per row, places of dates; `fast` without spaces after separators."""

    separator: str
    decimal: str
    head: TableHeader
    line: int
    width: int
    fast: bool = False
    dates: tuple[int, ...] = ()


def layout_of(source: str, text: str) -> TextLayout:
    """Return the layout with the most numeric columns; a line ``[Data]`` ends what is no table."""
    best, above = _layout(source, text), text[: max((each.end() for each in _DATA.finditer(text)), default=0)]
    if best.line > above.count("\n"):
        return best
    below = _layout(source, text.removeprefix(above))
    return replace(below, line=below.line + above.count("\n"))


def _layout(source: str, text: str) -> TextLayout:
    """Return the layout of the first repair that gives several numeric columns."""
    best, most = None, 0
    for repair in _REPAIRS:
        if most > 1:
            break
        columns, found = _best_layout(source, text, repair)
        best, most = (found, columns) if columns > most else (best, most)
    best = best or _as_it_is(source, text)
    check_units(best.head, source)
    return best


def _best_layout(source: str, text: str, repair: Callable[[Rows, str], Rows]) -> tuple[int, TextLayout | None]:
    """Return the most numeric columns of repaired rows and their layout."""
    best, most, seen = None, 0, list[list[str]]()
    for separator in _SEPARATORS:
        try:
            read = without_rules(list(islice(rows_of(io.StringIO(text), separator), 200)))
        except csv.Error:  # no table with this separator
            continue
        read = [(line, plain_row(row, separator)) for line, row in read]
        read = repair(with_spaced_names(read, text) if separator == SPACES else read, text)
        rows, blank = without_blank_ends([row for _, row in read])
        for decimal in (".", ","):
            head = find_head(rows, decimal)
            if head is None or (len(head.names) == 1 and decimal == ",") or _is_numbers(head.names):
                continue  # "0,1" alone may as well be two cells
            columns = _numeric_columns(rows[head.first :], len(head.names), decimal)
            if columns > most:
                width = len(head.names) + blank
                fast = separator != SPACES and f"{separator} " not in text
                most, seen = columns, rows
                dates = [k for k, cell in enumerate(rows[head.first]) if _DATE.match(cell)] if fast else []
                best = TextLayout(separator, decimal, head, read[head.first - 1][0], width, fast, tuple(dates))
    if best is not None:
        check_rows(seen, best.head, best.decimal, source)
    return most, best


def _numeric_columns(rows: Sequence[Sequence[str]], names: int, decimal: str) -> int:
    """Return the number of numeric columns of the first block of rows."""
    regular = [row for row in rows if len(row) == names]
    regular = regular[: next((k for k, row in enumerate(regular) if is_text_row(row, decimal)), None)]
    columns = list(zip(*regular, strict=True))
    return sum(
        any(may_be_number(cell, decimal) for cell in column)
        and all(may_be_number(cell, decimal) or is_missing(cell) for cell in column)
        for column in columns
    )


def _as_it_is(source: str, text: str) -> TextLayout:
    """Return a comma-separated layout with the first line as header, or refuse."""
    try:
        read = list(rows_of(io.StringIO(text), ","))
    except csv.Error:  # its sentences are for programmers
        said = "no text table, or lines end in carriage returns"
        raise InputError(f"{source}: {said}. End them in line feeds.") from None
    if not read or not any(cell.strip() for cell in read[0][1]):
        raise InputError(f"{source}: empty. Give a header with names, and rows of samples.")
    _check_head(source, text)
    rows = [row for _, row in read]
    header = tuple(cell.strip() for cell in rows[0])
    if _is_numbers(header) or is_number(header[0], ","):
        raise InputError(f"{source}: no header. Write the names of the columns into the first line.")
    alone = (
        len(header) == 1 and len(rows) > 3 and not any(is_number(row[0]) or is_missing(row[0]) for row in rows[1:20])
    )
    if alone or len({len(row) for row in rows[:20]}) > 2:
        raise InputError(f"{source}: no table. Save it as CSV: names in the first line, then one row per sample.")
    if len(rows) > 1 and len(rows[1]) != len(header):
        said = f"{len(header)} names in the header, {count_of_cells(len(rows[1]))} in row 1"
        line = len(rows) > 2 and len(rows[2]) == len(header)
        remedy = "Remove this row" if line else 'Quote names with commas ("x[1,2]"), or name all columns'
        raise InputError(f"{source}: {said}. {remedy}.")
    return TextLayout(",", ".", TableHeader(header, (), 1), read[0][0], len(header))


def _is_numbers(header: Sequence[str]) -> bool:
    return all(is_number(part) for name in header for part in name.split()) and any(header)


def _check_head(source: str, text: str) -> None:
    """Refuse rows of numbers below lines that are no header."""
    for separator in _SEPARATORS:
        with suppress(csv.Error):
            read = list(islice(rows_of(io.StringIO(text), separator), 200))
            cells = [len(row) if all(map(is_number, row)) else 0 for _, row in read]
            for k in range(1, len(read) - 2):
                if cells[k] > 1 and len(read[k - 1][1]) != cells[k] == cells[k + 1] == cells[k + 2]:
                    said = f"no header above the {cells[k]} numbers of line {read[k][0]}"
                    raise InputError(f"{source}: {said}. Insert a line with their names.")


def count_of_cells(count: int) -> str:
    """Return ``3 cells``."""
    return f"{count} cell{'s' * (count != 1)}"
