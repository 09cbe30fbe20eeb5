"""Phrases that topics share: directions that the data leave open, doubts about data files and earlier results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fmuid.estimation import Identifiability, WeakDirection
from fmuid.formatting import listed, two_digits
from fmuid.identification import TimeScaleMismatch
from fmuid.studies import SourceIssue

if TYPE_CHECKING:
    from fmuid.identification import TimeScaleWarning
    from fmuid.studies import SourceWarning

# Steps along a direction are told in percent of values, but of magnitudes where values are below this share of them.
# The largest is 1 %, which is small enough for the linear model: that of the first parameter within this share of it.
NEAR_ZERO_SHARE, AS_LARGE_SHARE = 0.5, 0.99
# Beyond so many magnitudes a standard deviation is told in its unit: a percentage of next to nothing says nothing.
FAR_MAGNITUDES = 10.0
# Of all coefficients, so many digits are shown.
DIGITS = 3


def direction_words(direction: WeakDirection) -> str:
    """Say in words what is not known along a direction."""
    if direction.determined in (Identifiability.NOT, Identifiability.HIDDEN):
        return _lost(direction)
    return _open(direction) if direction.determined is Identifiability.NOT_IN_EFFECT else _weak(direction)


def open_words(determined: Identifiability, names: Sequence[str]) -> str:
    """Say in words, without numbers, which parameters the data leave open."""
    effect = " in effect" if determined is Identifiability.NOT_IN_EFFECT else ""
    return f"{listed(names)} {'is not determined' if len(names) == 1 else 'cannot be told apart'}{effect}"


def _lost(direction: WeakDirection) -> str:
    names = direction.names
    who = listed(names)
    no_output = "no output"
    if direction.determined is Identifiability.HIDDEN:
        no_output = "the outputs by no more than the simulation's errors"
    if len(names) == 1:
        return f"{who} is not determined: changing it changes {no_output}"
    only = _combinations(direction)
    if len(names) == 2:
        return f"{who} cannot be told apart: only {only} is determined"
    pairs = list(zip(direction.values, direction.magnitudes, strict=True))
    sizes = [abs(value) if abs(value) > NEAR_ZERO_SHARE * magnitude else magnitude for value, magnitude in pairs]
    shares = [c / size for c, size in zip(direction.coefficients, sizes, strict=True)]
    largest = max(map(abs, shares))
    first = next(i for i, share in enumerate(shares) if abs(share) >= AS_LARGE_SHARE * largest)
    shares = [share / shares[first] for share in shares]
    # a percentage of what is negative or near zero would mislead
    steps = [
        f"{abs(share):.{DIGITS}g} %" + ("" if value >= size else f" of its magnitude {size:.{DIGITS}g}")
        for share, value, size in zip(shares, direction.values, sizes, strict=True)
    ]
    moves = [
        f"{name} {'rises' if share > 0 else 'falls'} by {step}"
        for i, (name, share, step) in enumerate(zip(names, shares, steps, strict=True))
        if i != first
    ]
    return (
        f"{who} cannot be told apart: raising {names[first]} by {steps[first]} while {listed(moves)} changes "
        f"{no_output}; only {only} are determined"
    )


def _open(direction: WeakDirection) -> str:
    who, std = listed(direction.names), f"{direction.std:.{DIGITS}g}"
    if len(direction.names) == 1:
        return f"{who} is not determined in effect: its standard deviation is {std} times its magnitude"
    return (
        f"{who} cannot be told apart in effect: only {_combinations(direction)} {_verb(direction)} determined, and "
        f"their standard deviation together is {std} times their magnitude"
    )


def _weak(direction: WeakDirection) -> str:
    who, std = listed(direction.names), f"{direction.std:.0%}"
    if len(direction.names) == 1 and direction.std > FAR_MAGNITUDES:  # it happens to lie near zero, as at a bound
        own = direction.std * abs(direction.coefficients[0])
        return f"{who} is hardly determined: its standard deviation, {own:.{DIGITS}g}, is far more than its value"
    if len(direction.names) == 1:
        return f"{who} is hardly determined: its standard deviation is {std} of its magnitude"
    return (
        f"{who} can hardly be told apart: {_combinations(direction)} {_verb(direction)} determined better than each "
        f"of them, whose standard deviation together is {std} of their magnitude"
    )


def _verb(direction: WeakDirection) -> str:
    return "is" if len(direction.names) == 2 else "are"


def _combinations(direction: WeakDirection) -> str:
    """Return the combinations that stay the same along a direction: θ_i − (v_i/v_last) θ_last."""
    last = direction.coefficients[-1]
    shares = [-coefficient / last for coefficient in direction.coefficients[:-1]]
    return listed(
        [
            f"{name} {'-' if share < 0 else '+'} {_times(abs(share), direction.names[-1])}"
            for name, share in zip(direction.names[:-1], shares, strict=True)
        ]
    )


def _times(factor: float, name: str) -> str:
    shown = f"{factor:.{DIGITS}g}"
    return name if shown == "1" else f"{shown} {name}"


# --- data files and earlier results ---------------------------------------------------------

SHOWN_DROPOUTS = 3


def dropout_words(source: str, times: Sequence[float]) -> str:
    """Return where rows of a table are missing, by the times before, s, and what is made of that."""
    some = ", ".join(f"{time:.6g}" for time in times[:SHOWN_DROPOUTS]) + (", …" if len(times) > SHOWN_DROPOUTS else "")
    return f"{source}: rows are missing after t = {some} s; inputs go on there as between any samples"


def time_words(doubt: TimeScaleWarning) -> str:
    """Return why the unit of a record's time is to be looked at."""
    lasts = f"{doubt.source} lasts {doubt.duration:.3g} s in steps of {doubt.step:.3g} s"
    look = 'look at the unit of its time, and say it by time_unit = "ms" or what it is'
    match doubt.kind:
        case TimeScaleMismatch.TOO_LONG:
            return f"{lasts}, and what the model does is over in {doubt.time_constant:.2g} s (ms?): {look}"
        case TimeScaleMismatch.TOO_SHORT:
            return f"{lasts}, and the model takes {doubt.time_constant:.2g} s for what it does (s, not ms?): {look}"


def size_words(source: str, column: str, ratio: float) -> str:
    """Return why the units of a record are to be looked at: so many times as far moves the model at its own values."""
    return (
        f"{source}: at the FMU's own values what {column!r} measures moves {two_digits(ratio)} times as far as "
        'measured: look at the units of its column and of the inputs\', and say them by units, as in U = "mV"'
    )


def source_words(note: SourceWarning) -> str:
    """Return why an earlier result, of which something is taken, is to be taken with care."""
    match note.doubt:
        case SourceIssue.DID_NOT_SUCCEED:
            return f"{note.path}, an earlier result, did not succeed: {note.outcome.value}"
        case SourceIssue.NO_MODEL:
            return f"{note.path} does not say of which model it is a result"
        case SourceIssue.OTHER_BUILD:
            assert note.fmu is not None
            return f"{note.path} was made with another build of {note.fmu.name} than {note.fmu.path}"
