"""Operations of the core and its grid, as checked arrays.

A wrong plan is a defect of fmuid, not of its user: `ValueError`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Flags, Floats, Indices
from fmuid.simulation import codes
from fmuid.simulation.failures import function_name

MOST_STEPS = 1_000_000
"""Of an integrator between two samples: some seconds, then it will never arrive."""


class Operation(NamedTuple):
    """One call of the core, with value references and signals.

    It takes `n_references` from `reference` on and `n_values` from `signal` on. For COPY, `reference` is the source
    signal, `n_references` the conversion's number, `signal` the target.
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
    """An algebraic loop: ranges of its operations, inputs, and name.

    From `first` on it gets and copies, from `setting` on it sets. `nominals` of its input `signals` are 0 if unknown.
    """

    first: int
    setting: int
    last: int
    signals: tuple[int, ...]
    nominals: tuple[float, ...]
    words: str


class Sensitivities(NamedTuple):
    """Sensitivities of n states to N parameters, filled in before each run.

    `magnitudes` (N,) of the parameters scale the tolerances. With directional derivatives, `initial` (N, n) are
    initial values and `references` (N,) the parameters'. Else `twins` are components with one parameter changed each,
    by `steps` (N,).
    """

    magnitudes: Floats
    initial: Floats
    references: NDArray[np.uint32]
    steps: Floats
    twins: tuple[int, ...]


class Integration(NamedTuple):
    """Integration of a Model Exchange component; `inputs` refer to continuous inputs.

    `input_starts` has a value per array element. An `autonomous` component has no varying inputs: steps may pass
    samples. One that `follows` is a twin, not integrated itself. More than `most_steps` between samples fail, except
    of "rk4". `tolerance` is relative, times the nominal value absolute. `step_size` is the largest step, s.
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


class PlanInputs(NamedTuple):
    """External inputs: signals, signals of slopes, modes (`codes.HELD` ...), polynomials.

    `curves` has each input's component and row of its polynomials, or (-1, -1).
    """

    signals: Indices
    slopes: Indices
    modes: Indices
    curves: tuple[tuple[int, int], ...]


class SimulationPlan(NamedTuple):
    """Operations and signals of the core.

    `stages` are the first operations of: start values | inputs | exchange | outputs | input derivatives | exchange
    after each component's step (Gauss–Seidel). `groups` are (first, last) operations of the exchange, or (-1, number)
    of a loop. Output j is the sum of the signals from `output_terms[j]` on.
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
    inputs: PlanInputs
    output_signals: Indices
    output_terms: Indices
    integrations: tuple[Integration | None, ...]
    tolerances: Floats
    gauss_seidel: bool


