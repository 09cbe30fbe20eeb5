"""Derivatives of whole simulations that the model gives (docs/method.md section 3), in place of finite differences.

`ModelSensitivities` stands where `fmuid.estimation.finite_differences.FiniteDifferences` does. Where a model cannot
give them at some point (an event that the sensitivities cannot be carried through), differences serve from there on.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.errors import SensitivityUnavailableError
from fmuid.estimation.finite_differences import INFLUENCE_NOISES, LARGEST_STEP, FiniteDifferences

SENSITIVITIES = ("finite-difference", "forward", "fmu")
"""How the derivatives of the outputs by the parameters are found: by differences of whole simulations, by integrating
the sensitivity system (1.26) with the model, or as outputs of the FMU."""


@dataclass(frozen=True)
class SensitivityMethod:
    """How the derivatives by the parameters were found.

    Attributes
    ----------
    method : str
        The one of `SENSITIVITIES` that was asked for.
    by_differences : bool
        Of "forward": whether the right-hand side of the sensitivity system is made of differences, not of directional
        derivatives.
    refusal : str
        Why the model has refused them somewhere; differences of whole simulations have served from there on.
    """

    method: str
    by_differences: bool = False
    refusal: str = ""


# Share of a derivative that its error is taken to be: what an integrator with the default tolerance leaves.
RELATIVE_ERROR = 1e-6


class JacobianProvider(Protocol):
    """Derivatives that a `fmuid.estimation.cost_function.CostFunction` needs; docstrings: `FiniteDifferences`."""

    def weighted(self, weights: float | Floats, noise: Floats) -> JacobianProvider:
        """Return the same with other weights."""

    def renoised(self, noise: Floats, size: float) -> JacobianProvider:
        """Return the same for another noise (n,) and size."""

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives of the weighted function at theta, (N, n)."""

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, Flags]:
        """Return the derivatives at the start and which parameters act on anything."""

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error of each row of a Jacobian, its norm over the samples (N,)."""


class ModelSensitivities:
    """Jacobians that the model gives, finite differences where it refuses.

    Parameters
    ----------
    derivatives : callable
        Theta (N,) to the derivatives (N, n) of the stacked outputs; raises `SensitivityUnavailableError`.
    differences : FiniteDifferences
        For when the model refuses.
    magnitudes : callable
        How large each parameter is at a theta.
    noise : (n,) array
        Standard deviation of the weighted function's noise.
    weights : float or (n,) array
        What the function is multiplied by.
    refused : callable
        Called with the reason when the model refuses.
    """

    def __init__(
        self,
        derivatives: Callable[[Floats], Floats],
        differences: FiniteDifferences,
        magnitudes: Callable[[Floats], Floats],
        noise: Floats,
        weights: float | Floats,
        refused: Callable[[str], None],
    ) -> None:
        self._derivatives, self._differences = derivatives, differences
        self._magnitudes, self._noise, self._weights = magnitudes, noise, weights
        self._refused = refused
        self._serves = True
        self._error = np.zeros(0)

    def weighted(self, weights: float | Floats, noise: Floats) -> ModelSensitivities:
        """Return the same with other weights."""
        other = copy.copy(self)
        other._weights, other._noise = weights, noise
        other._differences = self._differences.weighted(weights, noise)
        scale = _rms(noise) / _rms(self._noise) if _rms(self._noise) > 0 else 1.0
        other._error = scale * self._error
        return other

    def renoised(self, noise: Floats, size: float) -> ModelSensitivities:
        """Return the same for another noise (n,) and size."""
        other = copy.copy(self)
        other._noise, other._differences = noise, self._differences.renoised(noise, size)
        return other

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives of the weighted function at theta, (N, n), one row a parameter.

        Raises
        ------
        SensitivityError
            If the model refuses and every simulation near theta fails for some parameter.
        """
        found = self._of_model(theta)
        return self._differences.jacobian(theta, base, central=central) if found is None else found

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, Flags]:
        """Return the Jacobian (N, n) at the start and which parameters act on anything (N,)."""
        found = self._of_model(theta)
        if found is None:
            return self._differences.first_jacobian(theta, base)
        change = np.abs(found) * (LARGEST_STEP * self._magnitudes(theta))[:, None]
        floor = INFLUENCE_NOISES * np.maximum(self._noise, np.finfo(float).tiny)
        return found, np.asarray((change > floor).any(axis=1), dtype=np.bool_)

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error of each row of a Jacobian at theta, its norm over the samples (N,)."""
        return self._error if self._serves else self._differences.error(theta, central=central)

    def _of_model(self, theta: Floats) -> Floats | None:
        if not self._serves:
            return None
        try:
            found = self._derivatives(theta)
        except SensitivityUnavailableError as error:
            self._serves = False
            self._refused(str(error))
            return None
        found *= self._weights
        self._error = RELATIVE_ERROR * np.linalg.norm(found, axis=1)
        return found


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.vdot(values, values)) / max(values.size, 1))
