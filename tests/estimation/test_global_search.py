"""Global search: against dense grids and closed forms, on costs with known secondary optima, and through failures."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize_scalar

from fmuid import GlobalSearch, InputError, Noise, Normal, Parameter, Result
from fmuid.array_types import Floats
from fmuid.estimation import Evaluator, LeastSquares, TerminationReason, misfits, optima_table
from fmuid.estimation.global_search import Strategy
from fmuid.events import Event, GlobalStep
from fmuid.identification import identify
from tests.support.quick import first
from tests.support.sinusoids import FREQUENCY, METHODS, RANGE, TIMES, box, dense_minima, of_search, searched, sinusoid

# Minima lie 2 to 8 rad/s apart; at the flattest ones, with large residuals, the search ends within this.
NEAR = 0.05


def optima(found: Result) -> pd.DataFrame:
    return optima_table(found.names, found.history.optima)


def frequencies(found: Result) -> Floats:
    return optima(found)["w"].to_numpy()


# --- what is found ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def found() -> dict[Strategy, tuple[Result, list[GlobalStep]]]:
    """The searches for one frequency, and their events."""
    results: dict[Strategy, tuple[Result, list[GlobalStep]]] = {}
    for method in METHODS:
        events: list[Event] = []
        results[method] = searched(sinusoid(), GlobalSearch(method, starts=40), events.append), of_search(events)
    return results


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_search_finds_the_best_of_many_optima(
    method: Strategy, found: dict[Strategy, tuple[Result, list[GlobalStep]]]
) -> None:
    """Marquardt's search alone ends in the nearest secondary optimum."""
    minima, squares = dense_minima()
    best, (result, steps) = minima[np.argmin(squares)], found[method]
    alone = identify(sinusoid())
    assert alone.converged
    assert np.abs(alone["w"] - minima[minima != best]).min() < 2e-3
    assert result.converged
    assert result["w"] == frequencies(result)[0] == pytest.approx(best, abs=2e-3)
    for w in frequencies(result):  # secondary optima, each once
        assert np.abs(w - minima).min() < NEAR or not RANGE[0] < w < RANGE[1]
    assert min(abs(a - b) for a, b in itertools.combinations(frequencies(result), 2)) > 1.0
    assert (np.diff(optima(result).iloc[:, 0]) >= 0).all()
    first = "evolution" if method == "differential-evolution" else "spread"
    assert [phase for phase, _ in itertools.groupby(s.task for s in steps)] == [first, "fits"]
    for _, phase in itertools.groupby(steps, lambda s: s.task):
        done = [s.done for s in phase]
        assert done == sorted(set(done))
    assert all(s.done <= s.total for s in steps)
    assert (np.diff([s.cost for s in steps]) <= 0).all()
    assert steps[-1].values["w"] == pytest.approx(result["w"], rel=1e-6)
    assert result.history.simulations >= steps[-1].simulations


@pytest.mark.slow
@pytest.mark.parametrize("variance", [0.04, None])
def test_multistart_lists_all_optima_in_order(variance: float | None) -> None:
    """The minima of the grid and the ends of the box, each once; the cost by the given or the best's variance."""
    minima, squares = dense_minima()
    noise = None if variance is None else Noise(variance)
    found = searched(sinusoid(noise=noise), GlobalSearch("multi-start", starts=100))
    inside = [o for o in found.history.optima if RANGE[0] < o.theta[0] < RANGE[1]]
    np.testing.assert_allclose([o.theta[0] for o in inside], minima[np.argsort(squares)], atol=NEAR)
    unit = variance or min(squares) / (TIMES.size - 1)
    np.testing.assert_allclose([o.criterion for o in inside], np.sort(squares) / unit, rtol=1e-4)
    assert sum(o.hits for o in found.history.optima) == found.history.fits == 100
    assert len(found.history.optima) <= minima.size + 2
    assert all(o.converged for o in found.history.optima)


VALLEY = {"a": Parameter(1.0, min=0.5, max=4.0), "b": Parameter(1.0, min=0.5, max=4.0)}
DECAY = {"a": Parameter(1.0, min=0.1, max=10.0), "k": Parameter(1.0, min=0.1, max=50.0)}


@pytest.mark.parametrize("method", first(1, METHODS))
def test_valleys_and_perfect_data_have_one_optimum(method: Strategy) -> None:
    """Of y = a b t only a b is identifiable; without noise the costs of the fits are rounding."""
    measured = 2.0 * TIMES + 0.1 * np.random.default_rng(2).normal(size=TIMES.size)
    valley = LeastSquares.from_function(lambda theta: theta[0] * theta[1] * TIMES, measured, VALLEY)
    found = searched(valley, GlobalSearch(method, starts=12))
    (optimum,) = found.history.optima
    assert optimum.hits == found.history.fits
    assert optimum.hits >= (12 if method == "multi-start" else 1)
    assert not (optimum.converged or found.converged)
    assert optimum.outcome is TerminationReason.UNDETERMINED
    assert optimum.theta[0] * optimum.theta[1] == pytest.approx(2.0, abs=0.1)
    perfect = LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * TIMES), 3.0 * np.exp(-5.0 * TIMES), DECAY)
    found = searched(perfect, GlobalSearch(method, starts=20))
    assert len(found.history.optima) == 1
    np.testing.assert_allclose(found.values, [3.0, 5.0], rtol=1e-5)


