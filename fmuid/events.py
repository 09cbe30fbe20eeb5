"""Progress events of long work: a callback takes one event, ``progress(event)``.

KeyboardInterrupt from a callback acts as Ctrl-C.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Protocol

EVENTS = "FMUID_EVENTS"  # Environment variable with the file to which a command appends its events (`to_line`)


@dataclass(frozen=True, kw_only=True)
class Event:
    """Progress of a task; `share` is the completed fraction, 0 to 1, or NaN if unknown."""

    task: str
    share: float = math.nan


@dataclass(frozen=True, kw_only=True)
class CountedEvent(Event):
    """Progress in a task of `total` parts, of which `done` are completed."""

    done: int
    total: int
    share: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", self.done / self.total)


class Progress(Protocol):
    """Callback of long work."""

    def __call__(self, event: Event, /) -> None:
        """Take an event."""


@dataclass(frozen=True, kw_only=True)
class SearchStep(Event):
    """Iteration of Marquardt's method; number 0 is the initial guess.

    `cost` and `values` (by parameter) are those of the tried point. `damping` is Marquardt's λ: NaN at the initial
    guess, and after a change of the noise variances. `accepted` tells whether the optimizer continues from there.
    """

    task: str = "search"
    number: int
    cost: float
    damping: float
    accepted: bool
    values: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class GlobalStep(CountedEvent):
    """Step of a global search; its tasks are ``spread``, ``evolution`` and ``fits``.

    `done` and `total` count points, generations (at most) or fits. `cost` is the best so far: J_C, or its
    concentrated form for estimated noise variances; only differences count. `values` are its parameters, `simulations`
    the simulations since the beginning.
    """

    cost: float
    values: Mapping[str, float]
    simulations: int


@dataclass(frozen=True, kw_only=True)
class DataOnlyStep(Event):
    """Begin of the search for the optimum without the prior."""

    task: str = "data alone"


@dataclass(frozen=True, kw_only=True)
class MapStep(Event):
    """Begin of a cost map over the parameters `first` and `second`."""

    task: str = "map"
    first: str
    second: str


@dataclass(frozen=True, kw_only=True)
class ProfileStep(Event):
    """Point of the profile of parameter `name`.

    `rise` is J_p − J_min; the interval ends at `threshold`.
    """

    task: str = "profile"
    name: str
    value: float
    rise: float
    threshold: float


@dataclass(frozen=True, kw_only=True)
class SamplingStep(Event):
    """Step of all walkers of a sampler; `steps` is the maximum.

    `effective_size` is the smallest of all parameters at the last check (NaN before), `wanted` its goal.
    `acceptance` is the accepted fraction of moves so far.
    """

    task: str = "posterior"
    step: int
    steps: int
    effective_size: float
    wanted: int
    acceptance: float
    share: float = field(init=False)

    def __post_init__(self) -> None:
        known = not math.isnan(self.effective_size)
        share = max(self.step / self.steps, self.effective_size / self.wanted if known else 0.0)
        object.__setattr__(self, "share", min(share, 1.0))


@dataclass(frozen=True, kw_only=True)
class FaultStep(Event):
    """Begin of the fit of a fault model (None: healthy machine)."""

    task: str = "diagnosis"
    fault: str | None


@dataclass(frozen=True, kw_only=True)
class WindowStep(Event):
    """Begin of window `number` (from 0) of `total` in a recording."""

    task: str = "monitoring"
    record: str
    number: int
    total: int
    share: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", self.number / self.total)


@dataclass(frozen=True, kw_only=True)
class BatchStep(CountedEvent):
    """Progress of a batch, a few times per second.

    `failed` counts among the `done` cases. `rate` is in cases/s (0 before the first), `left` in s (inf before the
    first), `threads` counts the workers' threads.
    """

    task: str = "batch"
    failed: int
    rate: float
    left: float
    threads: int


def to_line(event: Event) -> str:
    """Return an event as a line of JSON, with NaN and Infinity."""
    return json.dumps({"event": type(event).__name__, **asdict(event)}) + "\n"


def of_line(line: str) -> Event:
    """Return the event of a line of `to_line`; raise ValueError for others."""
    found = json.loads(line)
    known: list[type[Event]] = [Event, *Event.__subclasses__(), *CountedEvent.__subclasses__()]
    kinds = {kind.__name__: kind for kind in known if kind.__module__ == __name__}
    if not isinstance(found, dict) or found.get("event") not in kinds:
        raise ValueError(f"no event: {line[:80]!r}")
    kind = kinds[found["event"]]
    return kind(**{each.name: found[each.name] for each in fields(kind) if each.init})
