"""Global searches with failing simulations, and interrupted ones."""

from __future__ import annotations

import numpy as np
import pytest

from fmuid.array_types import Floats
from fmuid.data import Parameter
from fmuid.errors import InputError
from fmuid.estimation.global_search import GlobalSearch, Strategy
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.search.state import TerminationReason
from fmuid.events import Event
from tests.support.sinusoids import METHODS, RANGE, TIMES, dense_minima, of_search, searched, sinusoid


def fragile(limit: float) -> LeastSquares:
    """Return the sinusoid with a simulation that fails below a frequency."""

    def simulate(theta: Floats) -> Floats:
        if theta[0] < limit:
            raise FloatingPointError("too slow")
        return np.asarray(np.sin(theta[0] * TIMES))

    return LeastSquares.from_function(simulate, sinusoid().measured, {"w": Parameter(5.0, min=RANGE[0], max=RANGE[1])})


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_failing_simulations_are_passed_over(method: Strategy) -> None:
    events: list[Event] = []
    found = searched(fragile(30.0), GlobalSearch(method, starts=30), events.append)
    steps = of_search(events)
    assert np.isfinite([step.cost for step in steps]).all()
    minima, squares = dense_minima()
    assert found["w"] == pytest.approx(minima[np.argmin(squares)], abs=2e-3)
    if method == "multi-start":
        assert found.history.fits == 30, "starts that fail are replaced"


@pytest.mark.parametrize("method", METHODS)
def test_nothing_but_failures(method: Strategy) -> None:
    with pytest.raises(InputError, match=r"all \d+ simulations.*too slow"):
        searched(fragile(100.0), GlobalSearch(method, starts=6))


def test_explosions_are_no_error() -> None:
    """Outputs beyond 1e154 cannot be squared; that is as bad as it gets, and no warning."""
    problem = LeastSquares.from_function(
        lambda theta: np.exp(theta[0] * TIMES),
        np.exp(2.0 * TIMES) + 0.01 * np.sin(50 * TIMES),
        {"a": Parameter(1.0, min=-700.0, max=700.0)},
    )
    assert searched(problem, GlobalSearch(starts=20))["a"] == pytest.approx(2.0, abs=0.01)


def test_error_where_no_fit_is_possible() -> None:
    parameters = {"a": Parameter(0.5, min=0.1, max=2.0), "idle": Parameter(1, 0.5, 2)}
    with pytest.raises(InputError, match="'idle'"):
        searched(
            LeastSquares.from_function(lambda theta: theta[0] * TIMES, TIMES, parameters),
            GlobalSearch("multi-start", starts=3),
        )


def interrupting(calls: int) -> tuple[LeastSquares, list[float]]:
    """Return the sinusoid whose user presses Ctrl-C once, after some simulations, and where it was simulated."""
    seen: list[float] = []

    def simulate(theta: Floats) -> Floats:
        seen.append(theta[0])
        if len(seen) == calls:
            raise KeyboardInterrupt
        return np.asarray(np.sin(theta[0] * TIMES))

    parameters = {"w": Parameter(12.0, min=RANGE[0], max=RANGE[1])}
    return LeastSquares.from_function(simulate, sinusoid().measured, parameters), seen


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "calls", "complete", "fitted"),
    [
        ("differential-evolution", 150, 120, False),
        ("differential-evolution", 800, 120, True),
        ("multi-start", 48, 40, False),
        ("multi-start", 2400, 2300, True),
    ],
)
def test_interruption_keeps_the_best(method: Strategy, calls: int, complete: int, fitted: bool) -> None:
    """No worse than any point of a complete generation or fit, with its uncertainty if a fit has it."""
    problem, seen = interrupting(calls)
    found = searched(problem, GlobalSearch(method, starts=40))
    assert found.outcome is TerminationReason.INTERRUPTED
    assert not found.converged
    assert len(seen) == calls  # who interrupts waits for nothing more to be simulated
    assert sum(o.hits for o in found.history.optima) == found.history.fits
    assert len(found.history.optima) < 40
    squares = [((np.sin(w * TIMES) - problem.measured) ** 2).sum() for w in seen[:complete]]
    assert ((np.sin(found["w"] * TIMES) - problem.measured) ** 2).sum() <= 1.0001 * min(squares)
    assert np.isfinite(found.std).all() == fitted == (found.fit.linearization is not None)


def test_interruption_before_the_first_fit() -> None:
    with pytest.raises(KeyboardInterrupt):
        searched(interrupting(3)[0])
