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
from fmuid.reports.topics.diagnosis_phrases import diagnosis_notes
from tests.support.stepping import MOTOR, stepping_fmu

TRUTH = {"R": 1.0, "L": 5e-3, "K": 0.05, "J": 1e-4}
STEP, FRICTION, NOISE = 1e-3, 3e-5, (0.02, 0.05)  # s, N m s, A and rad/s
HELD = {name: value for name, value in TRUTH.items() if name != "R"}
FAULT = fmuid.Parameter(0.0, nominal=1e-5, min=0.0)


def record(
    friction: float, seed: int, truth: dict[str, float] = TRUTH, noise: tuple[float, float] = NOISE
) -> fmuid.Experiment:
    r, inductance, k, j = truth.values()
    matrix = np.array([[-r / inductance, -k / inductance, 1.0 / inductance], [k / j, -friction / j, 0.0], [0.0] * 3])
    exact, rng = expm(STEP * matrix), np.random.default_rng(seed)
    u = np.repeat(rng.choice([-5.0, 5.0], 40), 15)
    x = np.zeros((u.size, 2))
    for i in range(u.size - 1):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * u[i]
    x += rng.standard_normal(x.shape) * noise
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u, "i": x[:, 0], "w": x[:, 1]})
    return fmuid.Experiment(frame, inputs=["u"], outputs=["i", "w"], interpolation="zoh")


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(stepping_fmu(tmp_path_factory.mktemp("motor"), MOTOR, exchange=True))


@pytest.fixture(scope="module")
def healthy(motor: fmuid.System) -> fmuid.Result:
    noise = fmuid.Noise(dict(zip("iw", np.square(NOISE).tolist(), strict=True)))
    start = {"R": fmuid.Parameter(1.5, min=0.1)}
    return fmuid.identify(fmuid.Problem(motor, record(0.0, 1), start, noise=noise, values={**HELD, "F": 0.0}))


def look(
    motor: fmuid.System, healthy: fmuid.Result, experiment: fmuid.Experiment, accuracy: str = "refine"
) -> fmuid.Diagnosis:
    noise = dict(zip("iw", np.square(NOISE).tolist(), strict=True))
    baseline = fmuid.Baseline(healthy, noise_variance=noise, values={**HELD, "F": 0.0})
    fault = fmuid.Fault(motor, {"F": FAULT}, values=HELD)
    return fmuid.diagnose(experiment, baseline, {"friction": fault}, motor, DiagnosisSettings(solver_check=accuracy))


def test_the_error_of_the_simulation_is_no_fault(motor: fmuid.System, healthy: fmuid.Result) -> None:
    """The record is simulated as finely as the healthy one was."""
    experiment = record(0.0, 2)
    coarse = look(motor, replace(healthy, accuracy=None), experiment)
    assert coarse.kind != "healthy"
    found = look(motor, healthy, experiment)
    assert found.kind == "healthy"
    assert not found.mismatched


def test_a_fault_has_its_size(motor: fmuid.System, healthy: fmuid.Result) -> None:
    found = look(motor, healthy, record(FRICTION, 3))
    size = found["friction.F"]
    assert found.named == ("friction",)
    assert abs(size.value - FRICTION) < 3.0 * size.std
    assert size.std < 0.1 * FRICTION
    assert found.accuracy is not None
    assert (found.accuracy.outcome, found.accuracy.tolerance) == (AccuracyOutcome.PASSED, 1e-9)


def test_what_is_not_cured_is_said_and_kept(motor: fmuid.System, healthy: fmuid.Result, tmp_path: Path) -> None:
    """Of a healthy machine that was identified coarsely, where the error is checked and left."""
    found = look(motor, replace(healthy, accuracy=None), record(FRICTION, 3), "report")
    again = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    for each in (found, again):
        assert each.named == ("friction",)
        assert each.accuracy is not None
        assert (each.accuracy.outcome, each.accuracy.kept) == (AccuracyOutcome.SHIFTED, RefinementRefusal.ASKED)
        assert any(f"F by {each.accuracy.shift[1]:+.2g}" in note.text for note in diagnosis_notes(each))


def test_windows_are_simulated_as_the_healthy_record_was(motor: fmuid.System, healthy: fmuid.Result) -> None:
    """Its estimates come from model exchange; Euler's steps would stand out in every window of a sound machine."""
    noise = dict(zip("iw", np.square(NOISE).tolist(), strict=True))
    fault = fmuid.Fault(motor, {"F": FAULT}, values=HELD)
    found = []
    for result in (healthy, replace(healthy, accuracy=None)):
        baseline = fmuid.Baseline(result, noise_variance=noise, values={**HELD, "F": 0.0})
        monitor = fmuid.Monitor(baseline, {"friction": fault}, motor)
        monitor.add(record(0.0, 5))
        found.append(bool(monitor.table["unexplained"].any()))
    assert found == [False, True]
