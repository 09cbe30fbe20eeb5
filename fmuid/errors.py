"""The errors that fmuid raises: few kinds, each one clear sentence, each carrying its data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping


class FmuidError(Exception):
    """Base of all errors that fmuid raises on purpose; its text is one sentence for the user.

    Examples
    --------
    >>> try:
    ...     fmuid.FMU("missing.fmu")
    ... except fmuid.FmuidError as error:
    ...     print(type(error).__name__)
    InputError
    """


class InputError(FmuidError):
    """Something the user gave is wrong: a file, a key, a variable (exit code 2 on the command line).

    The message names what is wrong, where, and the remedy.

    Examples
    --------
    >>> try:
    ...     fmuid.Parameter(start=1.0, min=2.0)
    ... except fmuid.InputError as error:
    ...     print(error)
    start 1 lies outside its bounds, 2 to inf; move the start inside or widen min and max
    """


NO_EXPERIMENT = "an experiment must be a fmuid.Experiment(table, inputs, outputs)"
"""What `check_kind` says of something else."""


def check_kind(given: object, kind: type | tuple[type, ...], what: str, remedy: str = "") -> None:
    """Check that what a user gave is of a kind: an `InputError` with what it must be, and the remedy, if it is not."""
    if not isinstance(given, kind):
        name = type(given).__name__
        article = "an" if name[0].lower() in "aeiou" else "a"
        raise InputError(f"{what}, not {article} {name}" + (f": {remedy}" if remedy else ""))


class ModelicaError(InputError):
    """A Modelica construct outside the exported subset.

    Attributes
    ----------
    file, line, construct
        Where it stands and what it is.

    Examples
    --------
    >>> print(fmuid.ModelicaError("Motor.mo", 3, "an algorithm section"))
    Motor.mo:3: an algorithm section
    """

    def __init__(self, file: str, line: int, construct: str) -> None:
        super().__init__(f"{file}:{line}: {construct}")
        self.file, self.line, self.construct = file, line, construct


class ModelicaWarning(UserWarning):
    """Something in a Modelica model that is probably not meant; it is exported all the same.

    Attributes
    ----------
    file, line, remark
        Where it stands and what it is.
    """

    def __init__(self, file: str, line: int, remark: str) -> None:
        super().__init__(f"{file}:{line}: {remark}")
        self.file, self.line, self.remark = file, line, remark


class SimulationError(FmuidError):
    """A simulation did not succeed (exit code 1 on the command line).

    Attributes
    ----------
    fmu : str
        The FMU (or the component and its FMU) that failed.
    time : float
        Simulation time of the failing call, s; not a number where that is not known.
    parameters : dict of str to float
        The parameter values of the failing simulation.
    call : str
        The FMI function and the status it returned.
    messages : tuple of str
        What the FMU itself logged during the simulation.

    Examples
    --------
    >>> print(fmuid.SimulationError("Motor.fmu", 0.1, {"R": 4.0}, "fmi2DoStep returned fmi2Error"))
    simulation of Motor.fmu failed at t = 0.1 s with R = 4: fmi2DoStep returned fmi2Error
    """

    def __init__(
        self, fmu: str, time: float, parameters: Mapping[str, float], call: str, messages: Iterable[str] = ()
    ) -> None:
        self.fmu, self.time, self.call = fmu, time, call
        self.parameters, self.messages = dict(parameters), tuple(messages)
        values = ", ".join(f"{name} = {value:.6g}" for name, value in self.parameters.items())
        said = f'; the FMU says: "{" / ".join(self.messages)}"' if self.messages else ""
        super().__init__(
            f"simulation of {fmu} failed"
            + (f" at t = {time:.6g} s" if math.isfinite(time) else "")
            + (f" with {values}" if values else "")
            + f": {call}{said}"
        )

    def __reduce__(self) -> tuple[type[SimulationError], tuple[object, ...]]:
        return SimulationError, (self.fmu, self.time, self.parameters, self.call, self.messages)


class SensitivityUnavailableError(FmuidError):
    """The model cannot give its derivatives here; the text says why."""
