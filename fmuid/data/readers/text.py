"""Delimited text: encoding, separator and header are detected."""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import dropwhile
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from fmuid.data.cells import NO_SAMPLE, is_missing, is_number, may_be_number, numbers_of
from fmuid.data.headers import RawTable, check_once, is_unit, named, with_columns
from fmuid.data.readers.cell_units import without_units
from fmuid.data.readers.encodings import decoded
from fmuid.data.readers.instruments import head_of, rewriter_of
from fmuid.data.readers.legends import units_in_legend
from fmuid.data.readers.sidecars import rewriter_beside
from fmuid.data.readers.text_layout import TextLayout, count_of_cells, layout_of
from fmuid.data.readers.text_rows import SPACES, is_text_row, rows_of
from fmuid.data.readers.unpacking import opener
from fmuid.errors import InputError
from fmuid.formatting import bounded

_LOOKED_AT = 1 << 18
"""Bytes that are looked at to find separator and head."""
_END = 1 << 14
"""Bytes in which lines after the samples are looked for."""
_SPREADSHEET = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of .xlsx, .ods and .zip, and of .xls."""
_MINUS = "\u2212"
"""Sign of typesetters."""
_TOO_MANY = re.compile(r"in line (?P<row>\d+), saw (?P<cells>\d+)")
_OPEN_QUOTE = re.compile(r"inside string starting at row (?P<row>\d+)")
"""What pandas' parser says."""
_DAMAGED = (ValueError, LookupError, AttributeError, TypeError, StopIteration, RuntimeError, csv.Error)
"""Errors of readers of instruments on damaged texts."""
_MARKS = sorted({form for mark in NO_SAMPLE if "inf" not in mark for form in (mark, mark.upper(), mark.title())})


def read_text(path: Path, source: str) -> RawTable:
    """Read delimited text, plain or packed; the separator gives the most numeric columns."""
    opened = opener(path, source)
    with opened() as file:
        start = file.read(_LOOKED_AT)
    if start.startswith(_SPREADSHEET):
        raise InputError(f"{source}: is a spreadsheet or packed file. Name it .xlsx, .ods, .xls or .zip.")
    short = len(start) < _LOOKED_AT
    for encoding, text in decoded(start, whole=short):
        if "\0" in text:
            packed = start[257:262] == b"ustar"
            raise InputError(f"{source}: {'an archive' if packed else 'not a text file'}. Give a table.")
        if text.lstrip("\ufeff \t\r\n").startswith(("<!", "<?", "<html", "<HTML", "<table")):
            raise InputError(f"{source}: a page in HTML or XML. Save it as .xlsx or .csv.")
        if text.lstrip("\ufeff \t\r\n").upper().startswith(("CREATE TABLE", "INSERT INTO", "PRAGMA ", "BEGIN TRANS")):
            raise InputError(f"{source}: commands of SQL. Export the rows as CSV.")
        with suppress(UnicodeDecodeError):  # further down: the next encoding is tried
            again = _as_utf8(opened, encoding, text)
            rewrite = rewriter_beside(path, text.removeprefix("\ufeff"), source) or rewriter_of(
                text.removeprefix("\ufeff")
            )
            if rewrite is not None:
                with again() as file:
                    lines = file.read().decode("utf-8-sig").splitlines()
                again = partial(io.BytesIO, _as_table(rewrite, lines, source))
            again, clock = _with_head(again, text.removeprefix("\ufeff"), source)
            with again() as file:
                first = file.read(_LOOKED_AT)
            shown = codecs.getincrementaldecoder("utf-8-sig")().decode(first, final=len(first) < _LOOKED_AT)
            layout = layout_of(source, shown if short else shown[: shown.rfind("\n") + 1] or shown)
            names, said = named(layout.head.names, layout.head.units)
            blank = [f"\0 {k}" for k, name in enumerate(names) if not name]
            names = [name or f"\0 {k}" for k, name in enumerate(names)] if blank[1:] else names
            check_once(source, names)
            size, last = _ending(again)
            frame = _samples(_without_end(again, size, last, layout), source, layout, names)
            frame = frame.drop(columns=[name for name in blank if name in frame and frame[name].isna().all()])
            check_once(source, ["" if name in blank else str(name) for name in frame.columns])
            if clock is not None and pd.api.types.is_numeric_dtype(frame[names[0]].dtype):
                frame[names[0]] = clock[0] + clock[1] * frame[names[0]]
            for name in frame.select_dtypes(["object", "str"]).columns:
                frame[name], unit = without_units(frame[name], layout.decimal)
                said |= {} if unit is None else {name: unit}
            bare = [name for name in names if name not in said]
            below = (line.decode("utf-8", "replace") for line in last)
            said |= units_in_legend([*shown.splitlines()[: layout.line], *below], bare)
            if layout.head.step is not None:  # it may stand for an empty column of times
                frame = frame.loc[:, frame.notna().any()]
            return RawTable(frame, said, step=layout.head.step, rows=layout.head.rows)
    raise InputError(f"{source}: not text in UTF-8, UTF-16 or cp1252. Save it as UTF-8.")


