"""The life of one instance of an FMU: loaded, instantiated, its messages collected, freed (FMPy underneath)."""

from __future__ import annotations

import ctypes
import logging
import os
import re
import sys
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fmpy import calloc, free
from fmpy.fmi1 import _FMU
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions
from fmpy.fmi3 import _FMU3, FMU3Model, FMU3Slave

from fmuid.errors import InputError
from fmuid.fmi.failures import STATUS_WORDS
from fmuid.fmi.float_environment import kept
from fmuid.fmi.fmu import FMU
from fmuid.fmi.native import LogStruct, core
from fmuid.fmi.sharing import Residents, residents

MESSAGES_KEPT = 20  # of one simulation: the first say what went wrong, the rest repeat it

_log = logging.getLogger("fmuid.fmu")
_loading = threading.Lock()  # loading changes the working directory of the whole process
_spent: set[str] = set()  # digests of the FMUs instantiated so far in this process
_abandoned: list[LogStruct] = []  # of instances that failed fatally


def _callbacks(log: LogStruct) -> fmi2CallbackFunctions:
    """Return callbacks whose logger formats the FMU's variadic messages and keeps them in a log.

    Memory comes from the C library. No callback enters Python: an FMU may call them while it steps.
    """
    callbacks = fmi2CallbackFunctions()
    types = dict(fmi2CallbackFunctions._fields_)
    callbacks.logger = ctypes.cast(core().log_message, types["logger"])
    callbacks.allocateMemory = ctypes.cast(calloc, types["allocateMemory"])
    callbacks.freeMemory = ctypes.cast(free, types["freeMemory"])
    callbacks.componentEnvironment = ctypes.addressof(log)
    return callbacks


def _receiver(messages: list[tuple[int, str]]) -> Callable[..., None]:
    """Return a logger of FMI 3.0 that appends to a list."""

    def receive(_environment: Any, status: int, _category: bytes, message: bytes) -> None:
        text = (message or b"").decode("utf-8", errors="replace").strip()
        if text and len(messages) < MESSAGES_KEPT:
            messages.append((status, text))

    return receive


class _Lenient:
    """FMPy's FMU without its refusal of binaries that lack functions nobody here calls.

    (FMPy tells the FMI version from the first letters of the class's name.)
    """

    dll: Any
    component: Any

    def _loadFunctions(self) -> None:
        library = self.dll
        self.dll = _Stubbed(library)
        super()._loadFunctions()  # type: ignore[misc]
        self.dll = library


class FMU2LenientSlave(_Lenient, FMU2Slave):  # type: ignore[misc]
    """A co-simulation FMU of FMI 2.0."""


class FMU2LenientModel(_Lenient, FMU2Model):  # type: ignore[misc]
    """A model-exchange FMU of FMI 2.0."""


class _Lenient3(_Lenient):
    def __init__(self, **words: Any) -> None:
        _FMU.__init__(self, **words)  # FMPy would look for the binary in one folder only


class FMU3LenientSlave(_Lenient3, FMU3Slave):  # type: ignore[misc]
    """A co-simulation FMU of FMI 3.0."""


class FMU3LenientModel(_Lenient3, FMU3Model):  # type: ignore[misc]
    """A model-exchange FMU of FMI 3.0."""


_CLASSES = {
    (2, "co-simulation"): FMU2LenientSlave,
    (2, "model-exchange"): FMU2LenientModel,
    (3, "co-simulation"): FMU3LenientSlave,
    (3, "model-exchange"): FMU3LenientModel,
}


