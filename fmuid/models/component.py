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
    """How an FMU is run; defaults depend on what the FMU offers (`Component.kind`, `Component.integrator`).

    Parameters
    ----------
    interface : "co-simulation" or "model-exchange", optional
    integrator : "rk4", "rk45" or "cvode", optional
        For model exchange: Runge–Kutta of order 4 with fixed steps, Dormand–Prince 5(4) with error control, or the
        stiff BDF methods of SUNDIALS.
    tolerance : float, optional
        Relative; for model exchange that of the integrator, for co-simulation the one passed to the FMU.
    step_size : float, optional
        Largest step, s: between communications, and inside an integrator.
    most_steps : int, optional
        Of an integrator that chooses its steps, between two samples; a simulation that needs more fails, and a search
        takes shorter steps. Default: `fmuid.simulation.MOST_STEPS`.
    samples : bool, optional
        Whether the FMU acts once a communication step, as a sampled controller does, so that shorter steps would make
        it another device; default: one of several without continuous states does, of others it is not known
        (`System.integrates`, `System.sampling_known`).

    Raises
    ------
    InputError
        If a word is unknown or a number not positive.

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
                raise InputError(f"{word} {given!r} is not known{near}: give {' or '.join(known)}")
        for word, unit in (("tolerance", "number"), ("step_size", "number of seconds"), ("most_steps", "number")):
            given = getattr(self, word)
            if given is not None and not 0 < given < float("inf"):
                raise InputError(f"{word} must be a positive {unit}, not {given:g}")

    def over(self, others: Numerics) -> Numerics:
        """Return these settings, completed by others where they are not given."""
        return Numerics(*(getattr(self if getattr(self, f.name) is not None else others, f.name) for f in fields(self)))


@dataclass(frozen=True)
class Isolation:
    """How a system's FMUs are run in a separate process, where a crash does not harm the study.

    A simulation that crashes the process, does not end or takes too much memory fails like any other that fails, and
    the next one is run by a new process. This is no sandbox: an FMU is native code with the rights of its user.

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
    """s for one simulation; default: by how long earlier ones took"""
    memory_limit_mb: Annotated[float, Gt(0)] | None = None
    """MB, with all that the process starts; default: an equal share of half the machine's for each core"""
    max_simulations_per_process: Annotated[int, Gt(0)] | None = None
    """simulations after which a process is replaced; default: only for its memory"""
    threads: int | None = field(default=None, metadata={"key": False})
    """simulations at a time, in as many processes where the FMU is not safe in threads; default: one for each core"""

    def __post_init__(self) -> None:
        for each in fields(self):
            given = getattr(self, each.name)
            if given is not None and not 0 < given < float("inf"):
                raise InputError(f"{each.name} must be a positive number, not {given:g}")


AS_OFFERED = Numerics()
"""All defaults."""


@dataclass(frozen=True, eq=False, init=False)
class Component:
    """An FMU in a system, and how it is run there.

    Raises
    ------
    InputError
        If the FMU has no such interface, or the integrator does not go with the interface.

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
        object.__setattr__(self, "fmu", fmu if isinstance(fmu, FMU) else FMU(fmu))
        object.__setattr__(self, "numerics", numerics)
        offered = self.fmu.description.interfaces
        if self.kind not in offered:
            raise InputError(f"{self.fmu.path} offers no {self.kind} interface; it offers {', '.join(offered)}")
        if numerics.integrator is not None and self.kind != "model-exchange":
            raise InputError(
                f"{self.fmu.path} runs as co-simulation, which has its own integrator; take out solver = "
                f'"{numerics.integrator}", or give interface = "model-exchange"'
            )

    @property
    def kind(self) -> str:
        """The interface that is used: the one asked for, else co-simulation where it is offered."""
        offered = self.fmu.description.interfaces
        return self.numerics.interface or next(kind for kind in KINDS if kind in offered)

    @property
    def integrator(self) -> str:
        """The integrator that model exchange begins with: the one asked for, else "rk45"."""
        return self.numerics.integrator or DEFAULT_INTEGRATOR

    def how_run(self, *, stiff: bool = False) -> SolverConfiguration:
        """Return how the FMU is run.

        Parameters
        ----------
        stiff : bool
            Whether "rk45" has found the model stiff, so that "cvode" took its place (`fmuid.Simulator.stiff`).
        """
        given, version = self.numerics, self.fmu.description.fmi_version
        if self.kind == "co-simulation":
            return SolverConfiguration(version, self.kind, None, False, given.tolerance, given.step_size)
        tolerance = None if self.integrator == "rk4" else given.tolerance or DEFAULT_TOLERANCE
        integrator = STIFF_INTEGRATOR if stiff else self.integrator
        return SolverConfiguration(version, self.kind, integrator, stiff, tolerance, given.step_size)


@dataclass(frozen=True)
class SolverConfiguration:
    """How an FMU was run, its defaults resolved.

    Attributes
    ----------
    fmi_version, interface : str
    integrator : str or None
        None for co-simulation, where it is inside the FMU.
    stiff : bool
        Whether `integrator` took the place of one that found the model stiff.
    tolerance : float or None
        Relative; None where there is none, or the FMU's own.
    step_size : float or None
        Largest step, s; None from sample to sample.
    divisor : int
        Into how many each step is divided beyond that.
    new_processes : bool
        Whether each simulation had a process of its own, since the FMU keeps something outside its instances.
    """

    fmi_version: str
    interface: str
    integrator: str | None
    stiff: bool
    tolerance: float | None
    step_size: float | None
    divisor: int = 1
    new_processes: bool = False


DEFAULT_INTEGRATOR = "rk45"  # no start-up phase after each step of the inputs, and detects stiffness
STIFF_INTEGRATOR = "cvode"
# Tight enough for errors far below the resolution of measurements, and for accurate finite differences.
DEFAULT_TOLERANCE = 1e-7
