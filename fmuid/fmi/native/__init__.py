"""The compiled core: its library loaded, and mirrors of the structures that it works on.

`core()` returns the library. Its sources are beside this file; docs/native-core.md describes them.
"""

from __future__ import annotations

import ctypes
import itertools
import logging
import threading
from ctypes import POINTER, Structure, c_char, c_char_p, c_double, c_int32, c_int64, c_size_t, c_void_p
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from fmuid.errors import InputError
from fmuid.fmi import codes
from fmuid.fmi.native import build

_log = logging.getLogger("fmuid.fmi")
_loading = threading.Lock()

SET_REALS, GET_REALS, SET_SLOPES, COPY_ONE, GET_SENSITIVITIES, OTHER = range(6)  # kinds of operations
METHODS = {"rk4": 0, "rk45": 1, "cvode": 2}


class Mirror(Structure):
    """A structure of the core, named like it with Struct behind; all derived ones are checked against the library."""

    kinds: ClassVar[dict[str, type[Mirror]]] = {}
    whole: ClassVar[bool] = True  # whether all fields are mirrored

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.kinds[cls.__name__.removesuffix("Struct")] = cls


class Fmi2Struct(Mirror):
    """Addresses of the functions of a binary of FMI 2.0."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        (name, c_void_p)
        for name in (
            *("Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"),
            *("SetReal", "SetInteger", "SetBoolean", "SetString", "GetReal", "GetInteger", "GetBoolean"),
            *("GetDirectionalDerivative", "SetRealInputDerivatives", "DoStep", "GetRealStatus", "GetBooleanStatus"),
            *("SetTime", "SetContinuousStates", "GetContinuousStates", "GetNominalsOfContinuousStates"),
            *("GetDerivatives", "GetEventIndicators", "EnterEventMode", "NewDiscreteStates"),
            *("EnterContinuousTimeMode", "CompletedIntegratorStep"),
        )
    ]


class Fmi3Struct(Mirror):
    """The same of FMI 3.0."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        (name, c_void_p)
        for name in (
            *("Reset", "EnterInitializationMode", "ExitInitializationMode"),
            *(f"Set{wire}" for wire in codes.WIRES),
            *(f"Get{wire}" for wire in codes.WIRES[:-1]),
            *("GetDirectionalDerivative", "EnterEventMode", "UpdateDiscreteStates", "EnterStepMode", "DoStep"),
            *("SetTime", "SetContinuousStates", "GetContinuousStates", "GetNominalsOfContinuousStates"),
            *("GetContinuousStateDerivatives", "GetEventIndicators", "EnterContinuousTimeMode"),
            "CompletedIntegratorStep",
        )
    ]


class ReportStruct(Mirror):
    """How a simulation ended; an array of these is one of words, `codes.REPORT` to a row."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *((name, c_int64) for name in ("failure", "component", "status", "sample", "state")),
        *((name, c_double) for name in ("time", "step")),
    ]


class CurveStruct(Mirror):
    """A polynomial of an input."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [("a", c_double * 4)]


class ComponentStruct(Mirror):
    """An instance, and how it is run."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(
            ("instance", c_void_p),
            ("fmi2", POINTER(Fmi2Struct)),
            ("fmi3", POINTER(Fmi3Struct)),
            ("integrator", c_void_p),
        ),
        *(("tolerance", c_double), ("used", c_void_p), ("event_mode", c_int32), ("mode", c_int32)),
        *(("time", c_double), ("begun", c_double)),
    ]


class OperationStruct(Mirror):
    """One transfer of values."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *((name, c_int32) for name in ("kind", "function", "component", "wire", "when")),
        *(("count", c_size_t), ("references", c_void_p), ("signal", c_size_t), ("n_values", c_size_t)),
        *(("values", c_void_p), ("last", c_void_p), ("instance", c_void_p), ("fmi2", POINTER(Fmi2Struct))),
        *(("source", c_size_t), ("factor", c_double), ("offset", c_double)),
    ]


