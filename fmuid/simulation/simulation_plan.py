"""What the core is to do, as arrays, and the experiment as it walks it."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats, Indices
from fmuid.simulation import core_constants as codes

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
