"""The integration of a model-exchange instance by the core: fixed-step, adaptive or stiff, events of all kinds."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.simulation import codes
from fmuid.simulation.native.library import METHODS, core
from fmuid.simulation.simulation_plan import Integration, Sensitivities

NO_REFERENCES: NDArray[np.uint32] = np.zeros(0, np.uint32)
REQUIRED = (
    *(
        codes.SET_TIME,
        codes.FLOAT64,
        codes.SET_STATES,
        codes.GET_DERIVATIVES,
        codes.GET_INDICATORS,
        codes.GET_STATES,
        codes.GET_NOMINALS,
    ),
    *(codes.ENTER_EVENT_MODE, codes.UPDATE_DISCRETE_STATES, codes.ENTER_CONTINUOUS_TIME_MODE),
)
"""The functions that model exchange requires."""


def function_table(version: int, address_of: Callable[[str], int]) -> ctypes.Structure:
    """Return the core's table of the functions of a binary, by `address_of` their names without prefix."""
    kind: type[ctypes.Structure] = getattr(core(), f"Fmi{version}")
    return kind(**{name: address_of(name) for name, *_ in kind._fields_})


def address(memory: Any) -> int | None:
    """Return where the numbers of an array, or structures, are; None for none."""
    if memory is None:
        return None
    return int(memory.ctypes.data) if isinstance(memory, np.ndarray) else ctypes.addressof(memory)


class Integrator:
    """The memory of one model-exchange instance under integration; freed with the object.

    Parameters
    ----------
    version : int
        Of the FMI standard: 2 or 3.
    handle : int
        Address of the instance.
    table : Fmi2 or Fmi3 of the core
        Its functions; without the optional CompletedIntegratorStep and GetDirectionalDerivative where they are not
        to be called.
    n_states, n_indicators : int
    given : Integration
        Its arrays of sensitivities may be filled in anew before each simulation.
    limit : float
        Steps may go beyond the wanted time up to here, s.
    state_references, derivative_references : (n_states,) array of uint32, optional
        Value references of states and derivatives, in their order, for directional derivatives.
    straight : bool
        Whether the polynomials of the inputs are of first order at most.
    twins : sequence of Integrator
        Those whose differences give the sensitivities.

    Attributes
    ----------
    handle : int
        Address of the memory.
    curves : (n_u, 4) array
        Input j at time t is the polynomial in t - state.origin with these coefficients, lowest power first.
    state : Integrator of the core
        How far it is, and what failed.

    Raises
    ------
    InputError
        If the integrator, its tolerance or step size is not one, or if there is no CVODE for this platform.
    """

    def __init__(
        self,
        version: int,
        handle: int,
        table: ctypes.Structure,
        n_states: int,
        n_indicators: int,
        given: Integration,
        *,
        limit: float = -math.inf,
        state_references: NDArray[np.uint32] = NO_REFERENCES,
        derivative_references: NDArray[np.uint32] = NO_REFERENCES,
        straight: bool = False,
        twins: Sequence[Integrator] = (),
    ) -> None:
        _check(given.integrator, given.tolerance, given.step_size)
        sensitivities = given.sensitivities
        self.curves: Floats = np.zeros((len(given.input_starts), 4))
        self.curves[:, 0] = given.input_starts
        references = (given.inputs, state_references, derivative_references)
        inputs, states, derivatives = (np.ascontiguousarray(values, np.uint32) for values in references)
        known = n_states > 0 and len(states) == len(derivatives) == n_states
        sundials = sundials_table() if given.integrator == "cvode" and n_states else None
        library = core()
        extension = None if sensitivities is None else self._extension(sensitivities, states, n_states, twins)
        self._kept: list[Any] = [inputs, states, derivatives, list(twins), sensitivities, table, extension, sundials]
        how = library.Integration(
            instance=handle,
            n_states=n_states,
            n_indicators=n_indicators,
            n_inputs=len(self.curves),
            n_input_references=len(inputs),
            input_references=address(inputs),
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
            **{f"fmi{version}": address(table)},
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


def _check(integrator: str, tolerance: float, step_size: float | None) -> None:
    if integrator not in METHODS:
        raise InputError(f'solver = "{integrator}" is none; choose one of {", ".join(METHODS)}')
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"tolerance = {tolerance:g} must lie between 0 and 1")
    if step_size is not None and not 0.0 < step_size < math.inf:
        raise InputError(f"step_size = {step_size:g} must be a positive number of seconds")


def sundials_table() -> ctypes.Structure:
    """Return the functions of the SUNDIALS libraries that FMPy carries.

    Raises
    ------
    InputError
        If there are none for this platform.
    """
    try:
        from fmpy.sundials import libraries
    except Exception as error:  # FMPy lets through what the loader raises: OSError, AttributeError, its own
        raise InputError(
            f'solver = "cvode" has no library for this platform ({error}); '
            'choose solver = "rk45", or "rk4" with a step_size'
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
