"""Linear algebraic loops: equations to solve together, and their solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching


def first_loop(unknowns: Sequence[set[str]]) -> list[int]:
    """Return the first smallest set of equations with as many unknowns; empty if there is none.

    It is a strongly connected component without outgoing edges (Duff, Erisman, Reid, *Direct Methods for Sparse
    Matrices*, 2nd ed., Oxford 2017, ch. 6). `unknowns` are those of each equation.
    """
    names = sorted(set().union(*unknowns))
    place = {name: k for k, name in enumerate(names)}
    count = len(unknowns)
    entries = [(row, place[name]) for row, each in enumerate(unknowns) for name in sorted(each)]
    rows, columns = np.array(entries).T
    incidence = csr_array((np.ones(len(entries)), (rows, columns)), shape=(count, len(names)))
    assigned = maximum_bipartite_matching(incidence, perm_type="row")  # unknown -> equation, or -1
    if len(names) != count or np.any(assigned < 0):
        return []
    edges = csr_array((np.ones(len(entries)), (rows, assigned[columns])), shape=(count, count))
    _, labels = connected_components(edges, directed=True, connection="strong")
    ends = zip(labels[rows], labels[assigned[columns]], strict=True)
    pointing = {label for label, other in ends if label != other}
    first = next(label for label in labels if label not in pointing)
    return [k for k in range(count) if labels[k] == first]


def always_singular(matrix: Any, values: Mapping[str, float]) -> bool:
    """Return whether an SX matrix is singular for any other symbols' values."""
    symbols = ca.symvar(matrix)
    evaluate = ca.Function("matrix", symbols, [ca.densify(matrix)])
    rng = np.random.default_rng(0)
    for _ in range(5):
        found = np.array(evaluate.call([values.get(each.name(), rng.uniform(0.1, 1.0)) for each in symbols])[0])
        if not np.all(np.isfinite(found)):
            return False
        for axis in (1, 0):  # independent of the units of equations and unknowns
            largest = np.abs(found).max(axis, keepdims=True)
            found = found / np.where(largest > 0, largest, 1.0)
        if np.linalg.matrix_rank(found) == len(found):
            return False
    return True


def solve_linear(matrix: Any, right: Any) -> list[Any]:
    """Return the solution of linear SX equations, one expression per unknown.

    Gaussian elimination with scaled partial pivoting (Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd
    ed., SIAM 2002, algorithm 9.2). Rows are exchanged at evaluation: a pivot may vanish for some parameters or states.
    """
    count = matrix.shape[0]
    largest = [reduce(ca.fmax, ca.horzsplit(ca.fabs(ca.densify(matrix[k, :])))) for k in range(count)]
    rows = [[*(matrix[k, j] for j in range(count)), right[k], largest[k]] for k in range(count)]
    for k in range(count):
        for i in range(k + 1, count):
            rows[k], rows[i] = _larger_first(rows[k], rows[i], k)
        inverse = 1 / rows[k][k]
        for i in range(k + 1, count):
            factor = rows[i][k] * inverse
            for j in range(k + 1, count + 1):
                rows[i][j] -= factor * rows[k][j]
        rows[k][k] = inverse
    solution: list[Any] = [None] * count
    for k in reversed(range(count)):
        rest = rows[k][count]
        for j in range(k + 1, count):
            rest -= rows[k][j] * solution[j]
        solution[k] = rest * rows[k][k]
    return solution


def _larger_first(upper: list[Any], lower: list[Any], k: int) -> tuple[list[Any], list[Any]]:
    """Return two rows, first that with the relatively larger element k."""
    if lower[k].is_zero():
        return upper, lower
    if upper[k].is_zero():
        return lower, upper
    better = ca.fabs(lower[k]) * upper[-1] > ca.fabs(upper[k]) * lower[-1]
    pairs = [*zip(upper[k:], lower[k:], strict=True)]
    first, second = ([ca.if_else(better, *pair) for pair in each] for each in ([p[::-1] for p in pairs], pairs))
    return [*upper[:k], *first], [*lower[:k], *second]
