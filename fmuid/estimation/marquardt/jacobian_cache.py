"""Derivatives along the way of one search, for searches that differ from it in the noise of measurements alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats

# A waypoint stands for what is no farther from it than this share of each parameter's magnitude.
REACH = 0.05


@dataclass(frozen=True, eq=False)
class JacobianCache:
    """Points of a search and the derivatives of the simulation there.

    Attributes
    ----------
    thetas : (k, N) array
    derivatives : sequence of (N, n) arrays
        Of all counted samples by the parameters.
    """

    thetas: Floats
    derivatives: tuple[Floats, ...]

    def near(self, theta: Floats, magnitudes: Floats) -> Floats | None:
        """Return the derivatives (N, n) at the waypoint nearest to theta (N,), None where it is not close."""
        distances = np.abs((self.thetas - theta) / magnitudes).max(axis=1, initial=0.0)
        nearest = int(np.argmin(distances)) if distances.size else -1
        return self.derivatives[nearest] if nearest >= 0 and distances[nearest] <= REACH else None
