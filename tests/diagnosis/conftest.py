"""Fixtures of the plate, for the tests that have none of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmuid
from tests.support.diagnosis_studies import Look
from tests.support.plate import (
    Faults,
    identified,
    record,
)
from tests.support.plate import faults as faults
from tests.support.plate import plate as plate


@pytest.fixture(scope="module")
def healthy(plate: fmuid.System) -> fmuid.Result:
    return identified(plate, record(np.random.default_rng(0)))


@pytest.fixture(scope="module")
def look(plate: fmuid.System, healthy: fmuid.Result, faults: Faults) -> Look:
    def diagnosis(experiment: fmuid.Experiment, **words: Any) -> fmuid.Diagnosis:
        given: dict[str, Any] = {"result": healthy, "std_factor": {"g": 5.0, "h": 5.0}} | words
        settings = fmuid.diagnosis.DiagnosisSettings(given.pop("level", 0.01))
        hypotheses = given.pop("faults", faults)
        return fmuid.diagnose(experiment, fmuid.Baseline(**given), hypotheses, plate, settings)

    return diagnosis
