"""Predictors, and Python functions as such."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Simulations
from fmuid.errors import InputError, SimulationError


class Predictor(Protocol):
    """Simulates one experiment; `fmuid.Simulator` is one."""

    def many(self, thetas: ArrayLike) -> Simulations:
        """Simulate thetas (m, N_i)."""


class FunctionPredictor:
    """Python function with the interface of a simulator."""

    def __init__(self, function: Callable[[Floats], ArrayLike], shape: tuple[int, int]) -> None:
        self._function, self._shape = function, shape

    def many(self, thetas: ArrayLike) -> Simulations:
        """Call the function for each of thetas (m, N)."""
        given = np.array(thetas, dtype=np.float64)
        outputs = np.full((len(given), *self._shape), np.nan)
        errors: list[Exception | None] = []
        for i, theta in enumerate(given):
            error: Exception | None = None
            try:
                with np.errstate(all="ignore"):
                    values = np.asarray(self._function(theta), dtype=np.float64)
            except (ArithmeticError, SimulationError) as caught:
                error = caught
            else:
                if values.shape not in (self._shape, self._shape[:1] if self._shape[1] == 1 else self._shape):
                    raise InputError(f"the function must return outputs of shape {self._shape}, not {values.shape}")
                if np.isfinite(values).all():
                    outputs[i] = values.reshape(self._shape)
                else:
                    error = ArithmeticError("the function returned a value that is not finite")
            errors.append(error)
        return Simulations(outputs, tuple(errors))
