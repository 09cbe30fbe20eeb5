"""Predictors, and Python functions as such."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.errors import InputError, SimulationError


class Predictions(Protocol):
    """Outputs simulated for several thetas."""

    @property
    def outputs(self) -> Floats:
        """(m, K, n_outputs), NaN if failed; the caller may change it."""

    @property
    def errors(self) -> Sequence[Exception | None]:
        """Error of each simulation, None if it succeeded."""


class Predictor(Protocol):
    """Simulates one experiment; `fmuid.Simulator` is one."""

    def many(self, thetas: ArrayLike) -> Predictions:
        """Simulate thetas (m, N_i)."""


@dataclass(frozen=True, eq=False)
class FunctionPredictions:
    """Outputs of a Python function for several thetas, as `Predictions`."""

    outputs: Floats
    errors: tuple[Exception | None, ...]


class FunctionPredictor:
    """Python function with the interface of a simulator."""

    def __init__(self, function: Callable[[Floats], ArrayLike], shape: tuple[int, int]) -> None:
        self._function, self._shape = function, shape

    def many(self, thetas: ArrayLike) -> FunctionPredictions:
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
        return FunctionPredictions(outputs, tuple(errors))
