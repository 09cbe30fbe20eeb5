"""Columns computed by expressions, without running them as Python."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.formatting import bounded, nearest

FUNCTIONS: Mapping[str, tuple[int, Callable[..., Any]]] = {
    "abs": (1, np.abs), "sign": (1, np.sign), "sqrt": (1, np.sqrt), "exp": (1, np.exp), "log": (1, np.log),
    "sin": (1, np.sin), "cos": (1, np.cos), "tan": (1, np.tan), "asin": (1, np.arcsin), "acos": (1, np.arccos),
    "atan": (1, np.arctan), "atan2": (2, np.arctan2), "min": (2, np.minimum), "max": (2, np.maximum),
}  # fmt: skip
"""Name: number of arguments, and what it does with columns."""
CONSTANTS = {"pi": math.pi}
_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.Mod: operator.mod,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def evaluate(text: str, column: Callable[[str], Floats], count: int) -> Floats:
    """Return an expression of columns as (K,); divisions by zero are not finite."""
    if len(text) > 1000:
        raise InputError(f"expression has {len(text)} characters. Write at most 1000.")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        with np.errstate(all="ignore"):
            value = _value(tree.body, text, column)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _refusal(text, "no expression") from None
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (count,)))


def _value(node: ast.expr, text: str, column: Callable[[str], Floats]) -> Any:
    match node:
        case ast.Constant(value=bool()):
            raise _refusal(text, "holds a truth value")
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
        case ast.Constant(value=str() as name):
            return column(name)
        case ast.Name(id=name):
            return np.float64(CONSTANTS[name]) if name in CONSTANTS else column(name)
        case ast.BinOp(left, kind, right) if type(kind) in _OPERATORS:
            return _OPERATORS[type(kind)](_value(left, text, column), _value(right, text, column))
        case ast.UnaryOp(kind, operand) if type(kind) in _OPERATORS:
            return _OPERATORS[type(kind)](_value(operand, text, column))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            return _call(name, arguments, text, column)
    raise _refusal(text, f"unknown part {bounded(ast.unparse(node), 60)!r}")


def _call(name: str, arguments: list[ast.expr], text: str, column: Callable[[str], Floats]) -> Any:
    if name not in FUNCTIONS:
        raise _refusal(text, f"unknown function {name!r}{nearest(name, FUNCTIONS)}")
    wanted, function = FUNCTIONS[name]
    if len(arguments) != wanted:
        raise _refusal(text, f"{name} takes {wanted} argument{'s' * (wanted != 1)}, not {len(arguments)}")
    return function(*(_value(each, text, column) for each in arguments))


def _refusal(text: str, why: str) -> InputError:
    return InputError(
        f"expression {bounded(text, 60)!r}: {why}. "
        f"Use numbers, columns, + - * / ** %, parentheses, pi and {', '.join(FUNCTIONS)}."
    )
