"""Robust losses: criteria that grow more slowly than the square of a residual, so that outliers pull less.

With f the residual of one sample in standard deviations of its noise, the criterion is Σ ρ(f²) instead of Σ f². The
losses are those of `scipy.optimize.least_squares` with f_scale = 1; all are f² for small f:

- ``soft_l1``: ρ(z) = 2 (√(1 + z) − 1), like |f| for large f and smooth in between;
- ``huber``: ρ(z) = z up to one standard deviation, 2 √z − 1 beyond;
- ``cauchy``: ρ(z) = ln(1 + z), which almost ignores gross outliers, at the price of secondary optima.

The criterion stays a sum of squares, that of t = ±√ρ(f²) with the sign of f ("square-rooting the kernel"): its
gradient is exact, and one least-squares engine serves all losses. Half the derivative of ρ(f²) by f is ψ(f), so that
dt/df = ψ/t.

References
----------
P. J. Huber, "Robust Statistics", Wiley 1981, sections 6.7 (proposal 2) and 7.6 (covariance);
C. Engels, H. Stewénius, D. Nistér, "Bundle adjustment rules", Photogrammetric Computer Vision 2006 (roots of kernels);
C. Zach, "Robust bundle adjustment revisited", ECCV 2014.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.formatting import nearest

# Mean of min(x², 1) over the standard normal distribution: what Huber's proposal 2 compares with.
NORMAL_SHARE = 1.0 - math.sqrt(2.0 / (math.pi * math.e))


class Loss(ABC):
    """A robust loss as a function of whitened residuals f (n,)."""

    @abstractmethod
    def root(self, f: Floats) -> Floats:
        """Return t = ±√ρ(f²)."""

    @abstractmethod
    def unroot(self, t: Floats) -> Floats:
        """Return the f whose root is t."""

    @abstractmethod
    def influence(self, f: Floats) -> Floats:
        """Return ψ(f) = ρ′(f²) f."""

    @abstractmethod
    def curvature(self, f: Floats) -> Floats:
        """Return ψ′(f)."""

    def slope(self, f: Floats) -> Floats:
        """Return dt/df, between 0 and 1."""
        t = self.root(f)
        return np.divide(self.influence(f), t, out=np.ones_like(f), where=t != 0)


class SoftL1(Loss):
    """ρ(z) = 2 (√(1 + z) − 1)."""

    def root(self, f: Floats) -> Floats:
        """Return f √(2/(1 + √(1 + f²))), the same without cancellation."""
        return np.asarray(f * np.sqrt(2.0 / (1.0 + np.hypot(1.0, f))))

    def unroot(self, t: Floats) -> Floats:
        """Return t √(1 + t²/4)."""
        return np.asarray(t * np.hypot(1.0, 0.5 * t))

    def influence(self, f: Floats) -> Floats:
        """Return f/√(1 + f²)."""
        return np.asarray(f / np.hypot(1.0, f))

    def curvature(self, f: Floats) -> Floats:
        """Return (1 + f²)^(−3/2)."""
        return np.asarray(np.hypot(1.0, f) ** -3.0)


class Huber(Loss):
    """ρ(z) = z up to 1, 2 √z − 1 beyond."""

    def root(self, f: Floats) -> Floats:
        """Return f, beyond 1 ±√(2 |f| − 1)."""
        return np.where(np.abs(f) <= 1.0, f, np.copysign(np.sqrt(np.maximum(2.0 * np.abs(f) - 1.0, 0.0)), f))

    def unroot(self, t: Floats) -> Floats:
        """Return t, beyond 1 ±(t² + 1)/2."""
        return np.where(np.abs(t) <= 1.0, t, np.copysign(0.5 * (t**2 + 1.0), t))

    def influence(self, f: Floats) -> Floats:
        """Return f, at most 1 and at least −1."""
        return np.clip(f, -1.0, 1.0)

    def curvature(self, f: Floats) -> Floats:
        """Return 1, beyond 1 nothing."""
        return (np.abs(f) <= 1.0).astype(np.float64)


class Cauchy(Loss):
    """ρ(z) = ln(1 + z)."""

    def root(self, f: Floats) -> Floats:
        """Return ±√ln(1 + f²)."""
        with np.errstate(over="ignore"):  # what overflows is rejected like what fails
            return np.copysign(np.sqrt(np.log1p(f**2)), f)

    def unroot(self, t: Floats) -> Floats:
        """Return ±√(exp t² − 1)."""
        return np.copysign(np.sqrt(np.expm1(t**2)), t)

    def influence(self, f: Floats) -> Floats:
        """Return f/(1 + f²)."""
        return np.asarray(f / (1.0 + f**2))

    def curvature(self, f: Floats) -> Floats:
        """Return (1 − f²)/(1 + f²)², which is negative beyond 1."""
        return np.asarray((1.0 - f**2) / (1.0 + f**2) ** 2)


LOSSES: dict[str, Loss | None] = {"linear": None, "soft_l1": SoftL1(), "huber": Huber(), "cauchy": Cauchy()}
"""The losses by name; "linear" is the plain sum of squares."""


def get_loss(name: str) -> Loss | None:
    """Return the loss of a name, None for the plain sum of squares.

    Raises
    ------
    InputError
        If there is no such loss.
    """
    if name not in LOSSES:
        raise InputError(f"loss must be one of {', '.join(LOSSES)}, not {name!r}{nearest(str(name), LOSSES)}")
    return LOSSES[name]


def robust_variance(residual: Floats, free: float) -> float:
    """Return the variance of normal noise behind a residual (n,) that outliers contaminate: Huber's proposal 2.

    The σ² with Σ min(r²/σ², 1) = `free` · E[min(x², 1)], x standard normal: of residuals beyond one σ, the corner of
    the loss ``huber``, only the number counts. Up to nearly half of the samples may be arbitrarily wrong.

    Parameters
    ----------
    residual : (n,) array
    free : float
        Degrees of freedom, n minus the number of parameters fitted.
    """
    squares = np.sort(residual**2)
    sums = np.cumsum(squares)
    beyond = np.arange(squares.size - 1, -1, -1.0)
    wanted = max(free, np.finfo(float).eps) * NORMAL_SHARE
    # the left side with σ² at each square in turn, from n downwards; between two squares it is sums/σ² + beyond
    left = np.divide(sums, squares, out=np.full_like(sums, np.inf), where=squares > 0) + beyond
    last = int(np.searchsorted(-left, -wanted)) - 1  # the last square that lies below σ²
    return float(sums[last] / max(wanted - beyond[last], np.finfo(float).tiny))
