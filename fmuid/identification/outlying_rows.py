"""Outlying and copied rows of experiments without a time.

Each value gets a shift of its own, linear about the estimates (Cook and Weisberg, Residuals and Influence in
Regression, 1982, section 2.2.2). The largest leave one after the other, so they do not hide each other
(Rosner, Technometrics 25, 1983).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats, Indices
from fmuid.data import ROW
from fmuid.estimation import LeastSquares, Result
from fmuid.identification.directed_tests import orthonormal_basis, whitened


@dataclass(frozen=True)
class OutlyingRowSettings:
    """Numbers of the test."""

    level: float = 0.01  # significance, of all values together
    most: float = 0.25  # of the values of an output
    freedom: float = 3.0  # degrees of freedom that remain
    values: int = 2000  # of all experiments: their influence on each other is a matrix


SETTINGS = OutlyingRowSettings()


@dataclass(frozen=True)
class OutlyingRows:
    """Rows (from 0) of one output of an experiment, the worst first; `size` is its residual over the others' noise."""

    output: str
    experiment: str
    rows: tuple[int, ...]
    size: float


def find_outlying_rows(problem: LeastSquares, result: Result) -> tuple[OutlyingRows, ...]:
    """Return the outlying rows of a result; none with a robust loss, which has reduced their weight."""
    local, noise = result.fit.linearization, result.fit.noise
    timeless = any(each.kind != "time" for each in problem.experiments)
    if not timeless or local is None or noise is None or problem.loss is not None:
        return ()
    if not np.isfinite(result.std).all() or local.residual.size > SETTINGS.values:
        return ()
    rows = whitened(noise, np.column_stack([local.residual, local.jacobian @ local.root]))
    basis = orthonormal_basis(rows[:, 1:])
    places = problem.tables(np.arange(len(rows), dtype=np.float64))
    pairs = [each for each in zip(problem.experiments, places, strict=True) if each[0].kind != "time"]
    level, found = SETTINGS.level / sum(table.shape[1] for _, table in pairs), []
    for experiment, table in pairs:
        for output, column in zip(experiment.output_names, table.T, strict=True):
            at = np.flatnonzero(np.isfinite(column))
            if own := list(_leave(rows[:, 0], basis, column[at].astype(np.intp), level)):
                found.append(OutlyingRows(output, experiment.name, tuple(int(at[k]) for k, _ in own), own[0][1]))
    return tuple(found)


def _leave(residual: Floats, basis: Floats, own: Indices, level: float) -> Iterator[tuple[int, float]]:
    """Yield places in `own` and sizes of outlying values, the worst first; each joins what the basis (n, p) fits."""
    residual = residual - basis @ (basis.T @ residual)
    free = 1.0 - np.sum(basis[own] ** 2, axis=1)
    stays, gone, outlying = np.ones(own.size, dtype=np.bool_), list[tuple[int, float]](), 0
    for _ in range(max(1, int(SETTINGS.most * own.size))):
        rest = float(free[stays].sum()) - 1.0
        if rest < SETTINGS.freedom:
            break
        falls = np.where(stays & (free > 1e-6), residual[own] ** 2 / np.maximum(free, 1e-6), 0.0)
        k, count = int(np.argmax(falls)), int(stays.sum())
        fall, shift = float(falls[k]), float(residual[own[k]] / free[k])
        column = -basis @ basis[own[k]]
        column[own[k]] += 1.0
        column /= np.linalg.norm(column)
        residual = residual - column * (column @ residual)
        basis, free = np.column_stack([basis, column]), free - column[own] ** 2
        stays[k] = False
        noise = float(np.sum(residual[own[stays]] ** 2)) / rest
        gone.append((k, abs(shift) / max(noise, 1e-300) ** 0.5))
        if special.fdtrc(1.0, rest, fall / max(noise, 1e-300)) * count < level:
            outlying = len(gone)
    yield from gone[:outlying]


def repeated_shares(problem: LeastSquares) -> dict[str, float]:
    """Return the share of copied rows, by experiment without a time."""
    found = {}
    for experiment in (each for each in problem.experiments if each.kind != "time"):
        given = [values for name, values in experiment.axis.items() if name != ROW]
        rows = np.nan_to_num(np.column_stack([*given, experiment.output_values]))
        if twice := len(rows) - len(np.unique(rows, axis=0)):
            found[experiment.name] = twice / len(rows)
    return found
