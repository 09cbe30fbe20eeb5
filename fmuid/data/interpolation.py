"""Inputs between their samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.errors import InputError
from fmuid.formatting import nearest

INTERPOLATIONS = ("linear", "zoh", "zoh-next", "pchip")
"""Linear is for measured signals, zero-order hold for numerical commands. "zoh-next" holds during the step that ends at
its sample (recorders that note commands late, OMSysIdent). "pchip" is Fritsch and Butland's monotone cubic."""
HELD = ("zoh", "zoh-next")


def as_held(values: Floats, words: Sequence[str]) -> Floats:
    """Return samples (K, n) as held from each time on."""
    early = [word == "zoh-next" for word in words]
    if any(early):
        values = values.copy()
        values[:-1, early] = values[1:, early]
    return values


def interpolation_words(source: str, given: str | Mapping[str, str], inputs: Mapping[str, str]) -> list[str]:
    """Return the interpolation of each input."""
    words = dict(given) if isinstance(given, Mapping) else dict.fromkeys(inputs, given)
    for variable in words:
        if variable not in inputs:
            near = nearest(str(variable), inputs)
            raise InputError(f"{source}: interpolation: {variable!r} is no input{near}. Name inputs only.")
    for word in words.values() if isinstance(given, Mapping) else [given]:
        if word not in INTERPOLATIONS:
            *some, last = (f'"{each}"' for each in INTERPOLATIONS)
            said = f"unknown value {word!r}{nearest(str(word), INTERPOLATIONS)}"
            raise InputError(f"{source}: interpolation: {said}. Choose {', '.join(some)} or {last}.")
    return [words.get(variable, "linear") for variable in inputs]


def slopes(source: str, times: Floats, values: Floats, curved: Flags) -> Floats:
    """Return slopes (K, n) of the monotone cubic curves, not across steps."""
    slopes = np.full(values.shape, np.nan)
    if curved.any():
        from scipy.interpolate import PchipInterpolator

        with np.errstate(over="ignore", divide="ignore", invalid="ignore"), suppress(ValueError):  # checked below
            for part in np.split(np.arange(times.size), np.flatnonzero(np.diff(times) == 0) + 1):
                flat = np.zeros((part.size, int(curved.sum())))
                at = times[part]
                slopes[np.ix_(part, curved)] = (
                    PchipInterpolator(at, values[np.ix_(part, curved)]).derivative()(at) if part.size > 1 else flat
                )
        if not np.isfinite(slopes[:, curved]).all():
            said = 'an input changes too fast for interpolation = "pchip"'
            raise InputError(f'{source}: {said}. Check its values and times, or use "linear".')
    return slopes
