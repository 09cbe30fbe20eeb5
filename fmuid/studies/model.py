"""The sections ``[model]`` and ``[[experiments]]`` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator

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
from fmuid.studies import value_kinds as kinds
from fmuid.studies.array_elements import by_element
from fmuid.studies.observation import ObservationSection
from fmuid.studies.operating_points import DataSection
from fmuid.studies.parameters import PriorSource, ResultValueSection
from fmuid.studies.section import SectionLocation, Settings, StudySection, entry

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.data import Experiment, Observation


@dataclass(frozen=True)
class ParsedModel:
    """Model of a study; the component ``""`` is a single FMU or ``.ssp``, `sources` are results with its values."""

    section: ModelSection
    components: Mapping[str, tuple[Path, Numerics]]
    values: Mapping[str, Value]
    sources: tuple[PriorSource, ...] = ()
    isolation: Isolation | None = None
    choices: Mapping[str, Sequence[Value] | str] = field(default_factory=dict)

    def choosing(self, choices: Mapping[str, Sequence[Value] | str]) -> ParsedModel:
        """Return the model with discrete parameters, held at their first listed value."""
        first = {name: values[0] for name, values in choices.items() if not isinstance(values, str)}
        return replace(self, values={**self.values, **first}, choices=choices)

    def system(self) -> System:
        """Return the FMUs and their connections."""
        numerics, coupling = self.section.numerics, self.section.coupling
        if "" not in self.components:
            return System(
                components={name: Component(path, each) for name, (path, each) in self.components.items()},
                connections=[each.connection for each in self.section.connections],
                numerics=numerics,
                master=coupling,
                connectors={
                    k: [(each, 1.0, 0.0) for each in some] for k, some in self.section.shared_variables.items()
                },
                isolation=self.isolation,
            )
        path, _ = self.components[""]
        if path.suffix.lower() == ".ssp":
            return System.read_ssp(path, numerics, coupling, self.isolation)
        return System(path, numerics=numerics, isolation=self.isolation)


# --- [model] ----------------------------------------------------------------------------


class SolverSection(StudySection):
    """Solver of an FMU."""

    interface: Annotated[str, kinds.one_of(KINDS)] | None = entry(
        None, 'FMI interface type; default: "co-simulation" if the FMU has it', "model-exchange"
    )
    solver: Annotated[str, kinds.one_of(INTEGRATORS)] | None = entry(
        None,
        f'"rk4" (fixed steps), "rk45" or "cvode"; default: "{DEFAULT_INTEGRATOR}", "cvode" for stiff models',
        "cvode",
    )
    tolerance: kinds.Share | None = entry(
        None, f"relative solver tolerance; default: {DEFAULT_TOLERANCE!r}, or that of the FMU", DEFAULT_TOLERANCE
    )
    step_size: kinds.Positive | None = entry(
        None, "largest communication step, s; default: the sampling interval", 1e-3
    )
    max_solver_steps: kinds.Count | None = entry(
        None, f'largest number of "rk45" and "cvode" steps between samples; default: {MOST_STEPS}', 10_000
    )

    @property
    def numerics(self) -> Numerics:
        """Numerics of the FMU."""
        return Numerics(self.interface, self.solver, self.tolerance, self.step_size, most_steps=self.max_solver_steps)


class ComponentSection(SolverSection):
    """One of several coupled FMUs."""

    name: kinds.Text = entry(..., "prefix of its variables")
    fmu: kinds.File = entry(..., "the FMU")
    discrete_time: kinds.Flag | None = entry(
        None,
        "acts once per communication step, like a sampled controller; default: true without continuous states",
        True,
    )

    @property
    def numerics(self) -> Numerics:
        """Numerics of the component."""
        return replace(super().numerics, samples=self.discrete_time)


class ConnectionSection(StudySection):
    """Connection from an output to an input."""

    source: kinds.Text = entry(..., "output", alias="from")
    target: kinds.Text = entry(..., "input", alias="to")
    factor: kinds.Number = entry(1.0, "gain of the connection")
    offset: kinds.Number = entry(0.0, "offset after the gain")

    @property
    def connection(self) -> tuple[str, str] | tuple[str, str, float, float]:
        """Connection for `fmuid.System`."""
        if self.model_fields_set <= {"source", "target"}:
            return self.source, self.target
        return self.source, self.target, self.factor, self.offset


OneOrMore = Annotated[kinds.Names, BeforeValidator(kinds.as_list, json_schema_input_type=str | list[str])]


ScalarOrEstimate = Annotated[kinds.Scalar | ResultValueSection, kinds.BY_SHAPE]
Held = Annotated[
    dict[str, ScalarOrEstimate],
    kinds.Entries("{ name = value }"),
    BeforeValidator(by_element, json_schema_input_type=dict[str, ScalarOrEstimate | list[Any]]),
]


class ModelSection(SolverSection):
    """Model: one FMU, or several coupled ones."""

    fmu: kinds.File | None = entry(None, "the FMU, or an SSP package, .ssp")
    coupling: Annotated[str, kinds.one_of(MASTERS)] = entry("jacobi", "order of several FMUs in a step")
    fixed: Held = entry({}, 'FMU variables with a value, an array, or an estimate, { result = "drive/result.json" }')
    components: list[ComponentSection] = entry([], "several FMUs, instead of fmu; variables are component.variable")
    connections: list[ConnectionSection] = entry([], "connections of components")
    shared_variables: Annotated[dict[str, OneOrMore], kinds.Entries("{ name = variables }")] = entry(
        {}, "name of the system = variables that share its value"
    )

    def settings(self) -> ParsedModel:
        """Return the model."""
        return ParsedModel(self, self._components(), *self.held())

    def held(self) -> tuple[dict[str, Value], tuple[PriorSource, ...]]:
        """Return fixed variables, and the results that values are taken from."""
        values: dict[str, Value] = {}
        sources: dict[Path, PriorSource] = {}
        for name, given in self.fixed.items():
            if isinstance(given, ResultValueSection):
                path = given.result
                with given.place.located():
                    earlier = sources.get(path) or PriorSource(str(self.place), path, Result.from_json(path), ())
                values[name] = given.value(name, earlier.result)
                sources[path] = replace(earlier, names=(*earlier.names, name))
            else:
                values[name] = given
        return values, tuple(sources.values())

    def _components(self) -> dict[str, tuple[Path, Numerics]]:
        if self.fmu is not None:
            for key in ("components", "connections", "shared_variables"):
                if key in self.model_fields_set:
                    raise self.error("cannot be combined with fmu. Keep one of the two.", key)
            return {"": (self.fmu, self.numerics)}
        if "components" not in self.model_fields_set:
            raise self.error("missing key 'fmu'. For several FMUs, add sections [[model.components]].")
        if not self.components:
            raise self.error("no components. Add sections [[model.components]].")
        found: dict[str, tuple[Path, Numerics]] = {}
        for each in self.components:
            if each.name in found:
                raise each.error(f"{each.name!r} is also the name of an earlier component.", "name")
            found[each.name] = each.fmu, each.numerics
        return found


# --- [[experiments]] --------------------------------------------------------------------


@dataclass(frozen=True)
class PreprocessSection(Preprocessing):
    """Preprocessing, in this order."""

    segments: kinds.Segments = field(default_factory=list)
    """segments instead of start_time and end_time, each an experiment"""

    def split(self) -> list[PreprocessSection]:
        """Return the preprocessing of each segment."""
        for key in ("start_time", "end_time") if self.segments else ():
            if getattr(self, key) is not None:
                raise InputError(f"segments and {key} cannot be combined. Keep one of the two.")
        if not self.segments:
            return [self]
        return [replace(self, segments=[], start_time=begin, end_time=end) for begin, end in self.segments]


Interpolation = Annotated[str, kinds.one_of(INTERPOLATIONS)]
Interpolations = Annotated[dict[str, Interpolation], kinds.Entries("{ input = interpolation }")]


class ExperimentSettings(DataSection):
    """Experiment: a data file with the roles of its columns."""

    name: kinds.Text = entry("", "name in messages and figures; default: the file name without suffix")
    inputs: kinds.Columns = entry({}, "measured inputs of the FMU")
    outputs: kinds.Columns = entry({}, "measured outputs of the FMU; those of an observation are its sensors")
    interpolation: Annotated[Interpolation | Interpolations, kinds.BY_SHAPE] = entry(
        "linear", "of inputs between samples", "linear"
    )
    warmup: kinds.NotNegative = entry(0.0, "initial time that is simulated but not scored, s", 0.0)
    fixed: Annotated[
        kinds.Scalars, BeforeValidator(by_element, json_schema_input_type=dict[str, kinds.Scalar | list[Any]])
    ] = entry({}, "FMU variables with a value or an array, in this experiment")
    noise: Annotated[Noise, Settings()] = entry(Noise(), "noise that differs from [noise]")
    preprocess: Annotated[PreprocessSection, Settings()] = entry(
        PreprocessSection(), "operations on the data before the fit"
    )
    units: kinds.Texts = entry({}, "units of columns, { variable = unit }; default: that of the file or the FMU")
    observation: ObservationSection | None = entry(None, "phase signals of a machine in rotating axes")

    @cached_property
    def observed(self) -> Observation | None:
        """Map of phase signals."""
        return None if self.observation is None else self.observation.observation

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs: variables of the FMU, and sensors."""
        if self.observed is None:
            return (*self.outputs, *self.response_columns)
        others = (name for name in self.outputs if name not in self.observed.currents)
        return (*others, *self.observed.current_sensors)

    @property
    def columns(self) -> list[str]:
        """Columns of inputs, outputs and phase signals."""
        found = [*self.inputs.values(), *self.outputs.values(), *self.response_columns.values()]
        if self.observed is not None:
            axes = (*self.observed.currents, *self.observed.voltages) if self.observed.source == "dq" else ()
            found += [*self.observed.columns, *(name for name in axes if name not in self.inputs | self.outputs)]
        return list(dict.fromkeys(found))

    def read_experiment(self, table: Path, source: str | None = None, *, measured: bool = True) -> Experiment:
        """Read a data file as an experiment."""
        source = source or str(table)
        return self.experiment(self.read_frame(table, source), source, measured=measured)

    def read_frame(self, table: Path, source: str | None = None) -> pd.DataFrame:
        """Read a data file before ``[experiments.preprocess]``."""
        from fmuid.data import in_time_of_model, read_data

        how = {key: getattr(self, key) for key in ("time_unit", "sample_rate", "sheet", "missing", "clocks")}
        frame = read_data(table, self.time if self.in_time else None, **how, source=source or str(table))
        return in_time_of_model(frame, self.time, self.model_time_unit) if self.in_time else frame

    def experiment(self, frame: pd.DataFrame, source: str, *, measured: bool = True) -> Experiment:
        """Return the experiment of a frame; outputs that are not `measured` need no column."""
        from fmuid.data import ROW, Experiment, time_name, with_rows

        other: dict[str, Any] = {name: getattr(self, name) for name in ("inputs", "outputs", "units", "name")}
        other |= {"values": self.fixed, "measured": measured, "source": source}
        if not self.in_time:
            rows = self.preprocess.applied(with_rows(frame), ROW, source, self.columns)
            return self.experiment_of_rows(rows, other)
        time = time_name(self.time)
        given = self.interpolation
        words = given if isinstance(given, dict) else dict.fromkeys(self.inputs, given)
        between = {column: words.get(name, "linear") for name, column in self.inputs.items()}
        frame = self.preprocess.applied(frame, time, source, self.columns, between)
        other |= {"observation": self.observed, "warmup": self.warmup}
        return Experiment(frame, time=time, interpolation=given, **other)


def named(experiments: Sequence[ExperimentSettings], top: SectionLocation) -> tuple[ExperimentSettings, ...]:
    """Return the experiments and segments, each with its own name."""
    found: dict[str, ExperimentSettings] = {}
    for each in experiments:
        name = each.name or each.data.stem
        each.check_keys(each.preprocess.by_rows)
        if not each.output_names:
            wanted = "responses.<name>" if each.kind == "frequency" else 'outputs = ["..."]'
            raise each.error(f"no outputs. Name the measured ones, {wanted}.")
        for output, column in each.outputs.items():
            if column in each.preprocess.fill_missing:
                text = f"{column!r} is the output {output!r}. Remove it: missing samples of outputs are ignored."
                raise each.error(text, "preprocess", "fill_missing")
        with each.place.below("preprocess").located():
            segments = each.preprocess.split()
        for k, segment in enumerate(segments, start=1):
            called = f"{name} {k}" if len(segments) > 1 else name
            if called in found:
                raise each.error(f"{called!r} is also the name of an earlier experiment. Set another name.")
            found[called] = each.model_copy(update={"name": called, "preprocess": segment})
    if not found:
        raise top.error("no experiments. Add a section [[experiments]].")
    return tuple(found.values())
