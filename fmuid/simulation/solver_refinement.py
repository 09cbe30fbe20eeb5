"""Solver refinements of a system, for its solver error.

Model Exchange with error control refines Co-Simulation if offered. Otherwise communication steps are divided by
four, repeatedly: half steps hide the error of some FMUs. Coupled FMUs also exchange more often. Discrete-time
components keep their steps: a controller at another rate is another device. If they are unknown, shorter steps only
show the dependence on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from fmuid.models import DEFAULT_TOLERANCE, Component, Numerics, SolverConfiguration, System
from fmuid.simulation.executor_pool import variant_of
from fmuid.simulation.instance_registry import needs_process
from fmuid.simulation.simulator import Simulator


@dataclass(frozen=True)
class RefinementSteps:
    """Steps from one solver refinement to the next."""

    # of model exchange in place of co-simulation: searches by looser ones take many times the simulations
    tolerance: float = 1e-9
    tighter: float = 1e-2  # what is run with a controlled error is checked by a simulation with so much less of it ...
    tightest: float = 1e-13  # ... down to here, where rounding begins
    division: int = 4  # what communication steps are divided by from one way to the next
    most_divided: int = 1024


STEPS = RefinementSteps()


@dataclass(frozen=True)
class Refinement:
    """Solver refinement of a system beyond its settings."""

    tolerance: float | None = None  # relative; components with continuous states then run by Model Exchange if offered
    divisor: int = 1  # number of parts of communication steps of components with continuous states

    @property
    def any(self) -> bool:
        """Whether anything is refined."""
        return self.tolerance is not None or self.divisor > 1


AS_ASKED = Refinement()  # nothing is finer


def next_refinement(system: System, than: Refinement = AS_ASKED, *, surely: bool = False) -> Refinement | None:
    """Return the solver refinement after another one; None if there is none.

    The system is as asked for. If `surely`, unknown discrete-time components forbid shorter steps
    (`System.sampling_known`).
    """
    exchanged = _exchanged(system)
    tolerance, divisor = than.tolerance, than.divisor
    if exchanged:
        now = tolerance or min(map(_tolerance, exchanged.values()))
        tighter = min(STEPS.tolerance, STEPS.tighter * now) if tolerance is None else STEPS.tighter * now
        tolerance = tolerance if tighter < STEPS.tightest else tighter
    divided = system.sampling_known or not surely
    if divided and (len(system.components) > 1 or not exchanged) and any(map(system.integrates, system.components)):
        divisor *= STEPS.division
    exhausted = divisor > STEPS.most_divided
    found = Refinement(tolerance, divisor)
    return None if exhausted or found == than else found


def replaces_interface(system: System, refinement: Refinement) -> bool:
    """Return whether a refinement replaces Co-Simulation by Model Exchange."""
    return refinement.tolerance is not None and any(m.kind == "co-simulation" for m in _exchanged(system).values())


def is_controlled(system: System, refinement: Refinement) -> bool:
    """Return whether all integration has error control."""
    exchanged = _exchanged(system)
    return all(
        name in exchanged and (refinement.tolerance is not None or math.isfinite(_tolerance(exchanged[name])))
        for name in filter(system.integrates, system.components)
    )


def is_free(system: System) -> bool:
    """Return whether refinement contradicts no given interface, tolerance or fixed step."""
    return not any(
        model.numerics.interface is not None
        if model.kind == "co-simulation"
        else model.numerics.tolerance is not None or model.numerics.integrator == "rk4"
        for model in _exchanged(system).values()
    )


def refined(simulator: Simulator, system: System, refinement: Refinement) -> Simulator:
    """Return a refined simulator of the same experiment; of the system as asked for.

    `InputError`: an FMU cannot step that way.
    """
    if refinement.tolerance is not None:
        system = _run_by(system, {name: _exchange(model) for name, model in _exchanged(system).items()})
    return simulator.by(system, refinement.divisor, refinement.tolerance)


def by_model_exchange(system: System) -> System | None:
    """Return a system by Model Exchange; None if impossible."""
    exchanged = _exchanged(system)
    if len(exchanged) < len(system.components):
        return None
    return _run_by(system, {name: _exchange(model, model.numerics.tolerance) for name, model in exchanged.items()})


def _run_by(system: System, numerics: Mapping[str, Numerics]) -> System:
    key = "run by", *sorted(numerics.items())
    return variant_of(system, key, lambda: system.run_by(numerics)) if numerics else system


def how_run(
    system: System, refinement: Refinement, stiff: frozenset[str] = frozenset()
) -> dict[str, SolverConfiguration]:
    """Return the solver settings of each component in use; `stiff` ones are those of `Simulator.stiff`."""
    models = dict(system.components)
    if refinement.tolerance is not None:
        models |= {name: Component(m.fmu, _exchange(m, refinement.tolerance)) for name, m in _exchanged(system).items()}
    new_processes = needs_process(models.values())
    return {
        name: replace(
            model.how_run(stiff=name in stiff),
            divisor=refinement.divisor if system.integrates(name) else 1,
            new_processes=new_processes,
        )
        for name, model in models.items()
    }


def _exchanged(system: System) -> dict[str, Component]:
    """Return the components with states that Model Exchange may integrate."""
    return {
        name: model
        for name, model in system.components.items()
        if model.fmu.description.states
        and "model-exchange" in model.fmu.description.interfaces
        and not model.numerics.samples
    }


def _exchange(model: Component, tolerance: float | None = STEPS.tolerance) -> Numerics:
    """Return a component's settings by Model Exchange with error control."""
    asked = model.numerics
    integrator = None if asked.integrator == "rk4" else asked.integrator
    return replace(asked, interface="model-exchange", integrator=integrator, tolerance=tolerance)


def _tolerance(model: Component) -> float:
    """Return a component's tolerance; infinite without error control."""
    if model.kind != "model-exchange" or model.numerics.integrator == "rk4":
        return math.inf
    return model.numerics.tolerance or DEFAULT_TOLERANCE
