"""The section ``[diagnosis]``: baseline and fault models."""

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
from fmuid.estimation import Reason, Result
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

BASELINE_FILE = "baseline.npz"  # beside the ``result.json`` of a healthy study with faults: the baseline of its data
RULE = Rule()
FACTOR = "a number above 0, inf for no prior"
Factor = Annotated[float, kinds.required(lambda value: value > 0, FACTOR), kinds.ValueKind(FACTOR)]
Factors = Annotated[dict[str, Factor], kinds.Entries("{ parameter = number }")]


class FaultParameterSection(StudySection):
    """Parameter of a fault model."""

    nominal: kinds.Positive | None = entry(None, "scale: a fault size of interest; not for an angle")
    min: kinds.Number = entry(-math.inf, "lower bound")
    max: kinds.Number = entry(math.inf, "upper bound")

    def parameter(self, *, is_angle: bool) -> Parameter:
        """Return the parameter; angles need no nominal."""
        with self.place.located():
            return Parameter(0.0, self.min, self.max, self.nominal or (1.0 if is_angle else None))


Angles = dict[str, Annotated[FaultAngle, Settings()]]


class FaultSection(ModelSection):
    """Fault model: a model of its own, or parameters of the study's model."""

    parameters: Annotated[dict[str, FaultParameterSection], BeforeValidator(by_element)] = entry(
        {}, "fault sizes, zero without the fault"
    )
    angles: Annotated[kinds.Names | Angles, kinds.BY_SHAPE] = entry(
        [], 'parameters that are angles, ["theta0"]; or each with its fault size'
    )
    variable_map: kinds.Texts = entry({}, "variable of the study = variable of this model")
    inputs: kinds.Columns = entry({}, "further inputs of this model")
    nuisance: dict[str, kinds.Numbers] = entry({}, "possible values of details, { lag = [0.001, 0.002] }; averaged")

    @property
    def own_model(self) -> ParsedModel | None:
        """Model of the fault, None for the study's own."""
        own = bool({"fmu", "components"} & self.model_fields_set)
        return replace(self.settings(), values={}, sources=()) if own else None

    def check(self) -> None:
        """Refuse a fault without parameters, or keys of a model without one."""
        for key in ModelSection.model_fields if self.own_model is None else ():
            if key in self.model_fields_set and key != "fixed":
                raise self.error(f"needs a model. Set fmu or components, or remove {key}.", key)
        if not self.parameters:
            raise self.error("no fault parameters. Set parameters = { dR = { nominal = 1.0 } }.")
        self.held()
        for name, each in self.parameters.items():
            each.parameter(is_angle=name in self.angles)

    def fault(self, system: System, model: ParsedModel) -> Fault:
        """Return the fault; `system` and `model` are the study's own."""
        from fmuid.diagnosis import Fault

        own, (values, _) = self.own_model, self.held()
        for name in self.parameters if own is None else ():
            if name not in system.variables:
                raise self.error(f"{system.label} has no variable {name!r}. Set the fault's own fmu or components.")
        with self.place.located():
            return Fault(
                system if own is None else replace(own, isolation=model.isolation).system(),
                {name: each.parameter(is_angle=name in self.angles) for name, each in self.parameters.items()},
                self.variable_map,
                self.angles,
                {**model.values, **values} if own is None else values,
                self.inputs,
                self.nuisance,
            )


class DiagnosisSection(StudySection):
    """Fault diagnosis against a baseline."""

    baseline: kinds.File | None = entry(
        None, "result.json of the healthy machine; without it, identify stores one", "healthy/result.json"
    )
    std_factor: Annotated[Factor | Factors, kinds.BY_SHAPE] = entry(
        1.0, "factor on the baseline's σ: allowed healthy changes"
    )
    false_alarm_rate: kinds.Share = entry(RULE.level, "probability of a false alarm", RULE.level)
    healthy_data: kinds.Files = entry([], "data files of the healthy machine, for sensor and supply errors")
    known_fault_data: dict[str, kinds.Files] = entry(
        {}, "data files with one known cause each, for fault_model_error", {}
    )
    causes: Annotated[Causes, Settings()] = entry(Causes(), "possible causes other than faults")
    fault_model_error: kinds.NotNegative = entry(
        MODEL_ERROR, "fault-model error along other signatures, fraction of the effect"
    )
    faults: dict[str, FaultSection] = entry({}, "fault models by name")

    _source: PriorSource | None = PrivateAttr(default=None)

    @property
    def source(self) -> PriorSource | None:
        """Result of the healthy machine; None without ``baseline``."""
        return self._source

    def of(self, model: ParsedModel, loss: str, known: ParsedParameters) -> Self:
        """Return the section, checked for a study, with its baseline result."""
        for other, there in (
            ("[prior]", known.joint_prior is not None),
            (f'loss = "{loss}"', loss != "linear"),
            (f"choices of {next(iter(known.choices), '')}", bool(known.choices)),
        ):
            if there:
                raise self.error(f"cannot be combined with {other}. Remove one of the two.")
        if not self.faults:
            raise self.error("no faults. Add a section [diagnosis.faults.<name>].")
        found = self.model_copy()
        if self.baseline is None:
            for key in sorted({"healthy_data", "known_fault_data"} & self.model_fields_set):
                raise self.error('needs a baseline. Set baseline = "healthy/result.json".', key)
        else:
            with self.place.below("baseline").located():
                result = Result.from_json(self.baseline)
            self._check_errors(result)
            names = tuple(name for name in result.names if not of_one_experiment(name) and name not in model.values)
            found._source = PriorSource(str(self.place), self.baseline, result, names)
        for each in self.faults.values():
            each.check()
        return found

    def _check_errors(self, result: Result) -> None:
        """Refuse a baseline without the errors that its estimates have beside them: it alarms for these."""
        known = () if result.verdict is None else result.verdict.freed
        freed = [each.subject for each in known if each.reason is Reason.MODEL_ERROR]
        if freed and not self.healthy_data:
            errors = ", ".join(f"{kind.replace('_', ' ')} of {' and '.join(names)}" for kind, _, _, *names in freed)
            raise self.error(f"estimated beside model errors ({errors}). List its data in healthy_data.", "baseline")

    @property
    def tables(self) -> tuple[Path, ...]:
        """Data files of the baseline and known faults, and the stored baseline."""
        kept = () if self.kept is None else (self.kept,)
        return (*kept, *self.healthy_data, *(path for paths in self.known_fault_data.values() for path in paths))

    @property
    def kept(self) -> Path | None:
        """File of the stored baseline, if any."""
        return self.baseline_file if self.source is not None and is_file(self.baseline_file) else None

    @property
    def baseline_file(self) -> Path:
        """Place of the stored baseline, beside the healthy result."""
        return self._known_source.path.with_name(BASELINE_FILE)

    @property
    def _known_source(self) -> PriorSource:
        if self.source is None:
            raise InputError("missing key 'baseline'. Set baseline = \"healthy/result.json\".")
        return self.source

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

        source = self._known_source
        records = [read(path) for path in self.healthy_data]
        trials = {name: [read(path) for path in paths] for name, paths in self.known_fault_data.items()}
        variance = noise.given_variance()
        shown = None if self.kept is None else StoredBaseline.read(self.kept, needed=not records)
        return Baseline(source.result, self.std_factor, variance, parameters, model.values, records, trials, shown)
