"""The study file: all its tables."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BeforeValidator

from fmuid.data import Noise
from fmuid.models import Isolation
from fmuid.studies.arrays import by_element
from fmuid.studies.batch import BatchSettings
from fmuid.studies.diagnosis import DiagnosisSection
from fmuid.studies.model import ExperimentSettings, ModelSection
from fmuid.studies.parameters import JointPriorSection, ParameterSection
from fmuid.studies.renamed_keys import refuse_renamed
from fmuid.studies.section import SectionLocation, Settings, StudySection, word
from fmuid.studies.settings import (
    EstimationWords,
    MonitoringSection,
    UncertaintySection,
)
from fmuid.studies.value_kinds import Text


class StudyFile(StudySection):
    """A study: model, experiments, parameters, and what is asked of them."""

    @classmethod
    def read(cls, data: object, place: SectionLocation) -> Self:
        """Return the sections of a file; keys with old names are refused by their new ones (`StudySection.read`)."""
        refuse_renamed(data, place)
        return super().read(data, place)

    title: Text = word("", "what the study is about")
    model: ModelSection = word({}, "the model", validate_default=True)
    experiments: list[ExperimentSettings] = word([], "the measurements")
    parameters: Annotated[dict[str, ParameterSection], BeforeValidator(by_element)] = word(
        {}, "the parameters to identify"
    )
    prior: JointPriorSection | None = word(None, "what is known of several parameters together")
    noise: Annotated[Noise, Settings()] = word(Noise(), "the noise of the measurements")
    estimation: EstimationWords = word({}, "how the parameters are searched for", validate_default=True)
    uncertainty: UncertaintySection = word(
        {}, "more than the standard deviations, which are local", validate_default=True
    )
    diagnosis: DiagnosisSection | None = word(None, "which fault, and how large")
    monitoring: MonitoringSection = word({}, "the same in windows of long records", validate_default=True)
    batch: BatchSettings | None = word(None, "many identifications")
    isolation: Annotated[Isolation, Settings()] = word(Isolation(), "what FMUs in a process of their own may do")
