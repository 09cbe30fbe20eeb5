"""Facts about an FMU for the identification of its parameters, as data; `fmuid info` prints them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from math import prod
from typing import NamedTuple
from xml.etree.ElementTree import Element

from fmuid.models.component import Component, SolverConfiguration
from fmuid.models.description import DESCRIPTION_FILE, Description, Variable
from fmuid.models.fmu import FMU, PLATFORMS
from fmuid.models.reading import read_text
from fmuid.models.untrusted_xml import started_elements

# Most elements of an array that are listed one by one; more of them share a line.
SINGLE_ELEMENTS = 4

# A number between brackets, alone or beside others.
_SUBSCRIPT = re.compile(r"(?<=[\[,])\s*\d+(?=\s*[\],])")

_TAGS = {
    "CoSimulation": "co-simulation",
    "ModelExchange": "model-exchange",
    "ScheduledExecution": "scheduled-execution",
}


@dataclass(frozen=True)
class FmuSummary:
    """The declarations of an FMU, sorted for the identification of its parameters.

    Attributes
    ----------
    fmu : FMU
    capabilities : mapping of str to mapping of str to str
        For each interface what it declares, by the names of FMI, "needsCompletedIntegratorStep" by that of FMI 3.0.
    here : str or None
        The folder of binaries for this machine; None if there is none.
    machine : str
        FMI's name of this machine's platform.
    run_as : SolverConfiguration
        How fmuid runs the FMU by default.
    tunable, fixed, calculated, structural : tuple of Variable
        Parameters: that may change at any time, that are set before the initialisation, that the FMU computes from
        others and nobody can set, and those that size arrays, which fmuid leaves alone.
    inputs, outputs, states : tuple of Variable
    starts : tuple of Variable
        Other variables whose start values can be set.
    direct : mapping of str to (tuple of str or None)
        For each output the inputs with direct feed-through to it; None if the FMU does not declare them.
    units : mapping of str to tuple of str
        Each unit of inputs, outputs and states with the units that a table may have instead.
    """

    fmu: FMU
    capabilities: Mapping[str, Mapping[str, str]]
    here: str | None
    machine: str
    run_as: SolverConfiguration
    tunable: tuple[Variable, ...]
    fixed: tuple[Variable, ...]
    calculated: tuple[Variable, ...]
    structural: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    starts: tuple[Variable, ...]
    direct: Mapping[str, tuple[str, ...] | None]
    units: Mapping[str, tuple[str, ...]]

    @property
    def others(self) -> int:
        """Number of variables in none of these groups."""
        known = (*self.tunable, *self.fixed, *self.calculated, *self.structural)
        known += (*self.inputs, *self.outputs, *self.states, *self.starts)
        return len(self.fmu.description.variables.keys() - {variable.name for variable in known})


def facts(fmu: FMU) -> FmuSummary:
    """Return the facts of an FMU; nothing of it is unpacked or loaded.

    Parameters
    ----------
    fmu : FMU
        Of FMI 2.0 or 3.0, for any platform.
    """
    described = fmu.description
    variables = tuple(described.variables.values())
    sorted_: dict[str | None, list[Variable]] = {}
    for v in variables:
        sorted_.setdefault(_group(v), []).append(v)
    groups = {group: tuple(sorted_.get(group, ())) for group in GROUPS}
    inputs = frozenset(described.inputs)
    observed = (*groups["inputs"], *groups["outputs"], *(v for v in variables if v.is_state))
    return FmuSummary(
        fmu=fmu,
        capabilities=_capabilities(fmu),
        here=next((name for name in PLATFORMS.values() if name in fmu.platforms), None),
        machine=PLATFORMS[described.major_version],
        run_as=Component(fmu).how_run(),
        states=tuple(v for v in variables if v.is_state),
        direct={v.name: _direct(described, v.name, inputs) for v in groups["outputs"]},
        units={
            unit: other_units(described, unit) for unit in dict.fromkeys(v.unit for v in observed if v.unit is not None)
        },
        **groups,
    )


GROUPS = ("tunable", "fixed", "calculated", "structural", "inputs", "outputs", "starts")
"""Disjoint groups of variables; states are also in `FmuSummary.states`."""


def _group(variable: Variable) -> str | None:
    """Return which of `GROUPS` a variable belongs to."""
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
        return None if variable.is_state else "starts"
    # tools export parameters that are computed from others as fixed local variables, too
    return "calculated" if variable.causality == "local" and variable.variability in ("fixed", "tunable") else None


def _capabilities(fmu: FMU) -> dict[str, dict[str, str]]:
    """Return what each interface declares, the attributes of its element; these stand before the variables."""
    found: dict[str, dict[str, str]] = {}
    for element in started_elements(read_text(fmu.path), f"{fmu.path}: its {DESCRIPTION_FILE}"):
        if element.tag == "ModelVariables":
            break
        if element.tag in _TAGS:
            found[_TAGS[element.tag]] = _declared(element, fmu.description.major_version)
    return dict(sorted(found.items()))


def _declared(element: Element, version: int) -> dict[str, str]:
    given = dict(element.attrib)
    if element.tag == "ModelExchange" and version == 2:  # FMI 2.0 states the opposite
        told = given.pop("completedIntegratorStepNotNeeded", "false").strip() in ("true", "1")
        given["needsCompletedIntegratorStep"] = "false" if told else "true"
    return given


def _direct(described: Description, output: str, inputs: frozenset[str]) -> tuple[str, ...] | None:
    depends = described.dependencies.get(output)
    if depends is None:
        return None
    return tuple(name for name in depends if name in inputs)


def other_units(described: Description, unit: str) -> tuple[str, ...]:
    """Return the units that `Description.conversion` converts to a unit: display units, and others of its dimension."""
    own = described.units.get(unit)
    if own is None:
        return ()
    same = [other.name for other in described.units.values() if own.exponents == other.exponents is not None]
    return tuple(name for name in dict.fromkeys([*own.display_units, *same]) if name != unit)


class VariableRow(NamedTuple):
    """One line of a list of variables: one variable, or many elements of an array.

    Attributes
    ----------
    name : str
        With the ranges of its subscripts where it stands for several: ``A[1..3,1..3]``.
    variables : tuple of Variable
    """

    name: str
    variables: tuple[Variable, ...]


def lines(variables: Iterable[Variable]) -> list[VariableRow]:
    """Return variables as lines: elements of one array, or of like components, share one where there are many.

    FMI 3.0 has arrays; tools that export FMI 2.0 write their elements as variables ``x[1]``, ``cells[1].R``. Elements
    share a line where they fill a box of subscripts and have the same type, unit, causality and variability.
    """
    alike: dict[tuple[object, ...], list[Variable]] = {}
    for v in variables:
        pattern = _SUBSCRIPT.sub("#", v.name) if "[" in v.name else v.name
        alike.setdefault((pattern, v.type, v.unit, v.causality, v.variability), []).append(v)
    found: list[VariableRow] = []
    for some in alike.values():
        if len(some) <= SINGLE_ELEMENTS:
            found += [VariableRow(v.name, (v,)) for v in some]
            continue
        places = [[int(n) for n in _SUBSCRIPT.findall(v.name)] for v in some]
        ranges = [(min(along), max(along)) for along in zip(*places, strict=True)]
        size = prod(high - low + 1 for low, high in ranges)
        if size == len(some):
            spans = [f"{low}..{high}" if high > low else str(low) for low, high in ranges]
            between = _SUBSCRIPT.split(some[0].name)
            name = "".join(chain.from_iterable(zip(between, [*spans, ""], strict=True)))
            found.append(VariableRow(name, tuple(some)))
        else:
            found += [VariableRow(v.name, (v,)) for v in some]
    return found