def _as_table(rewrite: Callable[[Sequence[str], str], Iterator[str]], lines: Sequence[str], source: str) -> bytes:
    """Return the text of an instrument as a plain table."""
    try:
        return "\n".join(rewrite(lines, source)).encode()
    except _DAMAGED:
        raise InputError(f"{source}: damaged text of an instrument. Save it again, or as a plain table.") from None


def _with_head(
    opened: Callable[[], IO[bytes]], start: str, source: str
) -> tuple[Callable[[], IO[bytes]], tuple[float, float] | None]:
    """Return an opener with a plain head; start and step of numbered rows."""
    try:
        head = head_of(start)
    except _DAMAGED:
        raise InputError(f"{source}: damaged text of an instrument. Save it again, or as a plain table.") from None
    if head is None:
        return opened, None
    with opened() as file:
        rest = file.read().split(b"\n", head.count)[head.count :]
    return partial(io.BytesIO, b"\n".join(("\n".join(head.lines).encode(), *rest))), head.clock


def _as_utf8(opened: Callable[[], IO[bytes]], encoding: str, text: str) -> Callable[[], IO[bytes]]:
    """Return an opener of UTF-8 with line feeds."""
    bare = "\r\n" not in text and text.count("\r") > text.count("\n")  # line feeds may be in quoted headers
    if encoding == "utf-8-sig" and not bare and "\ufeff" not in text and _MINUS not in text:
        return opened
    decoder, found = codecs.getincrementaldecoder(encoding)(), io.BytesIO()
    with opened() as file:
        while part := file.read(_LOOKED_AT):  # in parts that stay in the cache
            piece = decoder.decode(part).replace("\ufeff", "").replace(_MINUS, "-")  # some loggers mark each line
            found.write((piece.replace("\r", "\n") if bare else piece).encode())
    found.write(decoder.decode(b"", final=True).encode())
    return partial(io.BytesIO, found.getvalue())


def first_lines(path: Path, count: int) -> list[str]:
    """Return at most `count` first lines of a text file."""
    with opener(path, str(path))() as file:
        start = file.read(_LOOKED_AT)
        text = next((text for _, text in decoded(start, whole=len(start) < _LOOKED_AT)), "\0")
    return [] if "\0" in text else text.splitlines()[:count]


def head_length(start: bytes, source: str) -> int:
    """Return the bytes before the first row of samples; `start` has whole lines, not UTF-16.

    Raises
    ------
    InputError
        If it is no table, or has no row of samples yet.
    """
    text = next((text for _, text in decoded(start, whole=True)), "")
    layout = layout_of(source, text)
    lines = start.splitlines(keepends=True)
    if not b"".join(lines[layout.line :]).strip():
        raise InputError(f"{source}: no samples below the header. Give measured samples.")
    return len(b"".join(lines[: layout.line]))


