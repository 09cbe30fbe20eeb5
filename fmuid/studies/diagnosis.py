"""The table ``[diagnosis]`` of a study file: the healthy machine and the faults to look for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Tag

from fmuid.data import Experiment, Noise, Parameter
from fmuid.diagnosis import MODEL_ERROR, Causes, FaultAngle, Rule
from fmuid.errors import InputError
from fmuid.estimation import Marquardt, Result
from fmuid.files import is_file
from fmuid.formatting import of_one_experiment
from fmuid.models import System
from fmuid.studies.arrays import by_element, check_shapes
from fmuid.studies.model import ModelSection, ParsedModel
from fmuid.studies.parameters import ParsedParameters, PriorSource
from fmuid.studies.section import Settings, StudySection, word
from fmuid.studies.value_kinds import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Columns,
    Entries,
    File,
    Files,
    Names,
    NotNegative,
    Number,
    Positive,
    Share,
    Texts,
    ValueKind,
    must_be,
)

if TYPE_CHECKING:
    from fmuid.diagnosis import Baseline, DiagnosisSettings, Fault

BASELINE_FILE = "baseline.npz"
"""Beside the ``result.json`` of a healthy study with faults: what its tables show."""

RULE = Rule()
"""What is not said of a test."""


def _factor(value: float) -> float:
    if not value > 0:
        raise must_be(FACTOR)
    return value


FACTOR = "a number above 0, inf for no prior"
Factor = Annotated[float, AfterValidator(_factor), ValueKind(FACTOR)]
Factors = Annotated[dict[str, Factor], Entries("a table { parameter = number }")]


class FaultParameterSection(StudySection):
    """A parameter of a fault."""

    nominal: Positive | None = word(None, "size that is worth naming; of an angle not needed")
    min: Number = word(-math.inf, "lower bound")
    max: Number = word(math.inf, "upper bound")

    def parameter(self, *, is_angle: bool) -> Parameter:
        """Return the parameter; angles have a nominal without giving one.

        Raises
        ------
        InputError
            If its numbers do not fit together.
        """
        try:
            return Parameter(0.0, self.min, self.max, self.nominal or (1.0 if is_angle else None))
        except InputError as error:
            raise self.error(f"is refused: {error}") from None


Angles = Annotated[dict[str, Annotated[FaultAngle, Settings()]], Tag(TABLE_TAG)]


class FaultSection(ModelSection):
    """A fault to look for: a model of it, or parameters of the study's own model."""

    parameters: Annotated[dict[str, FaultParameterSection], BeforeValidator(by_element)] = word(
        {}, "those of the fault, zero where it is not there"
    )
    angles: Annotated[Annotated[Names, Tag(VALUE_TAG)] | Angles, BY_SHAPE] = word(
        [], 'the parameters that are angles, ["theta0"]; or each with the size that it belongs to'
    )
    variable_map: Texts = word({}, "what the study calls a variable, and what this model calls it")
    inputs: Columns = word({}, "inputs that only this model has")

    def fault(self) -> ParsedFault:
        """Return the fault that the words describe.

        Raises
        ------
        InputError
            If it has no parameters, or words on a model and no model.
        """
        own = bool({"fmu", "components"} & self.model_fields_set)
        for key in ModelSection.model_fields:
            if not own and key in self.model_fields_set and key != "fixed":
                raise self.error(f"has {key} and no model: give fmu or components, or leave {key} out")
        if not self.parameters:
            raise self.error(
                "has no parameters: name those of the fault, zero without it, as in "
                "parameters = { dR = { nominal = 1.0 } }"
            )
        return ParsedFault(
            str(self.place),
            replace(self.settings(), values={}, sources=()) if own else None,
            self.held()[0],
            {name: each.parameter(is_angle=name in self.angles) for name, each in self.parameters.items()},
            self.angles,
            self.variable_map,
            self.inputs,
        )


class DiagnosisSection(StudySection):
    """Which fault, and how large."""

    baseline: File | None = word(
        None,
        "the result.json of an identification of the healthy machine; without, fmuid identify keeps beside its "
        "result.json what the tables of this study, all of the healthy machine, show of the faults",
        "healthy/result.json",
    )
    std_factor: Annotated[Annotated[Factor, Tag(VALUE_TAG)] | Annotated[Factors, Tag(TABLE_TAG)], BY_SHAPE] = word(
        1.0, "factor on its standard deviations, or one for each parameter: for changes that are no fault"
    )
    false_alarm_rate: Share = word(RULE.level, "probability of a false alarm", RULE.level)
    healthy_data: Files = word([], "tables of the healthy machine: sensors and supply are told from faults by them")
    known_fault_data: dict[str, Files] = word(
        {}, "cause to tables in which it alone is new: they show fault_model_error", {}
    )
    causes: Annotated[Causes, Settings()] = word(Causes(), "what may have changed beside the faults")
    fault_model_error: NotNegative = word(
        MODEL_ERROR, "of a fault model along other signatures, a share of its effect; a quarter of it in its size"
    )
    faults: dict[str, FaultSection] = word({}, "the faults to look for, by their names")

    def settings(self, model: ParsedModel, loss: str, known: ParsedParameters) -> ParsedDiagnosis:
        """Return the diagnosis of a study with this model, loss and these parameters.

        Raises
        ------
        InputError
            If there is no fault to look for, the healthy result cannot be read, or another word of the study does not
            go with a diagnosis.
        """
        several = (f"choices of {next(iter(known.choices), '')}", bool(known.choices))
        for said, there in (
            ("[prior]", known.joint_prior is not None),
            (f'loss = "{loss}"', loss != "linear"),
            several,
        ):
            if there:
                raise self.error(f"does not go with {said} in this version: remove one of the two")
        if not self.faults:
            raise self.error("has no faults: describe at least one as [diagnosis.faults.<name>]")
        return ParsedDiagnosis(
            str(self.place),
            self._source(model),
            self.std_factor,
            self.false_alarm_rate,
            {name: each.fault() for name, each in self.faults.items()},
            tuple(self.healthy_data),
            self.causes,
            self.fault_model_error,
            {name: tuple(tables) for name, tables in self.known_fault_data.items()},
        )

    def _source(self, model: ParsedModel) -> PriorSource | None:
        if self.baseline is None:
            for key in sorted({"healthy_data", "known_fault_data"} & self.model_fields_set):
                raise self.error(f"has {key} and no baseline: give the result.json of the healthy machine, too")
            return None
        try:
            result = Result.from_json(self.baseline)
        except InputError as error:
            raise self.error(f"baseline: {error}") from None
        names = tuple(name for name in result.names if not of_one_experiment(name) and name not in model.values)
        return PriorSource(str(self.place), self.baseline, result, names)


