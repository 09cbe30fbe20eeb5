"""Predictions with the errors that a result has freed, against closed forms of a coil over other records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from fmuid import Experiment, InputError, Study, identify
from fmuid.array_types import Floats
from fmuid.identification import ErrorKind, Prediction, find_model_errors, predict_by_model, refit
from fmuid.identification.refit import without_sizes
from tests.support.coil_study import STUDY
from tests.support.held_coil import COIL, COUNT, STEP, L, R, closed, held_voltage, problem_of
from tests.support.paths import FMUS
from tests.support.quick import first
from tests.support.running import run_study

NOISE = 0.01
SCENES: dict[ErrorKind, Callable[[Floats], Floats]] = {
    ErrorKind.OFFSET: lambda u: closed(u) + 0.05,
    ErrorKind.DELAY: lambda u: closed(u, 0.7),
    ErrorKind.INPUT_OFFSET: lambda u: closed(u - 0.4),
}


def predicted(kind: ErrorKind, seed: int, fresh: Experiment) -> tuple[Prediction, Prediction]:
    """Return the predictions of a record with and without the error of another."""
    rng = np.random.default_rng([71, seed])
    u = held_voltage(rng)
    problem = problem_of(u, SCENES[kind](u) + NOISE * rng.standard_normal(COUNT))
    result = identify(problem)
    found = find_model_errors(problem, result)
    again = None if found is None else refit(problem, result, found)
    assert again is not None and again.found is not None
    own = without_sizes(again.result, 2)
    beside = predict_by_model(COIL, own, fresh, errors=again.found)
    assert beside.errors
    return beside, predict_by_model(COIL, own, fresh)


def over(u: Floats, i: Floats) -> Experiment:
    frame = pd.DataFrame({"time": STEP * np.arange(len(u)), "u": u, "i": i})
    return Experiment(frame, ["u"], ["i"], interpolation="zoh", name="fresh")


@pytest.mark.parametrize("kind", first(1, SCENES))
def test_predictions_have_the_freed_error(kind: ErrorKind) -> None:
    rng = np.random.default_rng(72)
    u = held_voltage(rng)
    exact = SCENES[kind](u)
    fresh = over(u, exact + NOISE * rng.standard_normal(COUNT))
    found, without = predicted(kind, 0, fresh)
    assert [kind] == [each.test.direction.kind for each in found.errors]
    assert np.sqrt(np.mean((found.fit.simulated[:, 0] - exact) ** 2)) < 0.2 * NOISE
    assert not found.scores[0].is_worse and without.scores[0].is_worse


def test_a_delay_is_a_time() -> None:
    """0.7 samples are 1.4 of a record with half the interval."""
    rng = np.random.default_rng(73)
    u = np.repeat(held_voltage(rng), 2)
    decay = np.exp(-R / L * 0.5 * STEP)
    exact = lfilter([0.0, (1.0 - decay) / R], [1.0, -decay], u)
    past = np.concatenate([[0.0, 0.0], exact[:-2]])  # 2 samples late, and 0.6 of one on
    on = np.exp(-R / L * 0.5 * STEP * 0.6)
    late = past * on + np.concatenate([[0.0, 0.0], u[:-2]]) / R * (1.0 - on)
    frame = pd.DataFrame({"time": 0.5 * STEP * np.arange(u.size), "u": u, "i": late})
    found, _ = predicted(ErrorKind.DELAY, 0, Experiment(frame, ["u"], ["i"], interpolation="zoh", name="fresh"))
    assert np.sqrt(np.mean((found.fit.simulated[2:, 0] - late[2:]) ** 2)) < 0.2 * NOISE


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCENES)
def test_the_band_has_the_covariance_of_size_and_estimates(kind: ErrorKind) -> None:
    """Errors of 60 predictions of one record, in their σ; those of size and parameters are correlated."""
    u = held_voltage(np.random.default_rng(74))
    exact = SCENES[kind](u)
    scores = []
    for seed in range(60):
        found, _ = predicted(kind, seed, over(u, exact))
        if [kind] != [each.test.direction.kind for each in found.errors]:
            continue  # an offset of the output and an initial state explain as much
        scores.append((found.fit.simulated[10::50, 0] - exact[10::50]) / found.std[10::50, 0])
    assert len(scores) >= 58
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25


def test_a_baseline_beside_freed_errors_needs_healthy_data(tmp_path: Path) -> None:
    rng = np.random.default_rng(75)
    u = held_voltage(rng)
    over(u, SCENES[ErrorKind.OFFSET](u) + NOISE * rng.standard_normal(COUNT)).frame.to_csv(tmp_path / "first.csv")
    (tmp_path / "study.toml").write_text(STUDY)
    run_study(tmp_path / "study.toml", tmp_path / "results")
    fault = f'fmu = "{(FMUS / "Coil/Coil.fmu").as_posix()}"\nparameters = {{ R = {{ nominal = 1.0 }} }}\n'
    diagnosis = STUDY + '[diagnosis]\nbaseline = "results/result.json"\n'
    faults = tmp_path / "faults.toml"
    faults.write_text(f"{diagnosis}[diagnosis.faults.turns]\n{fault}")
    with pytest.raises(
        InputError, match=r"diagnosis.baseline: estimated beside model errors \(offset of i\). List its"
    ):
        Study.read(faults)
    faults.write_text(f'{diagnosis}healthy_data = ["first.csv"]\n[diagnosis.faults.turns]\n{fault}')
    Study.read(faults)
