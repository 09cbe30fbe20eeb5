import math
from collections.abc import Callable

import numpy as np
import pytest

from fmuid import InputError, JointPrior, Normal, Parameter
from fmuid.data import ParameterSet

R = Parameter(1.0)
EYE = [[1.0, 0.0], [0.0, 1.0]]
WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: Parameter(12.0, 0.0, 10.0), r"start 12 is outside \[0, 10\]"),
    (lambda: Parameter(1.0, 2.0, 2.0), "min 2 must be less than max 2"),
    (lambda: Parameter(0.0), "Set nominal"),
    (lambda: Parameter(1.0, nominal=-1.0), "nominal must be greater than 0"),
    (lambda: Parameter(math.nan), "start must be finite"),
    (lambda: Parameter(1.0, max=math.nan), "max must be a number"),
    (lambda: Parameter("1"), "start must be a number, not '1'"),  # type: ignore[arg-type]
    (lambda: Parameter(1.0, prior=2.0), "prior must be a Normal"),  # type: ignore[arg-type]
    (lambda: Parameter(1.0, 0.0, prior=Normal(-1.0, 1.0)), "prior: mean -1 is outside"),
    (lambda: Normal(0.0, 0.0), "of a prior must be"),
    (lambda: Normal(math.nan, 1.0), "of a prior must be"),
    (lambda: Normal(0.0, math.inf), "of a prior must be"),
    (lambda: ParameterSet({"x0": Parameter(1.0, per_experiment=True)}, ["run", "run"]), "two experiments are named"),
    (lambda: ParameterSet({}), "no free parameters"),
    (lambda: JointPrior(["R", "L"], [1.0, 1.0], [[1.0, 0.5], [0.4, 1.0]]), "not symmetric"),
    (lambda: JointPrior(["R", "L"], [1.0, 1.0], [[1.0, 2.0], [2.0, 1.0]]), "not positive definite"),
    (lambda: JointPrior(["R", "L"], [1.0, 1.0], [[0.0, 0.0], [0.0, 1.0]]), "variance of 'R' must be greater than 0"),
    (lambda: JointPrior(["R", "L"], [1.0], EYE), "needs 2 means"),
    (lambda: JointPrior(["R", "R"], [1.0, 1.0], EYE), "twice"),
    (lambda: JointPrior(["R", "L"], [1.0, math.nan], EYE), "not finite"),
    (lambda: ParameterSet({"R": R}, joint_prior=JointPrior(["Rr"], [1.0], [[1.0]])), "did you mean 'R'"),
    (
        lambda: ParameterSet(
            {"R": Parameter(1.0, prior=Normal(1.0, 1.0))}, joint_prior=JointPrior(["R"], [1.0], [[1.0]])
        ),
        "its own prior",
    ),
    (
        lambda: ParameterSet({"R": Parameter(0.1, max=0.5)}, joint_prior=JointPrior(["R"], [1.0], [[1.0]])),
        "joint prior mean 1 of 'R' is outside",
    ),
]


@pytest.mark.parametrize(("call", "said"), WRONG, ids=[said for _, said in WRONG])
def test_wrong_parameters_and_priors(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_parameters_shared_and_per_experiment() -> None:
    start = Parameter(0.5, min=0.0, per_experiment=True)
    parameters = ParameterSet({"R": Parameter(-2.0), "x0": start, "L": Parameter(0.0, nominal=3.0)}, ["a", "b"])
    assert parameters.names == ("R", "x0[a]", "x0[b]", "L")
    for index, expected in enumerate([[0, 1, 3], [0, 2, 3]]):
        variables, where = parameters.for_experiment(index)
        assert variables == ("R", "x0", "L")
        assert where.tolist() == expected
    assert parameters.start.tolist() == [-2.0, 0.5, 0.5, 0.0]
    assert parameters.lower.tolist() == [-math.inf, 0.0, 0.0, -math.inf]
    assert parameters.scale.tolist() == [2.0, 0.5, 0.5, 3.0]
    assert parameters.magnitudes(np.array([0.0, 4.0, 0.5, 1.0])).tolist() == [2e-3, 4.0, 0.5, 3.0]


def test_prior_rows_are_the_cost_of_the_prior() -> None:
    """‖W(θ₀ − θ)‖² = (θ−θ₀)ᵀ M₀⁻¹ (θ−θ₀), J_0 of (1.37), with single and joint priors together."""
    covariance = np.array([[4e-4, 1e-7], [1e-7, 1e-10]])
    parameters = ParameterSet(
        {
            "R": Parameter(1.0),
            "L": Parameter(1e-3),
            "k": Parameter(5.0, prior=Normal(4.0, 0.5)),
            "free": Parameter(1.0),
        },
        joint_prior=JointPrior(["L", "R"], [2e-3, 1.5], covariance[::-1, ::-1]),
    )
    theta = np.array([1.7, 1.9e-3, 5.0, 77.0])
    away = theta[:2] - np.array([1.5, 2e-3])
    expected = away @ np.linalg.inv(covariance) @ away + (5.0 - 4.0) ** 2 / 0.5**2
    rows = parameters.prior_residual(theta[None])[0]
    assert rows @ rows == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(
        -parameters.prior_whitening @ (theta - np.nan_to_num(parameters.prior_mean)), rows, rtol=1e-12
    )
    np.testing.assert_allclose(parameters.prior_mean[:3], [1.5, 2e-3, 4.0])
    np.testing.assert_allclose(parameters.prior_std[:3], [2e-2, 1e-5, 0.5])
    assert np.isnan(parameters.prior_mean[3])