class RangeStruct(Mirror):
    """Operations from one number up to another."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [("first", c_size_t), ("last", c_size_t)]


class LoopStruct(Mirror):
    """A loop of direct feed-through."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(("get", RangeStruct), ("set", RangeStruct), ("n", c_size_t), ("signals", c_void_p)),
        *((name, c_void_p) for name in ("unknowns", "residual", "matrix")),
    ]


class GroupStruct(Mirror):
    """A part of the exchange."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [("range", RangeStruct), ("loop", POINTER(LoopStruct))]


class PlanStruct(Mirror):
    """What is simulated."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *((f"n_{name}", c_size_t) for name in ("components", "signals", "parameters", "inputs", "outputs", "groups")),
        *(("components", POINTER(ComponentStruct)), ("operations", POINTER(OperationStruct))),
        *((name, RangeStruct) for name in ("start_values", "inputs", "exchange", "outputs", "slopes")),
        *(("after_step", POINTER(RangeStruct)), ("groups", POINTER(GroupStruct)), ("signals", c_void_p)),
        *((f"{name}_signals", c_void_p) for name in ("start", "parameter", "input", "slope", "output")),
        *((name, c_void_p) for name in ("output_terms", "input_modes", "curves")),
        *((name, POINTER(OperationStruct)) for name in ("direct_inputs", "direct_outputs")),
        *(("ones", c_void_p), ("curved", c_int32), ("midpoints", c_int32), ("by_rows", c_int32)),
    ]


class GridStruct(Mirror):
    """The samples."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("n_times", c_size_t),
        *((name, c_void_p) for name in ("times", "inputs", "slopes", "substeps", "strides")),
        *((name, c_void_p) for name in ("states", "gain", "measured")),
    ]


class SundialsStruct(Mirror):
    """Addresses of the functions of SUNDIALS."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        (name, c_void_p)
        for name in (
            *("SUNContext_Create", "SUNContext_ClearErrHandlers", "SUNContext_Free", "N_VMake_Serial"),
            *("N_VGetArrayPointer", "N_VDestroy", "SUNDenseMatrix", "SUNDenseMatrix_Data", "SUNMatDestroy"),
            *("SUNLinSol_Dense", "SUNLinSolFree", "CVodeCreate", "CVodeInit", "CVodeReInit", "CVodeSetUserData"),
            *("CVodeSVtolerances", "CVodeSetLinearSolver", "CVodeSetJacFn", "CVodeSetMaxHnilWarns", "CVodeSetMaxStep"),
            *("CVodeSetStopTime", "CVodeSetInitStep", "CVode", "CVodeGetDky", "CVodeFree"),
        )
    ]


class SensitivitiesStruct(Mirror):
    """What is integrated with the states."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("count", c_size_t),
        *((name, c_void_p) for name in ("magnitudes", "initial", "steps", "knowns", "twins")),
    ]


class IntegrationStruct(Mirror):
    """How a component for model exchange is integrated."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(("instance", c_void_p), ("fmi2", POINTER(Fmi2Struct)), ("fmi3", POINTER(Fmi3Struct))),
        *((f"n_{name}", c_size_t) for name in ("states", "indicators", "inputs", "input_references")),
        *((name, c_void_p) for name in ("input_references", "curves", "state_references", "derivative_references")),
        *((name, c_double) for name in ("tolerance", "largest_step", "limit")),
        ("most_steps", c_size_t),
        *((name, c_int32) for name in ("method", "straight", "follows")),
        *(("sensitivities", POINTER(SensitivitiesStruct)), ("sundials", POINTER(SundialsStruct))),
    ]


class IntegratorStruct(Mirror):
    """The part of an integrator's memory that is looked at from here."""

    whole = False
    _fields_: ClassVar[list[tuple[str, Any]]] = [
        ("how", IntegrationStruct),
        *((name, c_double) for name in ("origin", "time", "step_start", "step_end", "step_length")),
        *(("next_step", c_double), ("next_event", c_double), ("n_steps", c_size_t), ("n_events", c_size_t)),
        *(("report", ReportStruct), ("cancel", c_void_p)),
    ]


