"""Rows that only look like a table of samples: refused before they are read wrongly."""

from __future__ import annotations

import re
from collections.abc import Sequence

from fmuid.data.cells import is_number
from fmuid.data.headers import TableHeader
from fmuid.errors import InputError

_SCALES = re.compile(
    r"(scal(e|ing) ?factors?|gains?|factors?|multipliers?|skalierung(sfaktor)?|(umrechnungs)?faktor(en)?|gain factor"
    r"|conversion factors?|offsets?|y ?offset|facteur|factor de escala)",
    re.IGNORECASE,
)
"""First cells of lines that say how samples are to be scaled."""
_FIRST_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")
_IN_THOUSANDS = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+") for mark in ".,"}


def check_rows(rows: Sequence[Sequence[str]], head: TableHeader, decimal: str, source: str) -> None:
    """Refuse tables whose samples need what is beside them."""
    _check_levels(rows[max(head.first - 3, 0) : head.first], source)
    _check_scales(rows[: head.first + 2], source)
    for name, column in zip(head.names, zip(*_regular(rows[head.first :], head), strict=True), strict=False):
        _check_thousands(name, column, decimal, source)


def check_count(found: float, said: str, source: str) -> None:
    """Refuse a table with other rows than its head says."""
    count = float(said or found)
    if found != count:
        raise InputError(f"{source}: {found:g} rows of samples in place of {count:g}. Write the whole file again.")


def _regular(rows: Sequence[Sequence[str]], head: TableHeader) -> list[Sequence[str]]:
    return [row for row in rows if len(row) == len(head.names)]


def _check_levels(above: Sequence[Sequence[str]], source: str) -> None:
    """Refuse rows of cycles, steps and records, whose headers stand like stairs."""
    blanks = [next((k for k, cell in enumerate(row) if cell.strip()), 0) for row in above]
    if blanks == [0, 1, 2] and not any(is_number(cell) for row in above for cell in row):
        raise InputError(f"{source}: rows of three levels. Export the last one alone, with a total time.")


def _check_scales(rows: Sequence[Sequence[str]], source: str) -> None:
    """Refuse factors and offsets that nothing says are applied."""
    for row in rows:
        first, *others = re.split(r"\s*[:=]\s*", row[0].strip("\"' "), maxsplit=1) if row else [""]
        if not _SCALES.fullmatch(key := re.sub(r"[_\s]+", " ", first.partition("[")[0]).strip()):
            continue
        neutral = 0.0 if "offset" in key.lower() else 1.0
        said = [found[0] for cell in others if (found := _FIRST_NUMBER.search(cell))]
        said += [found[0] for cell in row[1:] if (found := _FIRST_NUMBER.match(cell.strip("\"' ")))]
        if any(float(each.replace(",", ".")) != neutral for each in said):
            values = ", ".join(said[:3])
            raise InputError(f"{source}: line {first!r} scales samples ({values}). Apply it, then remove the line.")


def _check_thousands(name: str, column: Sequence[str], decimal: str, source: str) -> None:
    """Refuse ``1.069`` beside ``122``: marks between thousands that read as decimals."""
    cells = [cell.strip() for cell in column]
    marked = [cell for cell in cells if decimal in cell]
    whole = {cell for cell in cells if cell.lstrip("+-").isdecimal()}
    if len(marked) < 5 or not all(map(_IN_THOUSANDS[decimal].fullmatch, marked)):
        return
    if len(whole) >= 5 and all(len(cell.lstrip("+-")) <= 3 and cell.lstrip("+-")[:1] != "0" for cell in whole):
        said = f"column {name!r}: {marked[0]!r} beside {min(whole)!r} may be thousands"
        raise InputError(f"{source}: {said}. Write numbers without marks between thousands.")
