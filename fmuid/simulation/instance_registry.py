"""Rules for several instances of an FMU in one process.

Many tools declare canBeInstantiatedOnlyOncePerProcess wrongly or not at all (FMI 2.0.4, 3.3.1). Threads are only for
FMUs that declare it, or of tools known to be safe (`in_threads`).

Of any other FMU one instance at a time works in a process (`InstanceLock`). Its two interfaces never live there
together, and none is freed while another lives. OpenModelica's allocator, error hooks and thread-local pointers are
global to a library. Freeing one instance frees the memory of all; a plain C program with two threads crashes too.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from typing import Protocol

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.models import FMU, Component, Description

SAFE_TOOLS = ("fmuid", "Reference FMUs")
"""Beginnings of the generationTool of FMUs that keep everything inside their instances."""
UNSAFE_TOOLS = ("OpenModelica",)  # those that do not, whatever their FMUs say


def in_threads(description: Description, kind: str) -> bool:
    """Return whether instances may work in several threads of one process."""
    interface, tool = description.interfaces[kind], description.generation_tool
    if interface.once_per_process or interface.needs_execution_tool or tool.startswith(UNSAFE_TOOLS):
        return False
    return interface.declared_repeatable or tool.startswith(SAFE_TOOLS)


class _Owner(Protocol):
    def vacate(self, abandon: bool) -> None:
        """Free all instances, or leave them alone, never to be used again."""


class InstanceRegistry:
    """The instances of one FMU in this process.

    `turn` is held while its instances work. `owners` have the interface and the thread of their instances.
    """

    def __init__(self) -> None:
        self.turn = threading.RLock()
        self.owners: weakref.WeakKeyDictionary[_Owner, tuple[str, int]] = weakref.WeakKeyDictionary()
        self._living = 0
        self._waiting: list[tuple[int, Callable[[], None]]] = []  # threads, and what frees their instances

    def arrive(self) -> None:
        """Count an instance before it is made."""
        with _counting:
            self._living += 1

    def leave(self, thread: int = 0, free: Callable[[], None] | None = None) -> None:
        """Free an instance in its thread as soon as none lives."""
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
    """Return the registry of an FMU kept apart, or None."""
    if in_threads(fmu.description, kind) or fmu.description.interfaces[kind].once_per_process:
        return None
    with _counting:
        return _residents.setdefault(fmu.digest, InstanceRegistry())


class InstanceLock:
    """Keeps instances apart that could interfere; costs nothing for thread-safe FMUs."""

    def __init__(self, models: Iterable[tuple[FMU, str]]) -> None:
        found: dict[str, tuple[InstanceRegistry, str]] = {}
        for fmu, kind in models:
            there = residents(fmu, kind)
            if there is not None and found.setdefault(fmu.digest, (there, kind))[1] != kind:
                raise InputError(
                    f"{fmu.path}: Co-Simulation and Model Exchange in one process can crash FMUs of "
                    f"{fmu.description.generation_tool or 'an unknown tool'}. Give its components one interface."
                )
        self._held = [found[digest] for digest in sorted(found)]  # always in this order, so that nobody waits for ever

    @contextmanager
    def turn(self, owner: _Owner) -> Iterator[None]:
        """Wait for a turn; instances of the other interface are given up."""
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


_Key = tuple[tuple[str, str], ...]
_once: set[_Key] = set()


class Renewal(IntEnum):
    """Method that resets the FMUs of a system."""

    RESET = 0
    INSTANCE = 1
    PROCESS = 2


def labels(components: Mapping[str, Component]) -> str:
    """Return names and files of components, for messages."""
    return ", ".join(label(name, model) for name, model in components.items())


def label(name: str, model: Component) -> str:
    """Return name and file of a component, for messages."""
    return f"{name} ({model.fmu.path})" if name else str(model.fmu.path)


def is_repeated(outputs: Floats, expected: Floats) -> bool:
    """Return whether outputs repeat those of an earlier simulation."""
    # a solver that keeps its last step length is still the same model, and changes small outputs beside a large one
    return np.allclose(outputs, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max(initial=0.0))


def note_process(components: Iterable[Component]) -> bool:
    """Note FMUs that need new processes; return whether that is news."""
    key = _key(components)
    news = key not in _once
    _once.add(key)
    return news


def needs_process(components: Iterable[Component]) -> bool:
    """Return whether FMUs need a new process for each simulation."""
    return bool(_once) and _key(components) in _once


def _key(components: Iterable[Component]) -> _Key:
    return tuple(sorted((model.fmu.digest, model.kind) for model in components))
