"""The table ``[diagnosis]`` of a study file: the healthy machine and the faults to look for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmuid.data import Experiment, Noise, Parameter
from fmuid.diagnosis import LEVEL, Angle, Diagnosis, Fault, diagnose
from fmuid.errors import InputError
from fmuid.estimation import Marquardt, Result
from fmuid.models import System
from fmuid.studies import toml as toml
from fmuid.studies.parameters import Knowns, Source
from fmuid.studies.settings import MODEL_KEYS, ModelSettings, existing_file, model_of
from fmuid.studies.toml import Section

DIAGNOSIS_KEYS = ("healthy", "inflate", "level", "faults")
FAULT_KEYS = ("parameters", "angle", "names", "inputs")
FAULT_PARAMETER_KEYS, ANGLE_KEYS = ("start", "nominal", "min", "max"), ("size", "period")


@dataclass(frozen=True, eq=False)
class FaultSettings:
    """A table ``[diagnosis.faults.<name>]``.

    Attributes
    ----------
    where : str
        The study file and the table, for messages.
    model : ModelSettings or None
        None for the study's own.
    values : mapping
        Variables held at a value, beside those of the study's own model where it is that.
    parameters : dict of str to Parameter
    angles : mapping of str to Angle, or tuple of str
    names : dict of str to str
    inputs : dict of str to str
        Inputs that only this model has, and their columns.
    """

    where: str
    model: ModelSettings | None
    values: Mapping[str, float | int | bool | str]
    parameters: Mapping[str, Parameter]
    angles: Mapping[str, Angle] | Sequence[str]
    names: Mapping[str, str]
    inputs: Mapping[str, str]

    def fault(self, system: System, model: ModelSettings) -> Fault:
        """Return the fault; `system` and `model` are the study's own.

        Raises
        ------
        InputError
            If its FMUs cannot be read or its parameters are no fault's.
        """
        own = self.model is not None
        values = self.values if own else {**model.values, **self.values}
        for name in self.parameters:
            if not own and name not in system.variables:
                raise InputError(
                    f"{self.where}: the study's own model, {system.label}, has no {name!r}, and the fault no model of "
                    "its own: give it, as fmu or as components"
                )
        try:
            return Fault(
                replace(self.model, isolation=model.isolation).system() if self.model is not None else system,
                self.parameters,
                self.names,
                self.angles,
                values,
                self.inputs,
            )
        except InputError as error:
            raise InputError(f"{self.where}: {error}") from None


@dataclass(frozen=True, eq=False)
class DiagnosisSettings:
    """The table ``[diagnosis]``.

    Attributes
    ----------
    source : Source
        The healthy result and where it comes from.
    inflate : float or mapping of str to float
        Factor on its standard deviations.
    level : float
    faults : mapping of str to FaultSettings
    """

    source: Source
    inflate: float | Mapping[str, float]
    level: float
    faults: Mapping[str, FaultSettings]

    def diagnose(
        self,
        experiments: Sequence[Experiment],
        system: System,
        model: ModelSettings,
        parameters: Mapping[str, Parameter],
        *,
        noise: Noise,
        settings: Marquardt,
        sensitivity: str,
        progress: Callable[[str], None] | None = None,
    ) -> Diagnosis:
        """Look for the faults in experiments, with the study's own model and the words of its other tables.

        Raises
        ------
        InputError
            If the models, the healthy result and the tables do not fit together.
        SimulationError
            If the simulation fails at the healthy estimate.
        """
        hypotheses = {name: each.fault(system, model) for name, each in self.faults.items()}
        try:
            return diagnose(
                experiments,
                self.source.result,
                hypotheses,
                nominal_model=system,
                inflate=self.inflate,
                level=self.level,
                noise_variance=None if isinstance(noise.variance, str) else noise.variance,
                parameters=parameters,
                values=model.values,
                settings=settings,
                sensitivity=sensitivity,
                progress=progress,
            )
        except InputError as error:
            raise InputError(f"{self.source.where}: {error}") from None


def read_diagnosis(top: Section, folder: Path, model: ModelSettings, loss: str, known: Knowns) -> DiagnosisSettings:
    """Read the table ``[diagnosis]``.

    Parameters
    ----------
    top : Section
        The study file.
    folder : Path
        Paths are relative to it.
    model : ModelSettings
        Of the study.
    loss : str
    known : Knowns
        The study's parameters.

    Raises
    ------
    InputError
        If a key is unknown, missing or of the wrong kind, there is no fault to look for, or another word of the study
        does not go with a diagnosis.
    """
    section = top.table("diagnosis", DIAGNOSIS_KEYS)
    for word, there in (("[prior]", known.joint_prior is not None), (f'loss = "{loss}"', loss != "linear")):
        if there:
            raise section.error(f"does not go with {word} in this version: remove one of the two")
    path = existing_file(section, "healthy", "the result.json of an identification of the healthy machine", folder)
    try:
        result = Result.from_json(path)
    except InputError as error:
        raise section.error(f"healthy: {error}") from None
    listed = list(section.table("faults", section.data.get("faults", {})).data)
    if not listed:
        raise section.error("has no faults: describe at least one as [diagnosis.faults.<name>]")
    faults = section.table("faults", listed)
    inflate: float | Mapping[str, float] = section.get("inflate", _inflate, 1.0)
    names = tuple(name for name in result.names if not name.endswith("]") and name not in model.values)
    return DiagnosisSettings(
        Source(f"{section.file}: {section.where}", path, result, names),
        inflate,
        section.get("level", toml.share, LEVEL),
        {name: _fault(faults.table(name, (*MODEL_KEYS, *FAULT_KEYS)), folder) for name in listed},
    )


def _factor(value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and value > 0:
        return float(value)
    raise toml.MismatchError("a number above 0, inf for no prior")


def _inflate(value: object) -> Any:
    return toml.named(_factor)(value) if isinstance(value, dict) else _factor(value)


def _fault(section: Section, folder: Path) -> FaultSettings:
    own = {"fmu", "components"} & set(section.data)
    model = model_of(section, folder) if own else None
    for key in MODEL_KEYS:
        if not own and key in section.data and key != "values":
            raise section.error(f"has {key} and no model: give fmu or components, or leave {key} out")
    if not section.data.get("parameters"):
        raise section.error(
            "has no parameters: name those of the fault, zero without it, as in parameters = { dR = { nominal = 1.0 } }"
        )
    listed = section.table("parameters", section.data["parameters"])
    angles = _angles(section)
    parameters = {
        name: _parameter(listed.table(name, FAULT_PARAMETER_KEYS), 1.0 if name in angles else None)
        for name in listed.data
    }
    return FaultSettings(
        f"{section.file}: {section.where}",
        model if model is None else replace(model, values={}),
        section.get("values", toml.named(toml.scalar), {}),
        parameters,
        angles,
        section.get("names", toml.named(toml.text), {}),
        section.get("inputs", toml.columns, {}),
    )


def _parameter(section: Section, nominal: float | None) -> Parameter:
    """Read a parameter of a fault, which starts at zero; angles have a nominal without giving one."""
    try:
        return Parameter(
            section.get("start", toml.number, 0.0),
            section.get("min", toml.number, -math.inf),
            section.get("max", toml.number, math.inf),
            section.get("nominal", toml.positive, nominal),
        )
    except InputError as error:
        raise section.error(f"is refused: {error}") from None


def _angles(section: Section) -> Mapping[str, Angle] | Sequence[str]:
    given: Any = section.data.get("angle", [])
    if not isinstance(given, dict):
        listed: list[str] = section.get("angle", toml.names, [])
        return listed
    table = section.table("angle", given)
    found = {}
    for name in given:
        words = table.table(name, ANGLE_KEYS)
        size = words.need("size", toml.text, "the parameter that is the size of this fault")
        found[name] = Angle(size, words.get("period", toml.positive, 2.0 * math.pi))
    return found
