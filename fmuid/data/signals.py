"""Excitations, and the Concordia and Park transforms (docs/method/induction-machine.md).

Excitations are frames of ``time`` and an input, whose last sample is one step before the end. The Concordia matrix
keeps power: a balanced set of peak X becomes a vector of length sqrt(3/2) X.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data.column_lookup import missing_column
from fmuid.data.data_file import numeric_column
from fmuid.data.priors import checked_number
from fmuid.errors import InputError

SAMPLE_TOLERANCE = 1e-6
"""Share of a sample by which a duration may differ from a whole number of them: both are rounded decimals."""
T23: Floats = np.sqrt(2 / 3) * np.array([[1, -1 / 2, -1 / 2], [0, np.sqrt(3) / 2, -np.sqrt(3) / 2]])
"""Concordia matrix, three phases to two axes; its rows are orthonormal, so its transpose is the way back."""
T23.setflags(write=False)


def prbs(
    duration: float,
    step: float,
    amplitude: float,
    bit: int,
    *,
    order: int | None = None,
    seed: int = 0,
    offset: float = 0.0,
    column: str = "u",
) -> pd.DataFrame:
    """Return a pseudo-random binary sequence, offset ± amplitude.

    Its autocorrelation is nearly that of white noise, of bandwidth about 0.44/(bit·step) (L. Ljung, System
    Identification, 2nd edition, section 13.3).

    Parameters
    ----------
    duration, step : float
        Length and sampling interval, s.
    amplitude, offset : float
        Half the distance of the two levels and their middle, in the unit of the input.
    bit : int
        Samples per bit.
    order : int, optional
        Order of the shift register, 2 to 32. Default: the smallest with a period of at least the duration.
    seed : int
        Seed of the first bit's place in the period.
    column : str
        Name of the column.

    Returns
    -------
    pandas.DataFrame
        ``time`` (s) and the column, duration/step rows.

    Raises
    ------
    InputError
        If an argument is out of its range.

    Examples
    --------
    >>> fmuid.signals.prbs(1.0, 0.1, 12.0, bit=2, order=3)["u"].tolist()
    [-12.0, -12.0, 12.0, 12.0, 12.0, 12.0, 12.0, 12.0, -12.0, -12.0]
    """
    from scipy.signal import max_len_seq  # slow to import

    times = _times(duration, step, column, amplitude=amplitude, offset=offset)
    bit = _whole(bit, "bit, the samples of one bit,", 1, times.size)
    bits = -(-times.size // bit)
    order = max(2, bits.bit_length()) if order is None else _whole(order, "order", 2, 32)  # those of scipy
    state = int(np.random.default_rng(_whole(seed, "seed", 0)).integers(1, 2**order))
    sequence, _ = max_len_seq(order, [state >> k & 1 for k in range(order)], bits)
    values = offset + amplitude * (2.0 * np.repeat(sequence, bit)[: times.size] - 1.0)
    return pd.DataFrame({"time": times, column: values})


def multisine(
    duration: float,
    step: float,
    amplitude: float,
    lowest: float,
    highest: float,
    *,
    period: float | None = None,
    offset: float = 0.0,
    column: str = "u",
) -> pd.DataFrame:
    """Return equal cosines at all multiples of 1/period in a band.

    Schroeder's phases -π k(k-1)/n of the k-th of n lines keep the peak low (M. R. Schroeder, IEEE Trans. Information
    Theory 16, 1970).

    Parameters
    ----------
    duration, step, offset, column
        As in `prbs`.
    amplitude : float
        Largest distance from the offset, in the unit of the input.
    lowest, highest : float
        Band, Hz, below half the sampling frequency.
    period : float, optional
        Period, s. Default: the duration.

    Returns
    -------
    pandas.DataFrame
        As `prbs`.

    Raises
    ------
    InputError
        If an argument is out of its range, or no line lies in the band.

    Examples
    --------
    >>> signal = fmuid.signals.multisine(1.0, 1e-3, 12.0, lowest=1.0, highest=50.0)
    >>> float(round(signal["u"].abs().max(), 6))
    12.0
    """
    times = _times(duration, step, column, amplitude=amplitude, offset=offset)
    period = duration if period is None else _positive(period, "period")
    _positive(lowest, "lowest")
    if not lowest <= _positive(highest, "highest") < 0.5 / step:
        allowed = f"from lowest, {lowest:g} Hz, to below half the sampling rate, {0.5 / step:g} Hz"
        raise InputError(f"highest {highest:g} Hz must be {allowed}. Change the band or sample faster.")
    first, last = math.ceil(lowest * period - SAMPLE_TOLERANCE), math.floor(highest * period + SAMPLE_TOLERANCE)
    if last < first:
        said = f"no multiple of 1/period = {1 / period:g} Hz from {lowest:g} to {highest:g} Hz"
        raise InputError(f"{said}. Make period longer or the band wider.")
    values = np.zeros(times.size)
    for k, line in enumerate(range(first, last + 1)):
        values += np.cos(2.0 * np.pi * line / period * times - np.pi * k * (k + 1) / (last + 1 - first))
    return pd.DataFrame({"time": times, column: offset + amplitude / np.abs(values).max() * values})


def step_sequence(
    duration: float,
    step: float,
    levels: Sequence[float],
    *,
    times: Sequence[float] | None = None,
    offset: float = 0.0,
    column: str = "u",
) -> pd.DataFrame:
    """Return levels that follow each other.

    Parameters
    ----------
    duration, step, offset, column
        As in `prbs`; the offset is added to all levels.
    levels : sequence of float
        n values, in the unit of the input.
    times : sequence of float, optional
        Begin of each level, s, the first 0. Default: equally long levels.

    Returns
    -------
    pandas.DataFrame
        As `prbs`.

    Raises
    ------
    InputError
        If an argument is out of its range, or a level would have no sample.

    Examples
    --------
    >>> fmuid.signals.step_sequence(0.4, 0.1, [0.0, 12.0])["u"].tolist()
    [0.0, 0.0, 12.0, 12.0]
    """
    clock = _times(duration, step, column, offset=offset)
    heights = np.array([checked_number(level, "a level") for level in levels])
    if not 1 <= heights.size <= clock.size:
        raise InputError(f"{heights.size} levels do not fit {clock.size} samples. Give 1 to {clock.size}.")
    if times is None:
        first = np.arange(heights.size) * clock.size // heights.size
    else:
        begins = np.array([checked_number(begin, "a time") for begin in times])
        if begins.size != heights.size:
            raise InputError(f"{heights.size} levels but {begins.size} times. Give one time for each level.")
        first = np.ceil(begins / step - SAMPLE_TOLERANCE)
        if first[0] != 0 or (np.diff(first) <= 0).any() or first[-1] >= clock.size:
            raise InputError(f"times must begin with 0, be at least a sample apart and end before {duration:g} s.")
    which = np.searchsorted(first, np.arange(clock.size), side="right") - 1
    return pd.DataFrame({"time": clock, column: offset + heights[which]})


def _times(duration: float, step: float, column: str, **numbers: float) -> Floats:
    """Return the sample times after checks that all excitations need."""
    if not column or column == "time":
        raise InputError(f"column: {column!r} is not allowed. Give another name.")
    samples = _positive(duration, "duration") / _positive(step, "step")
    if samples > 1e8:  # the memory would not hold them
        raise InputError(f"duration {duration:g} s has {samples:g} samples of {step:g} s. Give both in seconds.")
    count = round(samples)
    if count < 2 or abs(samples - count) > SAMPLE_TOLERANCE:
        said = f"duration {duration:g} s is {samples:g} samples of {step:g} s"
        raise InputError(f"{said}. Give a whole number, two or more.")
    for name, value in numbers.items():
        checked_number(value, name)
    return float(step) * np.arange(count, dtype=np.float64)


def _positive(value: float, what: str) -> float:
    if not checked_number(value, what) > 0:
        raise InputError(f"{what} must be greater than 0, not {value!r}.")
    return float(value)


def _whole(value: int, what: str, least: int, most: int | None = None) -> int:
    within = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not within or value < least or (most is not None and value > most):
        upper = f" from {least} to {most}" if most is not None else f", {least} or more"
        raise InputError(f"{what} must be a whole number{upper}, not {value!r}.")
    return int(value)


def concordia_transform(frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """Add the two axes of three phases, x_αβ = T₂₃ x_abc.

    The zero sequence (a + b + c)/√3 is lost; phases without a neutral wire have none.

    Parameters
    ----------
    frame : pandas.DataFrame
        K rows.
    columns : three names
        Phases, in any unit.
    names : two names
        New columns, in the same unit.

    Returns
    -------
    pandas.DataFrame
        Frame with the new columns.

    Raises
    ------
    InputError
        If a column is missing or not numeric, or a new one exists.

    Examples
    --------
    >>> table = pd.DataFrame({"a": [2.0], "b": [-1.0], "c": [-1.0]})
    >>> fmuid.signals.concordia_transform(table, ["a", "b", "c"], ["alpha", "beta"])["alpha"].round(4).tolist()
    [2.4495]
    """
    return _with_columns(frame, _columns(frame, columns, 3) @ T23.T, names, 2)


def inverse_concordia(frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    """Add the three phases of two axes, x_abc = T₂₃ᵀ x_αβ.

    As `concordia_transform`, from two columns to three, whose sum is zero.

    Examples
    --------
    >>> axes = pd.DataFrame({"alpha": [np.sqrt(6.0)], "beta": [0.0]})
    >>> fmuid.signals.inverse_concordia(axes, ["alpha", "beta"], ["a", "b", "c"])["b"].round(4).tolist()
    [-1.0]
    """
    return _with_columns(frame, _columns(frame, columns, 2) @ T23, names, 3)


def park_transform(
    frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str], theta: str = "theta"
) -> pd.DataFrame:
    """Add the turning axes of three phases, x_dq = P(−θ) T₂₃ x_abc.

    As `concordia_transform`, with direct and quadrature axis as `names`. `theta` is the column of the electrical
    angle, rad: pole pairs times the mechanical angle.

    Examples
    --------
    >>> table = pd.DataFrame({"a": [2.0], "b": [-1.0], "c": [-1.0], "theta": [np.pi / 2]})
    >>> fmuid.signals.park_transform(table, ["a", "b", "c"], ["d", "q"])["q"].round(4).tolist()
    [-2.4495]
    """
    fixed = _columns(frame, columns, 3) @ T23.T
    return _with_columns(frame, _turned(fixed, -_columns(frame, [theta], 1)[:, 0]), names, 2)


def inverse_park(
    frame: pd.DataFrame, columns: Sequence[str], names: Sequence[str], theta: str = "theta"
) -> pd.DataFrame:
    """Add the three phases of turning axes, x_abc = T₂₃ᵀ P(θ) x_dq.

    As `park_transform`, from two columns to three, whose sum is zero.

    Examples
    --------
    >>> axes = pd.DataFrame({"d": [0.0], "q": [-np.sqrt(6.0)], "theta": [np.pi / 2]})
    >>> fmuid.signals.inverse_park(axes, ["d", "q"], ["a", "b", "c"])["a"].round(4).tolist()
    [2.0]
    """
    turned = _turned(_columns(frame, columns, 2), _columns(frame, [theta], 1)[:, 0])
    return _with_columns(frame, turned @ T23, names, 3)


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """Return P(angle) x of each row, P(θ) = [cos θ, −sin θ; sin θ, cos θ]; (K, 2)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y])


def _columns(frame: pd.DataFrame, columns: Sequence[str], count: int) -> Floats:
    _check_names("columns", columns, count)
    for column in columns:
        if column not in frame.columns:
            raise InputError(f"the frame: {missing_column('transformed', column, frame.columns)}")
    return np.column_stack([numeric_column(frame, column, "the frame") for column in columns])


def _with_columns(frame: pd.DataFrame, values: Floats, names: Sequence[str], count: int) -> pd.DataFrame:
    _check_names("names", names, count)
    for name in names:
        if name in frame.columns:
            raise InputError(f"the frame: column {name!r} exists already. Choose another name.")
    return frame.assign(**dict(zip(names, values.T, strict=True)))


def _check_names(word: str, names: Sequence[str], count: int) -> None:
    if isinstance(names, str) or len(names) != count or len(set(names)) != count:
        raise InputError(f"the frame: {word} = {names!r}. Give {count} different names.")
