"""What is known of the parameters from window to window: a parabola of the compound criterion (1.57), handed on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from fmuid.arrays import Floats


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of θ_e before or after a window, N parameters in the coordinates of the search.

    Attributes
    ----------
    mean : (N,) array
    information : (N, N) array
        Inverse of the covariance, zero where nothing is known.
    scatter : (N, N) array
        Covariance of information @ mean that is due to the noise of records: that of the prior comes on top.
    """

    mean: Floats
    information: Floats
    scatter: Floats

    @classmethod
    def of_json(cls, data: Mapping[str, Any]) -> Belief:
        """Return that of a file.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the data are not of one.
        """
        return cls(*(np.array(data[name], np.float64) for name in ("mean", "information", "scatter")))

    def like(self, other: Belief) -> bool:
        """Return whether two are the same but for rounding."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(one.shape == two.shape and np.allclose(one, two, rtol=1e-9, atol=0.0) for one, two in pairs)


def forgotten(before: Belief, prior: Belief, forgetting: float) -> Belief:
    """Return the prior of the next window: what the last one left, and the healthy prior in place of what is forgotten.

    The geometric mean of both densities (R. Kulhavý, M. B. Zarrop, "On a general concept of forgetting", Int. J.
    Control 58, 1993): information falls by the factor `forgetting` from window to window, but never below that of the
    healthy record, which counts once at all times.

    Parameters
    ----------
    before, prior : Belief
    forgetting : float
        0: every window by itself, to below 1: all windows as one.
    """
    information = forgetting * before.information + (1.0 - forgetting) * prior.information
    vector = forgetting * before.information @ before.mean + (1.0 - forgetting) * prior.information @ prior.mean
    known = np.diag(information) > 0
    mean = prior.mean.copy()
    mean[known] = np.linalg.solve(information[np.ix_(known, known)], vector[known])
    return Belief(mean, information, forgetting**2 * before.scatter)


def nearest(point: Floats, information: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return the point within the bounds that is nearest in the metric of an information matrix."""
    scale = 1.0 / np.sqrt(np.diag(information))
    root = np.linalg.cholesky(information * np.outer(scale, scale)).T
    found = optimize.lsq_linear(root, root @ (point / scale), (lower / scale, upper / scale), method="bvls")
    return np.asarray(np.clip(found.x * scale, lower, upper), dtype=np.float64)
