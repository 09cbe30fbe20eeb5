"""Forward sensitivities of a model: states ∂x/∂p and outputs ∂y/∂p.

With S = ∂x/∂p: ``dS/dt = ∂f/∂x S + ∂f/∂p``, ``∂y/∂p = ∂g/∂x S + ∂g/∂p``, ``S(0) = ∂x0/∂p``. A Runge-Kutta method gives
the exact derivative of its own x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import casadi as ca

from fmuid.errors import InputError, ModelicaError
from fmuid.export.explicit_model import ExplicitModel, column
from fmuid.export.syntax import Declaration
from fmuid.formatting import nearest


def with_sensitivities(system: ExplicitModel, parameters: Sequence[str] | Literal["all"]) -> ExplicitModel:
    """Return the model with sensitivities to these parameters, ``sens.p.x``; those of outputs are outputs.

    `ModelicaError` refuses relations and jumps, as sensitivities would miss their effect.
    """
    names = [each.name for each in system.parameters]
    chosen = names if parameters == "all" else list(dict.fromkeys(parameters))
    for name in chosen:
        if name not in names:
            raise InputError(
                f"{system.model.file}: no sensitivities to '{name}', which is no parameter of the model"
                f"{nearest(name, names) or ': the parameters are ' + (', '.join(names) or 'none')}"
            )
    if chosen and system.jumps:
        text = "sensitivities jump where relations, sign, floor, ceil and mod do: smooth these, or export without"
        raise ModelicaError(system.model.file, system.jumps, text)
    both = ca.vertcat(system.derivatives, system.algebraic)
    extra = _Extra(system)
    for name in chosen:
        extra.add(system.parameters[names.index(name)], both)
    return extra.joined() if chosen else system


class _Extra:
    def __init__(self, system: ExplicitModel) -> None:
        self.system = system
        self.states: list[Declaration] = []
        self.others: list[Declaration] = []
        self.expressions: dict[str, list[Any]] = {"x": [], "derivatives": [], "starts": [], "algebraic": []}
        self.numbers = dict(system.numbers)

    def add(self, parameter: Declaration, both: Any) -> None:
        """Add the sensitivities to one parameter; `both` is dx/dt and w."""
        s = self.system
        states = [self.declare(each, parameter) for each in s.states]
        outputs = [k for k, each in enumerate(s.others) if each.role == "output"]
        state = column(ca.SX.sym(each.name) for each in states)
        direction = ca.SX([float(each is parameter) for each in s.parameters])
        symbols, values = (column(each[k] for each in s.reciprocals) for k in (0, 1))
        knowns = ca.vertcat(s.x, s.p, symbols)
        seeds = ca.vertcat(state, direction, ca.jtimes(values, s.p, direction))
        both_seed = ca.densify(ca.jtimes(both, knowns, seeds))
        rates, others = ca.vertsplit(both_seed, [0, s.x.numel(), both.numel()])
        starts = ca.densify(ca.jtimes(s.starts, s.p, direction))
        self.states += states
        self.others += [self.declare(s.others[k], parameter) for k in outputs]
        for key, elements in (
            ("x", state),
            ("derivatives", rates),
            ("starts", starts),
            ("algebraic", column(others[k] for k in outputs)),
        ):
            self.expressions[key].append(elements)

    def declare(self, variable: Declaration, parameter: Declaration) -> Declaration:
        """Return the declaration of a sensitivity, nominal for the whole parameter."""
        name = f"sens.{parameter.name}.{variable.name}"
        numbers = self.system.numbers.get
        magnitude = numbers((parameter.name, "nominal")) or abs(numbers((parameter.name, "value"), 0.0)) or 1.0
        self.numbers[name, "nominal"] = numbers((variable.name, "nominal"), 1.0) / magnitude
        description = f"derivative of {variable.description or variable.name} with respect to {parameter.name}"
        return Declaration(name, variable.role, variable.line, description, _quotient(variable.unit, parameter.unit))

    def joined(self) -> ExplicitModel:
        """Return the model with all additions."""
        s = self.system
        there = {key: getattr(s, key) for key in self.expressions}
        model = replace(s.model, declarations=(*s.model.declarations, *self.states, *self.others))
        return replace(
            s,
            model=model,
            states=(*s.states, *self.states),
            others=(*s.others, *self.others),
            numbers=self.numbers,
            **{key: ca.vertcat(there[key], *more) for key, more in self.expressions.items()},
        )


def _quotient(numerator: str | None, denominator: str | None) -> str | None:
    """Return the unit of a quotient, such as ``N.s/m``; None if unknown."""
    if numerator is None or denominator is None:
        return None
    above, below = _factors(numerator)
    more_below, more_above = _factors(denominator)
    above, below = above + more_above, below + more_below
    for factor in [*above]:
        if factor in below:
            above.remove(factor)
            below.remove(factor)
    bottom = ".".join(below)
    return (".".join(above) or "1") + (f"/({bottom})" if len(below) > 1 else f"/{bottom}" if below else "")


def _factors(unit: str) -> tuple[list[str], list[str]]:
    """Return the factors above and below the line."""
    above, _, below = unit.partition("/")
    parts = (part.removeprefix("(").removesuffix(")").split(".") for part in (above, below))
    first, second = ([factor for factor in part if factor not in ("", "1")] for part in parts)
    return first, second
