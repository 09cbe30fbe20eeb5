"""Which FMUs may have several instances at work in one process, and how those are kept apart that may not.

FMI has an FMU say that it cannot be instantiated twice in a process (canBeInstantiatedOnlyOncePerProcess, FMI 2.0.4,
section 3.3.1); saying nothing means that it can. Too many tools say nothing, or the wrong thing. Threads are therefore
only for FMUs that say so themselves, or whose tool is known to keep everything inside the instances (`in_threads`).

Of any other FMU only one instance at a time is at work in a process (`InstanceLock`), instances of its two interfaces
never live there together, and none is freed while another lives: OpenModelica's allocator, its hooks for errors and its
thread-local pointers are one for the whole library. Freeing any instance frees the memory of all, and two threads use
and release the same memory; a plain C program with two threads crashes as well.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from typing import Protocol

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.models import FMU, Component, Description

SAFE_TOOLS = ("fmuid", "Reference FMUs")
"""Beginnings of the generationTool of FMUs that keep everything inside their instances."""
UNSAFE_TOOLS = ("OpenModelica",)
"""Those that do not, whatever their FMUs say."""


def in_threads(description: Description, kind: str) -> bool:
    """Return whether instances with this interface may be at work in several threads of one process at once."""
    interface, tool = description.interfaces[kind], description.generation_tool
    if interface.once_per_process or interface.needs_execution_tool or tool.startswith(UNSAFE_TOOLS):
        return False
    return interface.declared_repeatable or tool.startswith(SAFE_TOOLS)


class _Owner(Protocol):
    def vacate(self, abandon: bool) -> None:
        """Free all instances, or leave them alone, never to be used again."""


class InstanceRegistry:
    """The instances of one FMU in this process.

    Attributes
    ----------
    turn : RLock
        Held by whom its instances are at work for.
    owners : WeakKeyDictionary of owner to (str, int)
        Who has instances, of which interface, and the thread that uses them.
    """

    def __init__(self) -> None:
        self.turn = threading.RLock()
        self.owners: weakref.WeakKeyDictionary[_Owner, tuple[str, int]] = weakref.WeakKeyDictionary()
        self._living = 0
        self._waiting: list[tuple[int, Callable[[], None]]] = []  # threads, and what frees their instances

    def arrive(self) -> None:
        """Count an instance that is about to be made."""
        with _counting:
            self._living += 1

    def leave(self, thread: int = 0, free: Callable[[], None] | None = None) -> None:
        """Have an instance be freed, in the thread that made it, as soon as none lives any more."""
        with _counting:
            self._living -= 1
            self._waiting += [(thread, free)] if free else []
            if self._living == 0:
                here = threading.get_ident()
                mine = [free for owner, free in self._waiting if owner == here]
                self._waiting = [each for each in self._waiting if each[0] != here]
                for free in mine:
                    free()


_counting = threading.RLock()  # one for all: a collection of garbage can free any instance within any other's end
_residents: dict[str, InstanceRegistry] = {}


def residents(fmu: FMU, kind: str) -> InstanceRegistry | None:
    """Return who is there of an FMU that must be kept apart; None of one that need not, or can have one only."""
    if in_threads(fmu.description, kind) or fmu.description.interfaces[kind].once_per_process:
        return None
    with _counting:
        return _residents.setdefault(fmu.digest, InstanceRegistry())


class InstanceLock:
    """Keeps who has instances apart from all others in this process with whose instances they could interfere.

    Nothing is to be paid where all FMUs may run in threads.

    Parameters
    ----------
    models : iterable of (FMU, str)
        The FMUs, each with the interface that is used.

    Raises
    ------
    InputError
        If there are both interfaces of one FMU among them that must be kept apart.
    """

    def __init__(self, models: Iterable[tuple[FMU, str]]) -> None:
        found: dict[str, tuple[InstanceRegistry, str]] = {}
        for fmu, kind in models:
            there = residents(fmu, kind)
            if there is not None and found.setdefault(fmu.digest, (there, kind))[1] != kind:
                raise InputError(
                    f"{fmu.path} is used by co-simulation and by model exchange at once, which an FMU of "
                    f"{fmu.description.generation_tool or 'unknown make'} may not survive in one process; give its "
                    f"components one interface"
                )
        self._held = [found[digest] for digest in sorted(found)]  # always in this order, so that nobody waits for ever

    @contextmanager
    def turn(self, owner: _Owner) -> Iterator[None]:
        """Wait for one's turn, and have those with the other interface give their instances up."""
        if not self._held:
            yield
            return
        with ExitStack() as stack:
            for there, kind in self._held:
                stack.enter_context(there.turn)
                for other, (theirs, thread) in list(there.owners.items()):
                    if theirs != kind:
                        other.vacate(abandon=thread != threading.get_ident())
                        del there.owners[other]
                there.owners[owner] = kind, threading.get_ident()
            yield


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
