"""Values far beyond all others: marks of missing samples and overload, never fitted in silence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError


@dataclass(frozen=True)
class FarValueSettings:
    """Numbers of the decision."""

    beyond: float = 1e4  # times the size of the rest: no measured value
    mark_beyond: float = 10.0  # times the same, for marks that loggers write among whole numbers
    mark_apart: float = 0.2  # times the same, for marks written twice among fractions: clipped samples have neighbours
    mark_alone: float = 2.0  # times the same, for a mark written once among fractions
    share: float = 0.2  # of the samples that may be marks


SETTINGS = FarValueSettings()
COMMON_MARKS = (
    *(-99.0, -999.0, -9999.0, -99999.0, -999999.0, 999.0, 9999.0, 99999.0, 999999.0, -99.99, -999.9, -999.99),
    *(-999.25, -9999.9, 9999.9, 8888.0, 7777.0, -7999.0, 7999.0, -32768.0, 32767.0, 65535.0, -2147483648.0),
    2147483647.0,
)
"""Numbers that loggers write for no sample."""


@np.errstate(over="ignore")
def far_values(values: Floats) -> dict[float, int]:
    """Return values far beyond all others, with their number: repeated marks, and what is 10⁴ times the rest."""
    there = values[np.isfinite(values)]
    if there.size < 3:
        return {}
    scaled = there / max(float(np.abs(there).max()), 1e-300)  # sums of huge values overflow
    distances = np.abs(scaled - np.median(scaled))
    order = np.sort(distances)
    first = max(int((1 - SETTINGS.share) * order.size), 1)
    rest, above = order[first - 1 : -1], order[first:]
    jumps = np.flatnonzero((rest > 0) & (above > SETTINGS.beyond * rest))
    if jumps.size:
        found, counts = np.unique(there[distances > rest[jumps[0]]], return_counts=True)
        return dict(zip(found.tolist(), counts.tolist(), strict=True))
    marks: dict[float, int] = {}
    for mark in COMMON_MARKS:
        same = there == mark
        if not same.any():
            continue
        others = there[~same]
        if others.size < 2 or same.mean() > SETTINGS.share:
            continue
        size = max(float(np.ptp(others)), 0.1 * float(np.abs(others).max()))
        whole = float((others == np.round(others)).mean()) > 0.5
        fractions = SETTINGS.mark_apart if same.sum() > 1 else SETTINGS.mark_alone
        if np.abs(others - mark).min() > (SETTINGS.mark_beyond if whole else fractions) * size > 0:
            marks[mark] = int(same.sum())
    return marks


def check_values(values: Floats, column: str, source: str) -> None:
    """Refuse values far beyond all others.

    Raises
    ------
    InputError
        If there are some.
    """
    found = far_values(values)
    if found:
        value, count = max(found.items(), key=lambda each: each[1])
        listed = ", ".join(f"{each:g}" for each in [*found][:3])
        said = f"column {column!r}: {count} sample{'s are' if count > 1 else ' is'} {value:g}, far beyond all others"
        raise InputError(f"{source}: {said}. Set missing = [{listed}], or missing = [] to use them.")
