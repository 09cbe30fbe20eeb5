"""Finer ways to simulate a system, to see what the error of the one in use does to the outputs.

Model exchange with a controlled error is finer than what co-simulation has inside, wherever an FMU offers it. Without
it each communication step is divided by four, and by four again: half the steps see nothing of some FMUs that an eighth
would show. Where several FMUs are coupled, what they exchange between is divided too. What samples keeps its steps: a
controller that acts four times as often is another plant. Where it is not known which of them samples, shorter steps
show what depends on them, and no search goes on by them.
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
    """How much finer one way to simulate is than the one before."""

    tolerance: float = 1e-9
    """Of model exchange in place of co-simulation: searches by looser ones take many times the simulations."""
    tighter: float = 1e-2
    """What is run with a controlled error is checked by a simulation with so much less of it ..."""
    tightest: float = 1e-13
    """... down to here, where rounding begins."""
    division: int = 4
    """What communication steps are divided by from one way to the next."""
    most_divided: int = 1024


STEPS = RefinementSteps()


@dataclass(frozen=True)
class Refinement:
    """How much finer than asked for a system is simulated.

    Parameters
    ----------
    tolerance : float, optional
        Components with continuous states that offer model exchange are run by it, with this relative tolerance.
    divisor : int
        What the communication steps of components with continuous states are divided by.
    """

    tolerance: float | None = None
    divisor: int = 1

    @property
    def any(self) -> bool:
        """Whether anything is finer than asked for."""
        return self.tolerance is not None or self.divisor > 1


AS_ASKED = Refinement()
"""Nothing is finer."""


def next_refinement(system: System, than: Refinement = AS_ASKED, *, surely: bool = False) -> Refinement | None:
    """Return the next finer way to simulate a system, None where there is none.

    Parameters
    ----------
    system : System
        As asked for.
    than : Refinement
        How it is simulated.
    surely : bool
        Whether it must be the same system beyond doubt: then components exchange their values no more often where it
        is not known which of them sample (`System.sampling_known`).
    """
    exchanged = _exchanged(system)
    tolerance, divisor = than.tolerance, than.divisor
    if exchanged:
        now = tolerance or min(map(_tolerance, exchanged.values()))
        tolerance = min(STEPS.tolerance, STEPS.tighter * now) if tolerance is None else STEPS.tighter * now
    divided = system.sampling_known or not surely
    if divided and (len(system.components) > 1 or not exchanged) and any(map(system.integrates, system.components)):
        divisor *= STEPS.division
    exhausted = (tolerance is not None and tolerance < STEPS.tightest) or divisor > STEPS.most_divided
    found = Refinement(tolerance, divisor)
    return None if exhausted or found == than else found


def replaces_interface(system: System, refinement: Refinement) -> bool:
    """Return whether a refinement runs by model exchange what runs by co-simulation."""
    return refinement.tolerance is not None and any(m.kind == "co-simulation" for m in _exchanged(system).values())


def is_controlled(system: System, refinement: Refinement) -> bool:
    """Return whether all that is integrated is integrated with a controlled error."""
    exchanged = _exchanged(system)
    return all(
        name in exchanged and (refinement.tolerance is not None or math.isfinite(_tolerance(exchanged[name])))
        for name in filter(system.integrates, system.components)
    )


def is_free(system: System) -> bool:
    """Return whether a finer way goes against nothing that was asked for: interface, tolerance, fixed steps."""
    return not any(
        model.numerics.interface is not None
        if model.kind == "co-simulation"
        else model.numerics.tolerance is not None or model.numerics.integrator == "rk4"
        for model in _exchanged(system).values()
    )


def refined(simulator: Simulator, system: System, refinement: Refinement) -> Simulator:
    """Return what simulates the same experiment in a finer way, or again as asked for; it closes with the system.

    Parameters
    ----------
    simulator : Simulator
    system : System
        As asked for.
    refinement : Refinement

    Raises
    ------
    InputError
        If an FMU cannot step that way.
    """
    if refinement.tolerance is not None:
        system = _run_by(system, {name: _exchange(model) for name, model in _exchanged(system).items()})
    return simulator.by(system, refinement.divisor, refinement.tolerance)


def by_model_exchange(system: System, tolerance: float | None = None) -> System | None:
    """Return a system with all its components run by model exchange, None where one of them cannot be.

    Parameters
    ----------
    system : System
    tolerance : float, optional
        Relative; default: what each component says.
    """
    exchanged = _exchanged(system)
    if len(exchanged) < len(system.components):
        return None
    return _run_by(system, {name: _exchange(m, tolerance or m.numerics.tolerance) for name, m in exchanged.items()})


def _run_by(system: System, numerics: Mapping[str, Numerics]) -> System:
    """Return a system whose components are run in another way; simulators of it share its instances."""
    return (
        variant_of(system, ("run by", *sorted(numerics.items())), lambda: system.run_by(numerics))
        if numerics
        else system
    )


def how_run(
    system: System, refinement: Refinement, stiff: frozenset[str] = frozenset()
) -> dict[str, SolverConfiguration]:
    """Return how each component is run.

    Parameters
    ----------
    system : System
        As asked for.
    refinement : Refinement
    stiff : frozenset of str
        The components that were found stiff (`Simulator.stiff`).
    """
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
    """Return the components whose continuous states model exchange can integrate, and may."""
    return {
        name: model
        for name, model in system.components.items()
        if model.fmu.description.states
        and "model-exchange" in model.fmu.description.interfaces
        and not model.numerics.samples
    }


def _exchange(model: Component, tolerance: float | None = STEPS.tolerance) -> Numerics:
    """Return how a component is run by model exchange: by the integrator asked for, if its error is controlled."""
    asked = model.numerics
    integrator = None if asked.integrator == "rk4" else asked.integrator
    return replace(asked, interface="model-exchange", integrator=integrator, tolerance=tolerance)


def _tolerance(model: Component) -> float:
    """Return the tolerance of a component by model exchange, infinite where its error is not controlled."""
    if model.kind != "model-exchange" or model.numerics.integrator == "rk4":
        return math.inf
    return model.numerics.tolerance or DEFAULT_TOLERANCE
