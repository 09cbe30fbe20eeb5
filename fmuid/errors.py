"""Errors of fmuid: few kinds, one sentence each, with their data; warnings of its loggers."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager


class FmuidError(Exception):
    """Base of fmuid's errors; the text is one sentence.

    Examples
    --------
    >>> try:
    ...     fmuid.FMU("missing.fmu")
    ... except fmuid.FmuidError as error:
    ...     print(type(error).__name__)
    InputError
    """


class InputError(FmuidError):
    """Wrong input: a file, a key or a variable (exit code 2).

    The message names the error, its place and the remedy.

    Examples
    --------
    >>> try:
    ...     fmuid.Parameter(start=1.0, min=2.0)
    ... except fmuid.InputError as error:
    ...     print(error)
    start 1 is outside [2, inf]. Change start, min or max.
    """


NO_EXPERIMENT = "an experiment must be a fmuid.Experiment(table, inputs, outputs)"
"""Message of `check_kind` for other types."""


def check_kind(given: object, kind: type | tuple[type, ...], what: str, remedy: str = "") -> None:
    """Check the type of a user's value; raise `InputError` with the remedy."""
    if not isinstance(given, kind):
        name = type(given).__name__
        article = "an" if name[0].lower() in "aeiou" else "a"
        raise InputError(f"{what}, not {article} {name}" + (f": {remedy}" if remedy else ""))


class ModelicaError(InputError):
    """Modelica construct outside the exported subset.

    Attributes
    ----------
    file, line, construct
        Place and name of the construct.

    Examples
    --------
    >>> print(fmuid.errors.ModelicaError("Motor.mo", 3, "an algorithm section"))
    Motor.mo:3: an algorithm section
    """

    def __init__(self, file: str, line: int, construct: str) -> None:
        super().__init__(f"{file}:{line}: {construct}")
        self.file, self.line, self.construct = file, line, construct


class ModelicaWarning(UserWarning):
    """Probable mistake in a Modelica model that is exported, with its place."""

    def __init__(self, file: str, line: int, remark: str) -> None:
        super().__init__(f"{file}:{line}: {remark}")
        self.file, self.line, self.remark = file, line, remark


class SimulationError(FmuidError):
    """Failed simulation (exit code 1).

    Attributes
    ----------
    fmu : str
        The FMU, or its component and the FMU.
    time : float
        Simulation time of the failing call, s; NaN if unknown.
    parameters : dict of str to float
        Parameter values of the simulation.
    call : str
        FMI function and its status.
    messages : tuple of str
        Log of the FMU.

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
    """The model has no derivatives here, for a reason in the text."""


@contextmanager
def warnings_to(take: Callable[[logging.LogRecord], object]) -> Iterator[None]:
    """Pass the warnings of fmuid's loggers to a function meanwhile."""
    handler, logger = logging.Handler(logging.WARNING), logging.getLogger("fmuid")
    handler.emit = take  # type: ignore[assignment,method-assign]
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
