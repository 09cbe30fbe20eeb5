"""Priors that are wrong: named beside what explains as much, and no interval moves by another name."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.estimation import Grade, Reason
from fmuid.identification import ErrorKind, find_model_errors
from tests.support.verdict_scenes import COIL, STEP, L, R, records
from tests.support.verdicts import found_in

COUNT, DRAWS = 1000, 4
GAINS = {ErrorKind.GAIN, ErrorKind.INPUT_GAIN}


def problem_with(
    draw: int, priors: dict[str, fmuid.Normal], gain: float = 1.0, noise: fmuid.Noise | None = None
) -> fmuid.Problem:
    """Return a sound coil, but for its sensor's gain, with priors of its parameters."""
    u, i = (each[draw] for each in records("honest", COUNT, 0.0, DRAWS))
    frame = pd.DataFrame({"time": STEP * np.arange(COUNT), "u": u, "i": gain * i})
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")
    starts = {"R": (3.0, 0.0), "L": (0.03, 1e-4)}
    free = {name: fmuid.Parameter(own[0], min=own[1], prior=priors.get(name)) for name, own in starts.items()}
    return fmuid.Problem(COIL, experiment, free, noise=noise or fmuid.Noise())


@pytest.mark.parametrize("draw", range(DRAWS))
def test_a_wrong_prior_is_named_beside_gains_and_moves_nothing_else(draw: int) -> None:
    """A prior of R 10 % off: freed gains would give L 10 % off, without a word of the prior."""
    found = found_in(problem_with(draw, {"R": fmuid.Normal(1.1 * R, 0.01 * R)}))
    assert found.names and ErrorKind.PRIOR in found.names[0] and GAINS & found.names[0]
    assert found.verdict.grade is Grade.DOUBTFUL and Reason.PRIOR_DATA_CONFLICT in found.verdict.reasons
    assert not found.verdict.freed
    assert abs(found.values[1] - L) < 4.0 * found.std[1]


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(DRAWS))
def test_a_gain_that_priors_contradict_is_freed(draw: int) -> None:
    """Both parameters would have to be 10 % off: one sensor explains it better than two priors."""
    priors = {"R": fmuid.Normal(R, 0.01 * R), "L": fmuid.Normal(L, 0.01 * L)}
    assert found_in(problem_with(draw, priors)).verdict.grade is Grade.PASSED
    found = found_in(problem_with(draw, priors, gain=1.1))
    assert found.names and found.names[0] & GAINS and ErrorKind.PRIOR not in found.names[0]
    assert (np.abs(found.values - [R, L]) < 4.0 * found.std).all()


def test_score_of_a_prior_is_the_cost_that_it_brings() -> None:
    """L's prior is wrong, R's is right: no sensor explains that."""
    variance = float(np.mean(records("honest", COUNT, 0.0, DRAWS)[1][0] ** 2) / 31.0)
    right = fmuid.Normal(R, 0.01 * R)
    problems = [
        problem_with(0, {"R": right, **own}, noise=fmuid.Noise(variance, delay_std=0.0))
        for own in ({"L": fmuid.Normal(1.1 * L, 0.01 * L)}, dict[str, fmuid.Normal]())
    ]
    wrong, free = (fmuid.identify(each) for each in problems)
    found = find_model_errors(problems[0], wrong)
    assert found is not None
    first = found.errors[0].test
    assert first.direction.key == (ErrorKind.PRIOR, ("L",))
    assert first.score**2 == pytest.approx(wrong.fit.cost - free.fit.cost, rel=0.1)
    assert first.size == pytest.approx((1.1 * L - free.values[1]) / (0.01 * L), rel=0.05)
