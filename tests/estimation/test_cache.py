"""A cache: what problems share changes no estimate that counts, whichever comes first, and spares simulations."""

import numpy as np
import pytest

from fmuid import Cache, Marquardt, Noise, Parameter, Result
from fmuid.array_types import Floats
from fmuid.estimation import Evaluator, LeastSquares, TerminationReason
from tests.support.quick import first

TIMES = np.linspace(0.0, 3.0, 60)
STARTS = {"a": Parameter(1.0), "k": Parameter(3.0), "c": Parameter(-1.0)}
TRUTH = np.array([2.0, 1.0, 0.5])


def decay(theta: Floats) -> Floats:
    return np.asarray(theta[0] * np.exp(-theta[1] * TIMES) + theta[2])


def measured(seed: int, std: float) -> Floats:
    return decay(TRUTH) + std * np.random.default_rng(seed).standard_normal(TIMES.size)


class Draws:
    """Problems that differ in their noise alone, and what they take."""

    def __init__(self, count: int, std: float = 0.02) -> None:
        self.count, self.std, self.calls = count, std, 0

        def counted(theta: Floats) -> Floats:
            self.calls += 1
            return decay(theta)

        self.base = LeastSquares.from_function(counted, measured(0, std), STARTS)

    def problem(self, seed: int) -> LeastSquares:
        experiment = LeastSquares.from_function(decay, measured(seed, self.std), STARTS).experiments
        return self.base.measuring(experiment)

    def identify(self, cache: Cache | None, seeds: list[int]) -> dict[int, Result]:
        return {seed: Marquardt().search(Evaluator(self.problem(seed), cache)) for seed in seeds}


@pytest.mark.parametrize(("std", "shared"), first(1, [(0.02, True), (0.4, False)]))
def test_cache_spares_simulations_and_moves_no_estimate(std: float, shared: bool) -> None:
    """Where the estimates scatter over too many cells, no cell is used, and none is paid for."""
    seeds = list(range(1, 11 if shared else 7))
    alone, together = Draws(40, std), Draws(40, std)
    plain, found = alone.identify(None, seeds), together.identify(Cache(problems=40), seeds)
    for seed in seeds:
        assert found[seed].outcome is TerminationReason.CONVERGED
        assert (np.abs(found[seed].values - plain[seed].values) < 0.02 * plain[seed].std).all()
        np.testing.assert_allclose(found[seed].std, plain[seed].std, rtol=1e-2)
    assert together.calls < (0.9 if shared else 1.0) * alone.calls


def test_rows_are_alike_in_any_order() -> None:
    seeds, draws = list(range(1, 4)), Draws(40)
    forward = draws.identify(Cache(problems=40), seeds)
    backward = draws.identify(Cache(problems=40), seeds[::-1])
    fresh = {seed: draws.identify(Cache(problems=40), [seed])[seed] for seed in seeds}
    small = draws.identify(Cache(memory=5_000, problems=40), seeds)
    for seed in seeds:
        for other in (backward, fresh, small):
            assert (forward[seed].values == other[seed].values).all()
            assert (forward[seed].covariance == other[seed].covariance).all()
            assert forward[seed].history.simulations == other[seed].history.simulations


def test_the_least_recently_used_goes_first() -> None:
    made: list[int] = []

    def make(k: int) -> Floats:
        made.append(k)
        return np.zeros(100)

    cache = Cache(memory=2000)
    for k in (1, 2, 1, 3, 1, 2):
        cache.get("outputs", k, lambda k=k: make(k))  # type: ignore[misc]
    assert made == [1, 2, 3, 2]


def test_a_problem_does_not_change() -> None:
    problem = LeastSquares.from_function(decay, measured(1, 0.1), STARTS, noise=Noise(0.01))
    assert problem.as_in(None) is problem
    with pytest.raises(AttributeError, match="a problem does not change"):
        problem.measured = np.zeros(60)
