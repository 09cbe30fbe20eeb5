"""Syntax of a model of the subset, parsed but not yet checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

FUNCTIONS = {
    "sin": 1,
    "cos": 1,
    "sqrt": 1,
    "tanh": 1,
    "abs": 1,
    "sign": 1,
    "min": 2,
    "max": 2,
    "floor": 1,
    "ceil": 1,
    "mod": 2,
}
"""Functions of the subset and their number of arguments."""

MODIFIERS = {
    "parameter": ("unit", "min", "max", "nominal"),
    "constant": ("unit",),
    "input": ("unit", "min", "max", "nominal", "start"),
    "output": ("unit", "min", "max", "nominal", "start", "fixed"),
    "local": ("unit", "min", "max", "nominal", "start", "fixed"),
}
"""Attributes of variables by role."""


@dataclass(frozen=True)
class Expression:
    """An expression.

    `op` is "number", "name", "der", an operator + - * / ^, "neg", a function's name, "noEvent", or "if", whose
    arguments are alternately conditions and values, then the value of else. In conditions it is a relation < <= > >=,
    "and", "or", "not". `text` is the source of a relation or of a call.
    """

    line: int
    op: str
    args: tuple[Any, ...]
    text: str = ""

    def names(self) -> Iterator[str]:
        """Names of the variables in it, derivatives as ``der(x)``."""
        if self.op == "name":
            yield self.args[0]
        elif self.op == "der":
            yield f"der({self.args[0]})"
        elif self.op != "number":
            for arg in self.args:
                yield from arg.names()


@dataclass(frozen=True)
class Declaration:
    """One declared variable; `role` is a key of `MODIFIERS`."""

    name: str
    role: str
    line: int
    description: str = ""
    unit: str | None = None
    modifiers: Mapping[str, Expression] = field(default_factory=dict)
    value: Expression | None = None


@dataclass(frozen=True)
class Equation:
    """``left = right``."""

    line: int
    left: Expression
    right: Expression

    def names(self) -> set[str]:
        """Names of the variables in it, derivatives as ``der(x)``."""
        return {*self.left.names(), *self.right.names()}


@dataclass(frozen=True)
class Model:
    """A parsed model; `stop_time` and `interval` (s) are those of its experiment annotation, None where not given."""

    file: str
    name: str
    description: str
    declarations: tuple[Declaration, ...]
    equations: tuple[Equation, ...]
    stop_time: float | None
    interval: float | None
    last_line: int

    @property
    def step(self) -> float:
        """Largest internal step of co-simulation, s: Interval, by default 1/500 of StopTime, by default 1 s."""
        return self.interval or (self.stop_time or 1.0) / 500
