"""The study file: all its tables."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from fmuid.studies.arrays import by_element
from fmuid.studies.batch import BatchSettings
from fmuid.studies.diagnosis import DiagnosisWords
from fmuid.studies.model import ExperimentSettings, ModelWords
from fmuid.studies.parameters import JointPriorWords, ParameterWords
from fmuid.studies.section import Text, Words, word
from fmuid.studies.settings import EstimatorWords, IsolationWords, MonitoringWords, NoiseWords, UncertaintyWords


class StudyFile(Words):
    """A study: model, experiments, parameters, and what is asked of them."""

    title: Text = word("", "what the study is about")
    model: ModelWords = word({}, "the model", validate_default=True)
    experiments: list[ExperimentSettings] = word([], "the measurements")
    parameters: Annotated[dict[str, ParameterWords], BeforeValidator(by_element)] = word(
        {}, "the parameters to identify"
    )
    prior: JointPriorWords | None = word(None, "what is known of several parameters together")
    noise: NoiseWords = word({}, "the noise of the measurements", validate_default=True)
    estimator: EstimatorWords = word({}, "how the parameters are searched for", validate_default=True)
    uncertainty: UncertaintyWords = word(
        {}, "more than the standard deviations, which are local", validate_default=True
    )
    diagnosis: DiagnosisWords | None = word(None, "which fault, and how large")
    monitoring: MonitoringWords = word({}, "the same in windows of long records", validate_default=True)
    batch: BatchSettings | None = word(None, "many identifications")
    isolation: IsolationWords = word({}, "what FMUs in a process of their own may do", validate_default=True)
