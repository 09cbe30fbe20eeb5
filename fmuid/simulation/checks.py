"""What the core takes for granted: every index of a plan points into the plan, and all arrays have the right shape.

What is wrong here is a defect of fmuid, not of what its user gave: `ValueError`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats, Indices
from fmuid.simulation import core_constants as k
from fmuid.simulation.failures import function_name
from fmuid.simulation.simulation_plan import Operation, SimulationPlan, TimeGrid

_STAGES = 5  # start values, inputs, exchange, outputs, input derivatives; then the exchange after each component
_FLOAT, _WORD = np.dtype(np.float64), np.dtype(np.intp)
_WIRE_OF = {  # how the values of a type are passed, where that is not as it is called
    2: {k.BOOLEAN: k.INT32},
    3: {k.BOOLEAN: k.UINT8},
}


def check_plan(plan: SimulationPlan, grid: TimeGrid, versions: Sequence[int]) -> None:
    """Check a plan and its grid for components of the given versions of FMI.

    Raises
    ------
    ValueError
        If an index points nowhere or an array has the wrong shape or type.
    """
    n = len(versions)
    for name, array, kind in _arrays(plan, grid):
        _demand(array.dtype == kind and array.flags.c_contiguous, name, "is of another type")
    for operation in plan.operations:
        _check_operation(plan, operation, versions)
    stages = plan.stages
    _demand(len(stages) == 1 + _STAGES + n and stages[0] == 0, "stages", "do not match the components")
    _demand((np.diff(stages) >= 0).all() and stages[-1] == len(plan.operations), "stages", "are out of order")
    _check_groups(plan)
    _check_signals(plan)
    _demand(len(plan.integrations) == len(plan.tolerances) == n, "integrations", "do not match the components")
    for (component, row), mode in zip(plan.input_curves, plan.input_modes.tolist(), strict=True):
        integration = plan.integrations[component] if 0 <= component < n else None
        inside = integration is not None and 0 <= row < len(integration.input_starts)
        _demand(inside if mode == k.BY_STEPPER else (component, row) == (-1, -1), "input_curves", "point nowhere")
    for i, integration in enumerate(plan.integrations):
        twins = integration.sensitivities.twins if integration and integration.sensitivities else ()
        known = all(0 <= twin < i and plan.integrations[twin] is not None for twin in twins)
        _demand(known, "integrations", "have twins that are none")
    _check_grid(plan, grid, n)


def check_arrays(plan: SimulationPlan, grid: TimeGrid, thetas: Floats, outputs: Floats, reports: Indices) -> None:
    """Check what a call of the core reads and writes.

    Raises
    ------
    ValueError
        If an array has the wrong shape or type.
    """
    m = len(thetas)
    for name, array, shape, kind in (
        ("thetas", thetas, (m, len(plan.parameter_signals)), _FLOAT),
        ("outputs", outputs, (m, len(grid.times), len(plan.output_terms) - 1), _FLOAT),
        ("reports", reports, (m, k.REPORT), _WORD),
    ):
        _demand(array.shape == shape and array.dtype == kind and array.flags.c_contiguous, name, f"are not {shape}")


def _demand(right: object, what: str, wrong: str) -> None:
    if not right:
        raise ValueError(f"the {what} of a plan {wrong}")


def _arrays(plan: SimulationPlan, grid: TimeGrid) -> list[tuple[str, NDArray[Any], type[np.generic]]]:
    found: list[tuple[str, NDArray[Any], type[np.generic]]] = [
        (name, getattr(plan, name), np.intp)
        for name in (
            *("stages", "groups", "parameter_signals", "input_signals", "input_modes", "derivative_signals"),
            *("output_signals", "output_terms"),
        )
    ]
    found += [(name, getattr(plan, name), np.float64) for name in ("signals", "conversions", "tolerances")]
    found += [("references", plan.references, np.uint32)]
    found += [(name, getattr(grid, name), np.intp) for name in ("substeps", "strides")]
    found += [(name, getattr(grid, name), np.float64) for name in ("times", "inputs")]
    open_ = (("slopes", grid.slopes), ("states", grid.states), ("gain", grid.gain), ("measured", grid.measured))
    return [*found, *((name, array, np.float64) for name, array in open_ if array is not None)]


def _check_operation(plan: SimulationPlan, given: Operation, versions: Sequence[int]) -> None:
    n_signals = len(plan.signals)
    if given.function == k.COPY:
        inside = 0 <= given.reference < n_signals and 0 <= given.signal < n_signals
        _demand(inside and 0 <= given.n_references < len(plan.conversions), "operations", "copy from or to nowhere")
        return
    _demand(0 <= given.component < len(versions), "operations", "have no component")
    first, count = given.reference, given.n_references
    _demand(0 <= first <= first + count <= len(plan.references), "operations", "have references that are none")
    places = len(plan.texts) if given.wire == k.STRING else n_signals
    inside = 0 <= given.signal <= given.signal + given.n_values <= places
    _demand(inside and given.n_values >= 0, "operations", "have values that are none")
    version, integration = versions[given.component], plan.integrations[given.component]
    _demand(0 <= given.when < 2 * k.LATCHED, "operations", "have conditions that are none")
    if given.function == k.SENSITIVITIES:
        count_of = len(integration.sensitivities.magnitudes) if integration and integration.sensitivities else -1
        right = count_of >= 0 and given.n_values == count * count_of and given.wire == k.FLOAT64
    elif given.function == k.SET_DERIVATIVES:
        right = version == 2 and integration is None and given.n_values == count and given.wire == k.FLOAT64
    else:
        transfers = 0 <= given.function < 2 * k.N_WIRES and function_name(version, given.function) is not None
        kind = given.function % k.N_WIRES
        right = transfers and given.function != k.N_WIRES + k.STRING and given.wire == _WIRE_OF[version].get(kind, kind)
        right = right and (given.n_values == count if version == 2 else given.n_values >= count)
    _demand(right, "operations", "do what their component cannot")


def _check_groups(plan: SimulationPlan) -> None:
    first, last = int(plan.stages[2]), int(plan.stages[3])
    _demand(plan.groups.ndim == 2 and plan.groups.shape[1] == 2, "groups", "are no pairs")
    loops = [end for begin, end in plan.groups.tolist() if begin < 0]
    _demand(loops == list(range(len(plan.loops))), "groups", "do not match the loops")
    for begin, end in plan.groups.tolist():
        _demand(begin < 0 or first <= begin <= end <= last, "groups", "point out of the exchange")
    for loop in plan.loops:
        _demand(first <= loop.first <= loop.setting <= loop.last <= last, "loops", "point out of the exchange")
        _demand(all(0 <= each < len(plan.signals) for each in loop.signals), "loops", "have unknowns that are none")
        stated = len(loop.nominals) == len(loop.signals) and all(0 <= each < math.inf for each in loop.nominals)
        _demand(stated, "loops", "have nominal values that are none")


def _check_signals(plan: SimulationPlan) -> None:
    for name in ("parameter_signals", "input_signals", "derivative_signals", "output_signals"):
        signals = getattr(plan, name)
        _demand(signals.ndim == 1 and ((signals >= 0) & (signals < len(plan.signals))).all(), name, "point nowhere")
    n = len(plan.input_signals)
    same = n == len(plan.input_modes) == len(plan.derivative_signals) == len(plan.input_curves)
    _demand(same, "inputs", "differ in number")
    modes, terms = plan.input_modes, plan.output_terms
    _demand(((modes >= k.HELD) & (modes <= k.BY_MIDPOINT)).all(), "input_modes", "are not known")
    ordered = len(terms) > 0 and terms[0] == 0 and (np.diff(terms) >= 0).all()
    _demand(ordered and terms[-1] == len(plan.output_signals), "output_terms", "are out of order")
    _demand(plan.conversions.ndim == 2 and plan.conversions.shape[1] == 2, "conversions", "are no pairs")


def _check_grid(plan: SimulationPlan, grid: TimeGrid, n: int) -> None:
    n_times = len(grid.times)
    shape = (n_times, len(plan.input_signals))
    _demand(n_times > 0 and np.isfinite(grid.times).all(), "times", "are no numbers")
    _demand(grid.inputs.shape == shape, "inputs", f"are not {shape}")
    _demand(grid.slopes is None or grid.slopes.shape == shape, "slopes", f"are not {shape}")
    _demand(grid.substeps.shape == (n_times - 1,) and (grid.substeps > 0).all(), "substeps", "are not positive")
    if grid.states is not None or grid.gain is not None:
        (integration,) = plan.integrations if n == 1 else (None,)
        _demand(integration is not None and integration.sensitivities is None, "states", "have no single component")
    _demand((grid.gain is None) == (grid.measured is None), "gain", "has nothing measured")
    n_y = len(plan.output_terms) - 1
    _demand(grid.measured is None or grid.measured.shape == (n_times, n_y), "measured", "are not those of the outputs")
    _demand(grid.strides.shape == (n,) and (grid.strides > 0).all(), "strides", "are not positive")
