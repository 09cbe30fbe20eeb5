"""Concordia and Park transforms between columns of frames (docs/method.md section 8).

The Concordia matrix is the power-invariant one: the instantaneous power of three phases is the same in two axes, and
a balanced set of peak value X becomes a vector of length sqrt(3/2) X. Every function returns a copy of the frame with
the new columns behind the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.tables import numeric_column
from fmuid.data.times import missing_column
from fmuid.errors import InputError

T23: Floats = np.sqrt(2 / 3) * np.array([[1, -1 / 2, -1 / 2], [0, np.sqrt(3) / 2, -np.sqrt(3) / 2]])
"""Concordia matrix, three phases to two axes; its rows are orthonormal, so its transpose is the way back."""
T23.setflags(write=False)


def concordia_transform(frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """Add the two axes of three phases: x_αβ = T₂₃ x_abc (docs/method.md section 8).

    The zero sequence (a + b + c)/√3 is lost; phases without a neutral wire have none.

    Parameters
    ----------
    frame : pandas.DataFrame
        K rows.
    columns : three names
        The phases, any unit.
    names : two names
        The new columns, in the same unit.

    Returns
    -------
    pandas.DataFrame
        The frame and the two new columns.

    Raises
    ------
    InputError
        Where a column is missing or no number, or a new one is already there.

    Examples
    --------
    >>> table = pd.DataFrame({"a": [2.0], "b": [-1.0], "c": [-1.0]})
    >>> fmuid.concordia_transform(table, ["a", "b", "c"], ["alpha", "beta"])["alpha"].round(4).tolist()
    [2.4495]
    """
    return _with_columns(frame, _columns(frame, columns, 3) @ T23.T, names, 2)


def inverse_concordia(frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """Add the three phases of two axes, without zero sequence: x_abc = T₂₃ᵀ x_αβ (docs/method.md section 8).

    As `concordia`, with the two axes as `columns` and the three phases, whose sum is zero, as `names`.
    """
    return _with_columns(frame, _columns(frame, columns, 2) @ T23, names, 3)


def park_transform(
    frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str], theta: str = "theta"
) -> pd.DataFrame:
    """Add the two axes, turning with `theta`, of three phases: x_dq = P(−θ) T₂₃ x_abc (docs/method.md section 8).

    With the electrical angle of the rotor these are Park's axes linked to the rotor. The zero sequence is lost.

    As `concordia`, with direct and quadrature axis as `names`.

    Parameters
    ----------
    theta : str
        The column of the electrical angle, rad: pole pairs times the mechanical angle.

    Examples
    --------
    >>> table = pd.DataFrame({"a": [2.0], "b": [-1.0], "c": [-1.0], "theta": [np.pi / 2]})
    >>> fmuid.park_transform(table, ["a", "b", "c"], ["d", "q"])["q"].round(4).tolist()
    [-2.4495]
    """
    fixed = _columns(frame, columns, 3) @ T23.T
    return _with_columns(frame, _turned(fixed, -_columns(frame, [theta], 1)[:, 0]), names, 2)


def inverse_park(
    frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str], theta: str = "theta"
) -> pd.DataFrame:
    """Add the three phases of two axes turning with `theta`: x_abc = T₂₃ᵀ P(θ) x_dq (docs/method.md section 8).

    As `park`, with direct and quadrature axis as `columns` and the three phases, whose sum is zero, as `names`.
    """
    turned = _turned(_columns(frame, columns, 2), _columns(frame, [theta], 1)[:, 0])
    return _with_columns(frame, turned @ T23, names, 3)


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """Return P(angle) x for each row, P(θ) = [cos θ, −sin θ; sin θ, cos θ]; shapes (K, 2) and (K,)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y])


def _columns(frame: pd.DataFrame, columns: Sequence[str], count: int) -> Floats:
    """Return `count` columns side by side."""
    _check_names("columns", columns, count)
    for column in columns:
        if column not in frame.columns:
            raise InputError(f"the frame: {missing_column('transformed', column, frame.columns)}")
    return np.column_stack([numeric_column(frame, column, "the frame") for column in columns])


def _with_columns(frame: pd.DataFrame, values: Floats, names: Sequence[str], count: int) -> pd.DataFrame:
    _check_names("names", names, count)
    for name in names:
        if name in frame.columns:
            raise InputError(f"the frame: there is a column {name!r} already: give the new column another name")
    return frame.assign(**dict(zip(names, values.T, strict=True)))


def _check_names(word: str, names: Sequence[str], count: int) -> None:
    if isinstance(names, str) or len(names) != count or len(set(names)) != count:
        raise InputError(f"the frame: {word} is {names!r}: give {count} different names")
