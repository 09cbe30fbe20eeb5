"""Robust losses: cost functions ρ(f²) that grow more slowly than f².

f is a residual in σ of its noise. The losses are those of `scipy.optimize.least_squares` with f_scale = 1:

- ``soft_l1``: ρ(z) = 2 (√(1 + z) − 1);
- ``huber``: ρ(z) = z up to one σ, 2 √z − 1 beyond;
- ``cauchy``: ρ(z) = ln(1 + z).

The cost stays a sum of squares, that of t = ±√ρ(f²) with the sign of f. With ψ(f) = ρ′(f²) f, dt/df = ψ/t.

References: P. J. Huber, "Robust Statistics", Wiley 1981, sections 6.7 and 7.6; C. Engels, H. Stewénius, D. Nistér,
"Bundle adjustment rules", 2006 (roots of kernels); C. Zach, "Robust bundle adjustment revisited", ECCV 2014.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.formatting import nearest

Function = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Loss:
    """Robust loss as functions of whitened residuals f (n,)."""

    root: Function
    """t = ±√ρ(f²)"""
    unroot: Function
    """f with root t"""
    influence: Function
    """ψ(f) = ρ′(f²) f"""
    curvature: Function
    """ψ′(f)"""

    def slope(self, f: Floats) -> Floats:
        """Return dt/df, between 0 and 1."""
        t = self.root(f)
        return np.divide(self.influence(f), t, out=np.ones_like(f), where=t != 0)

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return get_loss, (next(name for name, loss in LOSSES.items() if loss is self),)


def _cauchy_root(f: Floats) -> Floats:
    with np.errstate(over="ignore"):  # what overflows is rejected like what fails
        return np.copysign(np.sqrt(np.log1p(f**2)), f)


LOSSES: dict[str, Loss | None] = {
    "linear": None,
    "soft_l1": Loss(
        root=lambda f: f * np.sqrt(2.0 / (1.0 + np.hypot(1.0, f))),  # without cancellation
        unroot=lambda t: t * np.hypot(1.0, 0.5 * t),
        influence=lambda f: f / np.hypot(1.0, f),
        curvature=lambda f: np.hypot(1.0, f) ** -3.0,
    ),
    "huber": Loss(
        root=lambda f: np.where(np.abs(f) <= 1.0, f, np.copysign(np.sqrt(np.maximum(2.0 * np.abs(f) - 1.0, 0.0)), f)),
        unroot=lambda t: np.where(np.abs(t) <= 1.0, t, np.copysign(0.5 * (t**2 + 1.0), t)),
        influence=lambda f: np.clip(f, -1.0, 1.0),
        curvature=lambda f: (np.abs(f) <= 1.0).astype(np.float64),
    ),
    "cauchy": Loss(
        root=_cauchy_root,
        unroot=lambda t: np.copysign(np.sqrt(np.expm1(t**2)), t),
        influence=lambda f: f / (1.0 + f**2),
        curvature=lambda f: (1.0 - f**2) / (1.0 + f**2) ** 2,  # negative beyond 1
    ),
}
"""The losses by name; "linear" is the plain sum of squares."""


def get_loss(name: str) -> Loss | None:
    """Return the loss of a name, None for squares.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name not in LOSSES:
        raise InputError(f"loss: unknown value {name!r}{nearest(str(name), LOSSES)}. Choose {', '.join(LOSSES)}.")
    return LOSSES[name]


def robust_variance(residual: Floats, free: float) -> float:
    """Return the noise variance behind a residual with outliers (Huber's proposal 2).

    It solves Σ min(r²/σ², 1) = `free` · E[min(x², 1)], x standard normal.

    Parameters
    ----------
    residual : (n,) array
        May have nearly half of its samples wrong.
    free : float
        Degrees of freedom.
    """
    squares = np.sort(residual**2)
    sums = np.cumsum(squares)
    beyond = np.arange(squares.size - 1, -1, -1.0)
    wanted = max(free, np.finfo(float).eps) * (1.0 - math.sqrt(2.0 / (math.pi * math.e)))  # E[min(x², 1)]
    # the left side with σ² at each square in turn, from n downwards; between two squares it is sums/σ² + beyond
    left = np.divide(sums, squares, out=np.full_like(sums, np.inf), where=squares > 0) + beyond
    last = int(np.searchsorted(-left, -wanted)) - 1  # the last square that lies below σ²
    return float(sums[last] / max(wanted - beyond[last], np.finfo(float).tiny))
