"""Estimates of models that are linear in their parameters (1.1–1.12), in closed form by QR.

With regressors Φ (K, N), measured y* (K,) and instruments Z (K, N) that have nothing to do with the noise, the estimate
solves Zᵀ(y* − Φθ) = 0. Z = Φ is the method of least squares: unbiased where Φ is free of noise, as the inputs of a
model are. Regressors made of measured outputs are not: their noise pulls the estimates, however long the record.

References
----------
L. Ljung, "System Identification: Theory for the User", 2nd edition, Prentice Hall 1999, sections 7.3 and 7.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd
import scipy
from numpy.typing import ArrayLike
from scipy import special

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError, check_kind
from fmuid.estimation.covariance import check_level
from fmuid.estimation.linear_models.colored import colored_covariance
from fmuid.formatting import listed

# Regressors, each of length 1, are dependent where a combination of them is shorter than this.
DEPENDENT = 1e-10
# Those with less than this share of the largest one's part in such a combination are not named.
WORTH_NAMING = 0.05


class Estimator(Enum):
    """How an estimate was made, which decides what is to be thought of it."""

    LEAST_SQUARES = "least_squares"
    """Unbiased where the regressors are free of noise; the covariance takes the residual for white."""
    EQUATION_ERROR = "equation_error"
    """Biased by noise in measured regressors, of which the covariance knows nothing."""
    INSTRUMENTAL_VARIABLES = "instrumental_variables"
    """The noise has nothing to do with the instruments, so that the bias vanishes with the length of the record."""


@dataclass(frozen=True, eq=False)
class LinearEstimate:
    """The parameters of a linear model.

    Attributes
    ----------
    estimator : Estimator
    names : tuple of str
    values : (N,) array
    covariance : (N, N) array
        By (1.11), of a white residual, for least squares; else by the correlations of the residual, whose colour is the
        filter's. Of scatter alone, not of bias.
    freedom : (N,) array
        Degrees of freedom of the variances on the diagonal of `covariance`; few, where the residual is colored.
    variance : float
        Of the residual, J/(K − N) (1.12).
    degrees_of_freedom : int
        Of `variance`: K − N, less the free terms of a filter's start.
    residual : (K,) array
        y* − Φθ, NaN where a sample is missing.
    rounds : int
        How often instruments were made anew; 0 without instruments.
    converged : bool
        Whether the instruments have settled; True without instruments.

    Examples
    --------
    >>> line = fmuid.linear_least_squares([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]], [1.0, 3.1, 4.9], ["slope", "offset"])
    >>> round(line["slope"], 2), line.degrees_of_freedom
    (1.95, 1)
    """

    estimator: Estimator
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    freedom: Floats
    variance: float
    degrees_of_freedom: int
    residual: Floats
    rounds: int = 0
    converged: bool = True

    def __getitem__(self, name: str) -> float:
        """Return the estimate of one parameter."""
        if name not in self.names:
            raise InputError(f"the estimate has no parameter {name!r}; it has {', '.join(self.names)}")
        return float(self.values[self.names.index(name)])

    @property
    def std(self) -> Floats:
        """Standard deviations of the estimates (N,)."""
        return np.sqrt(np.diag(self.covariance))

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return the confidence interval of each parameter, columns ``lower`` and ``upper``.

        By Student's t for the degrees of freedom of each standard deviation (`freedom`).

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level)
        half = special.stdtrit(self.freedom, 0.5 + level / 2.0) * self.std
        return pd.DataFrame({"lower": self.values - half, "upper": self.values + half}, index=list(self.names))


def linear_least_squares(regressors: ArrayLike, measured: ArrayLike, names: Sequence[str] = ()) -> LinearEstimate:
    """Estimate the parameters of y = φᵀθ by least squares: θ̂ = (Σ φφᵀ)⁻¹ Σ φ y* (1.6), by QR.

    Parameters
    ----------
    regressors : (K, N) array
        A row φ_k a sample. With measured outputs among them, as in the difference equation y_k = a y_{k−1} + b u_{k−1},
        their noise biases the estimate: `instrumental_variables` and `identify` are free of that.
    measured : (K,) array
        Samples where it or a regressor is NaN do not count.
    names : sequence of str, optional
        Of the parameters; default theta1, theta2, ...

    Returns
    -------
    LinearEstimate

    Raises
    ------
    InputError
        If shapes do not fit, a value is infinite, samples are too few, or regressors are linearly dependent.

    Examples
    --------
    >>> import numpy as np, fmuid
    >>> u, y = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.9, 5.1, 7.1, 8.9])
    >>> fmuid.linear_least_squares(np.column_stack([u, np.ones(4)]), y, ["slope", "offset"]).values.round(2)
    array([2., 1.])
    """
    rows, values = numbers(regressors, "regressors"), numbers(measured, "measured")
    check_kind(names, (list, tuple), "names must be a list, one a regressor")
    if rows.ndim != 2 or not rows.size or values.shape != rows.shape[:1]:
        raise InputError(
            f"regressors need a row a sample and a column a parameter, measured a value a sample; "
            f"their shapes are {rows.shape} and {values.shape}"
        )
    known = tuple(names) or tuple(f"theta{i + 1}" for i in range(rows.shape[1]))
    return solve(Estimator.LEAST_SQUARES, known, rows, values)


def solve(
    estimator: Estimator, names: Sequence[str], rows: Floats, values: Floats, instruments: Floats | None = None
) -> LinearEstimate:
    """Solve Zᵀ(y* − Φθ) = 0.

    Parameters
    ----------
    estimator : Estimator
    names : sequence of str
        Of the parameters of the first columns; those of more columns are found too, and not told.
    rows : (K, N + free) array
        Φ.
    values : (K,) array
        y*.
    instruments : (K, N + free) array, optional
        Z; default Φ.

    Raises
    ------
    InputError
        As `linear_least_squares`.
    """
    width, count = rows.shape[1], len(names)
    if count > width or (count < width and estimator is Estimator.LEAST_SQUARES):
        raise InputError(f"{count} names were given for {width} regressors")
    there = ~(np.isnan(values) | np.isnan(rows).any(axis=1))
    y, phi = values[there], rows[there]
    if not (np.isfinite(y).all() and np.isfinite(phi).all()):
        raise InputError("regressors and measured must be finite, or NaN where a sample is missing")
    freedom = y.size - width
    if freedom < 1:
        raise InputError(f"{y.size} samples are too few for {width} coefficients: measure more")
    lengths = _lengths(names, phi)
    z = phi if instruments is None else instruments[there]
    basis = np.asarray(scipy.linalg.qr(z / _lengths(names, z), mode="economic")[0], dtype=np.float64)
    inverse = scipy.linalg.pinv(basis.T @ (phi / lengths)) / lengths[:, None]
    theta = inverse @ (basis.T @ y)
    left = np.asarray(y - phi @ theta, dtype=np.float64)
    variance = float(left @ left) / freedom
    if estimator is Estimator.LEAST_SQUARES:
        covariance, own = variance * inverse @ inverse.T, np.full(width, float(freedom))
    else:
        covariance, own = colored_covariance(basis, inverse, phi, left)
    residual = np.full(values.size, np.nan)
    residual[there] = left
    return LinearEstimate(
        estimator, tuple(names), theta[:count], covariance[:count, :count], own[:count], variance, freedom, residual
    )


def _lengths(names: Sequence[str], columns: Floats) -> Floats:
    """Return the lengths of columns that must be independent of each other.

    Raises
    ------
    InputError
        If they are not.
    """
    lengths = np.linalg.norm(columns, axis=0)
    if not lengths.all():
        where = int(np.argmin(lengths))
        raise InputError(f"the regressor of {names[where]!r} is zero in the whole record: leave it out, or excite it")
    _, sizes, directions = np.linalg.svd(columns / lengths, full_matrices=False)
    if sizes[-1] < DEPENDENT:
        share = np.abs(directions[-1])
        involved = [repr(name) for name, part in zip(names, share, strict=False) if part >= WORTH_NAMING * share.max()]
        raise InputError(
            f"the regressors of {listed(involved or [repr(name) for name in names])} depend on each other in this "
            "record: hold one at a value, or measure under another excitation"
        )
    return np.asarray(lengths, dtype=np.float64)
