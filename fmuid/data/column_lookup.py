"""Columns by the names that users give."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fmuid.data.headers import split_header
from fmuid.formatting import nearest

_LISTED_NAMES = 12
"""Names listed in a message."""


def column_of(columns: Iterable[object], wanted: str) -> str | None:
    """Return the column of a name, with or without its unit; None if missing."""
    names = [str(each) for each in columns]
    return next((each for each in (wanted, split_header(wanted)[0]) if each in names), None)


def missing_column(
    role: str,
    column: str,
    known: Iterable[object],
    remedy: str = "Name the right column.",
    left_out: Mapping[str, str] | None = None,
) -> str:
    """Return the sentences on a missing column, with reason or near names."""
    if left_out and column in left_out:
        return f"{role} column {column!r} was not read: {left_out[column]}. Save it with its times, or resample it."
    names = [str(name) or "(no name)" for name in known]
    listed = ", ".join(names[:_LISTED_NAMES]) + (", …" if len(names) > _LISTED_NAMES else "")
    found = nearest(column, names) or f" (columns: {listed or 'nothing numeric'})"
    return f"{role} column {column!r} not found{found}. {remedy}"