class MessageStruct(Mirror):
    """What an FMU says."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [("status", c_int32), ("text", c_char * 2048)]


class LogStruct(Mirror):
    """All that an instance has said since the count was set to 0, and a bounded number of messages."""

    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(("count", c_int32), ("messages", MessageStruct * 20), ("callbacks", c_void_p * 5)),
    ]


class _Place(Structure):
    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(("structure", c_char_p), ("field", c_char_p)),
        *(("offset", c_size_t), ("size", c_size_t)),
    ]


@cache
def core() -> Any:
    """Return the library; where it lies beside changed sources, it is compiled first.

    Raises
    ------
    InputError
        If it is missing or of other sources, and cannot be compiled.
    """
    with _loading:
        path = _path()
        try:
            library = ctypes.CDLL(str(path))
        except OSError as error:
            raise InputError(f"fmuid's compiled core {path} cannot be loaded ({error}); install fmuid anew") from error
        _declare(library)
        wrong = _difference(library)
        if wrong:
            raise InputError(
                f"fmuid's compiled core {path} is of another version than fmuid ({wrong}); install it anew"
            )
        return library


def _path() -> Path:
    if not build.sources():
        found = list(build.HERE.glob("core-*"))
        if len(found) == 1:
            return found[0]
        raise InputError(
            f"fmuid's compiled core is missing in {build.HERE}; install fmuid from a wheel of this platform"
        )
    path = build.HERE / build.library_name()
    if path.is_file():
        return path
    _log.info("compiling the core, which has changed or was not compiled yet")
    try:
        return build.build_here()
    except (build.BuildError, OSError) as error:
        raise InputError(f"fmuid's core is not compiled from the sources in {build.HERE}, and {error}") from error


def _declare(library: Any) -> None:
    integrator = c_void_p
    for name, result, arguments in (
        ("layout", POINTER(_Place), []),
        ("code_names", POINTER(c_char_p), []),
        ("simulate", None, [c_void_p, c_void_p, c_size_t, c_void_p, c_void_p, c_void_p, c_void_p]),
        *(("environment_size", c_size_t, []), ("environment_keep", None, [c_void_p])),
        *(("environment_restore", None, [c_void_p]), ("log_open", c_void_p, [c_void_p])),
        ("integrator_create", integrator, [c_void_p]),
        ("integrator_free", None, [integrator]),
        *(
            (f"integrator_{name}", ctypes.c_int, [integrator, c_double])
            for name in ("begin", "enter_events", "leave_events", "advance")
        ),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments


def _difference(library: Any) -> str:
    """Return where the mirrors differ from what the library was compiled from."""
    told: dict[str, list[tuple[str, int, int]]] = {name: [] for name in Mirror.kinds}
    places = library.layout()
    for place in itertools.takewhile(lambda place: place.structure, map(places.__getitem__, itertools.count())):
        name, field = place.structure.decode(), (place.field or b"").decode()
        if name not in told:
            return str(name)
        told[name].append((field, place.offset, place.size))
    apart = [name for name, mirror in Mirror.kinds.items() if told[name] != _places(mirror)]
    return apart[0] if apart else _renumbered(library)


def _places(mirror: type[Mirror]) -> list[tuple[str, int, int]]:
    fields = [(name, getattr(mirror, name).offset, getattr(mirror, name).size) for name, *_ in mirror._fields_]
    return [("", 0, ctypes.sizeof(mirror)), *fields] if mirror.whole else fields


def _renumbered(library: Any) -> str:
    wires = [wire.upper() for wire in codes.WIRES]
    names: list[str] = [*wires, *wires, *codes.FAILURES]
    told = library.code_names()
    theirs = [name.decode() for name in itertools.takewhile(bool, map(told.__getitem__, itertools.count()))]
    wrong = [name or other for name, other in itertools.zip_longest(names, theirs, fillvalue="") if name != other]
    return wrong[0] if wrong else ""
