"""Which column of a table is which variable of an FMU: guessed from names and units, one step of doubt after another.

A guess must be the only one at its step, from either side: two columns that could be the same variable are left to who
knows them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from fmuid.errors import InputError
from fmuid.formatting import nearest

if TYPE_CHECKING:
    from fmuid.models import Description, Variable

# What test benches add to the name of a measured quantity (in English and German), and to that of a commanded one.
_MEASURED = {
    "meas", "measured", "measurement", "mes", "mess", "messung", "messwert", "gemessen", "ist", "istwert", "act",
    "actual", "sensor", "value", "val", "wert", "signal", "sig", "raw", "data", "filt", "filtered",
}  # fmt: skip
_COMMANDED = {"set", "setpoint", "sp", "soll", "sollwert", "ref", "reference", "cmd", "command"}
# Words that mean a quantity, by a unit of it. Speed is none: without its unit nobody knows what a number of it is.
_QUANTITIES = {
    "voltage": "V", "spannung": "V", "current": "A", "strom": "A", "torque": "N.m", "drehmoment": "N.m",
    "temperature": "K", "temperatur": "K", "temp": "K", "pressure": "Pa", "druck": "Pa",
}  # fmt: skip
_WORDS = re.compile(r"[^\W\d_]+|\d+")
_HUMP = re.compile(r"(?<=[a-zäöüß\d])(?=[A-ZÄÖÜ])")


class Reason(Enum):
    """Why a column is taken for a variable, the surest first."""

    GIVEN = "given"
    NAME = "name"
    SPELLING = "spelling"
    """The same but for case and separators."""
    ADDITION = "addition"
    """The same without what says that it is measured or commanded, or without the component before it."""
    BEGINNING = "beginning"
    """One name begins with the other, and the units convert."""
    QUANTITY = "quantity"
    """No other column and no other variable is of this quantity."""


SURE = (Reason.GIVEN, Reason.NAME)
"""Reasons that leave no doubt."""


@dataclass(frozen=True)
class ColumnMatch:
    """A variable of the FMU and the column that is taken for it.

    Attributes
    ----------
    variable : str
    role : "input" or "output"
    column : str or None
        None where there is none.
    reason : Reason or None
    unit : str or None
        Of the variable.
    column_unit : str or None
        What the table says.
    choices : tuple of str
        The columns between which nothing decides, where there are several.
    """

    variable: str
    role: str
    column: str | None = None
    reason: Reason | None = None
    unit: str | None = None
    column_unit: str | None = None
    choices: tuple[str, ...] = ()

    @property
    def sure(self) -> bool:
        """Whether nobody need be asked."""
        return self.reason in SURE


def guess(
    description: Description, columns: Sequence[str], units: Mapping[str, str], given: Mapping[str, str]
) -> tuple[ColumnMatch, ...]:
    """Return for each input and output which column it is, and local variables that are columns.

    Parameters
    ----------
    description : Description
    columns : sequence of str
        Of the table, without time.
    units : mapping of str to str
        What the table says of them.
    given : mapping of str to str
        Variables whose column is known; an empty text for none.

    Raises
    ------
    InputError
        If a variable or a column that is given is not there.
    """
    roles = {name: role for role in ("input", "output") for name in of_tables(description, role)}
    local = of_tables(description, "local")
    for variable, column in given.items():
        _check_given(variable, column, [*roles, *local], columns)
        roles.setdefault(variable, "output")
    local = [name for name in local if name not in description.derivatives]  # simulators write them, nobody measures
    found = {name: (column, Reason.GIVEN) for name, column in given.items() if column}
    exact = set(columns) - {column for column, _ in found.values()}
    found |= {name: (name, Reason.NAME) for name in [*roles, *local] if name in exact and name not in given}
    roles |= {name: "output" for name in found if name not in roles}
    names = list(roles) if any(role == "output" for role in roles.values()) else [*roles, *local]
    search = _Guesses(description, roles, units)
    open_ = [name for name in names if name not in found and name not in given]
    found |= search.run(open_, [c for c in columns if c not in {column for column, _ in found.values()}])
    roles |= {name: "output" for name in found if name not in roles}
    links = []
    for name, role in roles.items():
        match, reason = found.get(name, (None, None))
        unit, said = description.variables[name].unit, units.get(match or "")
        links.append(
            ColumnMatch(name, role, match, reason, unit, said, search.choices.get(name, ()) if not match else ())
        )
    return tuple(links)


def of_tables(description: Description, causality: str) -> list[str]:
    """Return the variables of one causality that the column of a table can stand for."""
    return [
        variable.name
        for variable in description.with_causality(causality)
        if variable.type in ("Real", "Integer", "Boolean") and variable.variability in ("continuous", "discrete")
    ]


def _check_given(variable: str, column: str, variables: Sequence[str], columns: Sequence[str]) -> None:
    if variable not in variables:
        raise InputError(
            f"mapping {variable}={column}: the FMU has no input or output {variable!r}{nearest(variable, variables)}: "
            "write variable=column"
        )
    if column and column not in columns:
        near = nearest(column, columns) or f"; it has {', '.join(columns[:12])}{', …' if len(columns) > 12 else ''}"
        raise InputError(f"mapping {variable}={column}: the table has no column {column!r}{near}")


Step = Callable[["Variable", str, str], bool]


class _Guesses:
    """Looks for pairs of variables and columns step by step, and keeps between which columns it cannot decide."""

    def __init__(self, description: Description, roles: Mapping[str, str], units: Mapping[str, str]) -> None:
        self.description, self.roles, self.units = description, roles, units
        self.choices: dict[str, tuple[str, ...]] = {}
        self.steps: Mapping[Reason, Step] = {
            Reason.SPELLING: self._same_spelling,
            Reason.ADDITION: self._same_without_addition,
            Reason.BEGINNING: self._begins_so,
            Reason.QUANTITY: self._same_quantity,
        }

    def run(self, variables: Sequence[str], columns: Sequence[str]) -> dict[str, tuple[str, Reason]]:
        found: dict[str, tuple[str, Reason]] = {}
        for reason, step in self.steps.items():
            rest = [name for name in variables if name not in found]
            free = [each for each in columns if each not in {column for column, _ in found.values()}]
            pairs = {name: [column for column in free if self._fits(step, name, column)] for name in rest}
            claimed = [column for several in pairs.values() for column in several]
            for name, several in pairs.items():
                if len(several) == 1 and claimed.count(several[0]) == 1:
                    found[name] = several[0], reason
                elif several:
                    self.choices.setdefault(name, tuple(several))
        return found

    def _fits(self, step: Step, name: str, column: str) -> bool:
        variable, role = self.description.variables[name], self.roles.get(name, "output")
        if role == "output" and not _COMMANDED.isdisjoint(set(_words(column)) - set(_words(name))):
            return False  # what is commanded is not measured
        return self._converts(variable, column) is not False and step(variable, role, column)

    def _converts(self, variable: Variable, column: str) -> bool | None:
        """Return whether the unit of a column is one of the variable's; None where one of the two is not known."""
        unit = self.units.get(column)
        if not unit or variable.unit in (None, "", "1"):
            return None
        return self._has_unit(variable, unit)

    def _has_unit(self, variable: Variable, unit: str) -> bool:
        try:
            self.description.conversion(variable, unit)
        except InputError:
            return False
        return True

    def _same_spelling(self, variable: Variable, role: str, column: str) -> bool:  # noqa: ARG002
        return "".join(_words(variable.name)) == "".join(_words(column))

    def _same_without_addition(self, variable: Variable, role: str, column: str) -> bool:
        return not _bare(column, role).isdisjoint(_bare(variable.name, role))

    def _begins_so(self, variable: Variable, role: str, column: str) -> bool:
        if not self._converts(variable, column):
            return False
        pairs = ((a, b) for a in _bare(variable.name, role) for b in _bare(column, role))
        return any(a.startswith(b) or b.startswith(a) for a, b in pairs)

    def _same_quantity(self, variable: Variable, role: str, column: str) -> bool:  # noqa: ARG002
        if self._converts(variable, column):
            return True
        meant = {_QUANTITIES[word] for word in _words(column) if word in _QUANTITIES}
        known = variable.unit not in (None, "", "1") and not self.units.get(column)
        return known and any(self._has_unit(variable, unit) for unit in meant)


def _words(name: str) -> list[str]:
    """Return the words of a name in small letters: ``IdMeas_2`` is id, meas, 2."""
    return [word.casefold() for part in _WORDS.findall(name) for word in _HUMP.split(part)]


def _bare(name: str, role: str) -> set[str]:
    """Return a name without what is added to a measured quantity, or commanded as an input is; whole and its end."""
    words, added = _words(name), _MEASURED | (_COMMANDED if role == "input" else set())
    last = _words(name.rpartition(".")[2])
    forms = ([word for word in some if word not in added] for some in (words, last))
    return {"".join(form) for form in forms if form}
