"""Series on one grid: their noise as spectra, and what covariances need of it (`fmuid.estimation.colour.sandwich`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from fmuid.arrays import Complexes, Floats
from fmuid.estimation.colour.autoregression import Autoregression
from fmuid.estimation.colour.series import Series

# Correlations of innovations are kept this far from singular.
LEAST_EIGENVALUE = 1e-6


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of data that a covariance is made of.

    Attributes
    ----------
    residual : (n,) array
        Whitened.
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
    columns: Floats
    root: Floats
    prior: Floats
    given: NDArray[np.bool_]
    white: NDArray[np.bool_]


class Grid:
    """The series of one grid, their spectra, and the noise that is taken for theirs.

    Parameters
    ----------
    rows : Rows
    series : sequence of Series
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

    def __init__(self, rows: Rows, series: Sequence[Series], members: Sequence[int]) -> None:
        self.rows, self.series, self.members = rows, series, members
        self.length = 1 + max(int(each.places[-1]) for each in series)
        self.columns = [self._placed(each, rows.residual[:, None]) for each in series]
        self.there = self._there()

    def _there(self) -> NDArray[np.bool_]:
        there = np.zeros((len(self.series), self.length), dtype=np.bool_)
        for own, each in zip(there, self.series, strict=True):
            own[each.places] = True
        return there

    def _placed(self, each: Series, rows: Floats) -> Floats:
        """Return the columns of rows (n, k) that a series has, on the grid (k, length)."""
        grid = np.zeros((rows.shape[1], self.length))
        grid[:, each.places] = rows[each.rows].T
        return grid

    def take(self, models: Sequence[Autoregression]) -> None:
        """Take models for the noise of the series: filter the columns, find what the innovations have in common."""
        self.models = models
        self.size = fft.next_fast_len(self.length + max(model.memory for model in models), real=True)
        self.transfers = [model.transfer(self.size) for model in models]
        self.filtered = [
            fft.rfft(self._placed(each, self.rows.columns), self.size) * np.conj(transfer)
            for each, transfer in zip(self.series, self.transfers, strict=True)
        ]
        self.innovations = self._innovations()

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

    def _coupled(self) -> list[Complexes]:
        """Return Σ_b S_ab Z_b of each series, as spectra (k, f)."""
        return [
            np.sum([s * z for s, z in zip(row, self.filtered, strict=True)], axis=0)
            if len(row) > 1
            else row[0] * self.filtered[0]
            for row in self.innovations
        ]

    def gram(self) -> Floats:
        """Return the grid's part of CᵀΓC (k, k)."""
        self.coupled = self._coupled()
        total = np.sum([_product(z, c, self.size) for z, c in zip(self.filtered, self.coupled, strict=True)], axis=0)
        return np.asarray((total + total.T) / 2.0, dtype=np.float64)

    def add_removed(self, inner: Floats) -> None:
        """Add the columns C + H and C − H of each series: half of their squares' difference is what is missing."""
        for index, (each, transfer, coupled) in enumerate(zip(self.series, self.transfers, self.coupled, strict=True)):
            own = self._placed(each, self.rows.columns)
            spread = fft.irfft(transfer * coupled, self.size)[:, : self.length] * self.there[index]
            half = spread - 0.5 * inner.T @ own
            self.columns[index] = np.vstack([self.columns[index][:1], own + half, own - half])

    def slopes(self) -> list[Floats]:
        """Return of each series the slopes (N, 1 + p) of the V_ii by log σ² and the φ_j."""
        found = []
        for each, model, transfer, z, c in zip(
            self.series, self.models, self.transfers, self.filtered, self.coupled, strict=True
        ):
            own, coupled, order = self.rows.root @ z, self.rows.root @ c, model.coefficients.size
            share = fft.irfft(np.conj(coupled) * own, self.size)[:, :1]
            # ∂Z/∂φ_j is Z filtered once more, j samples later
            slopes = 2.0 * fft.irfft(np.conj(coupled) * own * np.conj(transfer), self.size)[:, 1 : order + 1]
            if self.rows.given[each.group]:  # as φ changes, the variance of the innovation keeps that of the process
                power = np.abs(transfer) ** 2
                gains = 2.0 * fft.irfft(power * np.conj(transfer), self.size)[1 : order + 1]
                slopes = slopes - share * gains / fft.irfft(power, self.size)[0]
                share = np.zeros_like(share)
            if self.rows.white[each.group]:
                share = np.zeros_like(share)
            found.append(np.hstack([share, slopes]))
        return found


def _product(left: Complexes, right: Complexes, size: int) -> Floats:
    """Return Σ_t x(t) y(t) of all pairs of columns, from spectra (k, f) of a real transform."""
    weights = np.full(left.shape[1], 2.0 / size)
    weights[0] = 1.0 / size
    if size % 2 == 0:
        weights[-1] = 1.0 / size
    return np.asarray(((np.conj(left) * weights) @ right.T).real, dtype=np.float64)


def _correlations(left: Floats, right: Floats, reach: int) -> Floats:
    """Return Σ_t x(t) y(t + k) for k from −reach to reach."""
    size = fft.next_fast_len(left.size + reach, real=True)
    found = fft.irfft(np.conj(fft.rfft(left, size)) * fft.rfft(right, size), size)
    return np.concatenate([found[size - reach :], found[: reach + 1]]) if reach else found[:1]
