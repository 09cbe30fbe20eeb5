"""The stepper of a model-exchange instance: its integrator, as the compiled master loop calls it.

Only who runs model exchange imports this, and with it the compiled integrators.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmuid.fmi import block
from fmuid.fmi.description import Description
from fmuid.fmi.instance import Instance
from fmuid.fmi.integrators import FUNCTIONS, OPTIONAL, ModelExchange, advance, begin, enter_events, leave_events
from fmuid.fmi.layout import Integration


class ModelExchangeStepper:
    """Takes one model-exchange instance from one communication point to the next (`fmuid.fmi.loop.Stepper`).

    Parameters
    ----------
    instance : Instance
    integration : Integration
    last_time : float
        The last sample, s: steps of an autonomous model may go as far.
    twins : sequence of int
        Addresses of the memory of the twins whose differences give the sensitivities.

    Attributes
    ----------
    block : int
        Address of its memory.
    functions : tuple of int
        Addresses of begin, enter_events, leave_events and advance.
    failure : int
        Address of two words, what failed and its status.
    origin : int
        Address of the time from which on the polynomials of the inputs count.
    fresh : int
        Address of the word that is 0 where the integrator has to start anew.
    coefficients : (n, 4) array
        The polynomials of the inputs.
    sensitivities : int
        Address of the getter of the outputs' sensitivities, 0 where there is none.

    Raises
    ------
    InputError
        If the binary lacks a function, or the platform the integrator.
    """

    def __init__(
        self, instance: Instance, integration: Integration, last_time: float, twins: Sequence[int] = ()
    ) -> None:
        description = instance.fmu.description
        interface = description.interfaces[instance.kind]
        unused = {
            "CompletedIntegratorStep": not interface.completed_step,
            "GetDirectionalDerivative": not interface.directional_derivatives,
        }
        addresses = {}
        for key, names in FUNCTIONS.items():
            name = names[instance.version - 2].removeprefix(f"fmi{instance.version}")
            if not unused.get(key, False):
                addresses[key] = instance.address(name) if key in OPTIONAL else instance.required(name)
        self.states = description.states
        self._solver = ModelExchange(
            instance.version,
            instance.handle,
            addresses,
            len(description.derivatives),
            description.indicators,
            integrator=integration.integrator,
            tolerance=integration.tolerance,
            step_size=integration.step_size,
            input_references=integration.inputs,
            input_starts=integration.input_starts,
            state_references=_references(description, description.states),
            derivative_references=_references(description, description.derivatives),
            magnitudes=integration.sensitivities.magnitudes if integration.sensitivities else None,
        )
        if integration.autonomous:
            self._solver.reals[block.LIMIT] = last_time
        self.block = self._solver.address
        self.functions: tuple[int, ...] = tuple(each.address for each in (begin, enter_events, leave_events, advance))
        self.sensitivities = 0
        if integration.follows or integration.sensitivities:
            self._append(integration, _references(description, description.states), twins)
        self.failure = self.block + 8 * block.FAILED_FUNCTION
        self.origin = int(self._solver.reals.ctypes.data) + 8 * block.ORIGIN
        self.fresh = self.block + 8 * block.FRESH
        self.coefficients = self._solver.coefficients

    def _append(self, integration: Integration, states: NDArray[np.uint32], twins: Sequence[int]) -> None:
        """Prepare for sensitivities: those of this instance, or as a twin for those of another."""
        from fmuid.fmi.sensitivities import OUTPUTS, TWIN_FUNCTIONS, SensitivityMemory  # compiled where it is needed

        if integration.follows:
            self.functions = begin.address, *TWIN_FUNCTIONS
        elif integration.sensitivities:
            self._memory = SensitivityMemory(self._solver.words, integration.sensitivities, states, twins)
            self.sensitivities = 0 if twins else OUTPUTS

    def whereabouts(self) -> tuple[float, float]:
        """Return the time that was reached and the step that was tried last, s."""
        reals = self._solver.reals
        return float(reals[block.STEP_END]), float(reals[block.H])

    def bad_state(self) -> str:
        """Return the name of the state that ceased to be finite, or has the largest error."""
        bad = int(self._solver.words[block.BAD_STATE])
        count = len(self.states)
        of = f"(its sensitivity to parameter {bad // count})" if count and bad >= count else ""
        return f"{self.states[bad % count]}{of}" if count else f"number {bad + 1}"


def _references(description: Description, names: Sequence[str]) -> NDArray[np.uint32]:
    """Return value references; none where an array is among the variables, whose reference stands for all of it."""
    variables = [description.variables[name] for name in names]
    if any(variable.array for variable in variables):
        return np.zeros(0, np.uint32)
    return np.array([variable.reference for variable in variables], np.uint32)
