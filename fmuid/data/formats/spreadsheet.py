"""Spreadsheets: .xlsx, .xls and .ods; the head is found as in a text."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fmuid.data.formats.columns import Cell, Head, RawTable, check_once, find_head, is_missing, named
from fmuid.data.formats.libraries import library
from fmuid.errors import InputError


def read_spreadsheet(path: Path, source: str) -> RawTable:
    """Read the first sheet with a table.

    Raises
    ------
    InputError
        Where the file cannot be read, has no table.
    """
    calamine = library("python_calamine", "excel", source)
    try:
        book = calamine.CalamineWorkbook.from_path(path)
    except PermissionError:
        raise
    except Exception:  # calamine has an error of its own for each format
        raise InputError(f"{source}: the file is no readable spreadsheet: save it again") from None
    for name in book.sheet_names:
        rows = _without_margins(book.get_sheet_by_name(name).to_python())
        head = find_head(rows)
        if head is not None:
            return _table(source, rows, head)
    raise InputError(f"{source}: no sheet holds a table: give a header with the names and rows of samples")


def _without_margins(rows: list[list[Cell]]) -> list[list[Cell]]:
    """Leave out rows and columns that are empty."""
    filled = [row for row in rows if not all(map(is_missing, row))]
    columns = [k for k in range(max(map(len, filled), default=0)) if not all(is_missing(row[k]) for row in filled)]
    return [[row[k] for k in columns] for row in filled]


def _table(source: str, rows: list[list[Cell]], head: Head) -> RawTable:
    names, units = named(head.names, head.units)
    check_once(source, names)
    samples = [[None if is_missing(cell) else cell for cell in row] for row in rows[head.first :]]
    frame = pd.DataFrame(samples, columns=names, dtype=object).infer_objects()
    return RawTable(frame, units)
