"""The table ``[diagnosis]``: the healthy machine and the faults to look for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, PrivateAttr

from fmuid.data import Experiment, Noise, Parameter
from fmuid.diagnosis import MODEL_ERROR, Causes, FaultAngle, Rule
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import is_file
from fmuid.formatting import of_one_experiment
from fmuid.models import System
from fmuid.studies import value_kinds as kinds
from fmuid.studies.array_elements import by_element, check_shapes
from fmuid.studies.model import ModelSection, ParsedModel
from fmuid.studies.parameters import ParsedParameters, PriorSource
from fmuid.studies.section import Settings, StudySection, entry

if TYPE_CHECKING:
    from fmuid.diagnosis import Baseline, Fault

BASELINE_FILE = "baseline.npz"
"""Beside the ``result.json`` of a healthy study with faults: what its tables show."""

RULE = Rule()
"""What is not said of a test."""


FACTOR = "a number above 0, inf for no prior"
Factor = Annotated[float, kinds.required(lambda value: value > 0, FACTOR), kinds.ValueKind(FACTOR)]
Factors = Annotated[dict[str, Factor], kinds.Entries("a table { parameter = number }")]


class FaultParameterSection(StudySection):
    """A parameter of a fault."""

    nominal: kinds.Positive | None = entry(None, "size that is worth naming; of an angle not needed")
    min: kinds.Number = entry(-math.inf, "lower bound")
    max: kinds.Number = entry(math.inf, "upper bound")

    def parameter(self, *, is_angle: bool) -> Parameter:
        """Return the parameter; angles need no nominal."""
        with self.place.located(" is refused:"):
            return Parameter(0.0, self.min, self.max, self.nominal or (1.0 if is_angle else None))


Angles = dict[str, Annotated[FaultAngle, Settings()]]


class FaultSection(ModelSection):
    """A fault to look for: a model of it, or parameters of the study's own model."""

    parameters: Annotated[dict[str, FaultParameterSection], BeforeValidator(by_element)] = entry(
        {}, "those of the fault, zero where it is not there"
    )
    angles: Annotated[kinds.Names | Angles, kinds.BY_SHAPE] = entry(
        [], 'the parameters that are angles, ["theta0"]; or each with the size that it belongs to'
    )
    variable_map: kinds.Texts = entry({}, "what the study calls a variable, and what this model calls it")
    inputs: kinds.Columns = entry({}, "inputs that only this model has")

    @property
    def own_model(self) -> ParsedModel | None:
        """Model of the fault, None for the study's own."""
        own = bool({"fmu", "components"} & self.model_fields_set)
        return replace(self.settings(), values={}, sources=()) if own else None

    def check(self) -> None:
        """Refuse a fault without parameters, or with words on a model that it has not."""
        for key in ModelSection.model_fields if self.own_model is None else ():
            if key in self.model_fields_set and key != "fixed":
                raise self.error(f"has {key} and no model: give fmu or components, or leave {key} out")
        if not self.parameters:
            raise self.error(
                "has no parameters: name those of the fault, zero without it, as in "
                "parameters = { dR = { nominal = 1.0 } }"
            )
        self.held()
        for name, each in self.parameters.items():
            each.parameter(is_angle=name in self.angles)

    def fault(self, system: System, model: ParsedModel) -> Fault:
        """Return the fault; `system` and `model` are the study's own."""
        from fmuid.diagnosis import Fault  # and all that decides, only where faults are looked for

        own, (values, _) = self.own_model, self.held()
        for name in self.parameters if own is None else ():
            if name not in system.variables:
                raise InputError(
                    f"{self.place}: the study's own model, {system.label}, has no {name!r}, and the fault no model of "
                    "its own: give it, as fmu or as components"
                )
        with self.place.located():
            return Fault(
                system if own is None else replace(own, isolation=model.isolation).system(),
                {name: each.parameter(is_angle=name in self.angles) for name, each in self.parameters.items()},
                self.variable_map,
                self.angles,
                {**model.values, **values} if own is None else values,
                self.inputs,
            )


