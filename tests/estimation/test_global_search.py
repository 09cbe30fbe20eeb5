"""Global search: against dense grids and closed forms, on criteria with known secondary optima."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize_scalar

from fmuid.array_types import Floats
from fmuid.data import Normal, Parameter
from fmuid.data.data_file import read_data
from fmuid.data.noise import Noise
from fmuid.errors import InputError
from fmuid.estimation import global_search
from fmuid.estimation.cost_components import misfits
from fmuid.estimation.estimate import Marquardt
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.global_search import GlobalSearch, Strategy, optima_table
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.search.loop import TerminationReason
from fmuid.events import Event
from fmuid.identification import Problem, identify
from tests.support.paths import ROOT
from tests.support.sinusoids import FREQUENCY, METHODS, RANGE, TIMES, dense_minima, of_search, searched, sinusoid

# Minima lie 2 to 8 rad/s apart; at the flattest ones, with large residuals, the search ends within this.
NEAR = 0.05


def optima(found: Result) -> pd.DataFrame:
    return optima_table(found.names, found.history.optima)


def frequencies(found: Result) -> Floats:
    return optima(found)["w"].to_numpy()


# --- what is found ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "seed"), [("differential-evolution", 0), ("differential-evolution", 1), ("multi-start", 0)]
)
def test_finds_the_best_of_many_optima(method: Strategy, seed: int) -> None:
    """Marquardt's search alone ends in the nearest secondary optimum."""
    minima, squares = dense_minima()
    best = minima[np.argmin(squares)]
    assert minima.size > 10
    alone = identify(sinusoid())
    assert alone.converged
    assert np.abs(alone["w"] - minima[minima != best]).min() < 2e-3
    found = searched(sinusoid(), GlobalSearch(method, seed=seed))
    assert found.converged
    assert found["w"] == pytest.approx(best, abs=2e-3)
    assert found["w"] == frequencies(found)[0]
    assert found.names == ("w",)


@pytest.mark.slow
def test_multistart_lists_all_optima_in_order() -> None:
    """The grid's minima and the ends of the box, each once, their criterion being the grid's sums of squares."""
    minima, squares = dense_minima()
    found = searched(sinusoid(noise=Noise(0.04)), GlobalSearch("multi-start", starts=100))
    inside = [o for o in found.history.optima if RANGE[0] < o.theta[0] < RANGE[1]]
    order = np.argsort(squares)
    np.testing.assert_allclose([o.theta[0] for o in inside], minima[order], atol=NEAR)
    np.testing.assert_allclose([o.criterion for o in inside], squares[order] / 0.04, rtol=1e-5)
    assert sum(o.hits for o in found.history.optima) == found.history.fits == 100
    assert len(found.history.optima) <= minima.size + 2
    assert all(o.converged for o in found.history.optima)
    criteria = optima(found)["criterion"].to_numpy()
    assert (np.diff(criteria) >= 0).all()


@pytest.mark.slow
def test_evolution_lists_secondary_optima_once() -> None:
    minima, _ = dense_minima()
    found = searched(sinusoid())
    assert len(found.history.optima) >= 3
    for w in frequencies(found):
        inside = RANGE[0] < w < RANGE[1]
        assert np.abs(w - minima).min() < NEAR or not inside
    gaps = [abs(a - b) for a, b in itertools.combinations(frequencies(found), 2)]
    assert min(gaps) > 1.0


@pytest.mark.slow
def test_criterion_of_estimated_variance_is_relative_to_the_best() -> None:
    """With σ̂² = J/(K − 1) of the best, its criterion is K − 1 and the others' are in proportion."""
    minima, squares = dense_minima()
    found = searched(sinusoid(), GlobalSearch("multi-start", starts=12))
    first, second = (squares[np.argmin(np.abs(minima - o.theta[0]))] for o in found.history.optima[:2])
    assert found.history.optima[0].criterion == pytest.approx(TIMES.size - 1, rel=1e-6)
    assert found.history.optima[1].criterion == pytest.approx((TIMES.size - 1) * second / first, rel=1e-4)


def test_the_start_takes_part() -> None:
    """One start alone is the parameters' own, and gives what an identification gives."""
    found = searched(sinusoid(), GlobalSearch("multi-start", starts=1))
    alone = identify(sinusoid())
    assert found["w"] == alone["w"]
    assert found.estimates.start[0] == 12.0


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


