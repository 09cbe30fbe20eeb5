"""What is to be said of the estimates of a linear model, by how they were made."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmuid.estimation import Estimator
from fmuid.text import with_std

if TYPE_CHECKING:
    from fmuid.estimation import LinearEstimate

THOUGHTS = {
    Estimator.LEAST_SQUARES: "unbiased where the regressors are free of noise and the residual is white",
    Estimator.EQUATION_ERROR: (
        "noise in measured terms biases these values, which their standard deviations do not show: "
        "a start for identify, not a result"
    ),
    Estimator.INSTRUMENTAL_VARIABLES: "free of the bias by noise in measured terms, as far as the model is right",
}
"""What is to be thought of an estimator."""


def linear_words(estimate: LinearEstimate) -> tuple[str, ...]:
    """Return the values with their standard deviations, then what is to be thought of them."""
    values = ", ".join(
        f"{name} = {with_std(value, std)}"
        for name, value, std in zip(estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True)
    )
    words = (values, THOUGHTS[estimate.estimator])
    if estimate.converged:
        return words
    return *words, f"the instruments had not settled after {estimate.rounds} rounds: give a start nearer by"
