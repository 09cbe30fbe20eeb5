"""Derivatives by the model (docs/method/sensitivities.md), replaced by differences if refused."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.errors import SensitivityUnavailableError
from fmuid.estimation.finite_differences import DIFFERENCES, FiniteDifferences

SENSITIVITIES = ("finite-difference", "forward", "fmu")
"""Methods: differences of simulations, sensitivity equations (1.26), outputs of the FMU."""


@dataclass(frozen=True)
class SensitivityMethod:
    """Method of the derivatives.

    Attributes
    ----------
    method : str
        One of `SENSITIVITIES`, as requested.
    by_differences : bool
        "forward" only: True if the right-hand side is differentiated by differences.
    refusal : str
        The model's reason to refuse; finite differences were used afterwards.
    """

    method: str
    by_differences: bool = False
    refusal: str = ""


RELATIVE_ERROR = 1e-6  # of a derivative, by an integrator with default tolerance


class ModelSensitivities:
    """Jacobians from the model, or by differences if it refuses; interface of `FiniteDifferences`.

    `derivatives` gives (N, n) at theta or raises `SensitivityUnavailableError`; `refused` receives the reason.
    """

    def __init__(
        self, derivatives: Callable[[Floats], Floats], differences: FiniteDifferences, refused: Callable[[str], None]
    ) -> None:
        self._derivatives, self._differences, self._refused = derivatives, differences, refused
        self._serves = True
        self._error = np.zeros(0)

    def weighted(self, weights: float | Floats, noise: Floats) -> ModelSensitivities:
        """Return a copy with other weights."""
        other, before = copy.copy(self), _rms(self._differences.noise)
        other._differences = self._differences.weighted(weights, noise)
        other._error = (_rms(noise) / before if before > 0 else 1.0) * self._error
        return other

    def renoised(self, noise: Floats, size: float) -> ModelSensitivities:
        """Return a copy for other noise (n,) and size."""
        other = copy.copy(self)
        other._differences = self._differences.renoised(noise, size)
        return other

    def jacobian(self, theta: Floats, base: Floats, *, central: bool) -> Floats:
        """Return the derivatives (N, n) of the weighted function at theta."""
        found = self._of_model(theta)
        return self._differences.jacobian(theta, base, central=central) if found is None else found

    def first_jacobian(self, theta: Floats, base: Floats) -> tuple[Floats, Flags]:
        """Return the Jacobian (N, n) and flags (N,) of acting parameters."""
        found = self._of_model(theta)
        if found is None:
            return self._differences.first_jacobian(theta, base)
        change = np.abs(found) * (DIFFERENCES.largest_step * self._differences.function.magnitudes(theta))[:, None]
        floor = DIFFERENCES.effect * np.maximum(self._differences.noise, np.finfo(float).tiny)
        return found, np.asarray((change > floor).any(axis=1), dtype=np.bool_)

    def error(self, theta: Floats, *, central: bool) -> Floats:
        """Return the error norm (N,) of each Jacobian row at theta."""
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
        found *= self._differences.weights
        self._error = RELATIVE_ERROR * np.linalg.norm(found, axis=1)
        return found


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.vdot(values, values)) / max(values.size, 1))
