"""The life of one instance of an FMU: loaded, instantiated, its messages collected, freed (FMPy underneath)."""

from __future__ import annotations

import ctypes
import itertools
import logging
import os
import sys
import weakref
from typing import Any

import numpy as np
from fmpy import calloc, free
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.logging import addLoggerProxy
from numpy.typing import NDArray

from fmuid.errors import InputError
from fmuid.fmi.archive import FMU
from fmuid.fmi.kernels import DO_STEP, FUNCTIONS

MESSAGES_KEPT = 20  # of one simulation: the first say what went wrong, the rest repeat it
STATUS_WORDS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")

_log = logging.getLogger("fmuid.fmu")
_instances: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
_keys = itertools.count(1)
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


class FMU2LenientSlave(FMU2Slave):  # type: ignore[misc]
    """FMPy's co-simulation FMU, without its refusal of binaries that lack functions nobody here calls.

    (FMPy tells the FMI version from the first letters of the class's name.)
    """

    def _loadFunctions(self) -> None:
        library: Any = self.dll
        self.dll: Any = _Stubbed(library)
        super()._loadFunctions()
        self.dll = library


class _Stubbed:
    """A library in which every missing function is one that reports an error."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self._library, name)
        except AttributeError:
            return ctypes.CFUNCTYPE(ctypes.c_int)(lambda: STATUS_WORDS.index("fmi2Error"))


class Instance:
    """One co-simulation instance of an FMU.

    Parameters
    ----------
    fmu : FMU
    name : str
        Instance name, as the FMU uses it in its messages.

    Attributes
    ----------
    handle : int
        The address of the instance (fmi2Component).
    addresses : (len(FUNCTIONS),) array of intp
        The addresses of the FMI functions in the order of `fmuid.fmi.kernels.FUNCTIONS`.
    messages : list of (int, str)
        Status and text of what the FMU logged since the list was last cleared.

    Raises
    ------
    InputError
        If the FMU has no co-simulation interface or binary for this platform, or cannot be loaded or instantiated.
    """

    def __init__(self, fmu: FMU, name: str) -> None:
        interface = fmu.description.interfaces.get("co-simulation")
        if interface is None:
            raise InputError(f"{fmu.path} offers no co-simulation interface; export it as co-simulation")
        if interface.once_per_process and fmu.digest in _spent:
            raise InputError(
                f"{fmu.path} can be instantiated only once in a process, and was; share one fmuid.System between "
                f"simulators, or run the next one in another process"
            )
        self.fmu, self.name = fmu, name
        self.messages: list[tuple[int, str]] = []
        key = next(_keys)
        _instances[key] = self
        library = fmu.library(interface.identifier)
        folder = os.getcwd()  # noqa: PTH109  # FMPy changes the working directory and, on failure, leaves it so
        try:
            self._slave: Any = FMU2LenientSlave(
                guid=fmu.description.guid,
                modelIdentifier=interface.identifier,
                unzipDirectory=str(fmu.directory),
                instanceName=name,
                libraryPath=str(library),
                requireFunctions=False,
            )
            callbacks = _callbacks()
            callbacks.componentEnvironment = key
            self._slave.instantiate(callbacks=callbacks, loggingOn=False)
        except Exception as error:
            said = "; ".join(text for _, text in self.messages)
            raise InputError(
                f"{fmu.path} cannot be instantiated: {error}" + (f' (the FMU says: "{said}")' if said else "")
            ) from error
        finally:
            os.chdir(folder)
        _spent.add(fmu.digest)
        self._finalizer = weakref.finalize(self, _free, self._slave)
        self.handle = int(self._slave.component)
        self.addresses = self._find_functions()

    @property
    def library(self) -> Any:
        """The loaded shared library, as ctypes has it."""
        return self._slave.dll

    def _find_functions(self) -> NDArray[np.intp]:
        addresses = np.zeros(len(FUNCTIONS), np.intp)
        for i, function in enumerate(FUNCTIONS):
            try:
                addresses[i] = ctypes.cast(getattr(self.library, function), ctypes.c_void_p).value or 0
            except AttributeError:
                raise InputError(
                    f"{self.fmu.path}: its binary lacks the function {function}, which FMI 2.0 requires"
                ) from None
        return addresses

    def set_logging(self, on: bool) -> None:
        """Switch the FMU's debug log (fmi2SetDebugLogging with all categories)."""
        self._slave.setDebugLogging(on, [])

    def close(self, fatal: bool = False) -> None:
        """Free the instance; after a fatal error it must not be touched any more (FMI 2.0.4, section 2.1.3)."""
        if fatal:
            self._finalizer.detach()
        else:
            self._finalizer()


def _free(slave: Any) -> None:
    slave.fmi2FreeInstance(slave.component)


def describe_failure(function: int, status: int) -> str:
    """Return the failing FMI call in words."""
    word = STATUS_WORDS[status] if 0 <= status < len(STATUS_WORDS) else f"the illegal status {status}"
    hint = " (the FMU cannot go on from here)" if function == DO_STEP and status == 2 else ""
    return f"{FUNCTIONS[function]} returned {word}{hint}"


def warn(instance: Instance, told: set[str]) -> None:
    """Pass on, once each, the warnings that an instance gave during simulations that succeeded."""
    for status, text in instance.messages:
        if status > 0 and text not in told:
            told.add(text)
            _log.warning("%s: %s", instance.name, text)


if sys.maxsize <= 2**32:  # pragma: no cover
    raise ImportError("fmuid needs a 64-bit Python: its compiled loops pass 64-bit addresses")