@dataclass(frozen=True, eq=False)
class ParsedFault:
    """A table ``[diagnosis.faults.<name>]``.

    Attributes
    ----------
    where : str
        The study file and the table, for messages.
    model : ParsedModel or None
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
    model: ParsedModel | None
    values: Mapping[str, float | int | bool | str]
    parameters: Mapping[str, Parameter]
    angles: Mapping[str, FaultAngle] | Sequence[str]
    names: Mapping[str, str]
    inputs: Mapping[str, str]

    def fault(self, system: System, model: ParsedModel) -> Fault:
        """Return the fault; `system` and `model` are the study's own.

        Raises
        ------
        InputError
            If its FMUs cannot be read or its parameters are no fault's.
        """
        from fmuid.diagnosis import Fault  # and all that decides, only where faults are looked for

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
class ParsedDiagnosis:
    """What the table ``[diagnosis]`` says: the healthy machine, and the faults to look for.

    Attributes
    ----------
    where : str
        The study file and the table, for messages.
    source : PriorSource or None
        The healthy result and where it comes from; None where the study itself is of the healthy machine.
    inflate : float or mapping of str to float
        Factor on its standard deviations.
    level : float
    faults : mapping of str to ParsedFault
    records : tuple of Path
        Tables of the healthy machine.
    causes : Causes
        Beside the faults, where there are healthy records.
    model_error : float
    trials : mapping of str to tuple of Path
        Cause to tables in which it alone is new.
    """

    where: str
    source: PriorSource | None
    inflate: float | Mapping[str, float]
    level: float
    faults: Mapping[str, ParsedFault]
    records: tuple[Path, ...] = ()
    causes: Causes = field(default_factory=Causes)
    model_error: float = MODEL_ERROR
    trials: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    @property
    def tables(self) -> tuple[Path, ...]:
        """All records of the healthy machine and of trials, and what was kept of its identification."""
        kept = () if self.kept is None else (self.kept,)
        return (*kept, *self.records, *(path for paths in self.trials.values() for path in paths))

    @property
    def kept(self) -> Path | None:
        """What the identification of the healthy machine has kept of its tables, None for nothing."""
        path = None if self.source is None else self.source.path.with_name(BASELINE_FILE)
        return path if path is not None and is_file(path) else None

    def fault_models(self, system: System, model: ParsedModel, data: Mapping[str, Any]) -> dict[str, Fault]:
        """Return the faults; `system` and `model` are the study's own, `data` the content of its file.

        Raises
        ------
        InputError
            If an FMU of theirs cannot be read, their parameters are no fault's, or an array is of another shape.
        """
        found = {name: each.fault(system, model) for name, each in self.faults.items()}
        for name, fault in found.items():
            check_shapes(System.of(fault.model), data["diagnosis"]["faults"][name], self.faults[name].where)
        return found

    def how(self, search: Marquardt, sensitivity: str, accuracy: str) -> DiagnosisSettings:
        """Return the settings of the diagnosis, with those of the study's estimator."""
        from fmuid.diagnosis import DiagnosisSettings

        return DiagnosisSettings(self.level, search, sensitivity, accuracy, self.causes, self.model_error)

    def baseline(
        self,
        model: ParsedModel,
        parameters: Mapping[str, Parameter],
        noise: Noise,
        read: Callable[[Path], Experiment],
    ) -> Baseline:
        """Return the healthy machine, with the words of the study's other tables, and its records, which `read` reads.

        Raises
        ------
        InputError
            If the healthy result does not fit them.
        """
        from fmuid.diagnosis import Baseline, StoredBaseline

        if self.source is None:
            raise InputError(
                'there is no healthy machine: give baseline = "healthy/result.json", of its identification'
            )
        records = [read(path) for path in self.records]
        trials = {name: [read(path) for path in paths] for name, paths in self.trials.items()}
        variance = noise.given_variance()
        shown = None if self.kept is None else StoredBaseline.read(self.kept, needed=not records)
        return Baseline(self.source.result, self.inflate, variance, parameters, model.values, records, trials, shown)
