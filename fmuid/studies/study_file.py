"""The study file: all its sections."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from fmuid.data import Noise
from fmuid.models import Isolation
from fmuid.studies.array_elements import by_element
from fmuid.studies.batch import BatchSettings
from fmuid.studies.estimation import EstimationSection, MonitoringSection, UncertaintySection
from fmuid.studies.faults import DiagnosisSection
from fmuid.studies.model import ExperimentSettings, ModelSection
from fmuid.studies.parameters import JointPriorSection, ParameterSection
from fmuid.studies.section import Settings, StudySection, entry
from fmuid.studies.value_kinds import Text


class StudyFile(StudySection):
    """Study: model, experiments, parameters and settings."""

    title: Text = entry("", "title of the study")
    model: ModelSection = entry({}, "model", validate_default=True)
    experiments: list[ExperimentSettings] = entry([], "data files")
    parameters: Annotated[dict[str, ParameterSection], BeforeValidator(by_element)] = entry({}, "free parameters")
    prior: JointPriorSection | None = entry(None, "joint prior of several parameters")
    noise: Annotated[Noise, Settings()] = entry(Noise(), "measurement noise")
    estimation: EstimationSection = entry({}, "optimization of the parameters", validate_default=True)
    uncertainty: UncertaintySection = entry({}, "intervals beyond the local standard deviations", validate_default=True)
    diagnosis: DiagnosisSection | None = entry(None, "fault diagnosis against a baseline")
    monitoring: MonitoringSection = entry({}, "diagnosis of long recordings", validate_default=True)
    batch: BatchSettings | None = entry(None, "many identifications, called cases")
    isolation: Annotated[Isolation, Settings()] = entry(Isolation(), "limits of FMU processes")