def _ending(opened: Callable[[], IO[bytes]]) -> tuple[int, list[bytes]]:
    """Return a text's size, and its last lines with their ends."""
    with opened() as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(size - _END, 0))
        return size, file.read().splitlines(keepends=True)[1:]


def _without_end(
    opened: Callable[[], IO[bytes]], size: int, last: Sequence[bytes], layout: TextLayout
) -> Callable[[], IO[bytes]]:
    """Return an opener without the lines after the samples."""
    end, lines = size, [*last]
    while lines and _says_nothing(lines[-1].decode("utf-8", "replace"), layout):
        end -= len(lines.pop())
    if end == size:
        return opened
    with opened() as file:
        return partial(io.BytesIO, file.read(end))


def _says_nothing(line: str, layout: TextLayout) -> bool:
    """Return whether a line has no sample and is no cut row."""
    row = next((row for _, row in rows_of(iter([line]), layout.separator)), [""])
    if all(map(is_missing, row)):
        return True
    numeric = any(is_number(cell, layout.decimal) for cell in row)
    if layout.separator == SPACES and len(row) > 2 and is_text_row(row, layout.decimal):  # a sentence has spaces
        return True
    return len(row) < layout.width and not numeric and not line.lstrip("\"'+- ")[:1].isdigit()


def _parsed(opened: Callable[[], IO[bytes]], layout: TextLayout, names: list[str], *, fast: bool) -> pd.DataFrame:
    """Return the rows as pandas reads them; `fast` in parts, without spaces."""

    def read(source: IO[bytes] | str, above: int) -> pd.DataFrame:
        frame: pd.DataFrame = pd.read_csv(
            source,
            header=None,
            skiprows=above,
            names=[*names, *(f"\0{k}" for k in range(layout.width - len(names)))],
            index_col=False,
            sep=layout.separator,
            decimal=layout.decimal,
            na_values=_MARKS,
            skipinitialspace=not fast,
            low_memory=fast,
            parse_dates=[names[k] for k in layout.dates] if fast else False,
            date_format="ISO8601",
        )[names]
        return frame

    with opened() as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)
        warnings.simplefilter("error", pd.errors.ParserWarning)  # more cells than names in the first row
        above = [file.readline() for _ in range(layout.line)]
        odd = any(b'"' in line or b"\r" in line.removesuffix(b"\r\n") for line in above)  # pandas counts them otherwise
        if isinstance(file, io.BufferedReader) and above and not odd:
            with suppress(pd.errors.ParserError, pd.errors.ParserWarning):  # its rows are named below
                return read(file.name, layout.line)  # in half the time
        return read(file, 0)


def _samples(opened: Callable[[], IO[bytes]], source: str, layout: TextLayout, names: list[str]) -> pd.DataFrame:
    try:
        frame = _parsed(opened, layout, names, fast=layout.fast)
        if layout.fast and any(map(pd.api.types.is_object_dtype, frame.dtypes)):  # numbers here, texts there
            frame = _parsed(opened, layout, names, fast=False)
    except pd.errors.EmptyDataError:  # a header alone; how few rows there are is said by who needs them
        return pd.DataFrame({name: [] for name in names})
    except (csv.Error, pd.errors.ParserError, pd.errors.ParserWarning) as error:
        _check_block(opened, layout, source)
        raise InputError(f"{source}: {_of_parser(str(error), layout.width)}") from None
    rows = len(frame)
    if not any(map(pd.api.types.is_numeric_dtype, frame.dtypes)):  # parts put together, each with the header
        frame = frame[~(frame == list(layout.head.names)).all(axis="columns")].reset_index(drop=True)
    frame = with_columns(frame, partial(as_numbers, decimal=layout.decimal))
    last = frame[names[-1]]
    uneven = last.hasnans and not _are_even(
        opened, layout, rows, remark=last.count() == 1 and bool(last.notna().iloc[0])
    )
    if uneven or not any(map(pd.api.types.is_numeric_dtype, frame.dtypes)):
        _check_block(opened, layout, source)
    if uneven:
        with io.TextIOWrapper(opened(), "utf-8-sig", newline="") as text:
            _check_rows((row for _, row in rows_of(text, layout.separator)), source, layout.width, layout.head.first)
    return frame


