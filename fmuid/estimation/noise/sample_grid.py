"""Noise of the series of one grid, as spectra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from fmuid.array_types import Complexes, Flags, Floats, Indices
from fmuid.estimation.noise.autoregression import Autoregression
from fmuid.estimation.noise.low_frequency import line_counts
from fmuid.estimation.noise.output_series import OutputSeries

LEAST_EIGENVALUE = 1e-6  # of the innovations' correlation matrix


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of data for a covariance."""

    residual: Floats  # (n,), whitened, of the data's own optimum: prior conflict is no color
    basis: Floats  # (n, m), orthonormal, of the fitted part
    columns: Floats  # (n, k), C = J R
    root: Floats  # (N, k), R
    prior: Floats  # (k, k), (WR)ᵀ WR
    given: Flags  # (n_outputs,), noise of variance 1, as given
    white: Flags  # (n_outputs,), nothing but rounding: white, of variance 1
    shared: tuple[Indices, ...] = ()  # outputs with one variance


@dataclass(frozen=True, eq=False)
class Spectra:
    """Columns of one grid's series, filtered by 1/A backwards in time."""

    size: int  # of the transforms: grid and memory
    transfers: Complexes  # (m, f), 1/A of each series
    filtered: Complexes  # (m, k, f), Z of each series

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
        flat = self.filtered.view(np.float64).reshape(len(innovations), -1)
        return (innovations @ flat).view(np.complex128).reshape(self.filtered.shape)

    def gram(self, coupled: Complexes) -> Floats:
        """Return Σ_ab S_ab Z_aᵀ Z_b (k, k)."""
        weights = np.repeat(line_counts(self.size) / self.size, 2)
        total = np.sum((self.filtered.view(np.float64) * weights) @ coupled.view(np.float64).swapaxes(1, 2), axis=0)
        return np.asarray((total + total.T) / 2.0, dtype=np.float64)


def length_of(series: Sequence[OutputSeries]) -> int:
    """Return the grid length of some series."""
    return 1 + max(int(each.places[-1]) for each in series)


def on_grid(each: OutputSeries, rows: Floats, length: int) -> Floats:
    """Return a series' columns (k, length) of all rows (n, k)."""
    if each.places.size == length:
        return np.ascontiguousarray(rows[each.rows].T)
    grid = np.zeros((rows.shape[1], length))
    grid[:, each.places] = rows[each.rows].T
    return grid


class SampleGrid:
    """Series of one grid; `columns` are its residual and, after `add_removed`, corrections (1 + 2 k, length)."""

    def __init__(self, rows: Rows, series: Sequence[OutputSeries], members: Sequence[int]) -> None:
        self.rows, self.series, self.members = rows, series, members
        self.length = length_of(series)
        self.columns = [on_grid(each, rows.residual[:, None], self.length) for each in series]
        self.there: Flags = np.zeros((len(series), self.length), dtype=np.bool_)
        for own, each in zip(self.there, series, strict=True):
            own[each.places] = True

    def take(self, models: Sequence[Autoregression], columns: Floats, innovations: Floats | None = None) -> Floats:
        """Adopt noise models and innovations (m, m); return their part of XᵀΓX (k, k), X = columns."""
        self.models = models
        self.spectra = Spectra.of(columns, self.series, models)
        self.innovations = self._innovations() if innovations is None else innovations
        self.coupled = self.spectra.coupled(self.innovations)
        return self.spectra.gram(self.coupled)

    def _innovations(self) -> Floats:
        """Return S (m, m): model variances with the residuals' correlations."""
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
        """Return the covariance Σ a_k b_l r_ij(k − l) of two innovations."""
        a, b = (np.concatenate([[1.0], -self.models[each].coefficients]) for each in (i, j))
        lags = np.arange(a.size)[:, None] - np.arange(b.size)
        reach = int(np.abs(lags).max())
        sums = _correlations(self.columns[i][0], self.columns[j][0], reach)
        pairs = _correlations(self.there[i].astype(np.float64), self.there[j].astype(np.float64), reach)
        cross = sums / np.maximum(np.rint(pairs), 1.0)
        return float(a @ cross[lags + reach] @ b)

    def add_removed(self, gram: Floats) -> None:
        """Add columns Q + H and Q − H: half of their squares' difference is missing."""
        parts = zip(self.series, self.spectra.transfers, self.coupled, strict=True)
        for index, (each, transfer, coupled) in enumerate(parts):
            own = on_grid(each, self.rows.basis, self.length)
            spread = fft.irfft(transfer * coupled, self.spectra.size)[:, : self.length] * self.there[index]
            half = spread - 0.5 * gram @ own
            self.columns[index] = np.vstack([self.columns[index][:1], own + half, own - half])

    def slopes(self) -> list[Floats]:
        """Return each series' slopes of V_ii by log σ² and φ_j."""
        found, size = [], self.spectra.size
        for each, model, transfer, z, c in zip(
            self.series, self.models, self.spectra.transfers, self.spectra.filtered, self.coupled, strict=True
        ):
            own, coupled = self.rows.root @ z, self.rows.root @ c
            both = np.conj(coupled) * own
            share = both.real @ (line_counts(size) / size)[:, None]
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


def _correlations(left: Floats, right: Floats, reach: int) -> Floats:
    """Return Σ_t x(t) y(t + k) for k from −reach to reach."""
    after = [float(left[: left.size - k] @ right[k:]) for k in range(reach + 1)]
    before = [float(left[k:] @ right[: right.size - k]) for k in range(reach, 0, -1)]
    return np.array(before + after)
