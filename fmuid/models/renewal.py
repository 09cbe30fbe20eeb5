"""What brings the FMUs of a system back to their beginning before a simulation."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum

import numpy as np

from fmuid.array_types import Floats
from fmuid.models.component import Component

# Two simulations with the same parameters may differ by this share of the largest output: an integrator that keeps its
# last step length is still the same model, and leaves more in a small output beside a large one.
REPEAT_TOLERANCE = 1e-6

_Key = tuple[tuple[str, str], ...]
_once: set[_Key] = set()


class Renewal(IntEnum):
    """What brings the FMUs of a system back to their beginning."""

    RESET = 0
    INSTANCE = 1
    PROCESS = 2


def is_repeated(outputs: Floats, expected: Floats) -> bool:
    """Return whether outputs repeat those of an earlier simulation with the same parameters."""
    return np.allclose(outputs, expected, rtol=0.0, atol=REPEAT_TOLERANCE * np.abs(expected).max(initial=0.0))


def note_process(components: Iterable[Component]) -> bool:
    """Note that FMUs need a new process for each simulation; return whether that is news in this process."""
    key = _key(components)
    news = key not in _once
    _once.add(key)
    return news


def needs_process(components: Iterable[Component]) -> bool:
    """Return whether FMUs are known to need a new process for each simulation."""
    return bool(_once) and _key(components) in _once


def _key(components: Iterable[Component]) -> _Key:
    return tuple(sorted((model.fmu.digest, model.kind) for model in components))
