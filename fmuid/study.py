"""A study: model, experiments, parameters, noise and estimator, read from a TOML file.

`MODEL_KEYS` and its neighbours list the words of the file; `fmuid.study_file` checks that there are no others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fmuid import study_file as toml
from fmuid.errors import InputError
from fmuid.estimators.marquardt import Iteration, Marquardt
from fmuid.experiment import Experiment
from fmuid.identification import identify
from fmuid.noise import Noise
from fmuid.parameters import Normal, Parameter
from fmuid.problem import Problem
from fmuid.report import Fit, fit_of
from fmuid.result import Result
from fmuid.simulator import Simulator
from fmuid.study_file import Section
from fmuid.system import System

if TYPE_CHECKING:
    import pandas as pd

STUDY_KEYS = ("title", "model", "experiments", "parameters", "noise", "estimator")
MODEL_KEYS = ("fmu", "interface", "step_size", "values", "components", "connections")
EXPERIMENT_KEYS = ("table", "name", "time", "inputs", "outputs", "interpolation", "discard", "units")
PARAMETER_KEYS = ("start", "min", "max", "nominal", "prior", "per_experiment")
PRIOR_KEYS = ("mean", "std")
NOISE_KEYS = ("variance", "start")
ESTIMATOR_KEYS = ("method", "sensitivity", "max_iterations", "tolerance", "first_radius")


@dataclass(frozen=True)
class ModelSettings:
    """The table ``[model]``.

    Attributes
    ----------
    components : mapping of str to Path
        The FMU files; a single FMU is the component ``""``.
    connections : tuple of (str, str)
        (output, input), both as ``component.variable``.
    step_size : float or None
        The largest internal step (one FMU) or the communication step (several), s.
    values : mapping
        The FMU variables held at a value.
    """

    components: Mapping[str, Path]
    connections: tuple[tuple[str, str], ...] = ()
    step_size: float | None = None
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)


@dataclass(frozen=True)
class ExperimentSettings:
    """One entry of ``[[experiments]]``, with the words of `fmuid.Experiment`."""

    table: Path
    name: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    time: str = "time"
    interpolation: str | Mapping[str, str] = "linear"
    discard: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A study file, read and checked; nothing is loaded or simulated before a method asks for it.

    Attributes
    ----------
    path : Path
        The file.
    title : str
        What the file says it is about.
    model : ModelSettings
    experiments : tuple of ExperimentSettings
    parameters : dict of str to Parameter
        The parameters to identify.
    noise : Noise
    estimator : Marquardt
    """

    path: Path
    title: str
    model: ModelSettings
    experiments: tuple[ExperimentSettings, ...]
    parameters: Mapping[str, Parameter]
    noise: Noise
    estimator: Marquardt

    @classmethod
    def read(cls, path: str | Path, overrides: Sequence[str] = ()) -> Study:
        """Read a study file.

        Parameters
        ----------
        path : path-like
            The TOML file. Paths in it are relative to it.
        overrides : sequence of str
            Values to put in place of the file's, each as ``parameters.Rs.start=9`` (`fmuid.study_file.override`).

        Raises
        ------
        InputError
            If the file or a file it names is missing, or a key is unknown, missing or of the wrong kind.
        """
        path = Path(path)
        data = toml.read_toml(path)
        for setting in overrides:
            toml.override(data, setting, str(path))
        file = f"{path} with --set" if overrides else str(path)
        top = Section(file, toml.TOP, data, STUDY_KEYS)
        return cls(
            path,
            top.get("title", toml.text, ""),
            _read_model(top, path.parent),
            _read_experiments(top, path.parent),
            _read_parameters(top),
            _read_noise(top),
            _read_estimator(top),
        )

    @cached_property
    def system(self) -> System:
        """The model: its FMUs and their connections.

        Raises
        ------
        InputError
            If an FMU cannot be read, or a connection is wrong.
        """
        if "" in self.model.components:
            return System(self.model.components[""])
        return System(components=self.model.components, connections=self.model.connections)

    @cached_property
    def tables(self) -> tuple[Experiment, ...]:
        """The experiments with their tables.

        Raises
        ------
        InputError
            If a table cannot be read or has not what the study says.
        """
        return tuple(
            Experiment.read(
                given.table,
                given.inputs,
                given.outputs,
                time=given.time,
                interpolation=given.interpolation,
                discard=given.discard,
                units=given.units,
                name=given.name,
            )
            for given in self.experiments
        )

    def problem(self) -> Problem:
        """Return the least-squares problem of the study.

        Raises
        ------
        InputError
            If model, tables and parameters do not fit together, or there are no parameters.
        """
        if not self.parameters:
            raise InputError(
                f"{self.path}: no parameters: name at least one to identify under [parameters], "
                "such as R = { start = 4.0 }"
            )
        model = self.model
        return Problem(
            self.system,
            self.tables,
            self.parameters,
            noise=self.noise,
            values=model.values,
            step_size=model.step_size,
        )

    def identify(self, progress: Callable[[Iteration], None] | None = None) -> Result:
        """Identify the parameters.

        Parameters
        ----------
        progress : callable, optional
            Called with every iteration of the search.

        Raises
        ------
        InputError
            As `problem`, or if a parameter acts on no output.
        SimulationError
            If the simulation at the start fails.
        """
        return identify(self.problem(), self.estimator, progress)

    def simulators(self) -> tuple[Simulator, ...]:
        """Return the simulator of each experiment, as a function of the study's parameters in their order."""
        names, model = tuple(self.parameters), self.model
        return tuple(
            Simulator(self.system, table, names, values=model.values, step_size=model.step_size)
            for table in self.tables
        )

    def simulate(self) -> list[pd.DataFrame]:
        """Simulate every experiment at the parameters' starts.

        Returns
        -------
        list of DataFrame
            One per experiment: the column ``time`` (s) and one for each output, by its name in the FMU.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        return [fit.simulated_frame() for fit in self.fits()]

    def fits(self) -> tuple[Fit, ...]:
        """Simulate every experiment at the parameters' starts and set the measurements beside.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        starts = [parameter.start for parameter in self.parameters.values()]
        return tuple(fit_of(self.system, each.experiment, each(starts)) for each in self.simulators())


