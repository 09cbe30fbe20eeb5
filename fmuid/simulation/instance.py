"""One instance of an FMU: loaded, instantiated, logged, freed."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import re
import sys
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import byref, c_char_p, c_int, c_size_t, c_uint8, c_void_p
from typing import Any

from fmuid.errors import InputError
from fmuid.models import FMU
from fmuid.simulation.instance_registry import InstanceRegistry, residents
from fmuid.simulation.native.library import core

_log = logging.getLogger("fmuid.fmu")
_loading = threading.Lock()  # loading changes the working directory of the whole process
_spent: set[str] = set()  # digests of the FMUs instantiated so far in this process
_abandoned: list[Any] = []  # of instances that failed fatally

LIFE_CYCLE = {
    2: ("Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"),
    3: ("Reset", "EnterInitializationMode", "ExitInitializationMode"),
}
"""Functions that every simulation calls."""
# What the functions take that instantiate (FMI 2.0.4, section 2.1.5; FMI 3.0.2, section 2.3.1).
_TAKEN_2 = (c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int)
_TAKEN_3 = {
    "ModelExchange": (c_char_p, c_char_p, c_char_p, c_uint8, c_uint8, c_void_p, c_void_p),
    "CoSimulation": (*(c_char_p,) * 3, *(c_uint8,) * 4, c_void_p, c_size_t, c_void_p, c_void_p, c_void_p),
}


class Instance:
    """One instance of an FMU by one interface, `kind`; an `InputError` if impossible."""

    handle: int  # its address
    event_mode: bool  # whether events are handled between its steps (FMI 3.0 Co-Simulation)

    def __init__(self, fmu: FMU, kind: str, name: str) -> None:
        interface = fmu.description.interfaces[kind]
        if interface.once_per_process and fmu.digest in _spent:
            raise InputError(
                f"{fmu.path}: it can be instantiated only once in a process. Share one fmuid.System between "
                f"simulators, or use process isolation."
            )
        self.fmu, self.kind, self.name = fmu, kind, name
        self.version = fmu.description.major_version
        self.event_mode = self.version == 3 and kind == "co-simulation" and interface.event_mode
        self._log: Any = core().Log()
        library = fmu.library(interface.identifier)
        self._residents = residents(fmu, kind)
        if self._residents:
            self._residents.arrive()
        try:
            with _loading, kept():
                with contextlib.chdir(library.parent):  # where some look for what else they need
                    self.library = ctypes.CDLL(str(library))
                for function in ("FreeInstance", *LIFE_CYCLE[self.version], *["DoStep"] * (kind == "co-simulation")):
                    self.required(function)
                self.handle = self._instantiate()
        except Exception as error:
            if self._residents:
                self._residents.leave()
            if isinstance(error, InputError):
                raise
            raise InputError(
                _missing_library(fmu, str(error)) or f"{fmu.path}: instantiation failed: {error}"
            ) from error
        _spent.add(fmu.digest)
        living = self._function("FreeInstance", c_void_p), self.handle, self._log
        self._finalizer = weakref.finalize(self, _free, *living, self._residents, threading.get_ident())

    def _instantiate(self) -> int:
        """Return the handle; no callback enters Python, since FMUs call them while stepping."""
        name, token, log = self.name.encode(), self.fmu.description.guid.encode(), byref(self._log)
        resources = self.fmu.directory / "resources"
        handle = None
        if self.version == 2:
            made = self._function("Instantiate", *_TAKEN_2, result=c_void_p)
            is_stepped = self.kind == "co-simulation"
            handle = made(name, is_stepped, token, resources.as_uri().encode(), core().log_open(log), 0, 0)
        else:
            words = name, token, f"{resources}{os.sep}".encode(), 0, 0
            interface = "CoSimulation" if self.kind == "co-simulation" else "ModelExchange"
            made = self._function(f"Instantiate{interface}", *_TAKEN_3[interface], result=c_void_p)
            logger = ctypes.cast(core().log_message_3, c_void_p)
            if self.kind == "model-exchange":
                return self._there(made(*words, log, logger))
            if self.event_mode:
                handle = made(*words, 1, 1, None, 0, log, logger, None)
            if not handle:  # there are binaries that do not have the event mode that their description promises
                self.event_mode, self._log.count = False, 0
                handle = made(*words, 0, 0, None, 0, log, logger, None)
        return self._there(handle)

    def _there(self, handle: int | None) -> int:
        if handle:
            return handle
        told = "; ".join(text for _, text in self.messages)
        raise OSError("it returns no instance" + (f' (FMU: "{told}")' if told else ""))

    def _function(self, name: str, *takes: Any, result: Any = None) -> Any:
        return ctypes.CFUNCTYPE(result, *takes)(self.required(name))

    @property
    def messages(self) -> list[tuple[int, str]]:
        """Status and text of the logged messages."""
        there = self._log.messages[: min(self._log.count, len(self._log.messages))] if self._log.count else ()
        said = ((message.status, message.text.decode("utf-8", errors="replace").strip()) for message in there)
        return [(status, text) for status, text in said if text]

    def forget_messages(self) -> None:
        """Forget the logged messages."""
        self._log.count = 0

    def address(self, name: str) -> int:
        """Return the address of an FMI function such as ``DoStep``, or 0."""
        try:
            return ctypes.cast(getattr(self.library, f"fmi{self.version}{name}"), ctypes.c_void_p).value or 0
        except AttributeError:
            return 0

    def required(self, name: str) -> int:
        """Return the address of an FMI function; an `InputError` without it."""
        found = self.address(name)
        if not found:
            raise InputError(f"{self.fmu.path}: its binary lacks the required function fmi{self.version}{name}")
        return found

    def set_logging(self, on: bool) -> None:
        """Switch the FMU's debug log, if it has one."""
        if self.address("SetDebugLogging"):
            boolean = c_int if self.version == 2 else c_uint8
            with kept():
                self._function("SetDebugLogging", c_void_p, boolean, c_size_t, c_void_p, result=c_int)(
                    self.handle, on, 0, None
                )

    def close(self, fatal: bool = False) -> None:
        """Free the instance; after a fatal error leave it (FMI 2.0.4, 2.1.3)."""
        if not fatal:
            self._finalizer()
        elif self._finalizer.detach():
            _abandoned.append(self._log)  # it may still speak
            if self._residents:
                self._residents.leave()


