"""The study file: all its tables."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BeforeValidator

from fmuid.data import Noise
from fmuid.models import Isolation
from fmuid.studies.array_elements import by_element
from fmuid.studies.batch import BatchSettings
from fmuid.studies.estimation import EstimationSection, MonitoringSection, UncertaintySection
from fmuid.studies.faults import DiagnosisSection
from fmuid.studies.model import ExperimentSettings, ModelSection
from fmuid.studies.parameters import JointPriorSection, ParameterSection
from fmuid.studies.renamed_keys import refuse_renamed
from fmuid.studies.section import SectionLocation, Settings, StudySection, entry
from fmuid.studies.value_kinds import Text


class StudyFile(StudySection):
    """A study: model, experiments, parameters, and what is asked of them."""

    @classmethod
    def read(cls, data: object, place: SectionLocation) -> Self:
        """Return the tables of a file; refuse old names first."""
        refuse_renamed(data, place)
        return super().read(data, place)

    title: Text = entry("", "what the study is about")
    model: ModelSection = entry({}, "the model", validate_default=True)
    experiments: list[ExperimentSettings] = entry([], "the measurements")
    parameters: Annotated[dict[str, ParameterSection], BeforeValidator(by_element)] = entry(
        {}, "the parameters to identify"
    )
    prior: JointPriorSection | None = entry(None, "what is known of several parameters together")
    noise: Annotated[Noise, Settings()] = entry(Noise(), "the noise of the measurements")
    estimation: EstimationSection = entry({}, "how the parameters are searched for", validate_default=True)
    uncertainty: UncertaintySection = entry(
        {}, "more than the standard deviations, which are local", validate_default=True
    )
    diagnosis: DiagnosisSection | None = entry(None, "which fault, and how large")
    monitoring: MonitoringSection = entry({}, "the same in windows of long records", validate_default=True)
    batch: BatchSettings | None = entry(None, "many identifications")
    isolation: Annotated[Isolation, Settings()] = entry(Isolation(), "what FMUs in a process of their own may do")
