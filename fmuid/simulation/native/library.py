"""The compiled core: its library and structures.

`core()` returns the library with its structures as attributes, laid out as the library says.
Its sources and README.md, which describes them, are beside this file.
"""

from __future__ import annotations

import ctypes
import itertools
import logging
import threading
from ctypes import POINTER, Structure, c_char_p, c_double, c_size_t, c_void_p
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from fmuid.errors import InputError
from fmuid.simulation import codes
from fmuid.simulation.native import build
from fmuid.version import __version__

_log = logging.getLogger("fmuid.simulation")
_loading = threading.Lock()

SET_REALS, GET_REALS, SET_SLOPES, COPY_ONE, GET_SENSITIVITIES, OTHER = range(6)  # kinds of operations
METHODS = {"rk4": 0, "rk45": 1, "cvode": 2}


class _FieldLayout(Structure):
    _fields_: ClassVar[list[tuple[str, Any]]] = [
        *(("structure", c_char_p), ("field", c_char_p), ("type", c_char_p)),
        *(("offset", c_size_t), ("size", c_size_t)),
    ]


@cache
def core() -> Any:
    """Return the library, compiled first if its sources have changed."""
    with _loading:
        path = _path()
        try:
            library = ctypes.CDLL(str(path))
        except OSError as error:
            raise InputError(f"{path}: fmuid's compiled core cannot be loaded ({error}). Reinstall fmuid.") from error
        _declare(library)
        wrong = _difference(library)
        if wrong:
            raise InputError(f"{path}: fmuid's compiled core is of another version ({wrong}). Reinstall fmuid.")
        for name, structure in _structures(library).items():
            setattr(library, name, structure)
        return library


def _path() -> Path:
    if not build.sources():
        found = list(build.HERE.glob("core-*"))
        if len(found) == 1:
            return found[0]
        raise InputError(f"{build.HERE}: fmuid's compiled core is missing. Install a wheel of this platform.")
    path = build.HERE / build.library_name()
    if path.is_file():
        return path
    _log.info("compiling the core")
    try:
        return build.build_here()
    except (build.BuildError, OSError) as error:
        raise InputError(f"{build.HERE}: fmuid's core must be compiled. {error}") from error


def _declare(library: Any) -> None:
    integrator = c_void_p
    for name, result, arguments in (
        ("layout", POINTER(_FieldLayout), []),
        *(("code_names", POINTER(c_char_p), []), ("version", c_char_p, [])),
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


def _structures(library: Any) -> dict[str, type[Structure]]:
    """Return the structures as laid out by the library; unknown fields are refused."""
    made: dict[str, type[Structure]] = {}
    fields: list[tuple[str, Any]] = []
    offsets: list[int] = []
    places = library.layout()
    for place in itertools.takewhile(lambda place: place.structure, map(places.__getitem__, itertools.count())):
        if place.field is not None:
            kind = made.get(place.type.decode()) or getattr(ctypes, place.type.decode())
            count = place.size // ctypes.sizeof(kind)
            fields.append((place.field.decode(), kind if count == 1 else kind * count))
            offsets.append(place.offset)
            continue
        name = place.structure.decode()
        made[name] = whole = type(name, (Structure,), {"_fields_": fields, "__slots__": ()})
        if offsets != [getattr(whole, field).offset for field, _ in fields] or ctypes.sizeof(whole) > place.size:
            raise InputError(f"fmuid's compiled core has another layout of {name}. Reinstall fmuid.")
        fields, offsets = [], []
    return made


def _difference(library: Any) -> str:
    """Return the library's other version, or the name of another code."""
    version = library.version().decode()
    if version != __version__:
        return str(version)
    told = library.code_names()
    names = [name.decode() for name in itertools.takewhile(bool, map(told.__getitem__, itertools.count()))]
    numbers = [*range(codes.N_WIRES), *range(2 * codes.N_WIRES, codes.PROCESS)]
    wrong = (name for name, number in zip(names, numbers, strict=False) if getattr(codes, name, None) != number)
    return next(wrong, "") or ("" if len(names) == len(numbers) else names[-1])
