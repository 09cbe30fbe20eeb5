"""How far long work is: what every function that takes `progress` calls it with.

A callback has one shape whatever the work is: ``progress(event)``. Every event says which task it is of and how much
of it is done; what it is beyond that, its class says. A callback may raise KeyboardInterrupt, which is as Ctrl-C then.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Protocol

EVENTS = "FMUID_EVENTS"
"""The variable of the environment that names a file: a command adds each event to it, as a line (`to_line`)."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """How far a task is.

    Attributes
    ----------
    task : str
        What is being done, in a word.
    share : float
        How much of it is done, from 0 to 1; NaN where nobody knows.
    """

    task: str
    share: float = math.nan


class Progress(Protocol):
    """What is called while long work goes on: any function of an event."""

    def __call__(self, event: Event, /) -> None:
        """Take note of an event."""


@dataclass(frozen=True, kw_only=True)
class SearchStep(Event):
    """A step of Marquardt's search; number 0 is the start.

    Attributes
    ----------
    number : int
    criterion : float
        At the point tried.
    damping : float
        Marquardt's λ; NaN at the start, and where the search begins anew with other noise variances.
    accepted : bool
        Whether the search goes on from there.
    values : mapping of str to float
        The parameters at the point tried.
    """

    task: str = "search"
    number: int
    criterion: float
    damping: float
    accepted: bool
    values: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class GlobalStep(Event):
    """How far a global search is; its tasks are ``spread``, ``evolution`` and ``fits``.

    Attributes
    ----------
    done, total : int
        Points, generations (at most), or fits.
    criterion : float
        The best so far: J_C, or where noise variances are estimated its concentrated form; only differences count.
    values : mapping of str to float
        The parameters where it was found.
    simulations : int
        Since the search began.
    """

    done: int
    total: int
    criterion: float
    values: Mapping[str, float]
    simulations: int
    share: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", self.done / self.total)


@dataclass(frozen=True, kw_only=True)
class DataOnlyStep(Event):
    """The optimum of the data without the prior is going to be searched, for comparison."""

    task: str = "data alone"


@dataclass(frozen=True, kw_only=True)
class MapStep(Event):
    """The criterion is going to be mapped.

    Attributes
    ----------
    first, second : str
        The parameters over which.
    """

    task: str = "map"
    first: str
    second: str


@dataclass(frozen=True, kw_only=True)
class ProfileStep(Event):
    """A point of a profile, as it is found.

    Attributes
    ----------
    name : str
        The parameter.
    value : float
    rise : float
        J_p − J_min.
    threshold : float
        The rise at which the interval ends.
    """

    task: str = "profile"
    name: str
    value: float
    rise: float
    threshold: float


@dataclass(frozen=True, kw_only=True)
class SamplingStep(Event):
    """A step of all walkers of a sampler.

    Attributes
    ----------
    step, steps : int
        Steps made, and at most to be made.
    effective_size : float
        Of the parameter with the least, at the last look; NaN before the first one.
    wanted : int
        The effective size at which it may end.
    acceptance : float
        Share of the moves accepted so far.
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
    """A model of a diagnosis is going to be fitted.

    Attributes
    ----------
    fault : str or None
        None for the healthy machine's.
    """

    task: str = "diagnosis"
    fault: str | None


@dataclass(frozen=True, kw_only=True)
class WindowStep(Event):
    """A window of a record is going to be looked at.

    Attributes
    ----------
    record : str
    number, total : int
        Of the window, from 0 on, and how many the record has.
    """

    task: str = "monitoring"
    record: str
    number: int
    total: int
    share: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", self.number / self.total)


@dataclass(frozen=True, kw_only=True)
class BatchStep(Event):
    """How far a batch is; told some times a second.

    Attributes
    ----------
    done, total, failed : int
        Finished cases, all of them, and how many of the finished ones failed.
    rate : float
        Cases a second; 0 before the first.
    left : float
        Seconds left at this rate; inf before the first.
    threads : int
        Threads of workers there are now.
    """

    task: str = "batch"
    done: int
    total: int
    failed: int
    rate: float
    left: float
    threads: int
    share: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", self.done / self.total)


def to_line(event: Event) -> str:
    """Return an event as a line of JSON, which has NaN and Infinity besides."""
    return json.dumps({"event": type(event).__name__, **asdict(event)}) + "\n"


def of_line(line: str) -> Event:
    """Return the event that a line is (`to_line`).

    Raises
    ------
    ValueError
        If it is none.
    """
    found = json.loads(line)
    known: list[type[Event]] = [Event, *Event.__subclasses__()]
    kinds = {kind.__name__: kind for kind in known if kind.__module__ == __name__}
    if not isinstance(found, dict) or found.get("event") not in kinds:
        raise ValueError(f"no event: {line[:80]!r}")
    kind = kinds[found["event"]]
    return kind(**{each.name: found[each.name] for each in fields(kind) if each.init})
