"""Series on one grid: their noise as spectra, and what covariances need of it (`fmuid.estimation.noise.sandwich`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from fmuid.array_types import Complexes, Flags, Floats
from fmuid.estimation.noise.autoregression import Autoregression
from fmuid.estimation.noise.output_series import OutputSeries

# Correlations of innovations are kept this far from singular.
LEAST_EIGENVALUE = 1e-6


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of data that a covariance is made of.

    Attributes
    ----------
    residual : (n,) array
        Whitened, of the data's own optimum: a prior that disagrees with them would pass for colour.
    basis : (n, m) array
        An orthonormal basis of what their fit has taken out of it.
    columns : (n, k) array
        C = J R.
    root : (N, k) array
        R.
    prior : (k, k) array
        (WR)ᵀ WR, zero without prior.
    given : (n_outputs,) array of bool
        Outputs whose whitened noise has the variance 1, as it was given.
    white : (n_outputs,) array of bool
        Outputs whose residual is nothing but rounding, of which nothing can be told: white, of variance 1.
    """

    residual: Floats
    basis: Floats
    columns: Floats
    root: Floats
    prior: Floats
    given: Flags
    white: Flags


@dataclass(frozen=True, eq=False)
class Spectra:
    """Columns of the series of one grid, filtered by 1/A backwards in time.

    Attributes
    ----------
    size : int
        Of the transforms: the grid, and the noise's memory before it.
    transfers : (m, f) array
        1/A of each series.
    filtered : (m, k, f) array
        Z of each series.
    """

    size: int
    transfers: Complexes
    filtered: Complexes

    @classmethod
    def of(cls, columns: Floats, series: Sequence[OutputSeries], models: Sequence[Autoregression]) -> Spectra:
        """Filter the columns (n, k) of all rows."""
        size = fft.next_fast_len(length_of(series) + max(model.memory for model in models), real=True)
        transfers = np.array([model.transfer(size) for model in models])
        filtered = np.array([fft.rfft(on_grid(each, columns, length_of(series)), size) for each in series])
        filtered *= np.conj(transfers)[:, None]
        return cls(size, transfers, filtered)

    def coupled(self, innovations: Floats) -> Complexes:
        """Return Σ_b S_ab Z_b of each series (m, k, f)."""
        flat = _real(self.filtered).reshape(len(innovations), -1)
        return (innovations @ flat).view(np.complex128).reshape(self.filtered.shape)

    def gram(self, coupled: Complexes) -> Floats:
        """Return Σ_ab S_ab Z_aᵀ Z_b (k, k)."""
        weights = np.repeat(_lag_zero(self.size), 2)
        total = np.sum((_real(self.filtered) * weights) @ _real(coupled).swapaxes(1, 2), axis=0)
        return np.asarray((total + total.T) / 2.0, dtype=np.float64)


def length_of(series: Sequence[OutputSeries]) -> int:
    """Return the length of the grid of some series."""
    return 1 + max(int(each.places[-1]) for each in series)


def on_grid(each: OutputSeries, rows: Floats, length: int) -> Floats:
    """Return the columns of all rows (n, k) that a series has, on its grid (k, length)."""
    if each.places.size == length:
        return np.ascontiguousarray(rows[each.rows].T)
    grid = np.zeros((rows.shape[1], length))
    grid[:, each.places] = rows[each.rows].T
    return grid


