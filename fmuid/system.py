"""Components and connections: a system of FMUs that step together; one FMU is a system of one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from fmuid.errors import InputError, nearest
from fmuid.fmi.archive import FMU
from fmuid.fmi.description import Variable


class Connection(NamedTuple):
    """An output and the input that it feeds, both as (component, variable name inside the component)."""

    source: tuple[str, str]
    target: tuple[str, str]


class System:
    """FMUs coupled through connections.

    Parameters
    ----------
    fmu : FMU or path, optional
        The only component; its variables keep their names.
    components : mapping of str to FMU or path
        Several components; their variables are written ``component.variable``.
    connections : iterable of (str, str)
        (output, input), each as ``component.variable``.

    Attributes
    ----------
    components : dict of str to FMU
        A single FMU is the component ``""``.
    variables : dict of str to Variable
        All variables under their names in the system.

    Raises
    ------
    InputError
        If a connection names an unknown variable, the wrong causality, differing types or units, or feeds an
        input twice, or if the connections close a loop of direct feed-through.
    """

    def __init__(
        self,
        fmu: FMU | str | Path | None = None,
        *,
        components: Mapping[str, FMU | str | Path] | None = None,
        connections: Iterable[tuple[str, str]] = (),
    ) -> None:
        if (fmu is None) == (not components):
            raise InputError("a system needs either one FMU or named components; give exactly one of the two")
        given: Mapping[str, FMU | str | Path] = {"": fmu} if fmu is not None else dict(components or {})
        self.components = {name: model if isinstance(model, FMU) else FMU(model) for name, model in given.items()}
        for name in self.components:
            if fmu is None and (not name or "." in name):
                raise InputError(f"component name {name!r} must not be empty or contain a dot; rename the component")
        self.connections = tuple(self._connect(source, target) for source, target in connections)
        self._check_fed_once()
        self.exchange_order  # noqa: B018  # a loop of direct feed-through is an error now, not at the first simulation

    @classmethod
    def of(cls, model: System | FMU | str | Path) -> System:
        """Return the model itself where it is a system, else the system of one FMU."""
        return model if isinstance(model, System) else cls(model)

    def __repr__(self) -> str:
        return f"System({', '.join(self.components)})" if self.name_prefixed else f"System({self.label})"

    @property
    def name_prefixed(self) -> bool:
        """Whether variables carry their component's name."""
        return "" not in self.components

    @property
    def label(self) -> str:
        """The file name of the FMU, or of all components, for messages."""
        return ", ".join(fmu.path.name for fmu in self.components.values())

    @cached_property
    def variables(self) -> dict[str, Variable]:
        """All variables under their names in the system."""
        return {
            self.full_name(component, name): replace(variable, name=self.full_name(component, name))
            for component, fmu in self.components.items()
            for name, variable in fmu.description.variables.items()
        }

    @cached_property
    def connected_inputs(self) -> frozenset[str]:
        """Names of the inputs that a connection feeds."""
        return frozenset(self.full_name(*connection.target) for connection in self.connections)

    @property
    def can_be_repeated(self) -> bool:
        """Whether several instances of every component may live in one process."""
        interfaces = [fmu.description.interfaces.get("co-simulation") for fmu in self.components.values()]
        return all(i is not None and not i.once_per_process and not i.needs_execution_tool for i in interfaces)

    def full_name(self, component: str, name: str) -> str:
        """Return the name of a component's variable in the system."""
        return f"{component}.{name}" if component else name

    def split(self, name: str) -> tuple[str, str]:
        """Return (component, name inside it) of a variable's name in the system."""
        if not self.name_prefixed:
            return "", name
        component, _, inner = name.partition(".")
        return component, inner

    def variable(self, name: str, role: str = "variable") -> Variable:
        """Return a variable by its name in the system.

        Raises
        ------
        InputError
            If there is none; the sentence gives the nearest names.
        """
        found = self.variables.get(name)
        if found is None:
            raise InputError(f"{self.label} has no {role} {name!r}{nearest(name, self.variables)}")
        return found

    def _connect(self, source: str, target: str) -> Connection:
        ends = (self.variable(source, "connected variable"), self.variable(target, "connected variable"))
        for variable, causality in zip(ends, ("output", "input"), strict=True):
            if variable.causality != causality:
                raise InputError(
                    f"connection {source} -> {target}: {variable.name!r} is of causality {variable.causality!r}; "
                    f"connect an output to an input"
                )
        if ends[0].type != ends[1].type:
            raise InputError(f"connection {source} -> {target}: {ends[0].type} cannot feed {ends[1].type}")
        if ends[0].unit and ends[1].unit and ends[0].unit != ends[1].unit:
            raise InputError(
                f"connection {source} -> {target}: the units differ ({ends[0].unit} and {ends[1].unit}); "
                f"export the models with the same unit"
            )
        return Connection(self.split(source), self.split(target))

    def _check_fed_once(self) -> None:
        seen = set()
        for connection in self.connections:
            if connection.target in seen:
                raise InputError(f"input {self.full_name(*connection.target)!r} is fed by two connections; keep one")
            seen.add(connection.target)

    @cached_property
    def exchange_order(self) -> tuple[tuple[Connection, ...], ...]:
        """Connections in the order in which values can be passed on, in groups that may be passed on together.

        A connection comes after those that feed an input on which its source depends directly (ModelStructure,
        FMI 2.0.4, section 2.2.8; an FMU that declares no dependencies is taken to depend on all its inputs).
        """
        feeding = {connection.target: connection for connection in self.connections}
        graph = {
            connection: {
                feeding[connection.source[0], name]
                for name in self._direct_inputs(*connection.source)
                if (connection.source[0], name) in feeding
            }
            for connection in self.connections
        }
        sorter = TopologicalSorter(graph)
        try:
            sorter.prepare()
        except CycleError as error:
            loop = " -> ".join(self.full_name(*connection.source) for connection in reversed(error.args[1]))
            raise InputError(
                f"the connections close a loop of direct feed-through, {loop}; "
                f"break it with a component whose output does not depend directly on its input"
            ) from None
        groups = []
        while sorter.is_active():
            ready = sorter.get_ready()
            groups.append(tuple(sorted(ready)))
            sorter.done(*ready)
        return tuple(groups)

    def _direct_inputs(self, component: str, output: str) -> tuple[str, ...]:
        description = self.components[component].description
        declared = description.dependencies.get(output)
        return description.inputs if declared is None else declared
