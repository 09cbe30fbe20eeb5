"""Spreadsheets: .xlsx, .xls and .ods."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fmuid.data.cells import Cell, is_missing, may_be_number, numbers_of
from fmuid.data.headers import TableHeader, check_units, find_head
from fmuid.data.readers.base import FileColumns, array_of_cells, chosen, library
from fmuid.errors import InputError
from fmuid.units import SECONDS

_CELL = re.compile(r"<c ([^>]*)><v>([-+.\deE]+)</v>")


def read_spreadsheet(path: Path, source: str, sheet: str | int | None) -> FileColumns:
    """Read a sheet by name or place from 1; default: the first that is no summary of a ten times longer one."""
    book = library("python_calamine", "excel", source).CalamineWorkbook.from_path(path)
    tables: list[tuple[list[list[Cell]], TableHeader]] = []
    found: dict[tuple[str, ...], list[str]] = {}
    for name in book.sheet_names if sheet is None else [chosen(book.sheet_names, sheet, source)]:
        filled = [row for row in book.get_sheet_by_name(name).to_python() if not all(map(is_missing, row))]
        widest = range(max(map(len, filled), default=0))
        columns = [k for k in widest if not all(is_missing(row[k]) for row in filled)]
        rows = [[row[k] for k in columns] for row in filled]
        head = find_head(rows) or find_head(rows, ",")
        if head is not None:
            tables.append(_without_notes(rows[head.first :], head))
            found.setdefault(head.names, []).append(name)
    if not tables:
        which = "no sheet holds" if sheet is None else f"the sheet {sheet!r} does not hold"
        raise InputError(f"{source}: {which} a table. Give a header with names, and rows of samples.")
    longest = max(len(samples) for samples, _ in tables)
    samples, head = next(each for each in tables if 10 * len(each[0]) >= longest)
    if len(alike := found.get(head.names, [])) > 1:
        raise InputError(f"{source}: {len(alike)} sheets of one layout: {', '.join(alike[:5])}. Choose one by sheet.")
    check_units(head, source)
    for k, row in enumerate(samples, start=1):
        texts = [cell for cell in row if isinstance(cell, str) and not is_missing(cell)]
        if 2 * sum(not (may_be_number(cell, ".") or may_be_number(cell, ",")) for cell in texts) > len(row):
            raise InputError(f"{source}: row {k} of the samples has no number. Keep one table in a sheet.")
    return _columns(samples, head, path)


def _without_notes(rows: list[list[Cell]], head: TableHeader) -> tuple[list[list[Cell]], TableHeader]:
    """Return samples and header without columns of titles and notes."""
    kept = [k for k, name in enumerate(head.names) if name or sum(not is_missing(row[k]) for row in rows) > 1]
    if len(kept) in (0, len(head.names)):
        return rows, head
    units = tuple(head.units[k] for k in kept) if len(head.units) == len(head.names) else head.units
    return [[row[k] for k in kept] for row in rows], replace(
        head, names=tuple(head.names[k] for k in kept), units=units
    )


def _columns(rows: list[list[Cell]], head: TableHeader, path: Path) -> FileColumns:
    samples = [[None if is_missing(cell) else cell for cell in row] for row in rows]
    cells = [_numbers([row[k] for row in samples]) for k in range(len(head.names))]
    whole = _shown_as_whole(path)
    broken = [[each for each in column[:100] if isinstance(each, float) and each % 1] for column in cells]
    days = tuple(
        k for k, values in enumerate(broken) if values and (_are_days(values) if whole is None else values[0] in whole)
    )
    return FileColumns(head.names, tuple(map(array_of_cells, cells)), below=head.units, days=days)


def _numbers(cells: list[Cell]) -> list[Cell]:
    """Return cells whose texts are all numbers as these."""
    there = [cell for cell in cells if isinstance(cell, str)]
    if not there or len(there) < len(cells) - cells.count(None):
        return cells
    found = numbers_of(there, ".") or numbers_of(there, ",")
    numbers = iter(found or ())
    return [None if cell is None else next(numbers) for cell in cells] if found else cells


def _shown_as_whole(path: Path) -> set[float] | None:
    """Return the numbers of .xlsx shown without decimals, as pandas writes durations; None if unknown."""
    if path.suffix.lower() not in (".xlsx", ".xlsm"):
        return None
    found: set[float] = set()
    with zipfile.ZipFile(path) as book:

        def beginning(name: str) -> str:
            with book.open(name) as file:
                return file.read(1_000_000).decode(errors="ignore")

        styles = beginning("xl/styles.xml") if "xl/styles.xml" in book.namelist() else ""
        formats = re.findall(r'<xf [^>]*?numFmtId="(\d+)"', styles.partition("<cellXfs")[2].partition("</cellXfs>")[0])
        whole = {f's="{k}"' for k, each in enumerate(formats) if each == "1"}
        for name in book.namelist() if whole else []:
            if name.startswith("xl/worksheets/sheet"):
                cells = _CELL.findall(beginning(name))
                found |= {float(value) for words, value in cells if whole & set(words.split())}
    return found


def _are_days(values: Sequence[float]) -> bool:
    """Return whether numbers have few digits only as days counted in seconds."""
    return not all(map(_is_short, values)) and all(_is_short(SECONDS["d"] * value) for value in values)


def _is_short(value: float) -> bool:
    return abs(value - float(f"{value:.12g}")) <= 1e-15 * abs(value)
