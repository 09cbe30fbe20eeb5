"""Columns of data matched with FMU variables by name and unit; a guess must be the only one at its step."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import Description, Variable
from fmuid.units import unit_in_name

# Additions to names of measured and commanded quantities, in English and German.
_MEASURED = {
    "meas", "measured", "measurement", "mes", "mess", "messung", "messwert", "gemessen", "ist", "istwert", "act",
    "actual", "sensor", "value", "val", "wert", "signal", "sig", "raw", "data", "filt", "filtered",
}  # fmt: skip
_COMMANDED = {"set", "setpoint", "sp", "soll", "sollwert", "ref", "reference", "cmd", "command"}
# Quantities with a unit; speed is left out, as its unit varies.
_QUANTITIES = {
    "voltage": "V", "spannung": "V", "current": "A", "strom": "A", "torque": "N.m", "drehmoment": "N.m",
    "temperature": "K", "temperatur": "K", "temp": "K", "pressure": "Pa", "druck": "Pa",
}  # fmt: skip
_WORDS = re.compile(r"[^\W\d_]+|\d+")
_HUMP = re.compile(r"(?<=[a-zäöüß\d])(?=[A-ZÄÖÜ])")


class MatchReason(Enum):
    """Reason for a match, the most certain first."""

    GIVEN = "given"
    NAME = "name"
    SPELLING = "spelling"  # equal except for case and separators
    ADDITION = "addition"  # equal without additions such as "meas" or "set", or without the component
    BEGINNING = "beginning"  # one name begins with the other, and the units convert
    QUANTITY = "quantity"  # the only column and the only variable of this quantity


SURE = (MatchReason.GIVEN, MatchReason.NAME)  # reasons without doubt


@dataclass(frozen=True)
class ColumnMatch:
    """Variable and its column; `choices` are equally likely columns."""

    variable: str
    role: str
    column: str | None = None
    reason: MatchReason | None = None
    unit: str | None = None
    column_unit: str | None = None
    choices: tuple[str, ...] = ()

    @property
    def sure(self) -> bool:
        """Whether the match is certain."""
        return self.reason in SURE


def guess(
    description: Description, columns: Sequence[str], units: Mapping[str, str], given: Mapping[str, str]
) -> tuple[ColumnMatch, ...]:
    """Return the columns of inputs, outputs and measured local variables."""
    roles = {name: role for role in ("input", "output") for name in of_tables(description, role)}
    local = of_tables(description, "local")
    for variable, column in given.items():
        _check_given(variable, column, [*roles, *local], columns)
        roles.setdefault(variable, "output")
    local = [name for name in local if name not in description.derivatives]  # written by simulators
    found = {name: (column, MatchReason.GIVEN) for name, column in given.items() if column}
    exact = set(columns) - {column for column, _ in found.values()}
    found |= {name: (name, MatchReason.NAME) for name in [*roles, *local] if name in exact and name not in given}
    roles |= {name: "output" for name in found if name not in roles}
    names = list(roles) if any(role == "output" for role in roles.values()) else [*roles, *local]
    search = _Guesses(description, roles, units)
    open_ = [name for name in names if name not in found and name not in given]
    found |= search.run(open_, [c for c in columns if c not in {column for column, _ in found.values()}])
    roles |= {name: "output" for name in found if name not in roles}
    links = []
    for name, role in roles.items():
        match, reason = found.get(name, (None, None))
        unit = description.variables[name].unit
        said = search.unit_of(description.variables[name], match or "")
        links.append(
            ColumnMatch(name, role, match, reason, unit, said, search.choices.get(name, ()) if not match else ())
        )
    return tuple(links)


def of_tables(description: Description, causality: str) -> list[str]:
    """Return the variables of a causality that a column can be."""
    return [
        variable.name
        for variable in description.with_causality(causality)
        if variable.type in ("Real", "Integer", "Boolean") and variable.variability in ("continuous", "discrete")
    ]


def _check_given(variable: str, column: str, variables: Sequence[str], columns: Sequence[str]) -> None:
    if variable not in variables:
        raise InputError(
            f"mapping {variable}={column}: the FMU has no input or output {variable!r}{nearest(variable, variables)}"
        )
    if column and column not in columns:
        near = nearest(column, columns) or f". Columns: {', '.join(columns[:12])}{', …' if len(columns) > 12 else ''}"
        raise InputError(f"mapping {variable}={column}: column {column!r} not found{near}")


class _Guesses:
    """Matcher of variables and columns, step by step."""

    def __init__(self, description: Description, roles: Mapping[str, str], units: Mapping[str, str]) -> None:
        self.description, self.roles, self.units = description, roles, units
        self.choices: dict[str, tuple[str, ...]] = {}

    def run(self, variables: Sequence[str], columns: Sequence[str]) -> dict[str, tuple[str, MatchReason]]:
        found: dict[str, tuple[str, MatchReason]] = {}
        for reason in (MatchReason.SPELLING, MatchReason.ADDITION, MatchReason.BEGINNING, MatchReason.QUANTITY):
            rest = [name for name in variables if name not in found]
            free = [each for each in columns if each not in {column for column, _ in found.values()}]
            pairs = {name: [column for column in free if self._fits(reason, name, column)] for name in rest}
            claimed = [column for several in pairs.values() for column in several]
            for name, several in pairs.items():
                if len(several) == 1 and claimed.count(several[0]) == 1:
                    found[name] = several[0], reason
                elif several:
                    self.choices.setdefault(name, tuple(several))
        return found

    def _fits(self, reason: MatchReason, name: str, column: str) -> bool:
        variable, role, words = self.description.variables[name], self.roles.get(name, "output"), _words(column)
        if role == "output" and not _COMMANDED.isdisjoint(set(words) - set(_words(name))):
            return False  # a commanded column is not a measured output
        converts = self._converts(variable, column)
        if converts is False:
            return False
        if reason is MatchReason.SPELLING:
            return "".join(_words(name)) == "".join(words)
        if reason is MatchReason.QUANTITY:
            meant = {_QUANTITIES[word] for word in words if word in _QUANTITIES}
            known = variable.unit not in (None, "", "1") and not self.units.get(column)
            return bool(converts) or (known and any(self._has_unit(variable, unit) for unit in meant))
        bare, own = _bare(column, role), _bare(name, role)
        if reason is MatchReason.ADDITION:
            return not bare.isdisjoint(own)
        return bool(converts) and any(a.startswith(b) or b.startswith(a) for a in own for b in bare)

    def unit_of(self, variable: Variable, column: str) -> str | None:
        """Return the unit of a variable's column: said, or at the end of its name."""
        return self.units.get(column) or unit_in_name(column, variable.name, variable.unit or "")

    def _converts(self, variable: Variable, column: str) -> bool | None:
        """Return whether a column's unit converts to the variable's; None if unknown."""
        unit = self.unit_of(variable, column)
        if not unit or variable.unit in (None, "", "1"):
            return None
        return self._has_unit(variable, unit)

    def _has_unit(self, variable: Variable, unit: str) -> bool:
        try:
            self.description.conversion(variable, unit)
        except InputError:
            return False
        return True


def _words(name: str) -> list[str]:
    """Return the lower-case words of a name: ``IdMeas_2`` is id, meas, 2."""
    return [word.casefold() for part in _WORDS.findall(name) for word in _HUMP.split(part)]


def _bare(name: str, role: str) -> set[str]:
    """Return a name without additions such as meas or set; whole and last part."""
    words, added = _words(name), _MEASURED | (_COMMANDED if role == "input" else set())
    last = _words(name.rpartition(".")[2])
    forms = ([word for word in some if word not in added] for some in (words, last))
    return {"".join(form) for form in forms if form}