def _free(free: Any, handle: int, log: Any, those_there: InstanceRegistry | None, thread: int) -> None:
    def free_now() -> None:
        with kept():
            free(handle)
        log.count = 0  # it must be there for as long as the FMU may speak

    if those_there:
        those_there.leave(thread, free_now)
    else:
        free_now()


def _missing_library(fmu: FMU, error: str) -> str | None:
    """Return a sentence on a shared library missing on this machine."""
    found = re.search(r"(\S+): cannot open shared object file", error) or re.search(r"Library not loaded: (\S+)", error)
    if not found:
        return None
    return (
        f"{fmu.path}: its binary needs the shared library {found[1]}, which is missing here. "
        f"Install it, or export the FMU with its libraries."
    )


def warn(instance: Instance, told: set[str]) -> None:
    """Pass on new warnings of an instance after successful simulations."""
    for status, text in instance.messages:
        if status > 0 and text not in told:
            told.add(text)
            # without the number of its thread: the same of another one is nothing new
            _log.warning("%s: %s", instance.name.rpartition("-")[0], text)


if sys.maxsize <= 2**32:  # pragma: no cover
    raise ImportError("fmuid needs a 64-bit Python: its core is compiled for 64 bits")


@contextmanager
def kept() -> Iterator[None]:
    """Restore this thread's floating-point environment afterwards."""
    library = core()
    room = ctypes.create_string_buffer(library.environment_size())
    library.environment_keep(room)
    try:
        yield
    finally:
        library.environment_restore(room)
