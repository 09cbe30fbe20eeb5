"""What an error of the simulation does to estimates: against fits to data from which it is taken away."""

import math

import numpy as np
import pytest

from fmuid import Normal, Parameter
from fmuid.array_types import Floats
from fmuid.estimation import AccuracyOutcome, LeastSquares, estimate_solver_error, with_shift
from fmuid.identification import identify

TIMES = np.linspace(0.0, 1.0, 60)
BASIS = np.column_stack([np.ones(60), TIMES, TIMES**2])
NAMES = ("a", "b", "c")
ERROR = 0.02 * np.sin(5.0 * TIMES)


def problem(noise: float = 0.05, loss: str = "linear", prior: bool = False, columns: Floats = BASIS) -> LeastSquares:
    rng = np.random.default_rng(5)
    measured = BASIS @ [1.0, -2.0, 0.5] + noise * rng.standard_normal(60)
    given = Normal(-2.0, 0.05) if prior else None
    parameters = {name: Parameter(1.0, prior=given if name == "b" else None) for name in NAMES}
    return LeastSquares.from_function(lambda theta: columns @ theta, measured, parameters, loss=loss)


@pytest.mark.parametrize("prior", [False, True])
def test_the_shift_of_a_linear_model(prior: bool) -> None:
    """A finer simulation that gives ERROR more has its optimum where the data less ERROR have theirs."""
    one = problem(prior=prior)
    result = identify(one)
    sigma = math.sqrt(result.fit.noise_variance["y"])
    rows, values = BASIS / sigma, (one.measured - ERROR) / sigma
    if prior:
        rows, values = np.vstack([rows, [0.0, 1.0 / 0.05, 0.0]]), np.append(values, -2.0 / 0.05)
    moved = np.linalg.lstsq(rows, values)[0] - result.values
    found = estimate_solver_error(one, result, ERROR)
    assert found.shift * result.std == pytest.approx(moved, rel=2e-3)
    assert found.outcome is AccuracyOutcome.SHIFTED
    assert (np.abs(found.shift) <= found.change).all()


@pytest.mark.parametrize(
    ("noise", "error", "outcome"),
    [
        (0.05, 1e-3 * ERROR, AccuracyOutcome.PASSED),
        (0.05, np.zeros(60), AccuracyOutcome.UNCHECKABLE),
        (0.05, np.where(TIMES > 0.5, np.nan, ERROR), AccuracyOutcome.FAILED),
        (1e-12, 1e-7 * np.ones(60), AccuracyOutcome.PASSED),  # thousands of σ of a fit to rounding, and still nothing
    ],
)
def test_outcome(noise: float, error: Floats, outcome: AccuracyOutcome) -> None:
    one = problem(noise=noise)
    found = estimate_solver_error(one, identify(one), error)
    assert found.outcome is outcome
    assert np.isnan(found.shift).all() == (outcome is not AccuracyOutcome.PASSED)
    assert outcome is not AccuracyOutcome.PASSED or 0.0 < found.largest < 0.1 or noise < 1e-3


def test_where_a_standard_deviation_is_infinite() -> None:
    """Two parameters that act alike: their shift is not known, and not 0; that of the third is."""
    one = problem(columns=BASIS[:, [0, 0, 1]])
    result = identify(one)
    found = estimate_solver_error(one, result, ERROR)
    assert np.isnan(found.shift).tolist() == [True, True, False]
    assert estimate_solver_error(one, result, 1e-9 * ERROR).outcome is AccuracyOutcome.PASSED
    orthogonal = ERROR - BASIS[:, :2] @ np.linalg.lstsq(BASIS[:, :2], ERROR)[0]
    assert estimate_solver_error(one, result, orthogonal).outcome is AccuracyOutcome.UNKNOWN


def test_the_shift_is_part_of_the_covariance() -> None:
    one = problem()
    result = identify(one)
    found = estimate_solver_error(one, result, ERROR)
    whole = with_shift(result, found)
    assert whole.std == pytest.approx(result.std * np.hypot(1.0, found.shift))
    assert np.linalg.matrix_rank(whole.covariance - result.covariance, tol=1e-10) == 1
