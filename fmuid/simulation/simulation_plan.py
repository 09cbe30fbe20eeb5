"""What the core is to do, as arrays, and the experiment as it walks it; both are checked.

What is wrong with a plan is a defect of fmuid, not of what its user gave: `ValueError`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats, Indices
from fmuid.simulation import codes
from fmuid.simulation.failures import function_name

MOST_STEPS = 1_000_000
"""Of an integrator between two samples: some seconds, then it will never arrive."""


class Operation(NamedTuple):
    """One call: `n_references` value references from number `reference` on, `n_values` signals from `signal` on.

    For COPY, `reference` is the source signal, `n_references` the number of the conversion and `signal` the target.
    """

    function: int
    component: int
    reference: int
    n_references: int
    signal: int
    n_values: int
    wire: int
    when: int = codes.ALWAYS


class AlgebraicLoop(NamedTuple):
    """A loop of direct feed-through: which operations get and copy, which set, its inputs and its name.

    `signals` are those of the inputs, `nominals` their nominal values, 0 where none is stated.
    """

    first: int
    setting: int
    last: int
    signals: tuple[int, ...]
    nominals: tuple[float, ...]
    words: str


class Sensitivities(NamedTuple):
    """The sensitivities of the states to N parameters, to be integrated with a component's n states.

    `magnitudes` (N,) of the parameters scale the tolerances. The derivatives come from the FMU (directional
    derivatives): `initial` (N, n) are the sensitivities to begin with, `references` (N,) those of the parameters. Or
    they are differences: `twins` are components of the same FMU with one parameter each changed by `steps` (N,).
    The arrays are filled in before each simulation.
    """

    magnitudes: Floats
    initial: Floats
    references: NDArray[np.uint32]
    steps: Floats
    twins: tuple[int, ...]


class Integration(NamedTuple):
    """How a component for model exchange is integrated; `inputs` are the references of those that vary continuously.

    `input_starts` has one value for each of their elements (an array of FMI 3.0 has one reference for all). Components
    that are `autonomous` have no varying inputs at all, so that steps may go beyond the samples. A component that
    `follows` is not integrated: it is the twin of one that is. A simulation that needs more than `most_steps` between
    two samples fails, but by fixed steps. "rk45" is Dormand and Prince's method with step-size control, "rk4" the
    classical one with equal steps, "cvode" CVODE's BDF; `tolerance` is relative, the absolute one of a state that times
    its nominal value; there is no bound on a step but `step_size`, s, and the wanted times.
    """

    integrator: str = "rk45"
    tolerance: float = 1e-6
    step_size: float | None = None
    inputs: NDArray[np.uint32] = np.zeros(0, np.uint32)
    input_starts: Floats = np.zeros(0)
    autonomous: bool = False
    follows: bool = False
    sensitivities: Sensitivities | None = None
    most_steps: int = MOST_STEPS


class SimulationPlan(NamedTuple):
    """What the loop does, as arrays.

    `stages` says where each list of operations starts: start values | external inputs | exchange between components |
    outputs | input derivatives | exchange after the step of each component in turn (Gauss–Seidel). `groups` are the
    parts (first, last operation) of the exchange, (-1, number) for a loop of direct feed-through. Output j is the sum
    of the signals from `output_terms[j]` on. `input_curves` says of each external input which row of the polynomials of
    which component's stepper it is, (-1, -1) for those of none.
    """

    operations: tuple[Operation, ...]
    stages: Indices
    groups: Indices
    loops: tuple[AlgebraicLoop, ...]
    references: NDArray[np.uint32]
    signals: Floats
    conversions: Floats
    texts: tuple[bytes, ...]
    parameter_signals: Indices
    input_signals: Indices
    input_modes: Indices
    input_curves: tuple[tuple[int, int], ...]
    derivative_signals: Indices
    output_signals: Indices
    output_terms: Indices
    integrations: tuple[Integration | None, ...]
    tolerances: Floats
    gauss_seidel: bool


class TimeGrid(NamedTuple):
    """The experiment as the loop walks it, `SampleGrid` of the core.

    Times (K,), substeps of each interval (K-1,), how many substeps each component's own step has (n_components,), input
    values (K, n_u) and, where any input goes along a cubic curve, the slopes at the samples, else None.

    A single component for model exchange is shown `states` (K, n_x) in place of integrating it, at times in any order;
    or its states are corrected after each sample by a `gain` (n_x, n_y) times `measured` (K, n_y) less the outputs, but
    for what is NaN.
    """

    times: Floats
    substeps: Indices
    strides: Indices
    inputs: Floats
    slopes: Floats | None
    states: Floats | None = None
    gain: Floats | None = None
    measured: Floats | None = None


def new_reports(count: int) -> Indices:
    """Return reports (count, codes.REPORT) of simulations that are not done."""
    return np.full((count, codes.REPORT), codes.UNDONE, np.intp)


class GridSimulation:
    """What threads simulate: a plan over a grid. It can travel to another process.

    Parameters
    ----------
    plan : SimulationPlan
    grid : TimeGrid
    output_names : tuple of str
    """

    def __init__(self, plan: SimulationPlan, grid: TimeGrid, output_names: tuple[str, ...]) -> None:
        self.plan, self.grid, self.output_names = plan, grid, output_names

    def __reduce__(self) -> tuple[type[GridSimulation], tuple[SimulationPlan, TimeGrid, tuple[str, ...]]]:
        return GridSimulation, (self.plan, self.grid, self.output_names)

    def integrate(self, component: int, integrator: str) -> None:
        """Integrate a component for model exchange by another integrator from now on."""
        integrations = list(self.plan.integrations)
        old = integrations[component]
        integrations[component] = old and old._replace(integrator=integrator)
        self.plan = self.plan._replace(integrations=tuple(integrations))

    def control(self, tolerance: float, most_steps: int | None = None) -> None:
        """Integrate all components for model exchange with another relative tolerance, or limit, from now on."""
        integrations = tuple(
            each and each._replace(tolerance=tolerance, most_steps=most_steps or each.most_steps)
            for each in self.plan.integrations
        )
        self.plan = self.plan._replace(integrations=integrations)

    @property
    def varying(self) -> list[Sensitivities]:
        """What is filled in anew before each simulation."""
        return [each.sensitivities for each in self.plan.integrations if each is not None and each.sensitivities]


def shares(total: int, count: int) -> list[slice]:
    """Return the shares of `count` threads in `total` simulations."""
    edges = [total * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


_STAGES = 5  # start values, inputs, exchange, outputs, input derivatives; then the exchange after each component
_FLOAT, _WORD = np.dtype(np.float64), np.dtype(np.intp)
_WIRE_OF = {  # how the values of a type are passed, where that is not as it is called
    2: {codes.BOOLEAN: codes.INT32},
    3: {codes.BOOLEAN: codes.UINT8},
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
        _demand(inside if mode == codes.BY_STEPPER else (component, row) == (-1, -1), "input_curves", "point nowhere")
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
        ("reports", reports, (m, codes.REPORT), _WORD),
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
    if given.function == codes.COPY:
        inside = 0 <= given.reference < n_signals and 0 <= given.signal < n_signals
        _demand(inside and 0 <= given.n_references < len(plan.conversions), "operations", "copy from or to nowhere")
        return
    _demand(0 <= given.component < len(versions), "operations", "have no component")
    first, count = given.reference, given.n_references
    _demand(0 <= first <= first + count <= len(plan.references), "operations", "have references that are none")
    places = len(plan.texts) if given.wire == codes.STRING else n_signals
    inside = 0 <= given.signal <= given.signal + given.n_values <= places
    _demand(inside and given.n_values >= 0, "operations", "have values that are none")
    version, integration = versions[given.component], plan.integrations[given.component]
    _demand(0 <= given.when < 2 * codes.LATCHED, "operations", "have conditions that are none")
    if given.function == codes.SENSITIVITIES:
        count_of = len(integration.sensitivities.magnitudes) if integration and integration.sensitivities else -1
        right = count_of >= 0 and given.n_values == count * count_of and given.wire == codes.FLOAT64
    elif given.function == codes.SET_DERIVATIVES:
        right = version == 2 and integration is None and given.n_values == count and given.wire == codes.FLOAT64
    else:
        transfers = 0 <= given.function < 2 * codes.N_WIRES and function_name(version, given.function) is not None
        kind = given.function % codes.N_WIRES
        right = (
            transfers
            and given.function != codes.N_WIRES + codes.STRING
            and given.wire == _WIRE_OF[version].get(kind, kind)
        )
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
    _demand(((modes >= codes.HELD) & (modes <= codes.BY_MIDPOINT)).all(), "input_modes", "are not known")
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
