"""System: coupled FMUs; one FMU is a system of one."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models.component import AS_OFFERED, Component, Isolation, Numerics
from fmuid.models.connections import Connection, exchange_order
from fmuid.models.description import Variable, unit_conversion
from fmuid.models.fmu import FMU

MASTERS = ("jacobi", "gauss-seidel")

Port = tuple[str, float, float]  # a variable connected to a connector of the system, with factor and offset


@dataclass(frozen=True, eq=False, init=False, repr=False)
class System:
    """FMUs coupled through connections; fmuid.simulation runs it.

    Parameters
    ----------
    fmu : FMU or path, optional
        The only component; its variables keep their names.
    components : mapping of str to Component, FMU or path
        Several components; their variables are ``component.variable``.
    connections : iterable of (str, str) or (str, str, float, float)
        (output, input), each as ``component.variable``, with optional factor and offset; default: unit conversion.
    numerics : Numerics
        Default of the components; `step_size` is the communication step.
    master : "jacobi" or "gauss-seidel"
        Components step with values of the step's beginning, or with new values of preceding components.
    values : mapping of str to value
        Start values of variables that the simulation does not set.
    connectors : mapping of str to sequence of (str, float, float)
        The system's own inputs and parameters with target variables, factors and offsets; outputs with their source.
    isolation : Isolation, optional
        Runs the FMUs in a separate process; default: in this one.

    Attributes
    ----------
    components : dict of str to Component
        A single FMU is the component ``""``.
    variables : dict of str to Variable
        All variables by their names in the system.

    Raises
    ------
    InputError
        If a connection is invalid: unknown variable, causality, type, units, second source, loop of other than Real.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> pair = fmuid.System(components={"a": coil.fmu, "b": coil.fmu}, connections=[("a.i", "b.u", 4.0, 0.0)])
    >>> pair, pair.unit("b.i")
    (System(a, b), 'A')
    """

    components: dict[str, Component]
    connections: tuple[Connection, ...]
    connectors: Mapping[str, tuple[Port, ...]]
    exchange_order: tuple[tuple[tuple[Connection, ...], bool], ...]
    values: Mapping[str, float | int | bool | str]
    numerics: Numerics
    master: str
    isolation: Isolation | None

    def __init__(
        self,
        fmu: Component | FMU | str | Path | None = None,
        *,
        components: Mapping[str, Component | FMU | str | Path] | None = None,
        connections: Iterable[tuple[str, str] | tuple[str, str, float, float]] = (),
        numerics: Numerics = AS_OFFERED,
        master: str = "jacobi",
        values: Mapping[str, float | int | bool | str] | None = None,
        connectors: Mapping[str, Sequence[Port]] | None = None,
        isolation: Isolation | None = None,
    ) -> None:
        if (fmu is None) == (not components):
            raise InputError("a system needs either one FMU or named components.")
        if master not in MASTERS:
            raise InputError(
                f"master: unknown value {master!r}{nearest(master, MASTERS)}. Choose {' or '.join(MASTERS)}."
            )
        given: Mapping[str, Component | FMU | str | Path] = {"": fmu} if fmu is not None else dict(components or {})
        if fmu is None and "" in given:
            raise InputError("a component has an empty name. Name it.")

        own = vars(self)  # frozen for everybody else
        own |= {"numerics": numerics, "master": master, "isolation": isolation, "values": dict(values or {})}
        own["components"] = {
            name: Component(model.fmu, model.numerics.over(numerics))
            if isinstance(model, Component)
            else Component(model, numerics)
            for name, model in given.items()
        }
        own["connectors"] = {name: tuple(ports) for name, ports in (connectors or {}).items() if ports}
        own["connections"] = tuple(self._connect(*connection) for connection in connections)
        for target, count in Counter(connection.target for connection in self.connections).items():
            if count > 1:
                raise InputError(f"input {self.full_name(*target)!r} is fed by two connections. Keep one.")
        self._check_connectors()
        descriptions = {name: model.fmu.description for name, model in self.components.items()}
        own["exchange_order"] = exchange_order(self.connections, descriptions)
        for name in self.values:
            self.variable(name)

    @classmethod
    def read_ssp(
        cls,
        path: str | Path,
        numerics: Numerics = AS_OFFERED,
        master: str = "jacobi",
        isolation: Isolation | None = None,
    ) -> System:
        """Return the system of an ``.ssp`` file (SSP 1.0 and 2.0); an `InputError` if wrong.

        Its own connectors keep their names; other variables are ``component.variable``.
        """
        from fmuid.models.ssp import read_ssp

        structure = read_ssp(path)
        components = {
            name: Component(fmu, numerics.over(Numerics(interface=interface)))
            for name, (fmu, interface) in structure.components.items()
        }
        try:
            return cls(
                components=components,
                connections=structure.connections,
                numerics=numerics,
                master=master,
                values=structure.values,
                connectors=structure.connectors,
                isolation=isolation,
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @classmethod
    def of(
        cls, model: System | FMU | str | Path, numerics: Numerics = AS_OFFERED, isolation: Isolation | None = None
    ) -> System:
        """Return the system of a model; a system itself takes no numerics or isolation (`InputError`)."""
        if not isinstance(model, System):
            return cls(model, numerics=numerics, isolation=isolation)
        if numerics != AS_OFFERED or isolation is not None:
            raise InputError("a System has its own solver settings and isolation. Give them to the System.")
        return model

    def integrates(self, component: str) -> bool:
        """Return whether shorter steps suit a component: it has continuous states.

        A component without them acts once per communication step, unless `Numerics.samples` is false.
        A single FMU for Co-Simulation alone may not declare its states; there a continuous output counts.
        """
        model = self.components[component]
        if model.numerics.samples is not None:
            return not model.numerics.samples
        described = model.fmu.description
        untold = len(self.components) == 1 and "model-exchange" not in described.interfaces
        return bool(described.states) or (untold and any(v.continuous for v in described.with_causality("output")))

    @property
    def sampling_known(self) -> bool:
        """Whether the discrete-time components are known: no connections, or stated by `Numerics.samples`.

        Continuous states do not tell: a PI controller and a spring-damper have the same equations.
        """
        return not self.connections or any(model.numerics.samples is not None for model in self.components.values())

    def run_by(self, numerics: Mapping[str, Numerics]) -> System:
        """Return this system with other solver settings of some components; `Component` may refuse them."""
        other = copy.copy(self)
        changed = {name: Component(self.components[name].fmu, each) for name, each in numerics.items()}
        vars(other)["components"] = self.components | changed
        return other

    def __repr__(self) -> str:
        return f"System({', '.join(self.components)})" if self.name_prefixed else f"System({self.label})"

    @property
    def name_prefixed(self) -> bool:
        """Whether variables are prefixed by their component's name."""
        return "" not in self.components

    @property
    def label(self) -> str:
        """File names of all components, for messages."""
        return ", ".join(component.fmu.path.name for component in self.components.values())

    @cached_property
    def variables(self) -> dict[str, Variable]:
        """All variables by name; a connector is described by its first variable."""
        found = {
            self.full_name(component, name): variable._replace(name=self.full_name(component, name))
            for component, model in self.components.items()
            for name, variable in model.fmu.description.variables.items()
        }
        ports = {name: found[some[0][0]] for name, some in self.connectors.items() if some[0][0] in found}
        return found | {name: variable._replace(name=name) for name, variable in ports.items()}

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the continuous states of all components."""
        return self._full_names({name: each.fmu.description.states for name, each in self.components.items()})

    @cached_property
    def derivatives(self) -> tuple[str, ...]:
        """Names of the states' derivatives."""
        return self._full_names({name: each.fmu.description.derivatives for name, each in self.components.items()})

    def _full_names(self, inner: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
        return tuple(self.full_name(component, name) for component, names in inner.items() for name in names)

    @cached_property
    def connected_inputs(self) -> frozenset[str]:
        """Names of the inputs that a connection feeds."""
        return frozenset(self.full_name(*connection.target) for connection in self.connections)

    @property
    def can_be_repeated(self) -> bool:
        """Whether a process may hold several instances of every component."""
        used = [component.fmu.description.interfaces[component.kind] for component in self.components.values()]
        return all(not interface.once_per_process and not interface.needs_execution_tool for interface in used)

    def full_name(self, component: str, name: str) -> str:
        """Return a component variable's name in the system."""
        return f"{component}.{name}" if component else name

    def split(self, name: str) -> tuple[str, str]:
        """Return (component, inner name) of a variable's name in the system."""
        if not self.name_prefixed:
            return "", name
        if name in self.connectors:
            return self.split(self.connectors[name][0][0])
        known = [component for component in self.components if name.startswith(component + ".")]
        component = max(known, key=len, default=name.partition(".")[0])
        return component, name[len(component) + 1 :]

    def targets(self, name: str) -> tuple[Port, ...]:
        """Return the variables of a name, with factor and offset."""
        return self.connectors.get(name, ((name, 1.0, 0.0),))

    def terms(self, output: str) -> list[str]:
        """Return the summands of an output: ``machine.ia + fault.ia``."""
        return [output] if output in self.variables else [term.strip() for term in output.split(" + ")]

    def unit(self, name: str) -> str | None:
        """Return the unit of a variable or sum of variables."""
        found = self.variables.get(self.terms(name)[0])
        return found.unit if found else None

    def variable(self, name: str, role: str = "variable") -> Variable:
        """Return a variable by its name in the system; an `InputError` gives near names."""
        found = self.variables.get(name)
        if found is None:
            near = nearest(name, self.variables) or ". `fmuid info` lists all"
            raise InputError(f"{self.label}: no {role} {name!r}{near}.")
        return found

    def _connect(self, source: str, target: str, factor: float | None = None, offset: float = 0.0) -> Connection:
        output, input_ = (self.variable(end, "connected variable") for end in (source, target))
        for variable, causality in ((output, "output"), (input_, "input")):
            if variable.causality != causality:
                raise InputError(
                    f"connection {source} -> {target}: {variable.name!r} has causality {variable.causality!r}. "
                    "Connect an output to an input."
                )
        if output.type != input_.type or output.type not in ("Real", "Integer", "Boolean"):
            raise InputError(f"connection {source} -> {target}: {output.type} cannot feed {input_.type}.")
        ends = self.split(source), self.split(target)
        if factor is not None:
            return Connection(*ends, factor, offset)
        if not output.unit or not input_.unit or output.unit == input_.unit:
            return Connection(*ends)
        gives, takes = (self.components[component].fmu.description.units for component, _ in ends)
        conversion = unit_conversion(gives.get(output.unit), takes.get(input_.unit))
        if conversion is None:
            raise InputError(
                f"connection {source} -> {target}: units {output.unit} and {input_.unit} do not convert. "
                "Export models with units of one dimension."
            )
        return Connection(*ends, *conversion)

    def _check_connectors(self) -> None:
        for name, ports in self.connectors.items():
            if any(name == component or name.startswith(component + ".") for component in self.components):
                raise InputError(f"connector {name!r} is named like a component or its variable. Rename it.")
            behind = [self.variable(port, f"variable behind {name!r}") for port, _, _ in ports]
            for variable in behind:
                if variable.name in self.connected_inputs:
                    raise InputError(f"connector {name!r} sets {variable.name!r}, which a connection feeds. Keep one.")
                if variable.causality != behind[0].causality or variable.type != behind[0].type:
                    both = " and ".join(f"{v.name!r} ({v.causality}, {v.type})" for v in (behind[0], variable))
                    raise InputError(f"connector {name!r} joins {both}. Join variables of one kind.")
                if variable.causality == "output" and len(behind) > 1:
                    raise InputError(f"connector {name!r} joins several outputs. Write their sum in the outputs.")