@pytest.mark.parametrize("method", METHODS)
def test_valley_is_one_optimum(method: Strategy) -> None:
    """Of y = a b t only a b is determined: wherever in the valley the fits end is one optimum, and not converged."""
    problem = LeastSquares.from_function(
        lambda theta: theta[0] * theta[1] * TIMES,
        2.0 * TIMES + 0.1 * np.random.default_rng(2).normal(size=TIMES.size),
        {"a": Parameter(1.0, min=0.5, max=4.0), "b": Parameter(1.0, min=0.5, max=4.0)},
    )
    found = searched(problem, GlobalSearch(method, starts=12))
    (optimum,) = found.history.optima
    assert optimum.hits == found.history.fits
    assert optimum.hits >= (12 if method == "multi-start" else 1)
    assert not optimum.converged
    assert not found.converged
    assert optimum.outcome is TerminationReason.UNDETERMINED
    assert optimum.theta[0] * optimum.theta[1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_perfect_data_give_one_optimum(method: Strategy) -> None:
    """Without noise the criteria of the fits differ by orders of magnitude, being rounding; they are one optimum."""
    problem = LeastSquares.from_function(
        lambda theta: theta[0] * np.exp(-theta[1] * TIMES),
        3.0 * np.exp(-5.0 * TIMES),
        {"a": Parameter(1.0, min=0.1, max=10.0), "k": Parameter(1.0, min=0.1, max=50.0)},
    )
    found = searched(problem, GlobalSearch(method, starts=20))
    assert len(found.history.optima) == 1
    np.testing.assert_allclose(found.values, [3.0, 5.0], rtol=1e-5)


def test_induction_machine_from_a_wide_box() -> None:
    """From four boxes of a decade and more, the same estimates as from a start beside the truth."""
    from fmuid.data.experiment import Experiment

    table = ROOT / "experiments" / "induction_machine" / "table.csv"
    experiment = Experiment(read_data(table), inputs=["uds", "uqs", "w"], outputs=["ids", "iqs"])
    box = {"Rs": (1.0, 50.0), "Rr": (0.5, 20.0), "Lm": (0.05, 2.0), "Lf": (0.005, 0.5)}
    truth = np.array([9.8, 3.8, 0.436, 0.0762])
    problem = Problem(
        ROOT / "fmus" / "InductionMachine" / "InductionMachine.fmu",
        experiment,
        {name: Parameter(start=high, min=low, max=high) for name, (low, high) in box.items()},
    )
    found = searched(problem, GlobalSearch(starts=32))
    assert found.converged
    assert (np.abs(found.values - truth) < 4.0 * found.std).all()
    local = identify(problem, start=truth)
    assert (np.abs(found.values - local.values) < 0.01 * local.std).all()
    assert not (optima(found)["criterion"][1:] < found.history.optima[0].criterion + 1.0).any()


# --- the criterion that is compared -----------------------------------------------------


def test_concentrated_criterion_is_the_least_over_the_variance() -> None:
    """Σ K ln s² + K is the least of J/σ² + K ln σ² over σ² (minus twice the logarithm of the likelihood)."""
    problem = sinusoid()
    thetas = np.array([[5.0], [FREQUENCY]])
    got = misfits(Evaluator(problem), thetas).concentrated(problem)
    for theta, value in zip(thetas[:, 0], got, strict=True):
        squares = np.sum((problem.measured - np.sin(theta * TIMES)) ** 2)

        def negative(log: float, squares: float = squares) -> float:
            return float(squares * np.exp(-log) + TIMES.size * log)

        assert value + TIMES.size == pytest.approx(minimize_scalar(negative, (-8.0, 3.0)).fun, rel=1e-9)


def test_given_variances_and_priors_enter_the_criterion() -> None:
    """One output of known variance, one of unknown, and a prior."""
    rng = np.random.default_rng(3)
    measured = rng.normal(size=(30, 2))
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


# --- seeds, progress, interruption, settings --------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_seed_makes_it_repeatable(method: Strategy) -> None:
    steps: dict[int, list[float]] = {}
    tables = []
    for run, seed in enumerate((5, 5, 6)):
        seen: list[Event] = []
        tables.append(optima(searched(sinusoid(), GlobalSearch(method, starts=20, seed=seed), seen.append)))
        steps[run] = [step.criterion for step in of_search(seen)]
    assert steps[0] == steps[1] != steps[2]
    assert tables[0].equals(tables[1])


@pytest.mark.parametrize("method", METHODS)
def test_progress(method: Strategy) -> None:
    events: list[Event] = []
    problem = sinusoid()
    found = searched(problem, GlobalSearch(method, starts=10), events.append)
    steps = of_search(events)
    first = "evolution" if method == "differential-evolution" else "spread"
    assert [phase for phase, _ in itertools.groupby(s.task for s in steps)] == [first, "fits"]
    for _, phase in itertools.groupby(steps, lambda s: s.task):
        done = [s.done for s in phase]
        assert done == sorted(set(done))
    assert all(s.done <= s.total for s in steps)
    assert (np.diff([s.criterion for s in steps]) <= 0).all()
    assert steps[-1].values["w"] == pytest.approx(found["w"], rel=1e-6)
    assert found.history.simulations >= steps[-1].simulations


@pytest.mark.slow
def test_best_fit_is_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits get few iterations, but what they leave of the best one's way is gone after them."""
    monkeypatch.setattr(global_search, "FIT_ITERATIONS", 1)
    found = searched(sinusoid(), GlobalSearch("multi-start"))
    assert found.converged
    assert not all(o.converged for o in found.history.optima)
    minima, squares = dense_minima()
    assert found["w"] == pytest.approx(minima[np.argmin(squares)], abs=2e-3)
    limited = searched(sinusoid(), GlobalSearch("multi-start", marquardt=Marquardt(max_iterations=1)))
    assert not limited.converged


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"method": "evolutoin"}, "must be 'differential-evolution' or 'multi-start', not 'evolutoin'"),
        ({"starts": 4}, "starts of a global search must be a whole number from 5 on, not 4"),
        ({"starts": 0, "method": "multi-start"}, "starts .* from 1 on, not 0"),
        ({"starts": 5.5}, "starts .* not 5.5"),
        ({"seed": -1}, "seed .* from 0 on, not -1"),
        ({"generations": True}, "generations .* not True"),
    ],
)
def test_wrong_settings(settings: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        GlobalSearch(**settings)  # type: ignore[arg-type]


def test_a_robust_loss_is_refused() -> None:
    problem = LeastSquares.from_function(
        lambda theta: theta * TIMES, TIMES, {"w": Parameter(1.0, 0.5, 2.0)}, loss="huber"
    )
    with pytest.raises(InputError, match="a global search knows plain squares only"):
        searched(problem)
