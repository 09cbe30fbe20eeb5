"""Machines of these tests, each built once: the plate, which least squares solve exactly, and the coil."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmuid
from experiments.coil import study as coil
from tests.support.plate import Faults, Look, identified, record
from tests.support.plate import faults as faults
from tests.support.plate import plate as plate
from tests.support.results import changed


@pytest.fixture(scope="session")
def sound(plate: fmuid.System) -> fmuid.Result:
    """Return the healthy plate, its noise white as in a file without noise model."""
    return changed(identified(plate, record(np.random.default_rng(0))), output_noise={})


@pytest.fixture(scope="session")
def healthy_coil() -> fmuid.Result:
    """Return the healthy coil, its noise white as in a file without noise model."""
    return changed(fmuid.Result.from_json(coil.HERE / "healthy" / "result.json"), output_noise={})


@pytest.fixture(scope="session")
def look(plate: fmuid.System, sound: fmuid.Result, faults: Faults) -> Look:
    def diagnosis(experiment: fmuid.Experiment, **words: Any) -> fmuid.Diagnosis:
        given: dict[str, Any] = {"result": sound, "std_factor": {"g": 5.0, "h": 5.0}} | words
        settings = fmuid.diagnosis.DiagnosisSettings(given.pop("level", 0.01))
        hypotheses = given.pop("faults", faults)
        return fmuid.diagnose(experiment, fmuid.Baseline(**given), hypotheses, plate, settings)

    return diagnosis