class _Stubbed:
    """A library in which every missing function is one that reports an error."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self._library, name)
        except AttributeError:
            return ctypes.CFUNCTYPE(ctypes.c_int)(lambda: STATUS_WORDS.index("Error"))


class Instance:
    """One instance of an FMU.

    Parameters
    ----------
    fmu : FMU
    kind : str
        "co-simulation" or "model-exchange".
    name : str
        Instance name, as the FMU uses it in its messages.

    Attributes
    ----------
    handle : int
        The address of the instance (fmi2Component, fmi3Instance).
    version : int
        Of FMI, 2 or 3.
    event_mode : bool
        Whether the instance was told that events are handled between its steps (FMI 3.0 co-simulation).

    Raises
    ------
    InputError
        If the FMU has no such interface or no binary for this platform, or cannot be loaded or instantiated.
    """

    def __init__(self, fmu: FMU, kind: str, name: str) -> None:
        interface = fmu.description.interfaces.get(kind)
        if interface is None:
            raise InputError(
                f"{fmu.path} offers no {kind} interface; it offers {', '.join(fmu.description.interfaces)}"
            )
        if interface.once_per_process and fmu.digest in _spent:
            raise InputError(
                f"{fmu.path} can be instantiated only once in a process, and was; share one fmuid.System between "
                f"simulators, or run the next one in another process"
            )
        self.fmu, self.kind, self.name = fmu, kind, name
        self.version = fmu.description.major_version
        self.event_mode = self.version == 3 and kind == "co-simulation" and interface.event_mode
        self._log, self._said = LogStruct(), list[tuple[int, str]]()  # of FMI 2.0 and 3.0
        library = fmu.library(interface.identifier)
        self._residents = residents(fmu, kind)
        if self._residents:
            self._residents.arrive()
        try:
            with _loading, kept():
                self._load(interface.identifier, library)
        except Exception as error:
            if self._residents:
                self._residents.leave()
            said = "; ".join(text for _, text in self.messages)
            raise InputError(
                _missing_library(fmu, str(error))
                or f"{fmu.path} cannot be instantiated: {error}" + (f' (the FMU says: "{said}")' if said else "")
            ) from error
        _spent.add(fmu.digest)
        living = self._native, self._log
        self._finalizer = weakref.finalize(self, _free, *living, self._residents, threading.get_ident())
        self.handle = int(self._native.component)
        for function in LIFE_CYCLE[self.version] + ("DoStep",) * (kind == "co-simulation"):
            self.required(function)

    def _load(self, identifier: str, library: Path) -> None:
        folder = os.getcwd()  # noqa: PTH109  # FMPy changes the working directory and, on failure, leaves it so
        try:
            self._native: Any = _CLASSES[self.version, self.kind](
                guid=self.fmu.description.guid,
                modelIdentifier=identifier,
                unzipDirectory=str(self.fmu.directory),
                instanceName=self.name,
                libraryPath=str(library),
                requireFunctions=False,
            )
            self._instantiate()
        finally:
            os.chdir(folder)

    def _instantiate(self) -> None:
        if self.version == 3:
            log = {"loggingOn": False, "logMessage": _receiver(self._said)}
            if self.event_mode:
                try:
                    self._native.instantiate(**log, eventModeUsed=True, earlyReturnAllowed=True)
                except Exception:  # there are binaries that do not have the event mode that their description promises
                    self.event_mode = False
                    self._said.clear()
            if not self.event_mode:
                self._native.instantiate(**log)
            return
        self._native.instantiate(callbacks=_callbacks(self._log), loggingOn=False)

    @property
    def messages(self) -> list[tuple[int, str]]:
        """Status and text of what the FMU logged since it was last to forget."""
        if not self._log.count:  # looked at after every simulation
            return list(self._said)
        kept = self._log.messages[: min(self._log.count, MESSAGES_KEPT)]
        said = [(message.status, message.text.decode("utf-8", errors="replace").strip()) for message in kept]
        return [*self._said, *((status, text) for status, text in said if text)]

    def forget_messages(self) -> None:
        """Forget what the FMU logged."""
        self._said.clear()
        self._log.count = 0

    @property
    def library(self) -> Any:
        """The loaded shared library, as ctypes has it."""
        return self._native.dll

    def address(self, name: str) -> int:
        """Return the address of an FMI function by its name without prefix, such as ``DoStep``; 0 if there is none."""
        try:
            return ctypes.cast(getattr(self.library, f"fmi{self.version}{name}"), ctypes.c_void_p).value or 0
        except AttributeError:
            return 0

    def required(self, name: str) -> int:
        """Return the address of an FMI function.

        Raises
        ------
        InputError
            If the binary lacks it.
        """
        found = self.address(name)
        if not found:
            raise InputError(f"{self.fmu.path}: its binary lacks the function fmi{self.version}{name}, which is needed")
        return found

    def set_logging(self, on: bool) -> None:
        """Switch the FMU's debug log (fmi2SetDebugLogging, fmi3SetDebugLogging with all categories)."""
        with kept():
            self._native.setDebugLogging(on, [])

    def close(self, fatal: bool = False) -> None:
        """Free the instance; after a fatal error it must not be touched any more (FMI 2.0.4, section 2.1.3)."""
        if not fatal:
            self._finalizer()
        elif self._finalizer.detach():
            _abandoned.append(self._log)  # it may still speak
            if self._residents:
                self._residents.leave()


def _free(native: Any, log: LogStruct, those_there: Residents | None, thread: int) -> None:
    def free_now() -> None:
        free_instance = native.fmi3FreeInstance if isinstance(native, _FMU3) else native.fmi2FreeInstance
        with kept():
            free_instance(native.component)
        log.count = 0  # it must be there for as long as the FMU may speak

    if those_there:
        those_there.leave(thread, free_now)
    else:
        free_now()


def _missing_library(fmu: FMU, error: str) -> str | None:
    """Return a sentence that names a shared library which the FMU's binary needs and the loader did not find."""
    found = re.search(r"(\S+): cannot open shared object file", error) or re.search(r"Library not loaded: (\S+)", error)
    if not found:
        return None
    return (
        f"{fmu.path} cannot be loaded: its binary needs the shared library {found[1]}, which is not on this machine; "
        f"install what provides it, or export the FMU with its libraries inside"
    )


LIFE_CYCLE = {
    2: ("Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"),
    3: ("Reset", "EnterInitializationMode", "ExitInitializationMode"),
}
"""Functions that every simulation calls."""


def warn(instance: Instance, told: set[str]) -> None:
    """Pass on, once each, the warnings that an instance gave during simulations that succeeded."""
    for status, text in instance.messages:
        if status > 0 and text not in told:
            told.add(text)
            # without the number of its thread: the same of another one is nothing new
            _log.warning("%s: %s", instance.name.rpartition("-")[0], text)


if sys.maxsize <= 2**32:  # pragma: no cover
    raise ImportError("fmuid needs a 64-bit Python: its core is compiled for 64 bits")
