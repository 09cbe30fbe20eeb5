"""Parameters that take few values: Integer, Boolean and enumeration variables, of which each combination is tried."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import System
from fmuid.simulation import Value

ALL = "all"
"""In place of values: those of a Boolean or an enumeration, or what an Integer has between its bounds."""
# Each combination is a search of its own.
MOST_COMBINATIONS = 1000

Given = Mapping[str, Sequence[Value] | str]


def choices_of(system: System, given: Given) -> dict[str, tuple[Value, ...]]:
    """Return the values of each parameter that takes few.

    Raises
    ------
    InputError
        If the model has no such parameter, there are none or too many values, or one is given twice.
    """
    found = {name: _values(system, name, values) for name, values in given.items()}
    count = math.prod(map(len, found.values()))
    if count > MOST_COMBINATIONS:
        raise InputError(
            f"{' and '.join(map(repr, found))} have {count} combinations of values, each a search of its own, and at "
            f"most {MOST_COMBINATIONS} are tried: give fewer values"
        )
    return found


def combinations(choices: Mapping[str, Sequence[Value]]) -> list[dict[str, Value]]:
    """Return every combination of values."""
    return [dict(zip(choices, values, strict=True)) for values in product(*choices.values())]


def _values(system: System, name: str, given: Sequence[Value] | str) -> tuple[Value, ...]:
    variable = system.variables.get(name)
    if variable is None:
        raise InputError(f"{system.label} has no {name!r}{nearest(name, system.variables)}: values are given for it")
    if given != ALL:
        values = tuple(given)
        if not values or len({(type(each), each) for each in values}) < len(values):
            raise InputError(f"the values of {name!r} must be one or more, each once, not {list(values)!r}")
        return values
    if variable.type == "Boolean":
        return False, True
    if variable.items:
        return variable.items
    if variable.type == "Integer" and variable.min is not None and variable.max is not None:
        return tuple(range(int(variable.min), int(variable.max) + 1)[: MOST_COMBINATIONS + 1])
    raise InputError(f"{system.label} does not say which values {name!r} may take: list them in place of {ALL!r}")