class DiagnosisSection(StudySection):
    """Which fault, and how large."""

    baseline: kinds.File | None = entry(
        None,
        "the result.json of an identification of the healthy machine; without, fmuid identify keeps beside its "
        "result.json what the tables of this study, all of the healthy machine, show of the faults",
        "healthy/result.json",
    )
    std_factor: Annotated[Factor | Factors, kinds.BY_SHAPE] = entry(
        1.0, "factor on its standard deviations, or one for each parameter: for changes that are no fault"
    )
    false_alarm_rate: kinds.Share = entry(RULE.level, "probability of a false alarm", RULE.level)
    healthy_data: kinds.Files = entry(
        [], "tables of the healthy machine: sensors and supply are told from faults by them"
    )
    known_fault_data: dict[str, kinds.Files] = entry(
        {}, "cause to tables in which it alone is new: they show fault_model_error", {}
    )
    causes: Annotated[Causes, Settings()] = entry(Causes(), "what may have changed beside the faults")
    fault_model_error: kinds.NotNegative = entry(
        MODEL_ERROR, "of a fault model along other signatures, a share of its effect; a quarter of it in its size"
    )
    faults: dict[str, FaultSection] = entry({}, "the faults to look for, by their names")

    _source: PriorSource | None = PrivateAttr(default=None)

    @property
    def source(self) -> PriorSource | None:
        """Result of the healthy machine, None where the study is of it."""
        return self._source

    def of(self, model: ParsedModel, loss: str, known: ParsedParameters) -> Self:
        """Return the table, checked for a study, with the result of the healthy machine."""
        for said, there in (
            ("[prior]", known.joint_prior is not None),
            (f'loss = "{loss}"', loss != "linear"),
            (f"choices of {next(iter(known.choices), '')}", bool(known.choices)),
        ):
            if there:
                raise self.error(f"does not go with {said} in this version: remove one of the two")
        if not self.faults:
            raise self.error("has no faults: describe at least one as [diagnosis.faults.<name>]")
        found = self.model_copy()
        if self.baseline is None:
            for key in sorted({"healthy_data", "known_fault_data"} & self.model_fields_set):
                raise self.error(f"has {key} and no baseline: give the result.json of the healthy machine, too")
        else:
            with self.place.located(" baseline:"):
                result = Result.from_json(self.baseline)
            names = tuple(name for name in result.names if not of_one_experiment(name) and name not in model.values)
            found._source = PriorSource(str(self.place), self.baseline, result, names)
        for each in self.faults.values():
            each.check()
        return found

    @property
    def tables(self) -> tuple[Path, ...]:
        """Data files of the healthy machine and known faults, and the stored baseline."""
        kept = () if self.kept is None else (self.kept,)
        return (*kept, *self.healthy_data, *(path for paths in self.known_fault_data.values() for path in paths))

    @property
    def kept(self) -> Path | None:
        """File of the stored baseline, if any."""
        path = None if self.source is None else self.source.path.with_name(BASELINE_FILE)
        return path if path is not None and is_file(path) else None

    def fault_models(self, system: System, model: ParsedModel, data: Mapping[str, Any]) -> dict[str, Fault]:
        """Return the faults; `data` is the content of the study file."""
        found = {name: each.fault(system, model) for name, each in self.faults.items()}
        for name, fault in found.items():
            check_shapes(System.of(fault.model), data["diagnosis"]["faults"][name], str(self.faults[name].place))
        return found

    def healthy(
        self, model: ParsedModel, parameters: Mapping[str, Parameter], noise: Noise, read: Callable[[Path], Experiment]
    ) -> Baseline:
        """Return the healthy machine; `read` reads its data."""
        from fmuid.diagnosis import Baseline, StoredBaseline

        if self.source is None:
            raise InputError(
                'there is no healthy machine: give baseline = "healthy/result.json", of its identification'
            )
        records = [read(path) for path in self.healthy_data]
        trials = {name: [read(path) for path in paths] for name, paths in self.known_fault_data.items()}
        variance = noise.given_variance()
        shown = None if self.kept is None else StoredBaseline.read(self.kept, needed=not records)
        return Baseline(self.source.result, self.std_factor, variance, parameters, model.values, records, trials, shown)
