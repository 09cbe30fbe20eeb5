"""Integration of a Model Exchange instance by the core, with events."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.simulation import codes
from fmuid.simulation.native.library import METHODS, core
from fmuid.simulation.simulation_plan import Integration, Sensitivities

NO_REFERENCES: NDArray[np.uint32] = np.zeros(0, np.uint32)
REQUIRED = (
    *(codes.SET_TIME, codes.FLOAT64, codes.SET_STATES, codes.GET_STATES, codes.GET_DERIVATIVES, codes.GET_INDICATORS),
    *(codes.GET_NOMINALS, codes.ENTER_EVENT_MODE, codes.UPDATE_DISCRETE_STATES, codes.ENTER_CONTINUOUS_TIME_MODE),
)
"""The functions that model exchange requires."""


def function_table(version: int, address_of: Callable[[str], int]) -> ctypes.Structure:
    """Return the core's table of a binary's functions."""
    kind: type[ctypes.Structure] = getattr(core(), f"Fmi{version}")
    return kind(**{name: address_of(name) for name, *_ in kind._fields_})


def address(memory: Any) -> int | None:
    """Return the address of an array or structures; None for none."""
    if memory is None:
        return None
    return int(memory.ctypes.data) if isinstance(memory, np.ndarray) else ctypes.addressof(memory)


class IntegratedModel(NamedTuple):
    """A Model Exchange instance as the core integrates it.

    `table` lacks optional functions that are not to be called. References are for directional derivatives.
    """

    version: int
    handle: int
    table: ctypes.Structure
    n_states: int
    n_indicators: int
    state_references: NDArray[np.uint32] = NO_REFERENCES
    derivative_references: NDArray[np.uint32] = NO_REFERENCES


class Integrator:
    """Memory of one Model Exchange instance under integration.

    Steps may pass the wanted time up to `limit`, s. `straight`: input polynomials are at most linear. `twins` give the
    sensitivities by differences. `curves` (n_u, 4) are the inputs' polynomials in t − state.origin, lowest power first.
    """

    def __init__(
        self,
        model: IntegratedModel,
        given: Integration,
        *,
        limit: float = -math.inf,
        straight: bool = False,
        twins: Sequence[Integrator] = (),
    ) -> None:
        if not 0.0 < given.tolerance < 1.0:  # `Numerics` has checked the other settings
            raise InputError(f"tolerance: {given.tolerance:g} is outside (0, 1)")
        sensitivities = given.sensitivities
        self.curves: Floats = np.zeros((len(given.input_starts), 4))
        self.curves[:, 0] = given.input_starts
        n, states, derivatives = model.n_states, model.state_references, model.derivative_references
        known = n > 0 and len(states) == len(derivatives) == n
        sundials = sundials_table() if given.integrator == "cvode" and n else None
        library = core()
        extension = None if sensitivities is None else self._extension(sensitivities, states, n, twins)
        self._kept: list[Any] = [model, given, list(twins), extension, sundials]
        how = library.Integration(
            instance=model.handle,
            n_states=n,
            n_indicators=model.n_indicators,
            n_inputs=len(self.curves),
            n_input_references=len(given.inputs),
            input_references=address(given.inputs),
            curves=address(self.curves),
            state_references=address(states) if known else None,
            derivative_references=address(derivatives) if known else None,
            tolerance=given.tolerance,
            largest_step=math.inf if given.step_size is None else given.step_size,
            limit=limit,
            most_steps=given.most_steps,
            method=METHODS[given.integrator],
            straight=straight,
            follows=given.follows,
            sensitivities=address(extension),
            sundials=address(sundials),
            **{f"fmi{model.version}": address(model.table)},
        )
        made = library.integrator_create(ctypes.byref(how))
        if not made:
            raise MemoryError("an integrator cannot allocate its memory")
        self.handle: int = made
        self._finalizer = weakref.finalize(self, library.integrator_free, made)
        self.state = library.Integrator.from_address(made)

    def _extension(
        self, given: Sensitivities, states: NDArray[np.uint32], n: int, twins: Sequence[Integrator]
    ) -> ctypes.Structure:
        count, handles = len(given.magnitudes), np.array([twin.handle for twin in twins], np.intp)
        if given.initial.shape != (count, n) or len(given.steps) != count or len(twins) not in (0, count):
            raise ValueError("the arrays of the sensitivities do not fit together")
        knowns = np.zeros((count, n + 1), np.uint32)
        if not twins:
            knowns[:, :n], knowns[:, n] = states, given.references
        self._arrays = knowns, handles
        made: ctypes.Structure = core().Sensitivities(
            count=count,
            magnitudes=address(given.magnitudes),
            initial=address(given.initial),
            steps=address(given.steps),
            knowns=address(knowns),
            twins=address(handles) if twins else None,
        )
        return made


def sundials_table() -> ctypes.Structure:
    """Return the functions of FMPy's SUNDIALS libraries for this platform."""
    try:
        from fmpy.sundials import libraries
    except Exception as error:  # FMPy lets through what the loader raises: OSError, AttributeError, its own
        raise InputError(
            f'solver: "cvode" has no library for this platform ({error}). Choose "rk45", or "rk4" with a step_size.'
        ) from error
    return _table_of(libraries)


@cache
def _table_of(libraries: Any) -> ctypes.Structure:
    loaded = [
        getattr(libraries, f"sundials_{name}")
        for name in ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense", "cvode")
    ]
    found = {}
    for name, _ in core().Sundials._fields_:
        library = next(each for each in loaded if hasattr(each, name))
        found[name] = ctypes.cast(library[name], ctypes.c_void_p).value
    made: ctypes.Structure = core().Sundials(**found)
    return made
