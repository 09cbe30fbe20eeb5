"""A model as explicit CasADi expressions: the result of the analysis, from which the FMU is written."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmuid.export.syntax import Declaration, Model


@dataclass(frozen=True)
class Relation:
    """A relation or floor() that makes events, as written; `name` is that of its event indicator."""

    name: str
    text: str
    line: int


@dataclass(frozen=True)
class ExplicitModel:
    """An explicit model: dx/dt = derivatives, w = algebraic, z = indicators, each of (x, u, p, t, r); x(0) = starts(p).

    The declarations are those of the states x, inputs u, parameters p, other variables w and event indicators z, in
    the order of the elements of the symbols and expressions (SX columns); t is the time, s. The relations r are 0 or 1:
    an event sets r to z > 0. Behind them, r has the whole numbers floor(counted), for each of which z has two elements.
    `reciprocals` are symbols in these expressions with their values 1/(coefficient),
    functions of p alone, which many evaluations share. `numbers` are attributes: (variable, "value", "start",
    "min", "max" or "nominal") -> number. `jumps` is the line of the first relation or function that jumps, or 0.
    """

    model: Model
    states: tuple[Declaration, ...]
    inputs: tuple[Declaration, ...]
    parameters: tuple[Declaration, ...]
    others: tuple[Declaration, ...]
    relations: tuple[Relation, ...]
    integers: tuple[Relation, ...]
    x: Any
    u: Any
    p: Any
    t: Any
    r: Any
    derivatives: Any
    algebraic: Any
    indicators: Any
    counted: Any
    starts: Any
    reciprocals: tuple[tuple[Any, Any], ...]
    numbers: Mapping[tuple[str, str], float]
    jumps: int

    def names(self) -> list[str]:
        """Names of all variables in the order of their FMI value references."""
        known = [each.name for group in (self.states, self.inputs, self.parameters) for each in group]
        rates, others = [f"der({each.name})" for each in self.states], [each.name for each in self.others]
        return [*known, *rates, *others, *self.indicator_names(), "time"]

    def indicator_names(self) -> list[str]:
        """Names of the event indicators."""
        ends = [f"{each.name}.{end}" for each in self.integers for end in ("up", "down")]
        return [*(each.name for each in self.relations), *ends]

    def plain(self, expression: Any) -> Any:
        """Return the expression with its reciprocals written out."""
        return written_out(expression, self.reciprocals)


def written_out(expression: Any, reciprocals: Collection[tuple[Any, Any]]) -> Any:
    """Return an expression with the symbols of reciprocals replaced by their values."""
    symbols, values = (column(each[k] for each in reciprocals) for k in (0, 1))
    return ca.substitute(expression, symbols, values)


def column(elements: Any) -> Any:
    """Return an SX column of scalar expressions."""
    return ca.vertcat(*elements, ca.SX(0, 1))
