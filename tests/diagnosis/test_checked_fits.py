"""Diagnoses whose simulation is checked: a motor whose co-simulation is explicit Euler, its records exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from fmuid.diagnosis.fault_fits import fit_both
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
    return fmuid.diagnose(experiment, baseline, {"friction": fault}, motor, fmuid.DiagnosisSettings(accuracy=accuracy))


def test_the_error_of_the_simulation_is_no_fault(motor: fmuid.System, healthy: fmuid.Result) -> None:
    experiment = record(0.0, 2)
    assert look(motor, healthy, experiment, "off")["friction"].mismatch > 100.0
    found = look(motor, healthy, experiment)
    assert found.kind == "healthy"
    assert found["friction"].healthy_at_zero
    assert found.checked.accuracy is not None
    assert (found.checked.accuracy.outcome, found.checked.accuracy.tolerance) == (AccuracyOutcome.PASSED, 1e-9)
    each = found["friction"].checked.accuracy
    assert each is not None
    assert (each.outcome, each.tolerance) == (AccuracyOutcome.PASSED, 1e-9)


def test_a_fault_has_its_size(motor: fmuid.System, healthy: fmuid.Result) -> None:
    found = look(motor, healthy, record(FRICTION, 3))
    size = found["friction"]["F"]
    assert found.named == ("friction",)
    assert abs(size.value - FRICTION) < 3.0 * size.std
    assert size.std < 0.1 * FRICTION


def test_what_is_not_cured_is_said_and_kept(motor: fmuid.System, healthy: fmuid.Result, tmp_path: Path) -> None:
    found = look(motor, healthy, record(FRICTION, 3), "report")
    again = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    for each in (found, again):
        accuracy = each["friction"].checked.accuracy
        assert accuracy is not None
        assert (accuracy.outcome, accuracy.kept) == (AccuracyOutcome.SHIFTED, RefinementRefusal.ASKED)
        (said,) = [words for words in diagnosis_notes(each) if words.startswith("friction: the error")]
        assert f"F by {accuracy.shift[1]:+.2g}" in said


def test_both_fits_are_simulated_alike(motor: fmuid.System) -> None:
    """Only with the fault is the motor fast enough for Euler's steps to show; the fit without is repeated then."""
    experiment = record(0.05, 4, {**TRUTH, "L": 0.5}, (0.5, 0.02))
    noise, held = fmuid.Noise({"i": 0.25, "w": 4e-4}), {**HELD, "L": 0.5}
    parameters = {"R": fmuid.Parameter(400.0, min=0.1)}

    def problem(*, fault: bool) -> fmuid.Problem:
        if fault:
            return fmuid.Problem(motor, experiment, parameters | {"F": FAULT}, noise=noise, values=held)
        return fmuid.Problem(motor, experiment, parameters, noise=noise, values={**held, "F": 0.0})

    alone = problem(fault=False)
    assert fmuid.identify(alone, remedies=False).converged
    assert not alone.refinement.any
    pair = problem(fault=False), problem(fault=True)
    starts = [np.array([1.0, 1e-4]), np.array([1.0, 0.01])]
    without, best = fit_both(*pair, np.array([400.0]), lambda _: starts, fmuid.Marquardt(), "refine")
    assert [each.refinement.tolerance for each in pair] == [1e-9, 1e-9]
    assert without.accuracy is not None
    assert without.accuracy.tolerance == 1e-9
    assert abs(best["F"] - 0.05) < 3.0 * best.std[1]
    assert best.std[1] < 0.001


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
