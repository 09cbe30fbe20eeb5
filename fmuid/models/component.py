"""An FMU in a system, with interface, integrator, tolerance and step size."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

from annotated_types import Gt

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models.description import KINDS
from fmuid.models.fmu import FMU

INTEGRATORS = ("rk4", "rk45", "cvode")


@dataclass(frozen=True)
class Numerics:
    """Solver settings of an FMU; defaults depend on its interfaces (`Component.kind`).

    Parameters
    ----------
    interface : "co-simulation" or "model-exchange", optional
    integrator : "rk4", "rk45" or "cvode", optional
        Model Exchange only: Runge–Kutta 4 with fixed steps, Dormand–Prince 5(4), or BDF of SUNDIALS.
    tolerance : float, optional
        Relative; of the integrator, or passed to a Co-Simulation FMU.
    step_size : float, optional
        Largest communication step and solver step, s.
    most_steps : int, optional
        Limit of solver steps between two samples; default: `fmuid.simulation.MOST_STEPS`.
    samples : bool, optional
        Whether the FMU is a discrete-time component; default: see `System.integrates`.

    Raises
    ------
    InputError
        If a name is unknown or a number not positive.

    Examples
    --------
    >>> fmuid.Numerics(integrator="rk4", step_size=1e-4).integrator
    'rk4'
    """

    interface: str | None = None
    integrator: str | None = None
    tolerance: float | None = None
    step_size: float | None = None
    samples: bool | None = None
    most_steps: int | None = None

    def __post_init__(self) -> None:
        for word, known in (("interface", KINDS), ("integrator", INTEGRATORS)):
            given = getattr(self, word)
            if given is not None and given not in known:
                near = nearest(str(given), known)
                raise InputError(f"{word}: unknown value {given!r}{near}. Choose {' or '.join(known)}.")
        for word, unit in (("tolerance", "number"), ("step_size", "number of seconds"), ("most_steps", "number")):
            _check_positive(word, getattr(self, word), unit)

    def over(self, others: Numerics) -> Numerics:
        """Return these settings, completed by others."""
        return Numerics(*(getattr(self if getattr(self, f.name) is not None else others, f.name) for f in fields(self)))


@dataclass(frozen=True)
class Isolation:
    """Settings of the separate process that runs a system's FMUs.

    A simulation that crashes, hangs or takes too much memory fails alone; a new process runs the next one.
    This is no sandbox: an FMU is native code with its user's rights.

    Raises
    ------
    InputError
        If a number is not positive.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> system = fmuid.System(coil.fmu, isolation=fmuid.Isolation(time_limit=10.0))
    >>> fmuid.Simulator(system, coil.experiment, ["R"])([4.0]).shape
    (200, 1)
    """

    time_limit: Annotated[float, Gt(0)] | None = None
    """time limit of a simulation, s; default: from earlier simulations"""
    memory_limit_mb: Annotated[float, Gt(0)] | None = None
    """memory of a process and its children, MB; default: half the memory divided by the cores"""
    max_simulations_per_process: Annotated[int, Gt(0)] | None = None
    """simulations before a process is replaced; default: only at its memory limit"""
    threads: int | None = field(default=None, metadata={"key": False})
    """simulations at a time, in as many processes where the FMU is not safe in threads; default: one for each core"""

    def __post_init__(self) -> None:
        for each in fields(self):
            _check_positive(each.name, getattr(self, each.name))


def _check_positive(word: str, given: float | None, unit: str = "number") -> None:
    if given is not None and not 0 < given < float("inf"):
        raise InputError(f"{word} must be a positive {unit}, not {given:g}.")


AS_OFFERED = Numerics()  # all defaults


@dataclass(frozen=True, eq=False, init=False)
class Component:
    """An FMU in a system, with its solver settings.

    Raises
    ------
    InputError
        If the FMU lacks the interface, or an integrator is given for Co-Simulation.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> part = fmuid.Component(coil.fmu, fmuid.Numerics(step_size=1e-3))
    >>> fmuid.System(components={"coil": part}).unit("coil.i")
    'A'
    """

    fmu: FMU
    numerics: Numerics

    def __init__(self, fmu: FMU | str | Path, numerics: Numerics = AS_OFFERED) -> None:
        vars(self).update(fmu=fmu if isinstance(fmu, FMU) else FMU(fmu), numerics=numerics)  # frozen for others
        offered = self.fmu.description.interfaces
        if self.kind not in offered:
            raise InputError(f"{self.fmu.path}: no {self.kind} interface; offered: {', '.join(offered)}.")
        if numerics.integrator is not None and self.kind != "model-exchange":
            raise InputError(
                f'{self.fmu.path}: solver = "{numerics.integrator}" needs '
                'interface = "model-exchange". Co-Simulation has its own solver.'
            )

    @property
    def kind(self) -> str:
        """Interface in use: the requested one, else Co-Simulation if offered."""
        offered = self.fmu.description.interfaces
        return self.numerics.interface or next(kind for kind in KINDS if kind in offered)

    @property
    def integrator(self) -> str:
        """First integrator of Model Exchange: the requested one, else "rk45"."""
        return self.numerics.integrator or DEFAULT_INTEGRATOR

    def how_run(self, *, stiff: bool = False) -> SolverConfiguration:
        """Return the settings in use; with `stiff`, "cvode" has replaced "rk45"."""
        integrator, tolerance = None, self.numerics.tolerance
        if self.kind == "model-exchange":
            integrator = STIFF_INTEGRATOR if stiff else self.integrator
            tolerance = None if self.integrator == "rk4" else tolerance or DEFAULT_TOLERANCE
        version, step_size = self.fmu.description.fmi_version, self.numerics.step_size
        return SolverConfiguration(version, self.kind, integrator, stiff, tolerance, step_size)


@dataclass(frozen=True)
class SolverConfiguration:
    """Solver settings of a simulated FMU, defaults resolved."""

    fmi_version: str
    interface: str
    integrator: str | None  # None for Co-Simulation
    stiff: bool  # whether `integrator` replaced another for stiffness
    tolerance: float | None  # relative; None if there is none, or the FMU's own
    step_size: float | None  # largest step, s; None: from sample to sample
    divisor: int = 1  # number of parts of each step by solver refinement
    # whether each simulation had its own process, as the FMU keeps state outside its instances
    new_processes: bool = False


DEFAULT_INTEGRATOR = "rk45"  # no start-up phase after each step of the inputs, and detects stiffness
STIFF_INTEGRATOR = "cvode"
# Tight enough for errors far below the resolution of measurements, and for accurate finite differences.
DEFAULT_TOLERANCE = 1e-7
