"""Stacking, masks, whitening, priors, refusals before the search, and parameters without effect at the start."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fmuid import Experiment, InputError, JointPrior, Marquardt, Noise, Parameter, Result, SimulationError
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import Evaluator, LeastSquares, prepare
from fmuid.identification import identify
from tests.support.problems import TIMES, Fake, simulate


def table(name: str = "run", counted: NDArray[np.bool_] | None = None, values: Floats | None = None) -> Experiment:
    measured = simulate(1.5, 2.0) if values is None else values
    return Experiment.of_arrays(name, TIMES, ("a", "b"), measured, ~np.isnan(measured) if counted is None else counted)


def two_runs() -> tuple[LeastSquares, list[Fake]]:
    fakes = [Fake(), Fake()]
    counted = np.ones((50, 2), dtype=np.bool_)
    counted[:10] = False
    counted[20, 1] = False
    problem = LeastSquares(
        fakes,
        [table("first"), table("second", counted)],
        {"k": Parameter(1.0), "gain": Parameter(3.0, per_experiment=True)},
        noise=Noise({"a": 4.0, "b": 1e-6}),
    )
    return problem, fakes


def test_samples_are_stacked_and_whitened_each_with_its_own_sigma() -> None:
    problem, _ = two_runs()
    assert problem.parameters.names == ("k", "gain[first]", "gain[second]")
    assert problem.counts.tolist() == [90, 89]
    theta = np.array([1.2, 2.1, 1.9])
    residual = prepare(Evaluator(problem)).criterion.residuals(theta[None])[0]
    sigma = np.array([2.0, 1e-3])
    first = (simulate(1.5, 2.0) - simulate(1.2, 2.1)) / sigma
    second = (simulate(1.5, 2.0) - simulate(1.2, 1.9)) / sigma
    expected = [*first.ravel(), *second[10:20].ravel(), second[20, 0], *second[21:].ravel()]
    np.testing.assert_allclose(residual, expected, rtol=1e-9, atol=1e-9)


def test_an_experiment_is_not_simulated_again_for_the_parameters_of_others() -> None:
    problem, fakes = two_runs()
    evaluator = Evaluator(problem)
    prepare(evaluator)
    assert evaluator.simulations == sum(len(thetas) for fake in fakes for thetas in fake.taken)
    before = evaluator.simulations
    evaluator.predict(np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0], [1.0, 2.5, 3.0]]))
    assert evaluator.simulations - before == 4
    assert fakes[0].taken[-1].tolist() == [[1.0, 2.0], [1.0, 2.5]]


def test_first_variances() -> None:
    """Given ones as they are, others from the residual at the start or from where the user starts them."""
    measured = simulate(1.5, 2.0)
    parameters = {"k": Parameter(1.0), "gain": Parameter(3.0)}

    def variance(noise: Noise) -> list[float]:
        problem = LeastSquares([Fake()], [table()], parameters, noise=noise)
        return list(prepare(Evaluator(problem)).criterion.variance)

    residual = np.mean((measured - simulate(1.0, 3.0)) ** 2, axis=0)
    assert variance(Noise()) == pytest.approx(residual)
    assert variance(Noise({"b": 7.0})) == pytest.approx([residual[0], 7.0])
    assert variance(Noise(5.0)) == [5.0, 5.0]
    assert variance(Noise(initial_variance={"a": 3.0})) == pytest.approx([3.0, residual[1]])


def ones(count: int, **parameters: Parameter) -> Any:
    return LeastSquares.from_function(lambda theta: theta[0] * np.ones(count), np.ones(5), parameters)


def of(function: Callable[[Floats], Floats], measured: Any, names: str, **words: Any) -> LeastSquares:
    return LeastSquares.from_function(function, measured, {name: Parameter(1.0) for name in names}, **words)


K, GAIN = {"k": Parameter(1.0)}, {"gain": Parameter(3.0)}
EMPTY = Experiment.of_arrays("run", TIMES, (), np.zeros((50, 0)), np.zeros((50, 0), dtype=np.bool_))
JOINT = JointPrior(["kk"], [1.0], [[1.0]])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: LeastSquares([Fake()], [table(counted=np.tile([True, False], (50, 1)))], K), "'b'.*no scored sample"),
        (lambda: LeastSquares([Fake()], [EMPTY], K), "no outputs"),
        (lambda: of(lambda theta: theta[:2], [1.0, 2.0], "abc"), "2 .*samples are too few for 3"),
        (lambda: of(lambda theta: theta, [1.0, 2.0], "ab"), "2 .*samples are too few for 2"),
        (lambda: LeastSquares([], [], K), "no experiments"),
        (lambda: LeastSquares([Fake()], [table()], {}), "no free parameters"),
        (lambda: LeastSquares([Fake()], [table()], K, noise=Noise({"bb": 1.0})), "'bb'"),
        (lambda: of(np.sin, np.ones((5, 2)), "k"), "one column for each of y"),
        (lambda: of(np.sin, np.ones(5), "k", times=[1.0]), "times must have 5"),
        (lambda: of(np.sin, np.ones(5), "k", joint_prior=JOINT), "'kk'"),
        (lambda: of(np.sin, np.ones(5), "k", loss="hubert"), "'hubert'.*'huber'"),
        (lambda: prepare(Evaluator(ones(4, k=Parameter(1.0)))), "shape"),
        (lambda: identify(ones(5, k=Parameter(1.0)), start=[1.0, 2.0]), r"1 values.*\(2,\)"),
        (lambda: prepare(Evaluator(ones(5, k=Parameter(1.0))), [1.0, 2.0]), "1 values"),
        (lambda: prepare(Evaluator(ones(5, k=Parameter(2.0, max=3.0))), [4.0]), "4 of 'k'.*bounds"),
        (lambda: prepare(Evaluator(LeastSquares([Fake()], [table()], {"k": Parameter(-1.0), **GAIN}))), "fmi2Error"),
        (
            lambda: prepare(Evaluator(of(lambda p: np.full(5, p[1] if p[0] == 1.0 else np.nan), np.ones(5), "kg"))),
            "'k'",
        ),
        (lambda: prepare(Evaluator(of(lambda theta: theta[0] * TIMES, TIMES, "gij"))), "'i'.*'j'"),
    ],
)
def test_impossible_problem_is_refused(make: Callable[[], object], said: str) -> None:
    """Before the first step."""
    with pytest.raises((InputError, SimulationError), match=said):
        make()


# --- parameters without effect at the start


CLOCK = np.arange(0.0, 6.0, 0.01)
SLIDE = {"m": 0.8, "Fc": 1.0, "d": 0.4}
DRIVE = 2.0 * np.sin(CLOCK) + np.sin(3.1 * CLOCK)


def slide(theta: Floats) -> Floats:
    """A mass with Coulomb and viscous friction under a force of at most 4, by an implicit step that sticks exactly."""
    m, dry, viscous = theta.tolist()
    out, v = np.empty(CLOCK.size), 0.0
    for i, t in enumerate(CLOCK.tolist()):
        out[i] = v
        free = v + 0.01 * (3.0 * np.sin(1.5 * t) + np.sin(4.0 * t) - viscous * v) / m
        stop = 0.01 * dry / m
        v = max(free - stop, 0.0) + min(free + stop, 0.0)
    return out


def dead_zone(theta: Floats) -> Floats:
    gain, width, drift = theta[:3]
    return np.asarray(gain * (np.maximum(DRIVE - width, 0.0) + np.minimum(DRIVE + width, 0.0)) + drift * CLOCK)


def noisy(y: Floats) -> Floats:
    return np.asarray(y + 0.02 * np.random.default_rng(1).standard_normal(y.size))


def check(result: Result, truth: list[float]) -> None:
    assert result.converged, result.outcome
    assert (np.abs(result.values - truth) < 4.0 * result.std).all()
    assert result.history.simulations < 400


@pytest.mark.parametrize(
    ("bounds", "start"), [({}, (2.0, 8.0, 1.0)), pytest.param({"min": 0.0}, (0.5, 5.0, 0.1), marks=pytest.mark.slow)]
)
def test_friction_at_rest(bounds: dict[str, Any], start: tuple[float, ...]) -> None:
    """Nothing moves at the start: neither friction nor mass shows until the Coulomb friction is less."""
    parameters = {name: Parameter(value, **bounds) for name, value in zip(SLIDE, start, strict=True)}
    assert not slide(np.array(start)).any()
    problem = LeastSquares.from_function(slide, noisy(slide(np.array(list(SLIDE.values())))), parameters)
    result = identify(problem)
    check(result, list(SLIDE.values()))
    replaced = result.identifiability.replaced_initial_guess
    assert "Fc" in replaced
    assert result.estimates.start[1] < 4.0
    assert as_json(result)["identifiability"]["replaced_initial_guess"] == list(replaced)


@pytest.mark.parametrize(("bounds", "fragile"), [({}, False), ({"min": 0.0, "max": 10.0}, True)])
def test_dead_zone_that_nothing_leaves(bounds: dict[str, Any], fragile: bool) -> None:
    """Points of the box that cannot be simulated are no reason to refuse."""

    def function(theta: Floats) -> Floats:
        if fragile and theta[1] < 0.5:
            raise ZeroDivisionError
        return dead_zone(theta)

    parameters = {"gain": Parameter(1.0), "width": Parameter(6.0, **bounds), "drift": Parameter(0.2)}
    result = identify(LeastSquares.from_function(function, noisy(dead_zone(np.array([1.5, 0.9, 0.1]))), parameters))
    check(result, [1.5, 0.9, 0.1])
    assert result.identifiability.replaced_initial_guess == ("width",)
    assert result.estimates.start[[0, 2]].tolist() == [1.0, 0.2]


def test_parameter_without_effect_anywhere_is_refused() -> None:
    parameters = {"gain": Parameter(1.0), "width": Parameter(6.0), "drift": Parameter(0.2), "idle": Parameter(3.0)}
    problem = LeastSquares.from_function(dead_zone, noisy(dead_zone(np.array([1.5, 0.7, 0.1]))), parameters)
    with pytest.raises(InputError, match=r"'idle'.*40 "):
        Marquardt().search(evaluator := Evaluator(problem))
    assert evaluator.simulations < 120
