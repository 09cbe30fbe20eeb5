"""Summary of an FMU for parameter identification; `fmuid info` prints it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from math import prod
from typing import NamedTuple

from fmuid.models.component import Component, SolverConfiguration
from fmuid.models.description import Description, Variable
from fmuid.models.fmu import FMU, PLATFORMS

# A number between brackets, alone or beside others.
_SUBSCRIPT = re.compile(r"(?<=[\[,])\s*\d+(?=\s*[\],])")


@dataclass(frozen=True)
class FmuSummary:
    """Declarations of an FMU, grouped for parameter identification."""

    fmu: FMU
    # declared attributes of each interface; "needsCompletedIntegratorStep" has its FMI 3.0 name
    capabilities: Mapping[str, Mapping[str, str]]
    here: str | None  # folder of this machine's binaries
    machine: str  # FMI's name of this machine's platform
    run_as: SolverConfiguration  # default solver settings
    tunable: tuple[Variable, ...]  # parameters that may change at any time; `fixed` are set before initialization
    fixed: tuple[Variable, ...]
    calculated: tuple[Variable, ...]  # parameters that the FMU computes
    structural: tuple[Variable, ...]  # sizes of arrays
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    starts: tuple[Variable, ...]  # other variables with settable start values
    direct: Mapping[str, tuple[str, ...] | None]  # inputs with direct feed-through to each output; None if undeclared
    units: Mapping[str, tuple[str, ...]]  # units of inputs, outputs and states, with alternatives for data files

    @property
    def others(self) -> int:
        """Number of variables in none of these groups."""
        known = {v.name for group in (*GROUPS, "states") for v in getattr(self, group)}
        return len(self.fmu.description.variables.keys() - known)


def facts(fmu: FMU) -> FmuSummary:
    """Return the summary of an FMU, for any platform; nothing is unpacked or loaded."""
    described = fmu.description
    groups: dict[str, list[Variable]] = {name: [] for name in (*GROUPS, "")}
    for variable in described.variables.values():
        groups[_group(variable)].append(variable)
    states = tuple(v for v in described.variables.values() if v.is_state)
    observed = (*groups["inputs"], *groups["outputs"], *states)
    return FmuSummary(
        fmu=fmu,
        capabilities=described.capabilities,
        here=next((name for name in PLATFORMS.values() if name in fmu.platforms), None),
        machine=PLATFORMS[described.major_version],
        run_as=Component(fmu).how_run(),
        states=states,
        direct={v.name: _direct(described, v.name) for v in groups["outputs"]},
        units={v.unit: other_units(described, v.unit) for v in observed if v.unit is not None},
        **{name: tuple(groups[name]) for name in GROUPS},
    )


GROUPS = ("tunable", "fixed", "calculated", "structural", "inputs", "outputs", "starts")
"""Disjoint groups of variables; states are also in `FmuSummary.states`."""


def _group(variable: Variable) -> str:
    if variable.variability != "constant":
        if variable.causality == "parameter":
            return "tunable" if variable.variability == "tunable" else "fixed"
        if variable.causality == "structuralParameter":
            return "structural"
        if variable.causality == "input":
            return "inputs"
    if variable.causality == "output":
        return "outputs"
    if variable.causality == "calculatedParameter":
        return "calculated"
    if variable.settable:
        return "" if variable.is_state else "starts"
    # tools export parameters that are computed from others as fixed local variables, too
    return "calculated" if variable.causality == "local" and variable.variability in ("fixed", "tunable") else ""


def _direct(described: Description, output: str) -> tuple[str, ...] | None:
    depends = described.dependencies.get(output)
    return None if depends is None else tuple(v for v in depends if described.variables[v].causality == "input")


def other_units(described: Description, unit: str) -> tuple[str, ...]:
    """Return the convertible units: display units, and others of the dimension."""
    own = described.units.get(unit)
    if own is None:
        return ()
    same = [other.name for other in described.units.values() if own.exponents == other.exponents is not None]
    return tuple(name for name in dict.fromkeys([*own.display_units, *same]) if name != unit)


class VariableRow(NamedTuple):
    """A variable, or many elements of an array, as one row."""

    name: str  # with ranges of subscripts if it stands for several: ``A[1..3,1..3]``
    variables: tuple[Variable, ...]


def lines(variables: Iterable[Variable]) -> list[VariableRow]:
    """Return variables as rows; many elements of an array share one row.

    They share it if they fill a box of subscripts and have one type, unit, causality and variability.
    Tools write arrays as variables ``x[1]``, ``cells[1].R`` in FMI 2.0.
    """
    alike: dict[tuple[object, ...], list[Variable]] = {}
    for v in variables:
        pattern = _SUBSCRIPT.sub("#", v.name) if "[" in v.name else v.name
        alike.setdefault((pattern, v.type, v.unit, v.causality, v.variability), []).append(v)
    found: list[VariableRow] = []
    for some in alike.values():
        places = [[int(n) for n in _SUBSCRIPT.findall(v.name)] for v in some]
        ranges = [(min(along), max(along)) for along in zip(*places, strict=True)]
        if len(some) <= 4 or prod(high - low + 1 for low, high in ranges) != len(some):
            found += [VariableRow(v.name, (v,)) for v in some]
        else:
            spans = [f"{low}..{high}" if high > low else str(low) for low, high in ranges]
            between = _SUBSCRIPT.split(some[0].name)
            name = "".join(chain.from_iterable(zip(between, [*spans, ""], strict=True)))
            found.append(VariableRow(name, tuple(some)))
    return found
