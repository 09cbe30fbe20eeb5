"""Analysis of a parsed model: names, balance, causality; explicit CasADi expressions.

Unknowns (derivatives, algebraic variables) are solved equation by equation, each linear in its unknown. An equation is
taken as soon as its other variables are known. Otherwise the smallest set that determines its unknowns is an algebraic
loop, solved together if linear.

A relation becomes a symbol, 0 or 1, that only an event changes, and an event indicator, positive where the symbol is 1:
``a > b`` has a - b, ``a >= b`` is not b > a. Indicators depend on relations of earlier equations only.

``floor(a)`` becomes a symbol with two event indicators: symbol + 1 - a (not positive: it jumps up) and symbol - a
(positive: it jumps down). ``ceil(a)`` is -floor(-a), ``mod(a, b)`` is a - b*floor(a/b).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca

from fmuid.errors import ModelicaError
from fmuid.export.algebraic_loops import always_singular, first_loop, solve_linear
from fmuid.export.explicit_model import ExplicitModel, Relation, column, written_out
from fmuid.export.syntax import Declaration, Equation, Expression, Model
from fmuid.formatting import nearest

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "^": lambda a, b: a**b,
    "neg": lambda a: -a,
    "sin": ca.sin,
    "cos": ca.cos,
    "sqrt": ca.sqrt,
    "tanh": ca.tanh,
    "abs": ca.fabs,
    "sign": ca.sign,
    "min": ca.fmin,
    "max": ca.fmax,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "not": ca.logic_not,
}

_WHOLE: dict[str, Callable[..., Any]] = {
    "floor": lambda floor, a: floor(a),
    "ceil": lambda floor, a: -floor(-a),
    "mod": lambda floor, a, b: a - b * floor(a / b),
}
"""Functions expressed by floor, the first argument."""


def _choice(args: list[Any]) -> Any:
    """Return an if-expression of alternate conditions and values, then else."""
    *pairs, result = args
    for condition, value in zip(pairs[-2::-2], pairs[::-2], strict=True):
        result = ca.if_else(condition, value, result)
    return result


def analyse(model: Model) -> ExplicitModel:
    """Check a model and solve it for derivatives and algebraic variables."""
    return _Analysis(model).run()


class _Analysis:
    """Known variables, collected in the order of `run`."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.declared: dict[str, Declaration] = {}
        self.known: dict[str, Any] = {}  # name, or der(name) -> its SX
        self.numbers: dict[tuple[str, str], float] = {}
        self.reciprocals: dict[str, tuple[Any, Any]] = {}  # coefficient -> symbol, value
        self.parameters: set[str] = set()
        self.relations: dict[str, tuple[Any, Any, Relation]] = {}  # indicator -> symbol, value, relation
        self.integers: dict[str, tuple[Any, Any, Relation]] = {}  # argument of floor() -> symbol, value, call
        self.tested: list[Any] = []  # arguments of sign and floor in the present equation
        self.no_event = 0  # depth of nested noEvent()
        self.jumps = 0

    def error(self, line: int, text: str) -> ModelicaError:
        return ModelicaError(self.model.file, line, text)

    def run(self) -> ExplicitModel:
        for each in self.model.declarations:
            if each.name in self.declared:
                first = self.declared[each.name].line
                raise self.error(each.line, f"'{each.name}' is already declared at line {first}: rename one")
            if each.name == "time":
                raise self.error(each.line, "'time' is the simulation time: use it undeclared, or rename this variable")
            self.declared[each.name] = each
        for equation in self.model.equations:
            for name in sorted(equation.names()):
                self.require_declared(equation.line, name)
        self.evaluate_numbers()
        parameters, inputs, variables = self.of("parameter"), self.of("input"), self.of("output", "local")
        p = self.make_known(parameters)
        states = self.states()
        self.parameters = {each.name for each in parameters}
        starts = column(self.start(each) for each in states)
        x, u = self.make_known(states), self.make_known(inputs)
        t = self.known["time"] = ca.SX.sym("time")
        others = [each for each in variables if each not in states]
        rates = [f"der({each.name})" for each in states]
        self.solve([*rates, *(each.name for each in others)])
        held = [*self.relations.values(), *self.integers.values()]
        counted = column(value for _, value, _ in self.integers.values())
        ends = (end for symbol, value, _ in self.integers.values() for end in (symbol + 1 - value, symbol - value))
        return ExplicitModel(
            model=self.model,
            states=tuple(states),
            inputs=tuple(inputs),
            parameters=tuple(parameters),
            others=tuple(others),
            relations=tuple(relation for _, _, relation in self.relations.values()),
            integers=tuple(call for _, _, call in self.integers.values()),
            x=x,
            u=u,
            p=p,
            t=t,
            r=column(symbol for symbol, _, _ in held),
            derivatives=column(self.known[name] for name in rates),
            algebraic=column(self.known[each.name] for each in others),
            indicators=column([*(value for _, value, _ in self.relations.values()), *ends]),
            counted=counted,
            starts=starts,
            reciprocals=tuple(self.reciprocals.values()),
            numbers=self.numbers,
            jumps=self.jumps,
        )

    def of(self, *roles: str) -> list[Declaration]:
        return [each for each in self.model.declarations if each.role in roles]

    def require_declared(self, line: int, name: str) -> None:
        if name != "time" and name.removeprefix("der(").removesuffix(")") not in self.declared:
            hint = nearest(name, self.declared) or ": declare it"
            raise self.error(line, f"unknown variable '{name}'{hint}")

    def make_known(self, declarations: list[Declaration]) -> Any:
        """Give variables symbols; return their column."""
        self.known |= {each.name: ca.SX.sym(each.name) for each in declarations}
        return column(self.known[each.name] for each in declarations)

    def evaluate_numbers(self) -> None:
        """Evaluate constants in their order, then other numeric attributes."""
        for each in [*self.of("constant"), *self.of("parameter")]:
            if each.value is None:
                raise self.error(each.line, f"{each.role} '{each.name}' has no value: write '= ...' after it")
            self.numbers[each.name, "value"] = value = self.number(each.value, f"'{each.name}'")
            if each.role == "constant":
                self.known[each.name] = ca.SX(value)
        for each in self.model.declarations:
            for key, node in each.modifiers.items():
                if key in ("min", "max", "nominal") or (key == "start" and each.role == "input"):
                    self.numbers[each.name, key] = self.number(node, f"'{key}' of '{each.name}'")
            if self.numbers.get((each.name, "nominal"), 1.0) <= 0:
                raise self.error(each.line, f"'nominal' of '{each.name}' must be positive: give its magnitude")

    def number(self, node: Expression, what: str) -> float:
        return float(self.expression(node, f"{what} must be a number, or an expression of constants above it"))

    def expression(self, node: Expression, demand: str) -> Any:
        """Return the SX of an expression; `demand` begins the message for unknown names."""
        if node.op == "number":
            return ca.SX(node.args[0])
        if node.op in ("name", "der"):
            name = next(node.names())
            self.require_declared(node.line, name)
            if name not in self.known:
                raise self.error(node.line, f"{demand}, not of '{name}'")
            return self.known[name]
        if node.op == "noEvent":
            self.no_event += 1
            result = self.expression(node.args[0], demand)
            self.no_event -= 1
            return result
        args = [self.expression(arg, demand) for arg in node.args]
        if node.op in ("<", "<=", ">", ">="):
            return self.relation(node, *args)
        if node.op in _WHOLE:
            return _WHOLE[node.op](lambda value: self.whole(node, value), *args)
        if node.op == "sign":
            self.tested += args
            self.jumps = self.jumps or node.line
        result = _choice(args) if node.op == "if" else _OPERATIONS[node.op](*args)
        if result.is_constant() and not math.isfinite(float(result)):
            raise self.error(node.line, f"'{node.op}' gives no finite number here: correct its operands")
        return result

    def relation(self, node: Expression, left: Any, right: Any) -> Any:
        """Return the symbol of a relation, or its value without events."""
        negated = node.op in ("<=", ">=")
        indicator = left - right if node.op in (">", "<=") else right - left
        value = indicator > 0
        if self.makes_events(node, indicator):
            name = f"relation[{len(self.relations) + 1}]"
            entry = ca.SX.sym(name), indicator, Relation(name, node.text, node.line)
            value = self.relations.setdefault(str(indicator), entry)[0]
        return ca.logic_not(value) if negated else value

    def whole(self, node: Expression, value: Any) -> Any:
        """Return the symbol of floor(value), or its expression without events."""
        if not self.makes_events(node, value):
            return ca.floor(value)
        name = f"integer[{len(self.integers) + 1}]"
        entry = ca.SX.sym(name), value, Relation(name, node.text, node.line)
        return self.integers.setdefault(str(value), entry)[0]

    def makes_events(self, node: Expression, tested: Any) -> bool:
        """Record an expression that jumps; return whether the jump needs events."""
        known = self.parameters | {symbol.name() for symbol, _ in self.reciprocals.values()}
        self.tested.append(tested)
        if {each.name() for each in ca.symvar(tested)} <= known:
            return False
        self.jumps = self.jumps or node.line
        return not self.no_event

    def states(self) -> list[Declaration]:
        """Return the differentiated variables."""
        lines: dict[str, int] = {}  # state -> first equation with its derivative
        for equation in self.model.equations:
            for name in equation.names():
                if name.startswith("der("):
                    lines.setdefault(name[4:-1], equation.line)
        variables = self.of("output", "local")
        for name, line in lines.items():
            role = self.declared[name].role
            if self.declared[name] not in variables:
                raise self.error(line, f"der({name}) of {role} '{name}': declare it output or without a prefix")
        for each in variables:
            given = [key for key in ("start", "fixed") if key in each.modifiers]
            if each.name in lines and len(given) != 2:
                raise self.error(each.line, f"state '{each.name}' needs both start=... and fixed=true")
            if each.name not in lines and given:
                raise self.error(each.line, f"'{given[0]}' of '{each.name}', which is no state: remove it")
        return [each for each in variables if each.name in lines]

    def start(self, state: Declaration) -> Any:
        demand = f"'start' of '{state.name}' must be an expression of parameters and constants"
        return self.expression(state.modifiers["start"], demand)

    def solve(self, unknowns: list[str]) -> None:
        """Solve the equations for the unknowns, one after the other."""
        waiting = [(equation, equation.names() & {*unknowns}) for equation in self.model.equations]
        absent = [name for name in unknowns if not any(name in names for _, names in waiting)]
        if absent or len(waiting) != len(unknowns):
            detail = f"; no equation has {', '.join(absent)}" if absent else ""
            raise self.error(
                self.model.last_line,
                f"unbalanced model: {len(waiting)} equations for {len(unknowns)} unknowns "
                f"({', '.join(unknowns)}){detail}: give one equation for each",
            )
        while waiting:
            left = [names - self.known.keys() for _, names in waiting]
            loop = next(([k] for k, names in enumerate(left) if len(names) <= 1), None) or first_loop(left)
            if not loop:
                names = [name for name in unknowns if name not in self.known]
                text = f"the equations left for {', '.join(names)} do not determine all of them: correct these"
                raise self.error(waiting[0][0].line, text)
            equations, sets = [waiting[k][0] for k in loop], [left[k] for k in loop]
            waiting = [each for k, each in enumerate(waiting) if k not in loop]
            names = [name for name in unknowns if name in set().union(*sets)]
            if not names:
                text = "this equation has no unknown left, others give all its variables: correct or remove it"
                raise self.error(equations[0].line, text)
            if len(names) == 1:
                self.solve_one(equations[0], names[0])
            else:
                self.solve_loop(equations, names)

    def solve_one(self, equation: Equation, name: str) -> None:
        symbol = self.known[name] = ca.SX.sym(name)
        self.tested.clear()
        left, right = self.expression(equation.left, ""), self.expression(equation.right, "")
        coefficient = ca.jacobian(left - right, symbol)
        if ca.depends_on(ca.vertcat(coefficient, *self.tested), symbol):
            text = f"equation not linear in its unknown {name} is outside the exported subset: solve it by hand"
            raise self.error(equation.line, text)
        if coefficient.is_zero():
            raise self.error(equation.line, f"the unknown {name} of this equation drops out: correct it")
        rest = ca.substitute(right - left, symbol, 0)
        involved = {each.name() for each in ca.symvar(coefficient)}
        if involved and involved <= self.parameters:
            key = str(coefficient)
            self.reciprocals.setdefault(key, (ca.SX.sym(f"1/({key})"), 1 / coefficient))
            self.known[name] = rest * self.reciprocals[key][0]
        else:
            self.known[name] = rest / coefficient

    def solve_loop(self, equations: list[Equation], names: list[str]) -> None:
        """Solve an algebraic loop."""
        symbols = column(ca.SX.sym(name) for name in names)
        self.known |= dict(zip(names, ca.vertsplit(symbols), strict=True))
        self.tested.clear()
        residuals = column(self.expression(each.left, "") - self.expression(each.right, "") for each in equations)
        matrix = ca.jacobian(residuals, symbols)
        found = {each.name() for each in ca.symvar(ca.vertcat(ca.vec(matrix), *self.tested))}
        nonlinear = [name for name in names if name in found]
        where = f"algebraic loop between {', '.join(names)}"
        if nonlinear:
            text = f"{where}, which is not linear in {', '.join(nonlinear)}, is outside the exported subset"
            raise self.error(equations[0].line, f"{text}: solve it by hand, so that each equation gives one unknown")
        values = {name: self.numbers[name, "value"] for name in self.parameters}
        if always_singular(written_out(matrix, self.reciprocals.values()), values):
            lines = ", ".join(str(each.line) for each in equations)
            text = f"the equations of lines {lines} follow from each other or are in contradiction: correct them"
            raise self.error(equations[0].line, f"{where} has no unique solution, {text}")
        solution = solve_linear(matrix, ca.substitute(-residuals, symbols, ca.SX(symbols.sparsity(), 0)))
        self.known |= dict(zip(names, solution, strict=True))
