"""Phrases that topics share: identifiability."""

from __future__ import annotations

from collections.abc import Sequence

from fmuid.estimation import IdentifiabilityLevel, WeakDirection
from fmuid.formatting import listed

# Steps along a direction are told in percent of values, but of magnitudes where values are below this share of them.
# The largest is 1 %, which is small enough for the linear model: that of the first parameter within this share of it.
NEAR_ZERO_SHARE, AS_LARGE_SHARE = 0.5, 0.99
# Beyond so many magnitudes a standard deviation is told in its unit: a percentage of next to nothing says nothing.
FAR_MAGNITUDES = 10.0
# Of all coefficients, so many digits are shown.
DIGITS = 3


def direction_words(direction: WeakDirection) -> str:
    """Return the identifiability of a direction as text."""
    if direction.level in (IdentifiabilityLevel.NOT, IdentifiabilityLevel.HIDDEN):
        return _lost(direction)
    return _open(direction) if direction.level is IdentifiabilityLevel.NOT_IN_EFFECT else _weak(direction)


def open_words(determined: IdentifiabilityLevel, names: Sequence[str]) -> str:
    """Return the parameters that are not identifiable, without numbers."""
    effect = " in effect" if determined is IdentifiabilityLevel.NOT_IN_EFFECT else ""
    return f"{listed(names)} {'is not determined' if len(names) == 1 else 'cannot be told apart'}{effect}"


def _lost(direction: WeakDirection) -> str:
    names = direction.names
    who = listed(names)
    no_output = "no output"
    if direction.level is IdentifiabilityLevel.HIDDEN:
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
    """Return the identifiable combinations θ_i − (v_i/v_last) θ_last."""
    last = direction.coefficients[-1]
    said = []
    for name, coefficient in zip(direction.names[:-1], direction.coefficients[:-1], strict=True):
        factor = f"{abs(coefficient / last):.{DIGITS}g} ".removeprefix("1 ")
        said.append(f"{name} {'-' if -coefficient / last < 0 else '+'} {factor}{direction.names[-1]}")
    return listed(said)
