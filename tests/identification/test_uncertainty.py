"""What is asked beyond the local covariance: done in order, put side by side, kept when interrupted."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from fmuid import Noise, Parameter, assess, map_cost
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import AccuracyOutcome, LeastSquares, SolverCheck
from fmuid.events import Event, ProfileStep, SamplingStep
from fmuid.identification import Assessment, AssessmentSettings, SamplerSettings, identify
from fmuid.identification.final_covariance import std_without_shift, with_solver_error

ALL = AssessmentSettings(0.9, ("a", "b"), SamplerSettings(max_steps=600, effective_size=600), (("a", "b"),))


def line() -> LeastSquares:
    """Return a straight line a + b x with noise of known variance: everything about it has a closed form."""
    x = np.linspace(0.0, 1.0, 40)
    measured = 1.0 + 2.0 * x + 0.1 * np.random.default_rng(4).normal(size=x.size)
    parameters = {"a": Parameter(0.5), "b": Parameter(1.0)}
    return LeastSquares.from_function(lambda t: t[0] + t[1] * x, measured, parameters, noise=Noise(0.01))


def two_valleys() -> LeastSquares:
    """Return a problem whose least cost is at a = 2, and that has a second minimum near a = −2."""
    x = np.linspace(0.0, 1.0, 20)

    def model(theta: Floats) -> Floats:
        return np.asarray((theta[0] ** 2 - 4.0) + 0.3 * (theta[0] - 2.0) * x + theta[1] * x**2)

    parameters = {"a": Parameter(-2.2, -4.0, 4.0), "b": Parameter(0.1, -1.0, 1.0)}
    return LeastSquares.from_function(model, np.zeros(20), parameters, noise=Noise(0.01))


def test_everything_of_a_linear_problem_agrees() -> None:
    problem = line()
    result = identify(problem)
    steps: list[Event] = []
    found = assess(problem, result, ALL, steps.append)
    assert found.succeeded
    assert list(dict.fromkeys(step.task for step in steps)) == ["uncertainty", "map", "profile", "posterior"]
    assert all(0.0 <= step.share <= 1.0 for step in steps)

    limits = found.intervals(result)
    local = result.intervals(0.9).to_numpy()
    np.testing.assert_array_equal(limits["local"].to_numpy(), local)
    np.testing.assert_allclose(limits["profile"].to_numpy(), local, rtol=1e-4)
    np.testing.assert_allclose(limits["posterior"].to_numpy(), local, atol=0.3 * float(result.std.max()))

    table = found.profile_table
    assert list(table.columns) == ["profiled", "a", "b", "cost"]
    assert table["profiled"].drop_duplicates().tolist() == ["a", "b"]
    (chart,) = found.maps
    assert chart.cost == pytest.approx(result.fit.cost)

    content = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert content["profiles"][0]["lower"] == pytest.approx(local[0, 0], rel=1e-4)
    assert content["profiles"][0]["level"] == content["level"] == 0.9
    assert content["posterior"]["converged"] is True
    assert content["posterior"]["mean"][1] == pytest.approx(result["b"], abs=0.1 * result.std[1])
    assert content["posterior"]["names"] == ["a", "b"]


def test_parts_and_samples_that_cannot_be_trusted() -> None:
    """Parameters that are not profiled are left empty; a short chain is no success."""
    problem = line()
    result = identify(problem)
    asked = AssessmentSettings(profile=("b",), posterior=SamplerSettings(max_steps=20))
    found = assess(problem, result, asked)
    limits = found.intervals(result)
    assert limits.index.tolist() == ["a", "b"]
    np.testing.assert_array_equal(np.isnan(limits["profile"].to_numpy()), [[True, True], [False, False]])
    assert (found.interrupted, found.succeeded) == (False, False)


def interrupt(where: Callable[[Event], bool]) -> Callable[[Event], None]:
    """Return a progress that does what Ctrl-C does, at the first step of which `where` is true."""

    def progress(step: Event) -> None:
        if where(step):
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize(
    ("where", "maps", "profiles", "sampled"),
    [
        (lambda _: True, 0, 0, False),
        (lambda step: step.task == "map", 0, 0, False),
        (lambda step: step.task == "profile", 1, 1, False),
        (lambda step: isinstance(step, ProfileStep) and step.name == "b", 1, 2, False),
        (lambda step: isinstance(step, SamplingStep) and step.step == 150, 1, 2, True),
    ],
)
def test_interrupted_keeps_what_there_is(
    where: Callable[[Event], bool], maps: int, profiles: int, sampled: bool
) -> None:
    problem = line()
    found = assess(problem, identify(problem), ALL, interrupt(where))
    assert found.interrupted
    assert not found.succeeded
    assert (len(found.maps), len(found.profiles), found.posterior is not None) == (maps, profiles, sampled)
    if found.posterior is not None:
        assert len(found.posterior.chain) == 150
    json.dumps(as_json(found), allow_nan=False)


def test_a_better_optimum_on_the_map_is_named() -> None:
    problem = two_valleys()
    result = identify(problem)
    assert result["a"] < 0
    asked = AssessmentSettings(maps=(("a", "b"),))
    near = assess(problem, result, asked)  # four standard deviations around the estimate
    assert near.succeeded
    far = Assessment(maps=(map_cost(problem, result, "a", "b", ranges={"a": (-4.0, 4.0), "b": (-1.0, 1.0)}),))
    assert not far.succeeded


@pytest.mark.parametrize(("smaller", "outcome"), [(1.0, AccuracyOutcome.PASSED), (4.0, AccuracyOutcome.SHIFTED)])
def test_a_solver_error_in_other_standard_deviations(smaller: float, outcome: AccuracyOutcome) -> None:
    """0.04 of a σ four times as large are 0.16 σ, which σ then contains; the second estimate was not checked."""
    result = identify(line())
    checked = SolverCheck(AccuracyOutcome.PASSED, np.array([0.04]))
    found = with_solver_error(result, checked, smaller * result.std[:1])
    assert found.accuracy is not None
    assert found.accuracy.outcome is outcome
    assert found.accuracy.shift[0] == pytest.approx(0.04 * smaller)
    moved = 0.16 * result.std[0] if outcome is AccuracyOutcome.SHIFTED else 0.0
    assert found.std == pytest.approx(np.hypot(result.std, [moved, 0.0]), rel=1e-12)
    assert std_without_shift(found) == pytest.approx(result.std, rel=1e-12)
