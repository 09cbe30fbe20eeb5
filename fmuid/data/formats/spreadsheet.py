"""Spreadsheets: .xlsx, .xls and .ods; the head is found as in a text."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from fmuid.data.formats.columns import Cell, Head, RawTable, check_once, find_head, is_missing, named
from fmuid.data.formats.libraries import library
from fmuid.errors import InputError
from fmuid.text import nearest


def read_spreadsheet(path: Path, source: str, sheet: str | int | None = None) -> RawTable:
    """Read a sheet by its name or its place from 1; default: the first with a table.

    Raises
    ------
    InputError
        Where the file cannot be read, has no table or no such sheet.
    """
    calamine = library("python_calamine", "excel", source)
    try:
        book = calamine.CalamineWorkbook.from_path(path)
    except PermissionError:
        raise
    except Exception:  # calamine has an error of its own for each format
        raise InputError(f"{source}: the file is no readable spreadsheet: save it again") from None
    for name in book.sheet_names if sheet is None else [_sheet(book.sheet_names, sheet, source)]:
        rows = _without_margins(book.get_sheet_by_name(name).to_python())
        head = find_head(rows)
        if head is not None:
            return _table(source, rows, head)
    which = "no sheet holds" if sheet is None else f"the sheet {sheet!r} does not hold"
    raise InputError(f"{source}: {which} a table: give a header with the names and rows of samples")


def _sheet(names: list[str], wanted: str | int, source: str) -> str:
    """Return the name of a sheet."""
    if isinstance(wanted, int) and 1 <= wanted <= len(names):
        return names[wanted - 1]
    if isinstance(wanted, str) and wanted in names:
        return wanted
    near = nearest(wanted, names) if isinstance(wanted, str) else ""
    raise InputError(f"{source}: there is no sheet {wanted!r}{near}: the file has {', '.join(names)}")


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