# --- reading the tables of the file -----------------------------------------------------


def _read_model(top: Section, folder: Path) -> ModelSettings:
    section = top.table("model", MODEL_KEYS)
    section.get("interface", toml.one_of("co-simulation", later=("model-exchange",)), "co-simulation")
    if "fmu" in section.data:
        if "components" in section.data or "connections" in section.data:
            raise section.error("has both 'fmu' (one FMU) and components or connections (several): keep one of the two")
        components = {"": _file(section, "fmu", "the path of the FMU", folder)}
    elif "components" in section.data:
        components = _read_components(section, folder)
    else:
        raise section.error("needs the key 'fmu', the path of the FMU, or [[model.components]] where there are several")
    return ModelSettings(
        components,
        tuple(
            (entry.need("from", toml.text, "an output"), entry.need("to", toml.text, "the input that it feeds"))
            for entry in section.tables("connections", ("from", "to"))
        ),
        section.get("step_size", toml.positive, None),
        section.get("values", toml.named(toml.scalar), {}),
    )


def _read_components(section: Section, folder: Path) -> dict[str, Path]:
    components: dict[str, Path] = {}
    for entry in section.tables("components", ("name", "fmu")):
        name = entry.need("name", toml.text, "what its variables are prefixed with")
        if name in components:
            raise entry.error(f"has the name {name!r} of an earlier component: give each its own")
        components[name] = _file(entry, "fmu", "the path of the FMU", folder)
    if not components:
        raise section.error("has no components: name them with [[model.components]]")
    return components


