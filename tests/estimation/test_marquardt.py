"""The search against closed forms and scipy: bounds, failing regions, noise, limits."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import curve_fit, lsq_linear

from fmuid import InputError, Marquardt, Parameter
from fmuid.array_types import Floats
from fmuid.estimation import (
    Descent,
    Evaluator,
    Iteration,
    LeastSquares,
    LinearModel,
    State,
    TerminationReason,
    prepare,
    triangle,
)
from fmuid.estimation.search.marquardt import iterate
from fmuid.estimation.search.trust_region import REGION, Step, TrustRegion

TIMES = np.linspace(0.0, 3.0, 120)
TRUTH = np.array([3.0, 1.2, 0.5])


def decay(theta: Floats) -> Floats:
    return model(TIMES, *theta.tolist())


def model(t: Floats, a: float, k: float, c: float) -> Floats:
    return np.asarray(a * np.exp(-k * t) + c, dtype=np.float64)


def jacobian(t: Floats, a: float, k: float, _c: float) -> Floats:
    return np.column_stack([np.exp(-k * t), -a * t * np.exp(-k * t), np.ones_like(t)])


def measured(std: float = 0.05, seed: int = 2) -> Floats:
    return decay(TRUTH) + std * np.random.default_rng(seed).standard_normal(TIMES.size)


def run(
    function: Callable[[Floats], Floats],
    y: Floats,
    parameters: list[Parameter],
    settings: Marquardt | None = None,
    rough: bool = False,
) -> tuple[State, list[Iteration], Evaluator[LeastSquares]]:
    problem = LeastSquares.from_function(function, y, {f"p{i}": p for i, p in enumerate(parameters)})
    evaluator = Evaluator(problem)
    start = prepare(evaluator)
    state = State(start.theta, start.residual, start.jacobian)
    states = list(iterate(Descent(settings or Marquardt(), rough), start.criterion, state))
    return states[-1], [each.last for each in states if each.last is not None], evaluator


STARTS = [Parameter(1.0), Parameter(3.0), Parameter(-1.0)]


@pytest.fixture(scope="module")
def free() -> tuple[State, list[Iteration], int]:
    """The search without bounds and failures."""
    state, trace, evaluator = run(decay, measured(), STARTS)
    return state, trace, evaluator.simulations


def test_search_finds_the_optimum_of_scipy(free: tuple[State, list[Iteration], int]) -> None:
    state, trace, simulations = free
    exact, _, _ = run(decay, measured(), STARTS, Marquardt(tolerance=1e-9))
    reference = curve_fit(model, TIMES, measured(), TRUTH, jac=jacobian, xtol=1e-15, ftol=1e-15)[0]
    assert state.outcome is TerminationReason.CONVERGED
    np.testing.assert_allclose(state.theta, reference, rtol=3e-6)
    np.testing.assert_allclose(exact.theta, reference, rtol=1e-8)
    assert simulations < 60
    accepted = [i.criterion for i in trace if i.accepted]
    assert all(after <= before for before, after in itertools.pairwise(accepted))
    assert [i.number for i in trace] == list(range(len(trace)))
    assert trace[0].theta.tolist() == [1.0, 3.0, -1.0]
    perfect, _, _ = run(decay, decay(TRUTH), STARTS)  # data without noise are fitted to rounding
    assert perfect.outcome is not None
    assert perfect.outcome.converged
    np.testing.assert_allclose(perfect.theta, TRUTH, rtol=1e-9)


@pytest.mark.parametrize("radius", [0.1, 1.0, 3.0])
def test_damped_step_solves_marquardts_equation(radius: float) -> None:
    """[JᵀJ + λD²] p = −Jᵀr with the λ that is reported, and ‖D p‖ near the radius (1.16)."""
    rng = np.random.default_rng(5)
    jacobian, residual = rng.standard_normal((30, 4)) * [1.0, 10.0, 0.1, 1.0], 20.0 * rng.standard_normal(30)
    lengths, far, small = np.linalg.norm(jacobian, axis=0), np.full(4, np.inf), triangle(jacobian, residual)
    step = LinearModel(small, lengths).step(-far, far, radius)
    assert step.damping > 0
    matrix = jacobian.T @ jacobian + step.damping * np.diag(lengths**2)
    np.testing.assert_allclose(step.step, -np.linalg.solve(matrix, jacobian.T @ residual), rtol=1e-9)
    assert np.linalg.norm(lengths * step.step) == pytest.approx(radius, rel=0.11)
    after = residual + jacobian @ step.step
    assert step.predicted == pytest.approx(residual @ residual - after @ after, rel=1e-9)
    assert small.shape == (5, 5)
    assert np.linalg.norm(small @ np.append(step.step, 1.0)) == pytest.approx(np.linalg.norm(after), rel=1e-12)


def test_bounded_steps_are_those_of_scipy() -> None:
    """Stopping at the bounds one after the other never leaves them, and finds what lsq_linear finds in most cases."""
    rng, same = np.random.default_rng(6), 0
    for _ in range(50):
        jacobian, residual = rng.standard_normal((12, 3)), rng.standard_normal(12)
        lower, upper = -0.3 * rng.random(3), 0.3 * rng.random(3)
        step = LinearModel(triangle(jacobian, residual), np.linalg.norm(jacobian, axis=0)).step(lower, upper)
        assert (step.step >= lower).all()
        assert (step.step <= upper).all()
        assert step.predicted > 0
        best = lsq_linear(jacobian, -residual, (lower, upper), tol=1e-14)
        same += bool(np.allclose(step.step, best.x, atol=1e-6))
    assert same >= 45


def test_start_on_a_bound_leaves_it(free: tuple[State, list[Iteration], int]) -> None:
    starts = [Parameter(1.0, min=1.0), Parameter(3.0, max=3.0), Parameter(0.0, min=0.0, nominal=1.0)]
    state, trace, _ = run(decay, measured(), starts)
    assert not state.held.any()
    np.testing.assert_allclose(state.theta, free[0].theta, rtol=3e-6)
    thetas = np.array([each.theta for each in trace])
    assert (thetas[:, [0, 2]] >= [1.0, 0.0]).all()
    assert (thetas[:, 1] <= 3.0).all()


@pytest.mark.parametrize("raises", [False, True])
def test_points_that_fail_are_rejected(raises: bool, free: tuple[State, list[Iteration], int]) -> None:
    """The first steps overshoot into a region that cannot be simulated."""

    def fragile(theta: Floats) -> Floats:
        if theta[1] < 0.9 or theta[0] > 3.4:
            if raises:
                raise ZeroDivisionError
            return np.full(TIMES.size, np.nan)
        return decay(theta)

    state, trace, _ = run(fragile, measured(), [Parameter(0.2), Parameter(2.5), Parameter(-1.0)])
    assert any(not i.accepted and np.isnan(i.criterion) for i in trace)
    assert state.outcome is TerminationReason.CONVERGED
    np.testing.assert_allclose(state.theta, free[0].theta, rtol=3e-6)


def test_simulations_that_all_fail_around_a_point_end_the_search() -> None:
    armed = False

    def breaking(theta: Floats) -> Floats:
        return np.full(TIMES.size, np.nan) if armed else decay(theta)

    problem = LeastSquares.from_function(breaking, measured(), {f"p{i}": p for i, p in enumerate(STARTS)})
    start = prepare(Evaluator(problem))
    state = State(start.theta, start.residual, start.jacobian)
    states = iterate(Descent(Marquardt()), start.criterion, state)
    next(states), next(states)
    armed = True
    left = list(states)
    assert len(left) < 20
    state = left[-1]
    assert state.outcome is TerminationReason.FAILING


def test_units_do_not_matter(free: tuple[State, list[Iteration], int]) -> None:
    """The same problem with the parameters in other units takes the same steps."""
    units = np.array([1e-6, 1e3, 1.0])
    starts = [Parameter(u * p.start) for u, p in zip(units, STARTS, strict=True)]
    scaled, other, _ = run(lambda theta: decay(theta / units), measured(), starts)
    np.testing.assert_allclose(scaled.theta / units, free[0].theta, rtol=1e-6)
    assert len(free[1]) == len(other)


@pytest.mark.parametrize("words", [{"max_iterations": 0}, {"tolerance": 0.0}, {"tolerance": "x"}])
def test_settings_are_refused(words: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(words))):
        Marquardt(**words)  # type: ignore[arg-type]


def test_radius_follows_the_parabola_along_the_step() -> None:
    """J(t) = J(0) + 2 slope t + bend t² along the step, with J(0) - J(1) = fall."""
    step = Step(np.ones(2), 1.0, 4.0, np.zeros(2, np.bool_))
    for slope, fall, share in (
        (-1.0, -2.0, 0.25),  # 1 - 2t + 4t² rises by 2 and has its least value at a quarter of the step
        (-1.0, -0.5, 0.4),
        (-1.0, -30.0, REGION.shrink_most),  # at 1/32: not as short at once
        (-1.0, 0.2, REGION.shrink_least),  # at 0.56
        (0.5, -0.2, REGION.shrink_least),  # bends downwards: it has none
        (-4.0, 3.9, REGION.grow),  # a good step lengthens the next
    ):
        radius, good = TrustRegion.of(8.0).judged(step, 5.0, fall, slope, 0.0, moved=True)
        assert radius.value == pytest.approx(share * 5.0)
        assert good == (fall > 0.0)
    radius, good = radius.judged(step, 5.0, 2.0, -4.0, 0.0, moved=True)  # half of the prediction
    assert (good, radius.value) == (True, REGION.grow * 5.0)