class SampleGrid:
    """The series of one grid, their spectra, and the noise that is taken for theirs.

    Parameters
    ----------
    rows : Rows
    series : sequence of OutputSeries
    members : sequence of int
        Their numbers among all series.

    Attributes
    ----------
    there : (m, length) array of bool
        Where each series has a sample.
    columns : list of (1 + 2 k, length) arrays
        Of each series the residual and, after `add_removed`, the columns whose squares make up for what is missing.
    models : sequence of Autoregression
        The noise of each.
    """

    def __init__(self, rows: Rows, series: Sequence[OutputSeries], members: Sequence[int]) -> None:
        self.rows, self.series, self.members = rows, series, members
        self.length = length_of(series)
        self.columns = [on_grid(each, rows.residual[:, None], self.length) for each in series]
        self.there = self._there()

    def _there(self) -> Flags:
        there = np.zeros((len(self.series), self.length), dtype=np.bool_)
        for own, each in zip(there, self.series, strict=True):
            own[each.places] = True
        return there

    def take(self, models: Sequence[Autoregression], columns: Floats, innovations: Floats | None = None) -> Floats:
        """Take models for the noise of the series, and return their part of XᵀΓX (k, k).

        Parameters
        ----------
        models : sequence of Autoregression
        columns : (n, k) array
            X.
        innovations : (m, m) array, optional
            S; default what the residuals say.
        """
        self.models = models
        self.spectra = Spectra.of(columns, self.series, models)
        self.innovations = self._innovations() if innovations is None else innovations
        self.coupled = self.spectra.coupled(self.innovations)
        return self.spectra.gram(self.coupled)

    def _innovations(self) -> Floats:
        """Return the covariance S of the innovations (m, m): their variances, and the residuals' correlations."""
        scale = np.sqrt([model.variance for model in self.models])
        if len(self.models) == 1:
            return np.outer(scale, scale)
        known = [k for k, each in enumerate(self.series) if not self.rows.white[each.group]]
        matrix, common = np.eye(len(scale)), np.zeros((len(scale), len(scale)))
        for n, i in enumerate(known):
            for j in known[n::-1]:
                common[i, j] = self._common(i, j)
                if i != j and common[i, i] > 0 and common[j, j] > 0:
                    matrix[i, j] = matrix[j, i] = common[i, j] / math.sqrt(common[i, i] * common[j, j])
        values, vectors = np.linalg.eigh(matrix)
        if values[0] < LEAST_EIGENVALUE:
            matrix = (vectors * np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T
            scale = scale / np.sqrt(np.diag(matrix))
        return np.asarray(matrix * np.outer(scale, scale), dtype=np.float64)

    def _common(self, i: int, j: int) -> float:
        """Return the covariance of what the models leave of two residuals, Σ a_k b_l r_ij(k − l)."""
        a, b = (np.concatenate([[1.0], -self.models[each].coefficients]) for each in (i, j))
        lags = np.arange(a.size)[:, None] - np.arange(b.size)
        reach = int(np.abs(lags).max())
        sums = _correlations(self.columns[i][0], self.columns[j][0], reach)
        pairs = _correlations(self.there[i].astype(np.float64), self.there[j].astype(np.float64), reach)
        cross = sums / np.maximum(np.rint(pairs), 1.0)
        return float(a @ cross[lags + reach] @ b)

    def add_removed(self, gram: Floats) -> None:
        """Add the columns Q + H and Q − H of each series: half of their squares' difference is what is missing."""
        parts = zip(self.series, self.spectra.transfers, self.coupled, strict=True)
        for index, (each, transfer, coupled) in enumerate(parts):
            own = on_grid(each, self.rows.basis, self.length)
            spread = fft.irfft(transfer * coupled, self.spectra.size)[:, : self.length] * self.there[index]
            half = spread - 0.5 * gram @ own
            self.columns[index] = np.vstack([self.columns[index][:1], own + half, own - half])

    def slopes(self) -> list[Floats]:
        """Return of each series the slopes (N, 1 + p) of the V_ii by log σ² and the φ_j."""
        found, size = [], self.spectra.size
        for each, model, transfer, z, c in zip(
            self.series, self.models, self.spectra.transfers, self.spectra.filtered, self.coupled, strict=True
        ):
            own, coupled = self.rows.root @ z, self.rows.root @ c
            both = np.conj(coupled) * own
            share = both.real @ _lag_zero(size)[:, None]
            # ∂Z/∂φ_j is Z filtered once more, j samples later
            slopes = model.along(both, transfer, size)
            if self.rows.given[each.group]:  # as φ changes, the variance of the innovation keeps that of the process
                power = np.abs(transfer) ** 2
                gains = model.along(power, transfer, size)
                slopes = slopes - share * gains / fft.irfft(power, size)[0]
                share = np.zeros_like(share)
            if self.rows.white[each.group]:
                share = np.zeros_like(share)
            found.append(np.hstack([share, slopes]))
        return found


def _real(spectra: Complexes) -> Floats:
    """Return spectra (..., f) as real and imaginary parts side by side (..., 2 f)."""
    return spectra.view(np.float64)


def _lag_zero(size: int) -> Floats:
    """Return the weights (f,) of the real parts of X̄ Y, spectra of a real transform, whose sum is Σ_t x(t) y(t)."""
    weights = np.full(size // 2 + 1, 2.0 / size)
    weights[0] = 1.0 / size
    if size % 2 == 0:
        weights[-1] = 1.0 / size
    return weights


def _correlations(left: Floats, right: Floats, reach: int) -> Floats:
    """Return Σ_t x(t) y(t + k) for k from −reach to reach."""
    after = [float(left[: left.size - k] @ right[k:]) for k in range(reach + 1)]
    before = [float(left[k:] @ right[: right.size - k]) for k in range(reach, 0, -1)]
    return np.array(before + after)