def test_prior_decides_between_equal_optima() -> None:
    """Y = θ² t has the optima ±θ̂; a prior around one of them makes them differ by its own rows only (1.37)."""
    measured = 4.0 * TIMES + 0.1 * np.random.default_rng(1).normal(size=TIMES.size)
    parameter = Parameter(-1.0, min=-5.0, max=5.0, prior=Normal(2.5, 1.0))
    problem = LeastSquares.from_function(lambda theta: theta**2 * TIMES, measured, {"a": parameter}, noise=Noise(0.01))
    found = searched(problem, GlobalSearch("multi-start", starts=16))
    assert len(found.history.optima) == 2
    right, left = (o.theta[0] for o in found.history.optima)
    assert (right, left) == pytest.approx((2.0, -2.0), abs=0.05)
    rows = (left - 2.5) ** 2 - (right - 2.5) ** 2
    data = [np.sum((measured - o.theta[0] ** 2 * TIMES) ** 2) / 0.01 for o in found.history.optima]
    best, second = found.history.optima[:2]
    assert second.criterion - best.criterion == pytest.approx(rows + data[1] - data[0])


# --- the criterion that is compared -----------------------------------------------------


def test_concentrated_cost_is_the_least_over_the_variance() -> None:
    """Σ K ln s² + K is the least of J/σ² + K ln σ² over σ²; known variances and priors enter as they are."""
    problem, thetas = sinusoid(), np.array([[5.0], [FREQUENCY]])
    got = misfits(Evaluator(problem), thetas).concentrated(problem)
    for theta, value in zip(thetas[:, 0], got, strict=True):
        squares = float(np.sum((problem.measured - np.sin(theta * TIMES)) ** 2))
        least = minimize_scalar(lambda log, s=squares: s * np.exp(-log) + TIMES.size * log, (-8.0, 3.0))
        assert value + TIMES.size == pytest.approx(least.fun, rel=1e-9)
    measured = np.random.default_rng(3).normal(size=(30, 2))
    problem = LeastSquares.from_function(
        lambda theta: np.full((30, 2), theta[0]),
        measured,
        {"a": Parameter(1.0, prior=Normal(0.5, 0.2))},
        outputs=("x", "y"),
        noise=Noise({"x": 0.3}),
    )
    x, y = np.sum((measured - 0.7) ** 2, axis=0)
    expected = x / 0.3 + 30 * np.log(y / 30) + (0.7 - 0.5) ** 2 / 0.2**2
    assert misfits(Evaluator(problem), np.array([[0.7]])).concentrated(problem)[0] == pytest.approx(expected)


# --- seeds, failures, interruption, settings --------------------------------------------


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"method": "evolutoin"}, "evolutoin"),
        ({"starts": 4}, "starts.*5.*4"),
        ({"starts": 0, "method": "multi-start"}, "starts.*1.*0"),
        ({"starts": 5.5}, "starts.*5.5"),
        ({"seed": -1}, "seed.*0.*-1"),
        ({"generations": True}, "generations.*True"),
    ],
)
def test_settings_are_refused(settings: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        GlobalSearch(**settings)  # type: ignore[arg-type]


def test_robust_loss_is_refused() -> None:
    parameters = {"w": Parameter(1.0, 0.5, 2.0)}
    with pytest.raises(InputError, match="global search"):
        searched(LeastSquares.from_function(lambda theta: theta * TIMES, TIMES, parameters, loss="huber"))


def fragile(limit: float) -> LeastSquares:
    """Return the sinusoid with a simulation that fails below a frequency."""

    def simulate(theta: Floats) -> Floats:
        if theta[0] < limit:
            raise FloatingPointError("too slow")
        return np.asarray(np.sin(theta[0] * TIMES))

    return LeastSquares.from_function(simulate, sinusoid().measured, {"w": Parameter(5.0, min=RANGE[0], max=RANGE[1])})


@pytest.mark.parametrize("method", METHODS)
def test_nothing_but_failures(method: Strategy) -> None:
    with pytest.raises(InputError, match=r"all \d+ simulations.*too slow"):
        searched(fragile(100.0), GlobalSearch(method, starts=6))


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


# --- the box ----------------------------------------------------------------------------


def test_box_is_logarithmic_over_decades_and_from_a_prior() -> None:
    found = box(
        wide=Parameter(1.0, min=0.1, max=10.0),
        narrow=Parameter(1.0, min=1.0, max=9.0),
        signed=Parameter(1.0, min=-10.0, max=10.0),
        zero=Parameter(1.0, min=0.0, max=10.0),
    )
    assert found.logarithmic.tolist() == [True, False, False, False]
    np.testing.assert_allclose(found.thetas(np.full((1, 4), 0.5)), [[1.0, 5.0, 0.0, 5.0]])
    corners = found.thetas(np.array([np.zeros(4), np.ones(4)]))
    np.testing.assert_allclose(corners, [found.lower, found.upper], rtol=1e-15)
    assert (corners >= found.lower).all()
    assert (corners <= found.upper).all()
    units = np.random.default_rng(0).uniform(size=(50, 4))
    np.testing.assert_allclose(found.units(found.thetas(units)), units, atol=1e-12)
    np.testing.assert_array_equal(found.units(np.array([[100.0, -1.0, -11.0, 5.0]])), [[1.0, 0.0, 0.0, 0.5]])
    found = box(a=Parameter(1.0, prior=Normal(2.0, 0.1)), b=Parameter(1.0, min=0.0, prior=Normal(2.0, 1.0)))
    np.testing.assert_allclose(found.lower, [1.5, 0.0])
    np.testing.assert_allclose(found.upper, [2.5, 7.0])
    for loose, word in ((Parameter(1.0, min=0.0), "max"), (Parameter(1.0, max=9.0), "min")):
        with pytest.raises(InputError, match=f"'Lf'.*{word}"):
            box(Rs=Parameter(1.0, min=0.0, max=2.0), Lf=loose)
