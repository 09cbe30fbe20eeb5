"""The tables ``[model]`` and ``[[experiments]]`` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import BeforeValidator, Tag

from fmuid.data import INTERPOLATIONS, Noise, Preprocessing
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.models import (
    DEFAULT_INTEGRATOR,
    DEFAULT_TOLERANCE,
    INTEGRATORS,
    KINDS,
    MASTERS,
    Component,
    Isolation,
    Numerics,
    System,
)
from fmuid.simulation import MOST_STEPS, Value
from fmuid.studies.arrays import by_element
from fmuid.studies.parameters import PriorSource, ResultValueSection
from fmuid.studies.section import SectionLocation, Settings, StudySection, word
from fmuid.studies.value_kinds import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Columns,
    Count,
    Entries,
    File,
    Flag,
    NameOrPlace,
    Names,
    NotNegative,
    Number,
    Positive,
    Scalar,
    Scalars,
    Segments,
    Share,
    Text,
    Texts,
    as_list,
    one_of,
)
from fmuid.units import TIME_UNITS

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.data import Experiment


@dataclass(frozen=True)
class ParsedModel:
    """The table ``[model]``.

    Attributes
    ----------
    components : mapping of str to (Path, Numerics)
        The FMU files and how they are run; a single FMU, or a whole ``.ssp``, is the component ``""``.
    connections : tuple of tuples
        (output, input), both as ``component.variable``, or (output, input, factor, offset).
    numerics : Numerics
        How components run that do not say it themselves.
    master : "jacobi" or "gauss-seidel"
    values : mapping
        The FMU variables held at a value.
    connectors : mapping of str to tuple of str
        Names of the system's own, and the variables that each of them sets.
    isolation : Isolation or None
        How the FMUs run in a process of their own; None: in this one.
    sources : tuple of PriorSource
        The earlier results that values are taken from.
    choices : mapping of str to sequence of values, or to "all"
        The parameters that take few values, of which each combination is tried.
    """

    components: Mapping[str, tuple[Path, Numerics]]
    connections: tuple[tuple[str, str] | tuple[str, str, float, float], ...] = ()
    numerics: Numerics = field(default_factory=Numerics)
    master: str = "jacobi"
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    connectors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    isolation: Isolation | None = None
    sources: tuple[PriorSource, ...] = ()
    choices: Mapping[str, Sequence[Value] | str] = field(default_factory=dict)

    def choosing(self, choices: Mapping[str, Sequence[Value] | str]) -> ParsedModel:
        """Return the model with parameters that take few values, held at the first where these are listed."""
        first = {name: values[0] for name, values in choices.items() if not isinstance(values, str)}
        return replace(self, values={**self.values, **first}, choices=choices)

    def system(self) -> System:
        """Return the model: its FMUs and their connections.

        Raises
        ------
        InputError
            If an FMU or SSP cannot be read, or a connection is wrong.
        """
        if "" not in self.components:
            components = {name: Component(path, numerics) for name, (path, numerics) in self.components.items()}
            return System(
                components=components,
                connections=self.connections,
                numerics=self.numerics,
                master=self.master,
                connectors={name: [(each, 1.0, 0.0) for each in some] for name, some in self.connectors.items()},
                isolation=self.isolation,
            )
        path, _ = self.components[""]
        if path.suffix.lower() == ".ssp":
            return System.read_ssp(path, self.numerics, self.master, self.isolation)
        return System(path, numerics=self.numerics, isolation=self.isolation)


# --- [model] ----------------------------------------------------------------------------


class NumericsSection(StudySection):
    """How an FMU is run."""

    interface: Annotated[str, one_of(KINDS)] | None = word(
        None,
        'which of its two; default: "co-simulation" where the FMU offers it, with the solver inside the FMU',
        "model-exchange",
    )
    solver: Annotated[str, one_of(INTEGRATORS)] | None = word(
        None,
        f'of model exchange: "rk4" (fixed steps), "rk45" or "cvode" (stiff models); default: "{DEFAULT_INTEGRATOR}", '
        'and "cvode" once that finds the model stiff',
        "cvode",
    )
    tolerance: Share | None = word(
        None,
        f"relative; default: {DEFAULT_TOLERANCE!r}, or what the FMU has inside",
        DEFAULT_TOLERANCE,
    )
    step_size: Positive | None = word(None, "largest step, s; default: from sample to sample", 1e-3)
    max_solver_steps: Count | None = word(
        None,
        'of "rk45" and "cvode" between two samples: a simulation that needs more fails, and a search goes another way; '
        f"default: {MOST_STEPS}",
        10_000,
    )

    @property
    def numerics(self) -> Numerics:
        """The words as an object."""
        return Numerics(self.interface, self.solver, self.tolerance, self.step_size, most_steps=self.max_solver_steps)


class ComponentSection(NumericsSection):
    """One of several FMUs."""

    name: Text = word(..., "what its variables are prefixed with")
    fmu: File = word(..., "the path of the FMU")
    discrete_time: Flag | None = word(
        None,
        "whether it acts once a communication step, as a sampled controller does: finer simulations leave its steps as "
        "they are; default: an FMU without continuous states does, of others it is not known",
        True,
    )

    @property
    def numerics(self) -> Numerics:
        """The words as an object."""
        return replace(super().numerics, samples=self.discrete_time)


class ConnectionSection(StudySection):
    """An output that feeds an input."""

    source: Text = word(..., "an output", alias="from")
    target: Text = word(..., "the input that it feeds", alias="to")
    factor: Number = word(1.0, "what the output is multiplied by")
    offset: Number = word(0.0, "what is added then")

    @property
    def connection(self) -> tuple[str, str] | tuple[str, str, float, float]:
        """The words as `fmuid.System` takes them."""
        if self.model_fields_set <= {"source", "target"}:
            return self.source, self.target
        return self.source, self.target, self.factor, self.offset


OneOrMore = Annotated[Names, BeforeValidator(as_list, json_schema_input_type=str | list[str])]


ScalarOrEstimate = Annotated[
    Annotated[Scalar, Tag(VALUE_TAG)] | Annotated[ResultValueSection, Tag(TABLE_TAG)], BY_SHAPE
]
Values = Annotated[Scalars, BeforeValidator(by_element)]
Held = Annotated[dict[str, ScalarOrEstimate], Entries("a table { name = value }"), BeforeValidator(by_element)]


class ModelSection(NumericsSection):
    """The model: one FMU, or several coupled ones."""

    fmu: File | None = word(None, "the path of the FMU, or of a system, .ssp")
    coupling: Annotated[str, one_of(MASTERS)] = word("jacobi", "in which order several FMUs step")
    fixed: Held = word(
        {}, 'FMU variables held at a value, or at rows of them, or at an estimate, { result = "drive/result.json" }'
    )
    components: list[ComponentSection] = word(
        [], "several FMUs in place of fmu; their variables are component.variable"
    )
    connections: list[ConnectionSection] = word([], "what feeds what")
    shared_variables: Annotated[dict[str, OneOrMore], Entries("a table { name = variables }")] = word(
        {}, "names of the system's own, and the variables that each of them sets"
    )

    def settings(self) -> ParsedModel:
        """Return the model that the words describe.

        Raises
        ------
        InputError
            If it has no FMU, or words for one FMU and for several, or a result has no such estimate.
        """
        values, sources = self.held()
        return ParsedModel(
            self._components(),
            tuple(each.connection for each in self.connections),
            self.numerics,
            self.coupling,
            values,
            {name: tuple(some) for name, some in self.shared_variables.items()},
            sources=sources,
        )

    def held(self) -> tuple[dict[str, Value], tuple[PriorSource, ...]]:
        """Return the variables held at a value, and the results that values are taken from.

        Raises
        ------
        InputError
            If a result cannot be read, or has no such estimate.
        """
        results: dict[Path, Result] = {}
        values: dict[str, Value] = {}
        taken: dict[Path, list[str]] = {}
        for name, given in self.fixed.items():
            if isinstance(given, ResultValueSection):
                path = given.result
                try:
                    result = results.setdefault(path, results.get(path) or Result.from_json(path))
                except InputError as error:
                    raise InputError(f"{given.place}: {error}") from None
                values[name] = given.value(name, result)
                taken.setdefault(path, []).append(name)
            else:
                values[name] = given
        sources = (PriorSource(str(self.place), path, results[path], tuple(names)) for path, names in taken.items())
        return values, tuple(sources)

    def _components(self) -> dict[str, tuple[Path, Numerics]]:
        if self.fmu is not None:
            for key in ("components", "connections", "shared_variables"):
                if key in self.model_fields_set:
                    raise self.error(f"has both 'fmu' (one FMU) and {key} (of several): keep one of the two")
            return {"": (self.fmu, self.numerics)}
        if "components" not in self.model_fields_set:
            raise self.error(
                "needs the key 'fmu', the path of the FMU, or [[model.components]] where there are several"
            )
        if not self.components:
            raise self.error("has no components: name them with [[model.components]]")
        found: dict[str, tuple[Path, Numerics]] = {}
        for each in self.components:
            if each.name in found:
                raise each.error(f"has the name {each.name!r} of an earlier component: give each its own")
            found[each.name] = each.fmu, each.numerics
        return found


# --- [[experiments]] --------------------------------------------------------------------


@dataclass(frozen=True)
class PreprocessSection(Preprocessing):
    """What is done with the data first, in this order."""

    segments: Segments = field(default_factory=list)
    """in place of start_time and end_time: several segments, each an experiment of its own"""

    def split(self) -> list[PreprocessSection]:
        """Return what is done with the data of each segment.

        Raises
        ------
        InputError
            If there are both segments and one cut.
        """
        for key in ("start_time", "end_time") if self.segments else ():
            if getattr(self, key) is not None:
                raise InputError(f"has both segments and {key}: keep one of the two")
        if not self.segments:
            return [self]
        return [replace(self, segments=[], start_time=begin, end_time=end) for begin, end in self.segments]


Interpolation = Annotated[str, one_of(INTERPOLATIONS)]
Interpolations = Annotated[dict[str, Interpolation], Entries("a table { input = interpolation }")]


class ExperimentSettings(StudySection):
    """A table of measurements, with the words of `fmuid.Experiment`; as many as there are."""

    data: File = word(..., "the file of measurements")
    name: Text = word("", "what messages and figures call it; default: the file's name without suffix")
    time: NameOrPlace = word("time", "the column of time, by its name or its place from 1")
    time_unit: Annotated[str, one_of(TIME_UNITS)] | None = word(
        None, "unit of the time column; default: what the file says, else s"
    )
    sample_rate: Positive | None = word(None, "samples per second, of a table without times")
    sheet: NameOrPlace | None = word(None, "of a spreadsheet, by name or place from 1; default: the first with a table")
    inputs: Columns = word({}, "variables of the FMU that columns drive")
    outputs: Columns = word(..., "the measured outputs, a list of names")
    interpolation: Annotated[
        Annotated[Interpolation, Tag(VALUE_TAG)] | Annotated[Interpolations, Tag(TABLE_TAG)], BY_SHAPE
    ] = word("linear", 'between samples; "zoh" for commands of a digital controller', "linear")
    warmup: NotNegative = word(0.0, "s of transient at the beginning, simulated but not counted", 0.0)
    fixed: Annotated[Scalars, BeforeValidator(by_element)] = word(
        {}, "FMU variables held at a value, or at rows of them, in this experiment"
    )
    noise: Annotated[Noise, Settings()] = word(Noise(), "of this experiment, where it is not as [noise] says")
    preprocess: Annotated[PreprocessSection, Settings()] = word(PreprocessSection(), "what is done with the data first")
    units: Texts = word(
        {}, "of columns whose unit the table does not say and that are not in the FMU's: { variable = unit }"
    )

    def read_experiment(self, table: Path, source: str | None = None, *, measured: bool = True) -> Experiment:
        """Read a table and return the experiment that it is; arguments and errors as those of `experiment`."""
        source = source or str(table)
        return self.experiment(self.read_frame(table, source), source, measured=measured)

    def read_frame(self, table: Path, source: str | None = None) -> pd.DataFrame:
        """Read a table as it is before ``[experiments.preprocess]``; messages call it `source`.

        Raises
        ------
        InputError
            If it cannot be read.
        """
        from fmuid.data import read_data

        how = {key: getattr(self, key) for key in ("time_unit", "sample_rate", "sheet")}
        return read_data(table, self.time, **how, source=source or str(table))

    def experiment(self, frame: pd.DataFrame, source: str, *, measured: bool = True) -> Experiment:
        """Return the experiment that a table is with these words; messages call the table `source`.

        Outputs that are not `measured` need no column.

        Raises
        ------
        InputError
            If the table lacks what the words name.
        """
        from fmuid.data import Experiment, time_name

        time, columns = time_name(self.time), self.inputs | self.outputs
        given = self.interpolation
        words = given if isinstance(given, dict) else dict.fromkeys(self.inputs, given)
        between = {column: words.get(name, "linear") for name, column in self.inputs.items()}
        frame = self.preprocess.applied(frame, time, source, columns.values(), between)
        other = {name: getattr(self, name) for name in ("interpolation", "units", "name")}
        other |= {"discard": self.warmup, "values": self.fixed}
        return Experiment(frame, self.inputs, self.outputs, time, **other, measured=measured, source=source)


def named(experiments: Sequence[ExperimentSettings], top: SectionLocation) -> tuple[ExperimentSettings, ...]:
    """Return the experiments, each with its name.

    Raises
    ------
    InputError
        If there are none, one has no outputs, or two are of one name.
    """
    found: dict[str, ExperimentSettings] = {}
    for each in experiments:
        name = each.name or each.data.stem
        if not each.outputs:
            raise each.error('has no outputs: name those that are measured, outputs = ["..."]')
        for output, column in each.outputs.items():
            if column in each.preprocess.fill_missing:
                raise each.place.below("preprocess").error(
                    f"fills {column!r}, what was measured of the output {output!r}: leave it out of fill_missing, "
                    "missing samples of an output do not count"
                )
        try:
            segments = each.preprocess.split()
        except InputError as error:
            raise each.place.below("preprocess").error(str(error)) from None
        for k, segment in enumerate(segments, start=1):
            called = f"{name} {k}" if len(segments) > 1 else name
            if called in found:
                raise each.error(f'is called {called!r} like an earlier one: give it a name of its own, name = "..."')
            found[called] = each.model_copy(update={"name": called, "preprocess": segment})
    if not found:
        raise top.error("has no experiments: name at least one table with [[experiments]]")
    return tuple(found.values())
