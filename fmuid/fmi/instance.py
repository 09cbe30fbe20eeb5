"""The life of one instance of an FMU: loaded, instantiated, its messages collected, freed (FMPy underneath)."""

from __future__ import annotations

import ctypes
import itertools
import logging
import os
import re
import sys
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import calloc, free
from fmpy.fmi1 import _FMU
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import _FMU3, FMU3Model, FMU3Slave
from fmpy.logging import addLoggerProxy
from numpy.typing import NDArray

from fmuid.errors import InputError
from fmuid.fmi.codes import (
    BOOLEAN,
    DISCARD,
    DO_STEP,
    ENDED,
    ENTER_INITIALIZATION,
    EXIT_INITIALIZATION,
    FLOAT64,
    GET_BOOLEAN_STATUS,
    GET_REAL_STATUS,
    INT32,
    N_FUNCTIONS,
    N_WIRES,
    RESET,
    SET_DERIVATIVES,
    SETUP,
    STRING,
    WIRES,
)
from fmuid.fmi.float_environment import kept
from fmuid.fmi.fmu import FMU
from fmuid.fmi.sharing import Residents, residents

MESSAGES_KEPT = 20  # of one simulation: the first say what went wrong, the rest repeat it
STATUS_WORDS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

_log = logging.getLogger("fmuid.fmu")
_instances: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
_keys = itertools.count(1)
_loading = threading.Lock()  # loading changes the working directory of the whole process
_spent: set[str] = set()  # digests of the FMUs instantiated so far in this process


def _receive(environment: int | None, name: bytes, status: int, _category: bytes, message: bytes) -> None:
    """Give a message of an FMU to the instance that it concerns."""
    text = (message or b"").decode("utf-8", errors="replace").strip()
    instance = _instances.get(environment or 0)
    if instance is None:
        _log.info("%s: %s", (name or b"").decode("utf-8", errors="replace"), text)
    elif text and len(instance.messages) < MESSAGES_KEPT:
        instance.messages.append((status, text))


def _callbacks() -> fmi2CallbackFunctions:
    """Return callbacks whose logger formats the FMU's variadic messages (FMPy's proxy) and gives them to `_receive`.

    Memory comes from the C library's own functions by address, so that an FMU which allocates while it steps
    does not enter Python.
    """
    callbacks = fmi2CallbackFunctions()
    types = dict(fmi2CallbackFunctions._fields_)
    callbacks.logger = _receiver
    callbacks.allocateMemory = ctypes.cast(calloc, types["allocateMemory"])
    callbacks.freeMemory = ctypes.cast(free, types["freeMemory"])
    addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


_receiver = fmi2CallbackLoggerTYPE(_receive)


def _receiver3(messages: list[tuple[int, str]]) -> Callable[..., None]:
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
    addresses : (codes.N_FUNCTIONS,) array of intp
        The addresses of the FMI functions in the places that `fmuid.fmi.codes` gives them; 0 where there is none.
    messages : list of (int, str)
        Status and text of what the FMU logged since the list was last cleared.

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
        self.messages: list[tuple[int, str]] = []
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
        self._finalizer = weakref.finalize(self, _free, self._native, self._residents, threading.get_ident())
        self.handle = int(self._native.component)
        self.addresses = self._find_functions()

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
            log = {"loggingOn": False, "logMessage": _receiver3(self.messages)}
            if self.event_mode:
                try:
                    self._native.instantiate(**log, eventModeUsed=True, earlyReturnAllowed=True)
                except Exception:  # there are binaries that do not have the event mode that their description promises
                    self.event_mode = False
                    self.messages.clear()
            if not self.event_mode:
                self._native.instantiate(**log)
            return
        key = next(_keys)
        _instances[key] = self
        callbacks = _callbacks()
        callbacks.componentEnvironment = key
        self._native.instantiate(callbacks=callbacks, loggingOn=False)

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

    def _find_functions(self) -> NDArray[np.intp]:
        addresses = np.zeros(N_FUNCTIONS, np.intp)
        for place, name in function_names(self.version).items():
            addresses[place] = self.address(name)
        for name in LIFE_CYCLE[self.version] + ("DoStep",) * (self.kind == "co-simulation"):
            self.required(name)
        return addresses

    def set_logging(self, on: bool) -> None:
        """Switch the FMU's debug log (fmi2SetDebugLogging, fmi3SetDebugLogging with all categories)."""
        with kept():
            self._native.setDebugLogging(on, [])

    def close(self, fatal: bool = False) -> None:
        """Free the instance; after a fatal error it must not be touched any more (FMI 2.0.4, section 2.1.3)."""
        if not fatal:
            self._finalizer()
        elif self._finalizer.detach() and self._residents:
            self._residents.leave()


def _free(native: Any, those_there: Residents | None, thread: int) -> None:
    def free_now() -> None:
        free_instance = native.fmi3FreeInstance if isinstance(native, _FMU3) else native.fmi2FreeInstance
        with kept():
            free_instance(native.component)

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


def function_names(version: int) -> dict[int, str]:
    """Return place in a component's row of addresses -> FMI function without its prefix."""
    if version == 3:
        types = dict(enumerate(WIRES))
        others = {DO_STEP: "DoStep"}
    else:
        types = {FLOAT64: "Real", INT32: "Integer", BOOLEAN: "Boolean", STRING: "String"}
        others = {
            DO_STEP: "DoStep",
            SET_DERIVATIVES: "SetRealInputDerivatives",
            SETUP: "SetupExperiment",
            GET_REAL_STATUS: "GetRealStatus",
            GET_BOOLEAN_STATUS: "GetBooleanStatus",
        }
    others |= {
        RESET: "Reset",
        ENTER_INITIALIZATION: "EnterInitializationMode",
        EXIT_INITIALIZATION: "ExitInitializationMode",
    }
    setting = {place: f"Set{name}" for place, name in types.items()}
    getting = {N_WIRES + place: f"Get{name}" for place, name in types.items()}
    return setting | getting | others


LIFE_CYCLE = {
    2: ("Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"),
    3: ("Reset", "EnterInitializationMode", "ExitInitializationMode"),
}
"""Functions that every simulation calls."""


def describe_failure(version: int, function: int, status: int) -> str:
    """Return the failing FMI call in words."""
    if function == ENDED:
        return "the FMU ended the simulation"
    hint = " (the FMU cannot go on from here)" if function == DO_STEP and status == DISCARD else ""
    return f"fmi{version}{function_names(version)[function]} returned {status_word(version, status)}{hint}"


def status_word(version: int, status: int) -> str:
    """Return a status as the standard calls it."""
    if 0 <= status < len(STATUS_WORDS):
        return f"fmi{version}{STATUS_WORDS[status]}"
    return f"the illegal status {status}"


def warn(instance: Instance, told: set[str]) -> None:
    """Pass on, once each, the warnings that an instance gave during simulations that succeeded."""
    for status, text in instance.messages:
        if status > 0 and text not in told:
            told.add(text)
            _log.warning("%s: %s", instance.name, text)


if sys.maxsize <= 2**32:  # pragma: no cover
    raise ImportError("fmuid needs a 64-bit Python: its compiled loops pass 64-bit addresses")
