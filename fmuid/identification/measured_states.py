"""States from outputs, and unmeasured states by the model's equations.

Measured: x = x₀ + C⁺ (y* − y₀). With x = x* + N z and C N = 0, the unmeasured z obey ż = N⁺ f(x* + N z, u, θ). Newton's
method solves the trapezoidal rule over all intervals at once, at a cost that does not grow with stiffness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.simulation import RightHandSide

INDEPENDENT = 1e-6  # least singular value of ∂y/∂x of a measured direction, relative to the largest
MOST_UNMEASURED = 8  # directions; each costs an evaluation a step
# Newton's steps, their end and differences, in units of the nominals.
MOST_STEPS, SETTLED, CHANGE = 5, 1e-6, 1e-3


@dataclass(frozen=True, eq=False)
class MeasuredStates:
    """States of one experiment for any parameters."""

    side: RightHandSide
    intervals: Floats  # (K − 1, 1), between the samples, s
    told: Floats  # (K, n_x), from the outputs
    unseen: Floats  # (n_x, n_z), N, directions that change no output, of the length of the nominals

    def __call__(self, thetas: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield states (K, n_x) of each theta, and derivatives (2 (K − 1), n_x) at both ends of each interval."""
        if not self.unseen.size:
            yield from ((self.told, rates) for rates in self.side(both_ends(self.told), thetas)[0])
            return
        inverse = np.asarray(np.linalg.pinv(self.unseen), dtype=np.float64)
        first = self.side.initial(thetas)
        begins = np.zeros((len(thetas), len(inverse))) if first is None else (first - self.told[0]) @ inverse.T
        for theta, begin in zip(thetas, begins, strict=True):
            yield self._followed(theta[None], begin, inverse)

    def _followed(self, theta: Floats, begin: Floats, inverse: Floats) -> tuple[Floats, Floats]:
        """Return states and derivatives, from unmeasured states at the start (n_z,)."""
        unmeasured = np.tile(begin, (len(self.told), 1))
        half = 0.5 * self.intervals
        for step in range(MOST_STEPS + 1):
            states = self.told + unmeasured @ self.unseen.T
            ends = both_ends(states)
            rates = self.side(ends, theta)[0][0]
            own = rates @ inverse.T
            defect = half * (own[::2] + own[1::2]) - np.diff(unmeasured, axis=0)
            size = max(1.0, float(np.abs(unmeasured).max()))
            if step == MOST_STEPS or not np.isfinite(defect).all() or np.abs(defect).max() <= SETTLED * size:
                break
            moved = [self.side(ends + CHANGE * each, theta)[0][0] for each in self.unseen.T]
            slopes = np.stack([(each - rates) @ inverse.T for each in moved], axis=2) / CHANGE
            unmeasured[1:] += _marched(half[:, :, None] * slopes[::2], half[:, :, None] * slopes[1::2], defect)
        return states, rates


def _marched(begins: Floats, ends: Floats, defect: Floats) -> Floats:
    """Return δ of (I − E_k) δ_k = (I + B_k) δ_{k−1} + d_k."""
    size, one = defect.shape[1], np.eye(defect.shape[1])
    bands = np.zeros((3 * size - 1, defect.size))
    for i, j in np.ndindex(size, size):
        bands[size - 1 + i - j, j::size] = one[i, j] - ends[:, i, j]
        bands[2 * size - 1 + i - j, j:-size:size] = -one[i, j] - begins[1:, i, j]
    try:
        found = scipy.linalg.solve_banded((2 * size - 1, size - 1), bands, defect.ravel(), check_finite=False)
    except np.linalg.LinAlgError:
        return np.full(defect.shape, np.nan)
    return np.asarray(found.reshape(defect.shape), dtype=np.float64)


def both_ends(states: Floats) -> Floats:
    """Return the states at both ends of each interval."""
    return np.repeat(states, 2, axis=0)[1:-1]


def states_from_outputs(
    side: RightHandSide, theta: Floats, times: Floats, outputs: Floats
) -> tuple[MeasuredStates, Floats]:
    """Return the states by outputs (K, n_y), and C = ∂y/∂x (n_y, n_x)."""
    slopes, base, at = side.output_slopes(theta)
    if not np.isfinite(at).all() or not np.isfinite(slopes).all():
        raise InputError("the outputs are not available.")
    sizes = np.maximum(np.std(outputs, axis=0), 1e-300)
    _, values, directions = np.linalg.svd(slopes / sizes[:, None])
    count = int((values > INDEPENDENT * values.max(initial=0.0)).sum())
    if not count or len(directions) - count > MOST_UNMEASURED:
        raise InputError("the outputs do not determine the states.")
    seen = directions[:count] / side.nominals
    gain = side.nominals[:, None] * np.linalg.pinv(slopes / sizes[:, None], rcond=INDEPENDENT) / sizes
    told = (base @ seen.T) @ (directions[:count] * side.nominals) + (outputs - at) @ gain.T
    unseen = side.nominals[:, None] * directions[count:].T
    return MeasuredStates(side, np.diff(times)[:, None], told, unseen), slopes / side.nominals