class TimeGrid(NamedTuple):
    """The experiment as `SampleGrid` of the core.

    Times (K,), substeps per interval (K-1,), substeps per component's step (n_components,), inputs (K, n_u), slopes of
    cubic inputs. A single Model Exchange component may get `states` (K, n_x) instead of integration.
    Or samples correct its states: `gain` (n_x, n_y) times `measured` (K, n_y) − outputs, except NaN.
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
    """Return reports (count, codes.REPORT) of simulations not yet done."""
    return np.full((count, codes.REPORT), codes.UNDONE, np.intp)


@dataclass(eq=False)
class GridSimulation:
    """A plan over a grid, with output names; it can be pickled."""

    plan: SimulationPlan
    grid: TimeGrid
    output_names: tuple[str, ...]

    def integrate(self, component: int, integrator: str) -> None:
        """Use another integrator for a component from now on."""
        integrations = list(self.plan.integrations)
        old = integrations[component]
        integrations[component] = old and old._replace(integrator=integrator)
        self.plan = self.plan._replace(integrations=tuple(integrations))

    def control(self, tolerance: float, most_steps: int | None = None) -> None:
        """Use another tolerance, or step limit, from now on."""
        integrations = tuple(
            each and each._replace(tolerance=tolerance, most_steps=most_steps or each.most_steps)
            for each in self.plan.integrations
        )
        self.plan = self.plan._replace(integrations=integrations)

    def job(self, thetas: Floats) -> SimulationJob:
        """Return the job to simulate thetas (m, N)."""
        outputs = np.empty((len(thetas), self.grid.times.size, len(self.output_names)))
        return SimulationJob(self, thetas, outputs, new_reports(len(thetas)))

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return int(self.grid.substeps.sum())

    @property
    def varying(self) -> list[Sensitivities]:
        """Sensitivities to fill in before each simulation."""
        return [each.sensitivities for each in self.plan.integrations if each is not None and each.sensitivities]


@dataclass(frozen=True, eq=False)
class SimulationJob:
    """Thetas (m, N), outputs (m, K, n_outputs), reports (m, codes.REPORT)."""

    simulation: GridSimulation
    thetas: Floats
    outputs: Floats
    reports: Indices

    def __len__(self) -> int:
        return len(self.thetas)

    def __getitem__(self, part: slice) -> SimulationJob:
        return SimulationJob(self.simulation, self.thetas[part], self.outputs[part], self.reports[part])

    @property
    def failed(self) -> Flags:
        """Failed simulations (m,)."""
        return self.reports[:, 0] >= 0


def shares(total: int, count: int) -> list[slice]:
    """Return the shares of `count` threads in `total` simulations."""
    edges = [total * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


_TYPES: dict[str, type[np.generic]] = {  # of arrays that are no indices
    "references": np.uint32,
    **dict.fromkeys(("signals", "conversions", "tolerances", "times", "inputs", "slopes"), np.float64),
    **dict.fromkeys(("states", "gain", "measured"), np.float64),
}
_WIRE_OF = {  # how the values of a type are passed, where that is not as it is called
    2: {codes.BOOLEAN: codes.INT32},
    3: {codes.BOOLEAN: codes.UINT8},
}


def check_plan(plan: SimulationPlan, grid: TimeGrid, versions: Sequence[int]) -> None:
    """Check a plan and its grid for FMI versions of components; a `ValueError` if wrong."""
    n = len(versions)
    inputs = {f"input {name}": array for name, array in plan.inputs._asdict().items()}
    for name, array in (plan._asdict() | inputs | grid._asdict()).items():
        if isinstance(array, np.ndarray):
            right = array.dtype == _TYPES.get(name, np.intp) and array.flags.c_contiguous
            _demand(right, name, "is of another type")
    for operation in plan.operations:
        _check_operation(plan, operation, versions)
    stages = plan.stages
    _demand(len(stages) == 6 + n and stages[0] == 0, "stages", "do not match the components")
    _demand((np.diff(stages) >= 0).all() and stages[-1] == len(plan.operations), "stages", "are out of order")
    _check_groups(plan)
    _check_signals(plan)
    _demand(len(plan.integrations) == len(plan.tolerances) == n, "integrations", "do not match the components")
    for (component, row), mode in zip(plan.inputs.curves, plan.inputs.modes.tolist(), strict=True):
        integration = plan.integrations[component] if 0 <= component < n else None
        inside = integration is not None and 0 <= row < len(integration.input_starts)
        _demand(inside if mode == codes.BY_STEPPER else (component, row) == (-1, -1), "input curves", "point nowhere")
    for i, integration in enumerate(plan.integrations):
        twins = integration.sensitivities.twins if integration and integration.sensitivities else ()
        known = all(0 <= twin < i and plan.integrations[twin] is not None for twin in twins)
        _demand(known, "integrations", "have twins that are none")
    _check_grid(plan, grid, n)


def check_arrays(plan: SimulationPlan, grid: TimeGrid, thetas: Floats, outputs: Floats, reports: Indices) -> None:
    """Check the arrays of a call; a `ValueError` if one is wrong."""
    m = len(thetas)
    for name, array, shape, kind in (
        ("thetas", thetas, (m, len(plan.parameter_signals)), np.float64),
        ("outputs", outputs, (m, len(grid.times), len(plan.output_terms) - 1), np.float64),
        ("reports", reports, (m, codes.REPORT), np.intp),
    ):
        _demand(array.shape == shape and array.dtype == kind and array.flags.c_contiguous, name, f"are not {shape}")


def _demand(right: object, what: str, wrong: str) -> None:
    if not right:
        raise ValueError(f"the {what} of a plan {wrong}")


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
        right = transfers and given.function != codes.N_WIRES + codes.STRING
        right &= given.wire == _WIRE_OF[version].get(kind, kind)
        right &= given.n_values == count if version == 2 else given.n_values >= count
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
    inputs = plan.inputs
    for name, signals in (
        *(("parameter_signals", plan.parameter_signals), ("output_signals", plan.output_signals)),
        *(("input signals", inputs.signals), ("input slopes", inputs.slopes)),
    ):
        _demand(signals.ndim == 1 and ((signals >= 0) & (signals < len(plan.signals))).all(), name, "point nowhere")
    modes, terms = inputs.modes, plan.output_terms
    same = len(inputs.signals) == len(inputs.slopes) == len(modes) == len(inputs.curves)
    _demand(same, "inputs", "differ in number")
    _demand(((modes >= codes.HELD) & (modes <= codes.BY_MIDPOINT)).all(), "input modes", "are not known")
    ordered = len(terms) > 0 and terms[0] == 0 and (np.diff(terms) >= 0).all()
    _demand(ordered and terms[-1] == len(plan.output_signals), "output_terms", "are out of order")
    _demand(plan.conversions.ndim == 2 and plan.conversions.shape[1] == 2, "conversions", "are no pairs")


def _check_grid(plan: SimulationPlan, grid: TimeGrid, n: int) -> None:
    n_times = len(grid.times)
    shape = (n_times, len(plan.inputs.signals))
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