def _read_experiments(top: Section, folder: Path) -> tuple[ExperimentSettings, ...]:
    found: list[ExperimentSettings] = []
    for entry in top.tables("experiments", EXPERIMENT_KEYS):
        table = _file(entry, "table", "the file of measurements", folder)
        name = entry.get("name", toml.text, table.stem)
        if name in (earlier.name for earlier in found):
            raise entry.error(f'is called {name!r} like an earlier one: give it a name of its own, name = "..."')
        found.append(
            ExperimentSettings(
                table,
                name,
                entry.get("inputs", toml.columns, {}),
                entry.need("outputs", toml.columns, "the measured outputs, a list of names"),
                entry.get("time", toml.text, "time"),
                entry.get("interpolation", _interpolation, _interpolation("linear")),
                entry.get("discard", toml.not_negative, 0.0),
                entry.get("units", toml.named(toml.text), {}),
            )
        )
        if not found[-1].outputs:
            raise entry.error('has no outputs: name those that are measured, outputs = ["..."]')
    if not found:
        raise top.error("has no experiments: name at least one table with [[experiments]]")
    return tuple(found)


def _interpolation(value: object) -> str | Mapping[str, str]:
    kind = toml.one_of("linear", "hold")
    return toml.named(kind)(value) if isinstance(value, dict) else kind(value)


def _read_parameters(top: Section) -> dict[str, Parameter]:
    names = list(top.table("parameters", top.data.get("parameters", {})).data)
    section = top.table("parameters", names)
    return {name: _read_parameter(section.table(name, PARAMETER_KEYS)) for name in names}


def _read_parameter(section: Section) -> Parameter:
    prior = None
    if "prior" in section.data:
        table = section.table("prior", PRIOR_KEYS)
        prior = Normal(
            table.need("mean", toml.number, "its mean"), table.need("std", toml.positive, "its standard deviation")
        )
    words: dict[str, Any] = {
        "start": section.need("start", toml.number, "where the search begins"),
        "min": section.get("min", toml.number, -math.inf),
        "max": section.get("max", toml.number, math.inf),
        "nominal": section.get("nominal", toml.positive, None),
        "per_experiment": section.get("per_experiment", toml.flag, False),
    }
    try:
        return Parameter(**words, prior=prior)
    except InputError as error:  # a Parameter does not know what it is called
        raise InputError(f"{section.file}: {section.where}: {error}") from None


def _read_noise(top: Section) -> Noise:
    section = top.table("noise", NOISE_KEYS)
    return Noise(section.get("variance", _variance, "estimate"), section.get("start", _variances, None))


def _variances(value: object) -> float | Mapping[str, float]:
    return toml.named(toml.positive)(value) if isinstance(value, dict) else toml.positive(value)


def _variance(value: object) -> Literal["estimate"] | float | Mapping[str, float]:
    if value == "estimate":
        return "estimate"
    if isinstance(value, str):
        raise toml.MismatchError('"estimate", a number above 0 or a table { output = number }')
    return _variances(value)


def _read_estimator(top: Section) -> Marquardt:
    section = top.table("estimator", ESTIMATOR_KEYS)
    section.get("method", toml.one_of("marquardt", later=("global", "linear")), "marquardt")
    section.get("sensitivity", toml.one_of("finite-difference", later=("forward", "fmu")), "finite-difference")
    default = Marquardt()
    return Marquardt(
        section.get("max_iterations", toml.count, default.max_iterations),
        section.get("tolerance", toml.positive, default.tolerance),
        section.get("first_radius", toml.positive, default.first_radius),
    )


def _file(section: Section, key: str, meaning: str, folder: Path) -> Path:
    """Return the path of a file that must be there."""
    path = folder / section.need(key, toml.text, meaning)
    if not path.is_file():
        raise section.error(f"{key} = {toml.show(section.data[key])}: there is no file {path.resolve()}")
    return path
