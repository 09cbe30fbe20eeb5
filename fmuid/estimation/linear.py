"""Linear estimates in closed form by QR (1.1–1.12; docs/method/linear-models.md, with its symbols)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd
import scipy
from numpy.typing import ArrayLike
from scipy import fft, special

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError, check_kind
from fmuid.estimation.covariance import check_level
from fmuid.formatting import listed


@dataclass(frozen=True)
class LinearSettings:
    """Limits of dependent regressors, and of the correction for the fitted part."""

    dependent: float = 1e-10  # length of a combination of dependent unit regressors ...
    named_share: float = 0.05  # ... and share of the largest part for a name in the message
    lags_share: int = 2  # correlations count up to 1/lags_share of the recording
    rounds: int = 4  # of adding the fitted part; a fifth moves no standard deviation by 1 %
    least_freedom: float = 1.0  # lower limit of degrees of freedom


SETTINGS = LinearSettings()


class Estimator(Enum):
    """Kind of a linear estimate."""

    LEAST_SQUARES = "least_squares"  # unbiased if the regressors are free of noise; covariance for a white residual
    EQUATION_ERROR = "equation_error"  # biased by noise in measured regressors; the covariance ignores this
    INSTRUMENTAL_VARIABLES = "instrumental_variables"  # the bias vanishes with the length of the record


@dataclass(frozen=True, eq=False)
class LinearEstimate:
    """Parameters of a linear model.

    Attributes
    ----------
    estimator : Estimator
    names : tuple of str
    values : (N,) array
    covariance : (N, N) array
        By (1.11) for least squares, else under the residual's color; without bias.
    freedom : (N,) array
        Degrees of freedom of each variance in `covariance`.
    variance : float
        Variance of the residual, J/(K − N) (1.12).
    degrees_of_freedom : int
        Degrees of freedom of `variance`.
    residual : (K,) array
        y* − Φθ, NaN if a sample is missing.
    rounds : int
        Rounds of new instruments; 0 without instruments.
    converged : bool
        True if the instruments settled, or without instruments.

    Examples
    --------
    >>> from fmuid.estimation import linear_least_squares
    >>> line = linear_least_squares([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]], [1.0, 3.1, 4.9], ["slope", "offset"])
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
        """Return confidence intervals (Student's t), columns ``lower`` and ``upper``.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level)
        half = special.stdtrit(self.freedom, 0.5 + level / 2.0) * self.std
        return pd.DataFrame({"lower": self.values - half, "upper": self.values + half}, index=list(self.names))


def linear_least_squares(regressors: ArrayLike, measured: ArrayLike, names: Sequence[str] = ()) -> LinearEstimate:
    """Estimate y = φᵀθ by least squares (1.6).

    Parameters
    ----------
    regressors : (K, N) array
        Row φ_k per sample. Measured outputs among them bias the estimate.
    measured : (K,) array
        NaN in it or in a regressor excludes a sample.
    names : sequence of str, optional
        Default: theta1, theta2, ...

    Returns
    -------
    LinearEstimate

    Raises
    ------
    InputError
        If shapes do not fit, a value is infinite, samples are too few, or regressors are linearly dependent.

    Examples
    --------
    >>> from fmuid.estimation import linear_least_squares
    >>> import numpy as np, fmuid
    >>> u, y = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.9, 5.1, 7.1, 8.9])
    >>> linear_least_squares(np.column_stack([u, np.ones(4)]), y, ["slope", "offset"]).values.round(2)
    array([2., 1.])
    """
    rows, values = numbers(regressors, "regressors"), numbers(measured, "measured")
    check_kind(names, (list, tuple), "names must be a list, one a regressor")
    if rows.ndim != 2 or not rows.size or values.shape != rows.shape[:1]:
        raise InputError(
            f"regressors (K, N) and measured (K,) do not fit; their shapes are {rows.shape} and {values.shape}"
        )
    known = tuple(names) or tuple(f"theta{i + 1}" for i in range(rows.shape[1]))
    return solve(Estimator.LEAST_SQUARES, known, rows, values)


def solve(
    estimator: Estimator, names: Sequence[str], rows: Floats, values: Floats, instruments: Floats | None = None
) -> LinearEstimate:
    """Solve Zᵀ(y* − Φθ) = 0 for regressors (K, N + free); free columns have no name."""
    width, count = rows.shape[1], len(names)
    if count > width or (count < width and estimator is Estimator.LEAST_SQUARES):
        raise InputError(f"{count} names were given for {width} regressors")
    there = ~(np.isnan(values) | np.isnan(rows).any(axis=1))
    y, phi = values[there], rows[there]
    if not (np.isfinite(y).all() and np.isfinite(phi).all()):
        raise InputError("regressors and measured must be finite, or NaN where a sample is missing")
    freedom = y.size - width
    if freedom < 1:
        raise InputError(f"{y.size} samples are too few for {width} coefficients. Measure more.")
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
    """Return the lengths of columns; `InputError` if linearly dependent."""
    lengths = np.linalg.norm(columns, axis=0)
    if not lengths.all():
        where = int(np.argmin(lengths))
        raise InputError(f"the regressor of {names[where]!r} is zero in all samples. Remove or excite it.")
    _, sizes, directions = np.linalg.svd(columns / lengths, full_matrices=False)
    if sizes[-1] < SETTINGS.dependent:
        share = np.abs(directions[-1])
        named = share >= SETTINGS.named_share * share.max()
        involved = [repr(name) for name, is_large in zip(names, named, strict=False) if is_large]
        raise InputError(
            f"the regressors of {listed(involved or [repr(name) for name in names])} depend on each other. "
            "Fix one of them, or use another excitation."
        )
    return np.asarray(lengths, dtype=np.float64)


def colored_covariance(basis: Floats, solution: Floats, rows: Floats, residual: Floats) -> tuple[Floats, Floats]:
    """Return covariance (n, n) and degrees of freedom (n,); of Q (K, n), A (n, n), Φ (K, n), residual (K,)."""
    lags = _Lags(residual.size)
    taken, sums = rows @ solution, lags.products(residual[:, None], residual[:, None])
    missing = np.zeros(residual.size)
    for _ in range(SETTINGS.rounds + 1):
        # few pairs at long lags may make the transform improper
        power = np.maximum(lags.spectrum(lags.window * (sums + missing)), 0.0)
        seen = lags.convolved(power, basis)
        inner = basis.T @ seen
        half = seen - taken @ inner / 2.0
        missing = lags.products(taken, half) + lags.products(half, taken)
    covariance = solution @ inner @ solution.T
    weights = basis @ solution.T
    freedom = [lags.freedom(column, power, taken, half) for column in weights.T]
    return (covariance + covariance.T) / 2.0, np.array(freedom)


class _Lags:
    """Toeplitz matrices of a record, by their spectra."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.size = fft.next_fast_len(2 * count, real=True)
        self.pairs = np.arange(count, 0, -1, dtype=np.float64)
        share = np.arange(count) * SETTINGS.lags_share / count
        inner, outer = 1.0 - 6.0 * share**2 * (1.0 - share), 2.0 * np.maximum(1.0 - share, 0.0) ** 3
        self.window = np.where(share < 0.5, inner, outer) / self.pairs

    def products(self, one: Floats, other: Floats) -> Floats:
        """Return Σ_j Σ_t one_j(t) other_j(t + τ) for lags τ ≥ 0 (count,)."""
        spectra = np.conj(fft.rfft(one, self.size, axis=0)) * fft.rfft(other, self.size, axis=0)
        return np.asarray(fft.irfft(spectra.sum(axis=1), self.size)[: self.count])

    def spectrum(self, column: Floats) -> Floats:
        """Return the spectrum of the symmetric Toeplitz matrix with a column (count,)."""
        padded = np.zeros(self.size)
        padded[: self.count] = column
        padded[self.size - self.count + 1 :] = column[:0:-1]
        return np.asarray(fft.rfft(padded).real)

    def convolved(self, spectrum: Floats, columns: Floats) -> Floats:
        """Return a Toeplitz matrix times columns (count, n)."""
        spectra = spectrum[:, None] * fft.rfft(columns, self.size, axis=0)
        return np.asarray(fft.irfft(spectra, self.size, axis=0)[: self.count])

    def freedom(self, weights: Floats, power: Floats, taken: Floats, half: Floats) -> float:
        """Return tr(BR)²/tr(BRBR) with R = Γ − F Hᵀ − H Fᵀ."""
        of_weights = self.spectrum(self.window * self.products(weights[:, None], weights[:, None]))
        along = fft.irfft(of_weights * power, self.size)[: self.count]
        left, right = np.column_stack([taken, half]), np.column_stack([half, taken])
        seen, other = self.convolved(of_weights, left), self.convolved(of_weights, right)
        inner = right.T @ seen
        mean = self.count * along[0] - np.trace(inner)
        scatter = 2.0 * self.pairs @ along**2 - self.count * along[0] ** 2
        scatter += np.sum(inner * inner.T) - 2.0 * np.sum(other * self.convolved(power, seen))
        if not scatter > 0.0:
            return SETTINGS.least_freedom
        return float(np.clip(mean**2 / scatter, SETTINGS.least_freedom, self.count))
