"""What samples, and what does not: coupled FMUs whose communication steps are an error, or belong to the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from fmuid.array_types import Floats
from fmuid.estimation import AccuracyOutcome
from fmuid.simulation.executor_pool import closing
from tests.support.paths import FMUS
from tests.support.stepping import LAG, stepping_fmu

TRUTH, STEP, NOISE = 2.0, 0.05, 0.004


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stepping")


def off(result: fmuid.Result) -> float:
    """Return how far the one estimate is off, standard deviations."""
    return float(abs(result.values[0] - TRUTH) / result.std[0])


# --- a control with continuous states of its own

GAIN, INTEGRAL_TIME = 5.0, 0.4  # of the loop around x' = u − 2 x, sampled every 0.05 s
CONTROL = {"controller.K": GAIN, "controller.Ti": INTEGRAL_TIME}


@pytest.fixture(scope="module")
def sampled_loop() -> fmuid.Experiment:
    """Return what a control does whose command is held: closed forms from sample to sample."""
    rng = np.random.default_rng(5)
    reference = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    decay, x, integral = float(np.exp(-TRUTH * STEP)), np.zeros(reference.size), 0.0
    for i, wanted in enumerate(reference[:-1]):
        error = wanted - x[i]
        x[i + 1] = decay * x[i] + (1.0 - decay) / TRUTH * (GAIN * error + integral)
        integral += GAIN / INTEGRAL_TIME * STEP * error
    return _looped(reference, x + NOISE * rng.standard_normal(x.size))


@pytest.fixture(scope="module")
def continuous_loop() -> fmuid.Experiment:
    """Return what a control does that acts all the time: a matrix exponential from sample to sample."""
    rng = np.random.default_rng(6)
    reference = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    rows = [[-TRUTH - GAIN, 1.0, GAIN], [-GAIN / INTEGRAL_TIME, 0.0, GAIN / INTEGRAL_TIME], [0.0] * 3]
    exact, x = expm(STEP * np.array(rows)), np.zeros((reference.size, 2))
    for i, wanted in enumerate(reference[:-1]):
        x[i + 1] = exact[:2, :2] @ x[i] + exact[:2, 2] * wanted
    return _looped(reference, x[:, 0] + NOISE * rng.standard_normal(reference.size))


def _looped(reference: Floats, x: Floats) -> fmuid.Experiment:
    frame = pd.DataFrame({"time": STEP * np.arange(x.size), "controller.reference": reference, "lag.x": x})
    return fmuid.Experiment(frame, ["controller.reference"], ["lag.x"], interpolation="zoh")


def in_a_loop(folder: Path, table: fmuid.Experiment, order: int, samples: bool | None) -> fmuid.Result:
    """Identify a lag under its control, of which it is said whether it samples."""
    models = {
        "lag": fmuid.Component(stepping_fmu(folder, LAG, order=order, exchange=True)),
        "controller": fmuid.Component(FMUS / "CoilController/CoilController.fmu", fmuid.Numerics(samples=samples)),
    }
    links = [("lag.x", "controller.i"), ("controller.u", "lag.u")]
    with closing(fmuid.System(components=models, connections=links)) as system:
        return fmuid.identify(fmuid.Problem(system, table, {"lag.k": fmuid.Parameter(1.0, min=0.01)}, values=CONTROL))


def test_a_sampled_control_is_not_made_a_faster_one(folder: Path, sampled_loop: fmuid.Experiment) -> None:
    """Unsaid, the estimate stays where the finer steps would move it from, and the result says that they would."""
    result, said = (in_a_loop(folder, sampled_loop, 4, samples) for samples in (None, True))
    assert off(result) < 3.0
    found = result.accuracy
    assert found is not None
    assert (found.outcome, found.switches, found.divisor) == (AccuracyOutcome.COUPLED, (), 1)
    assert found.largest > 10.0
    assert said.accuracy is not None
    assert (said.accuracy.outcome, said.accuracy.switches) == (AccuracyOutcome.PASSED, ())
    assert said.values == pytest.approx(result.values, rel=1e-9)
    assert said.std == pytest.approx(result.std, rel=1e-6)


def test_the_inside_of_a_loop_is_refined_nevertheless(folder: Path, sampled_loop: fmuid.Experiment) -> None:
    """Euler inside the lag is an error whoever samples; model exchange takes its place, at the same steps."""
    result = in_a_loop(folder, sampled_loop, 1, None)
    assert off(result) < 3.0
    found = result.accuracy
    assert found is not None
    assert (found.outcome, found.tolerance, found.divisor) == (AccuracyOutcome.COUPLED, 1e-9, 1)


def test_a_continuous_control_is_for_the_study_to_say(folder: Path, continuous_loop: fmuid.Experiment) -> None:
    unsaid, said = (in_a_loop(folder, continuous_loop, 4, samples) for samples in (None, False))
    assert off(unsaid) > 5.0
    assert unsaid.accuracy is not None
    assert unsaid.accuracy.outcome is AccuracyOutcome.COUPLED
    assert said.accuracy is not None
    assert said.accuracy.divisor > 1
    assert off(said) < 3.0


# --- a control without states

DRIVE = {"drive": "PositionDrive", "controller": "PositionController"}


def test_sampled_controllers_keep_their_steps() -> None:
    """A drive that is integrated in shorter steps stays the same plant; its controller acts no more often."""
    system = fmuid.System(
        components={name: FMUS / model / f"{model}.fmu" for name, model in DRIVE.items()},
        connections=[
            ("drive.q", "controller.q"),
            ("drive.dq", "controller.dq"),
            ("controller.v", "drive.v"),
        ],
    )
    times = 1e-3 * np.arange(400)
    frame = pd.DataFrame({"time": times, "controller.qg": 1e-4 * (1.0 - np.cos(20.0 * times))})
    table = fmuid.Experiment(frame, ["controller.qg"], ["controller.v"], interpolation="zoh", measured=False)
    plain = fmuid.Simulator(system, table)([])
    finer = fmuid.Simulator(system, table, divisor=4)([])
    faster = fmuid.Simulator(system, table, step_size=2.5e-4)([])
    scale = np.abs(plain).max()
    assert np.abs(finer - plain).max() < 1e-6 * scale
    assert np.abs(faster - plain).max() > 1e-4 * scale
