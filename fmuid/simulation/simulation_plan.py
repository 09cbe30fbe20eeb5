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
from numpy.typing import ArrayLike, NDArray

from fmuid.array_types import Flags, Floats, Indices
from fmuid.simulation import codes
from fmuid.simulation.codes import function_name

MOST_STEPS = 1_000_000  # of an integrator between two samples: some seconds, then it will never arrive


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

    @classmethod
    def of(cls, references: Sequence[int], n_states: int, twins: tuple[int, ...] = ()) -> Sensitivities:
        """Return sensitivities to be filled in."""
        n = len(references)
        return cls(np.ones(n), np.zeros((n, n_states)), np.array(references, np.uint32), np.ones(n), twins)


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
    cubic inputs. Model Exchange components may get `states` at each sample instead of integration.
    Or samples correct their states: `gain` (n_x, n_y) times `measured` (K, n_y) − outputs, except NaN.
    """

    times: Floats
    substeps: Indices
    strides: Indices
    inputs: Floats
    slopes: Floats | None
    states: int | None = None
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
    driven: bool = False  # its inputs may change from call to call

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
        """Return the job to simulate thetas, with given states behind each."""
        outputs = np.empty((len(thetas), self.grid.times.size, len(self.output_names)))
        return SimulationJob(self, thetas, outputs, new_reports(len(thetas)))

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return int(self.grid.substeps.sum())

    @property
    def varying(self) -> list[Floats]:
        """Arrays to fill in before each simulation: those of sensitivities and changing inputs."""
        some = [each.sensitivities for each in self.plan.integrations if each is not None and each.sensitivities]
        given = [each for each in (self.grid.inputs, self.grid.slopes) if self.driven and each is not None]
        return [array for each in some for array in (each.magnitudes, each.initial, each.steps)] + given


@dataclass(frozen=True, eq=False)
class SimulationJob:
    """Thetas (m, N + K n_x), outputs (m, K, n_outputs), reports (m, codes.REPORT)."""

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
    """Return the shares of at most `count` threads in `total` simulations."""
    count = max(1, min(count, total))
    edges = [total * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


_TYPES: dict[str, type[np.generic]] = {  # of arrays that are no indices
    "references": np.uint32,
    **dict.fromkeys(("signals", "conversions", "tolerances", "times", "inputs", "slopes"), np.float64),
    **dict.fromkeys(("gain", "measured"), np.float64),
}
_PASSED_BOOLEAN = {2: codes.INT32, 3: codes.UINT8}  # other types are passed as they are called


def check_plan(plan: SimulationPlan, grid: TimeGrid, versions: Sequence[int]) -> None:
    """Check a plan and its grid for FMI versions of components; a `ValueError` if wrong."""
    n, n_signals, n_calls = len(versions), len(plan.signals), len(plan.operations)
    inputs = {f"input {name}": array for name, array in plan.inputs._asdict().items()}
    for name, array in (plan._asdict() | inputs | grid._asdict()).items():
        if isinstance(array, np.ndarray):
            _demand(array.dtype == _TYPES.get(name, np.intp) and array.flags.c_contiguous, name)
    for operation in plan.operations:
        _demand(_is_sound(plan, operation, versions), "operations")
    bounds, first, last = plan.stages, int(plan.stages[2]), int(plan.stages[3])
    _demand(len(bounds) == 6 + n and bounds[0] == 0 and _ascends(bounds, n_calls), "stages")
    _demand(plan.groups.ndim == plan.conversions.ndim == 2, "groups and conversions")
    _demand(plan.groups.shape[1] == plan.conversions.shape[1] == 2, "groups and conversions")
    loops = [end for begin, end in plan.groups.tolist() if begin < 0]
    _demand(loops == list(range(len(plan.loops))), "groups")
    _demand(all(begin < 0 or first <= begin <= end <= last for begin, end in plan.groups.tolist()), "groups")
    for loop in plan.loops:
        _demand(first <= loop.first <= loop.setting <= loop.last <= last and _inside(loop.signals, n_signals), "loops")
        _demand(len(loop.nominals) == len(loop.signals) and _inside(loop.nominals, math.inf), "loops")
    _demand(len(plan.integrations) == len(plan.tolerances) == n, "integrations")
    for i, integration in enumerate(plan.integrations):
        twins = integration.sensitivities.twins if integration and integration.sensitivities else ()
        _demand(all(0 <= twin < i and plan.integrations[twin] is not None for twin in twins), "twins")
    _check_inputs(plan, n_signals)
    _check_grid(plan, grid, n)


def check_arrays(plan: SimulationPlan, grid: TimeGrid, thetas: Floats, outputs: Floats, reports: Indices) -> None:
    """Check the arrays of a call; a `ValueError` if one is wrong."""
    m = len(thetas)
    for name, array, shape, kind in (
        ("thetas", thetas, (m, len(plan.parameter_signals) + len(grid.times) * (grid.states or 0)), np.float64),
        ("outputs", outputs, (m, len(grid.times), len(plan.output_terms) - 1), np.float64),
        ("reports", reports, (m, codes.REPORT), np.intp),
    ):
        _demand(array.shape == shape and array.dtype == kind and array.flags.c_contiguous, name)


def _demand(right: object, what: str) -> None:
    if not right:
        raise ValueError(f"the {what} of a plan are wrong")


def _inside(values: ArrayLike, end: float) -> bool:
    found = np.asarray(values)
    return bool(((found >= 0) & (found < end)).all())


def _ascends(bounds: Indices, end: int) -> bool:
    return bool((np.diff(bounds) >= 0).all() and bounds[-1] == end)


def _is_sound(plan: SimulationPlan, given: Operation, versions: Sequence[int]) -> bool:
    """Return whether an operation has signals and references; its component must know it."""
    n_signals, first, count, function = len(plan.signals), given.reference, given.n_references, given.function
    if function == codes.COPY:
        return _inside((first, given.signal), n_signals) and 0 <= count < len(plan.conversions)
    places = len(plan.texts) if given.wire == codes.STRING else n_signals
    if not (
        0 <= given.component < len(versions)
        and 0 <= first <= first + count <= len(plan.references)
        and 0 <= given.signal <= given.signal + given.n_values <= places
        and 0 <= given.when < 2 * codes.LATCHED
    ):
        return False
    version, integration = versions[given.component], plan.integrations[given.component]
    if function == codes.SENSITIVITIES:
        parameters = integration.sensitivities.magnitudes if integration and integration.sensitivities else None
        return parameters is not None and given.n_values == count * len(parameters) and given.wire == codes.FLOAT64
    if function == codes.SET_DERIVATIVES:
        return version == 2 and integration is None and given.n_values == count and given.wire == codes.FLOAT64
    if not 0 <= function < 2 * codes.N_WIRES or function == codes.N_WIRES + codes.STRING:
        return False
    kind = function % codes.N_WIRES
    passed = given.wire == (_PASSED_BOOLEAN[version] if kind == codes.BOOLEAN else kind)
    known = function_name(version, function) is not None
    return passed and known and (given.n_values == count if version == 2 else given.n_values >= count)


def _check_inputs(plan: SimulationPlan, n_signals: int) -> None:
    inputs, terms = plan.inputs, plan.output_terms
    for name, signals in (
        *(("parameter_signals", plan.parameter_signals), ("output_signals", plan.output_signals)),
        *(("input signals", inputs.signals), ("input slopes", inputs.slopes)),
    ):
        _demand(signals.ndim == 1 and _inside(signals, n_signals), name)
    _demand(len(inputs.signals) == len(inputs.slopes) == len(inputs.modes) == len(inputs.curves), "inputs")
    _demand(_inside(inputs.modes, codes.BY_MIDPOINT + 1), "input modes")
    _demand(len(terms) > 0 and terms[0] == 0 and _ascends(terms, len(plan.output_signals)), "output_terms")
    for (component, row), mode in zip(inputs.curves, inputs.modes.tolist(), strict=True):
        integration = plan.integrations[component] if 0 <= component < len(plan.integrations) else None
        inside = integration is not None and 0 <= row < len(integration.input_starts)
        _demand(inside if mode == codes.BY_STEPPER else (component, row) == (-1, -1), "input curves")


def _check_grid(plan: SimulationPlan, grid: TimeGrid, n: int) -> None:
    n_times = len(grid.times)
    shape = (n_times, len(plan.inputs.signals))
    _demand(n_times > 0 and np.isfinite(grid.times).all(), "times")
    _demand(grid.inputs.shape == shape and (grid.slopes is None or grid.slopes.shape == shape), "inputs")
    _demand(grid.substeps.shape == (n_times - 1,) and (grid.substeps > 0).all(), "substeps")
    _demand(grid.strides.shape == (n,) and (grid.strides > 0).all(), "strides")
    if grid.states is not None or grid.gain is not None:
        without = [each is not None and (grid.gain is None or each.sensitivities is None) for each in plan.integrations]
        _demand(all(without), "states")
    measured = None if grid.measured is None else grid.measured.shape
    _demand(measured == (None if grid.gain is None else (n_times, len(plan.output_terms) - 1)), "measured outputs")
