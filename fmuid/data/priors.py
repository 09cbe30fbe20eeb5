"""Gaussian priors of one parameter or several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.errors import InputError

# Beyond these limits squares overflow or vanish; no unit of measurement needs such numbers.
LARGEST_NUMBER, SMALLEST_MAGNITUDE = 1e100, 1e-100


def checked_number(value: object, what: str, *, infinite: bool = False) -> float:
    """Return a given number as a checked float."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{what} must be a number, not {value!r}.")
    number = float(value)
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise InputError(f"{what} must be {'a number' if infinite else 'finite'}, not {number:g}.")
    if abs(number) > LARGEST_NUMBER and not infinite:
        raise InputError(f"{what} must not exceed {LARGEST_NUMBER:g}, not {number:g}. Use another unit.")
    return number


@dataclass(frozen=True)
class Normal:
    """Gaussian prior of one parameter (1.36), in its unit.

    Parameters
    ----------
    mean : float
        Mean.
    std : float
        Standard deviation, above zero.

    Raises
    ------
    InputError
        If the mean is not finite or the standard deviation not positive.

    Examples
    --------
    >>> fmuid.Parameter(start=3.9, prior=fmuid.Normal(4.0, 0.1)).prior.std
    0.1
    """

    mean: float
    std: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", checked_number(self.mean, "the mean of a prior"))
        object.__setattr__(self, "std", checked_number(self.std, "the std of a prior"))
        if not self.std >= SMALLEST_MAGNITUDE:
            said = f"the std of a prior must be greater than 0, not {self.std:g}"
            raise InputError(f"{said}. Fix a known parameter instead.")


@dataclass(frozen=True, eq=False)
class JointPrior:
    """Gaussian prior of several parameters, θ₀ and M₀ of (1.36).

    Parameters
    ----------
    names : sequence of str
        Parameters in order; ``name[experiment]`` for those per experiment.
    mean : (q,) array
        Means.
    covariance : (q, q) array
        Symmetric, positive definite.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or the covariance is invalid.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> prior = fmuid.JointPrior(["R", "L"], [4.0, 0.1], [[0.01, 0.0], [0.0, 1e-6]])
    >>> result = fmuid.identify(fmuid.Problem(coil.fmu, coil.experiment, coil.parameters, joint_prior=prior))
    >>> result.estimates.prior_std.round(6).tolist()
    [0.1, 0.001]
    """

    names: tuple[str, ...]
    mean: Floats
    covariance: Floats

    def __init__(self, names: Sequence[str], mean: ArrayLike, covariance: ArrayLike) -> None:
        object.__setattr__(self, "names", tuple(names))
        object.__setattr__(self, "mean", np.array(mean, dtype=np.float64))
        object.__setattr__(self, "covariance", np.array(covariance, dtype=np.float64))
        count, which = len(self.names), f"joint prior of {', '.join(self.names)}"
        if len(set(self.names)) < count:
            raise InputError(f"joint prior: a parameter is named twice: {', '.join(self.names)}.")
        if self.mean.shape != (count,) or self.covariance.shape != (count, count):
            said = f"needs {count} means and a {count} x {count} covariance"
            raise InputError(f"{which}: {said}, not shapes {self.mean.shape} and {self.covariance.shape}.")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise InputError(f"{which}: a value is not finite.")
        for name, variance in zip(self.names, np.diag(self.covariance), strict=True):
            if variance <= 0:
                said = f"variance of {name!r} must be greater than 0, not {variance:g}"
                raise InputError(f"joint prior: {said}. Fix a known parameter instead.")
        unequal = ~np.isclose(self.covariance, self.covariance.T, rtol=1e-6, atol=0.0)  # rounding in a printed file
        if unequal.any():
            i, j = np.argwhere(unequal)[0]
            said = f"{self.names[i]}, {self.names[j]}: {self.covariance[i, j]:g} and {self.covariance[j, i]:g}"
            raise InputError(f"joint prior: covariance is not symmetric; {said}.")
        self.whitening()

    @property
    def std(self) -> list[float]:
        """Standard deviation of each parameter."""
        return [float(each) for each in np.sqrt(np.diag(self.covariance))]

    def whitening(self) -> Floats:
        """Return W (q, q) with WᵀW = M₀⁻¹."""
        std = np.sqrt(np.diag(self.covariance))
        try:  # on the correlation matrix: variances of very different units must not decide what counts as positive
            factor = np.linalg.cholesky(self.covariance / np.outer(std, std))
        except np.linalg.LinAlgError:
            said = f"joint prior of {', '.join(self.names)}: covariance is not positive definite"
            raise InputError(f"{said}. Check its correlations.") from None
        return np.asarray(np.linalg.solve(factor, np.diag(1.0 / std)), dtype=np.float64)
