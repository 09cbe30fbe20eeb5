"""A model as explicit CasADi expressions, and warnings on probable mistakes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmuid.errors import ModelicaWarning
from fmuid.export.syntax import Declaration, Model


@dataclass(frozen=True)
class Relation:
    """Relation or floor() with events, as written; `name` is its indicator's."""

    name: str
    text: str
    line: int


@dataclass(frozen=True)
class ExplicitModel:
    """Explicit model: dx/dt = derivatives, w = algebraic, z = indicators of (x, u, p, t, r).

    Declarations are in the order of the SX columns; x(0) = starts(p), t in s. An event sets relations r to z > 0;
    behind them r has floor(counted), with two elements of z each. `reciprocals` are symbols with values 1/(coefficient)
    of p alone. `numbers` maps (variable, attribute) to a number; `jumps` is the first line with a jump, or 0.
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
        """Return all variables in the order of their FMI value references."""
        known = [each.name for group in (self.states, self.inputs, self.parameters) for each in group]
        rates, others = [f"der({each.name})" for each in self.states], [each.name for each in self.others]
        return [*known, *rates, *others, *self.indicator_names(), "time"]

    def indicator_names(self) -> list[str]:
        """Return the names of the event indicators."""
        ends = [f"{each.name}.{end}" for each in self.integers for end in ("up", "down")]
        return [*(each.name for each in self.relations), *ends]

    def plain(self, expression: Any) -> Any:
        """Return an expression with its reciprocals written out."""
        return written_out(expression, self.reciprocals)


def written_out(expression: Any, reciprocals: Collection[tuple[Any, Any]]) -> Any:
    """Return an expression with reciprocals replaced by their values."""
    symbols, values = (column(each[k] for each in reciprocals) for k in (0, 1))
    return ca.substitute(expression, symbols, values)


def column(elements: Any) -> Any:
    """Return an SX column of scalar expressions."""
    return ca.vertcat(*elements, ca.SX(0, 1))


def remarks(system: ExplicitModel) -> list[ModelicaWarning]:
    """Return warnings: parameters without effect, no chosen integration step."""
    model = system.model
    computed = system.plain(ca.vertcat(system.derivatives, system.algebraic, system.indicators))
    used = {symbol.name() for symbol in ca.symvar(ca.vertcat(computed, system.starts))}
    found = [
        ModelicaWarning(model.file, each.line, f"parameter '{each.name}' is used nowhere: use or remove it")
        for each in system.parameters
        if each.name not in used
    ]
    if model.interval is None:
        text = f"experiment without Interval: co-simulation takes steps of {model.step:g} s, without error control"
        found.append(ModelicaWarning(model.file, model.last_line, f"{text}; give the step that the model needs"))
    return found
