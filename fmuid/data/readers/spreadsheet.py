"""Spreadsheets: .xlsx, .xls and .ods; the head is found as in a text."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

from fmuid.data.headers import Cell, TableHeader, find_head, is_missing
from fmuid.data.readers.base import FileColumns, array_of_cells, chosen, library
from fmuid.errors import InputError
from fmuid.units import SECONDS

_CELL = re.compile(r"<c ([^>]*)><v>([-+.\deE]+)</v>")
_BEGINNING = 1_000_000
"""Bytes of a sheet in which cells are looked at, its first rows, and of its formats."""
_LOOKED_AT = 100
_DIGITS = 12
"""Significant digits, which times as people and recorders write them do not exceed."""


def read_spreadsheet(path: Path, source: str, sheet: str | int | None) -> FileColumns:
    """Read a sheet by its name or its place from 1; default: the first with a table.

    Raises
    ------
    InputError
        Where the file cannot be read, has no table or no such sheet.
    """
    book = library("python_calamine", "excel", source).CalamineWorkbook.from_path(path)
    for name in book.sheet_names if sheet is None else [chosen(book.sheet_names, sheet, source)]:
        rows = _without_margins(book.get_sheet_by_name(name).to_python())
        head = find_head(rows)
        if head is not None:
            return _columns(rows, head, path)
    which = "no sheet holds" if sheet is None else f"the sheet {sheet!r} does not hold"
    raise InputError(f"{source}: {which} a table: give a header with the names and rows of samples")


def _without_margins(rows: list[list[Cell]]) -> list[list[Cell]]:
    """Leave out rows and columns that are empty."""
    filled = [row for row in rows if not all(map(is_missing, row))]
    columns = [k for k in range(max(map(len, filled), default=0)) if not all(is_missing(row[k]) for row in filled)]
    return [[row[k] for k in columns] for row in filled]


def _columns(rows: list[list[Cell]], head: TableHeader, path: Path) -> FileColumns:
    samples = [[None if is_missing(cell) else cell for cell in row] for row in rows[head.first :]]
    cells = [[row[k] for row in samples] for k in range(len(head.names))]
    whole = _shown_as_whole(path)
    broken = [[each for each in column[:_LOOKED_AT] if isinstance(each, float) and each % 1] for column in cells]
    days = tuple(
        k for k, values in enumerate(broken) if values and (_are_days(values) if whole is None else values[0] in whole)
    )
    return FileColumns(head.names, tuple(map(array_of_cells, cells)), below=head.units, days=days)


def _shown_as_whole(path: Path) -> set[float] | None:
    """Return the numbers of .xlsx in cells of the format 0, which shows no decimals; None where formats are not known.

    So pandas writes durations, and hardly anybody else a number that is not whole.
    """
    if path.suffix.lower() not in (".xlsx", ".xlsm"):
        return None
    found: set[float] = set()
    with zipfile.ZipFile(path) as book:

        def beginning(name: str) -> str:
            with book.open(name) as file:
                return file.read(_BEGINNING).decode(errors="ignore")

        styles = beginning("xl/styles.xml") if "xl/styles.xml" in book.namelist() else ""
        formats = re.findall(r'<xf [^>]*?numFmtId="(\d+)"', styles.partition("<cellXfs")[2].partition("</cellXfs>")[0])
        whole = {f's="{k}"' for k, each in enumerate(formats) if each == "1"}
        for name in book.namelist() if whole else []:
            if name.startswith("xl/worksheets/sheet"):
                cells = _CELL.findall(beginning(name))
                found |= {float(value) for words, value in cells if whole & set(words.split())}
    return found


def _are_days(values: Sequence[float]) -> bool:
    """Return whether numbers have many digits and few when they are days counted in seconds.

    Numbers in s look so, too, where a rate has a factor of 3, as 48 kHz.
    """
    return not all(map(_is_short, values)) and all(_is_short(SECONDS["d"] * value) for value in values)


def _is_short(value: float) -> bool:
    return abs(value - float(f"{value:.{_DIGITS}g}")) <= 1e-15 * abs(value)
