"""Diagnoses whose simulation is checked: a motor whose co-simulation is explicit Euler, its records exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from fmuid.diagnosis import DiagnosisSettings
from fmuid.estimation import AccuracyOutcome, RefinementRefusal
from fmuid.reports.topics.diagnosis import diagnosis_notes
from tests.support.stepping import MOTOR, stepping_fmu

TRUTH = {"R": 1.0, "L": 5e-3, "K": 0.05, "J": 1e-4}
STEP, FRICTION, NOISE = 1e-3, 3e-5, {"i": 0.02, "w": 0.05}  # s, N m s, A and rad/s
VARIANCE = {name: std**2 for name, std in NOISE.items()}
HELD = {name: value for name, value in TRUTH.items() if name != "R"}


def record(friction: float, seed: int) -> fmuid.Experiment:
    r, inductance, k, j = TRUTH.values()
    matrix = np.array([[-r / inductance, -k / inductance, 1.0 / inductance], [k / j, -friction / j, 0.0], [0.0] * 3])
    exact, rng = expm(STEP * matrix), np.random.default_rng(seed)
    u = np.repeat(rng.choice([-5.0, 5.0], 40), 15)
    x = np.zeros((u.size, 2))
    for i in range(u.size - 1):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * u[i]
    x += rng.standard_normal(x.shape) * list(NOISE.values())
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u, "i": x[:, 0], "w": x[:, 1]})
    return fmuid.Experiment(frame, inputs=["u"], outputs=["i", "w"], interpolation="zoh")


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(stepping_fmu(tmp_path_factory.mktemp("motor"), MOTOR, exchange=True))


@pytest.fixture(scope="module")
def fine(motor: fmuid.System) -> fmuid.Result:
    """Return the healthy motor, identified by model exchange."""
    start, values = {"R": fmuid.Parameter(1.5, min=0.1)}, {**HELD, "F": 0.0}
    return fmuid.identify(fmuid.Problem(motor, record(0.0, 1), start, noise=fmuid.Noise(VARIANCE), values=values))


@pytest.fixture(scope="module")
def coarse(fine: fmuid.Result) -> fmuid.Result:
    return replace(fine, accuracy=None)


def known(motor: fmuid.System, healthy: fmuid.Result) -> tuple[fmuid.Baseline, dict[str, fmuid.Fault], fmuid.System]:
    fault = fmuid.Fault(motor, {"F": fmuid.Parameter(0.0, nominal=1e-5, min=0.0)}, values=HELD)
    return fmuid.Baseline(healthy, noise_variance=VARIANCE, values={**HELD, "F": 0.0}), {"friction": fault}, motor


def test_solver_error_is_no_fault(motor: fmuid.System, fine: fmuid.Result, coarse: fmuid.Result) -> None:
    """A record is simulated as accurately as the healthy one was; Euler's steps stand out in a sound machine."""
    found = fmuid.diagnose(record(0.0, 2), *known(motor, fine))
    assert (found.kind, found.mismatched) == ("healthy", ())
    assert fmuid.diagnose(record(0.0, 2), *known(motor, coarse)).kind != "healthy"
    unexplained = []
    for healthy in (fine, coarse):
        monitor = fmuid.Monitor(*known(motor, healthy))
        monitor.add(record(0.0, 5))
        unexplained.append(bool(monitor.table["unexplained"].any()))
    assert unexplained == [False, True]


def test_size_of_a_fault(motor: fmuid.System, fine: fmuid.Result) -> None:
    found = fmuid.diagnose(record(FRICTION, 3), *known(motor, fine))
    size = found["friction.F"]
    assert found.named == ("friction",)
    assert abs(size.value - FRICTION) < 3.0 * size.std < 0.3 * FRICTION
    assert found.accuracy is not None
    assert (found.accuracy.outcome, found.accuracy.tolerance) == (AccuracyOutcome.PASSED, 1e-9)


def test_solver_error_left_is_reported(motor: fmuid.System, coarse: fmuid.Result, tmp_path: Path) -> None:
    found = fmuid.diagnose(record(FRICTION, 3), *known(motor, coarse), DiagnosisSettings(solver_check="report"))
    for each in (found, fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))):
        assert each.named == ("friction",)
        assert each.accuracy is not None
        assert (each.accuracy.outcome, each.accuracy.kept) == (AccuracyOutcome.SHIFTED, RefinementRefusal.ASKED)
        assert any(f"F by {each.accuracy.shift[1]:+.2g}" in note.text for note in diagnosis_notes(each))