def _check_block(opened: Callable[[], IO[bytes]], layout: TextLayout, source: str) -> None:
    """Refuse lines of text among the samples, as between two tables."""
    with io.TextIOWrapper(opened(), "utf-8-sig", newline="") as text, suppress(csv.Error):
        rows = ((line, row) for line, row in rows_of(text, layout.separator) if line > layout.line)
        samples = dropwhile(lambda each: is_text_row(each[1], layout.decimal), rows)
        found = next(((line, row) for line, row in samples if is_text_row(row, layout.decimal)), None)
    if found is not None and all(is_unit(cell.strip("[]() ")) for cell in found[1]):
        raise InputError(f"{source}: line {found[0]} has units. Move it below the header.")
    if found is not None:
        said = f"line {found[0]} among the samples has no number ({bounded(' '.join(found[1]).strip(), 30)!r})"
        raise InputError(f"{source}: {said}. Remove it, or keep one table in a file.")


def _are_even(opened: Callable[[], IO[bytes]], layout: TextLayout, rows: int, *, remark: bool) -> bool:
    """Return whether rows without quotes have all cells; with a remark, the first alone has the last one.

    None has more, or pandas would refuse it.
    """
    found, blank = 0, np.ones(1, bool)
    spaces = layout.separator == SPACES
    with opened() as file:
        for _ in range(layout.line):
            file.readline()
        while part := file.read(_LOOKED_AT):
            if b'"' in part:
                return False
            codes = np.frombuffer(part, np.uint8)
            if spaces:
                blank = np.concatenate([blank[-1:], (codes <= 32)])
                found += int(np.count_nonzero(blank[:-1] & ~blank[1:]))
            else:
                found += int(np.count_nonzero(codes == ord(layout.separator)))
    found += 0 if spaces else rows
    return found == rows * layout.width or (remark and found == rows * (layout.width - 1) + 1)


def _of_parser(error: str, width: int) -> str:
    """Return what pandas' parser found, in our words."""
    if found := _TOO_MANY.search(error):
        said = f"{width} names in the header, {count_of_cells(int(found['cells']))} in row {found['row']}"
        return f"{said}. Give all rows as many cells as the header."
    if found := _OPEN_QUOTE.search(error):
        return f"a quotation mark in row {int(found['row']) + 1} is not closed. Close or remove it."
    return "no table. Give all rows as many cells as the header."


def as_numbers(column: pd.Series[Any], decimal: str) -> pd.Series[Any]:
    """Return a numeric column, NaN where marked as missing; else unchanged."""
    if pd.api.types.is_numeric_dtype(column.dtype):
        return column
    there = column.dropna()
    first = there.iloc[0] if len(there) else None
    if not isinstance(first, str) or not (is_missing(first) or may_be_number(first, decimal)):
        return column
    if not all(isinstance(cell, str) for cell in there.tolist()):
        return column
    marked = column.where(~column.map(lambda cell: isinstance(cell, str) and is_missing(cell)))
    texts = marked.dropna()
    numbers = numbers_of(texts, decimal)
    if numbers is not None:
        return pd.Series(numbers, texts.index, dtype=np.float64).reindex(column.index)
    if decimal == ".":
        return marked
    return marked.map(lambda cell: cell.replace(",", ".") if isinstance(cell, str) and is_number(cell, ",") else cell)


def _check_rows(rows: Iterator[list[str]], source: str, names: int, first: int) -> None:
    """Refuse rows with too few cells, which pandas would fill."""
    for number, row in enumerate(rows, start=1 - first):
        if number > 0 and len(row) < names:
            said = f"{names} names in the header, {count_of_cells(len(row))} in row {number}"
            raise InputError(f"{source}: {said}. Leave missing cells empty.")
