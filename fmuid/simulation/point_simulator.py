"""Predictors of experiments without a time: what they have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Simulations
from fmuid.data import Experiment
from fmuid.errors import InputError, SimulationError
from fmuid.models import System
from fmuid.simulation.point_model import ModelOfPoints, PointModel
from fmuid.simulation.simulation_task import Value
from fmuid.simulation.solver_refinement import by_model_exchange


class PointSimulator(ABC):
    """Outputs of a model at operating points, by parameters; used like a `Simulator`.

    Theta sets `parameters`, in this order. Values held by the experiment take precedence over `values`.
    """

    stiff: frozenset[str] = frozenset()
    corrects = False
    unfed_inputs: tuple[str, ...] = ()

    def __init__(
        self,
        system: System,
        experiment: Experiment,
        parameters: Sequence[str] = (),
        *,
        values: Mapping[str, Value] | None = None,
    ) -> None:
        self.system, self.experiment, self.parameters = system, experiment, tuple(parameters)
        self._values = dict(values or {})
        self.held: dict[str, Value] = {**self._values, **experiment.values}
        self.target_names, self.settings = self.parameters, (self.held, None)
        self._prepare()

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs, in order of the last axis."""
        return self.experiment.output_names

    def issue_at(self, theta: Floats) -> tuple[int, str] | None:  # noqa: ARG002 - steady states have
        """Return the first doubtful row (from 0) at theta (N,), with reason."""
        return None

    def over(self, experiment: Experiment, parameters: Sequence[str] | None = None) -> Self:
        """Return the simulator of a like experiment, or of other parameters."""
        names = self.parameters if parameters is None else tuple(parameters)
        values = {name: value for name, value in self._values.items() if name not in names}
        return type(self)(self.system, experiment, names, values=values)

    def __call__(self, theta: ArrayLike) -> Floats:
        """Compute one theta (N,) or several (m, N); return (K, n_outputs) or (m, K, n_outputs)."""
        return Simulations.of(self.many, theta)

    def many(self, thetas: ArrayLike) -> Simulations:
        """Compute several finite thetas (m, N); failures do not end the others."""
        given = np.ascontiguousarray(thetas, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.parameters) or not np.isfinite(given).all():
            raise InputError(f"theta must have {len(self.parameters)} finite values, not the shape {given.shape}")
        with np.errstate(all="ignore"):
            outputs, reasons = self._compute(given)
        errors: list[SimulationError | None] = [None] * len(given)
        for i, theta in enumerate(given):
            reason = reasons[i] or ("" if np.isfinite(outputs[i]).all() else "an output is not finite")
            if reason:
                named = dict(zip(self.parameters, theta.tolist(), strict=True))
                errors[i] = SimulationError(self.system.label, np.nan, named, f"{self.experiment.source}: {reason}")
                outputs[i] = np.nan
        return Simulations(outputs, tuple(errors))

    @abstractmethod
    def _prepare(self) -> None:
        """Check the names of the experiment, and load the model."""

    @abstractmethod
    def _compute(self, thetas: Floats) -> tuple[Floats, list[str]]:
        """Return outputs (m, K, n_outputs), and reasons of failures."""

    @cached_property
    def model(self) -> ModelOfPoints | None:
        """The model by Model Exchange; None if it shows no derivatives."""
        system = by_model_exchange(self.system)
        return None if system is None else ModelOfPoints(system, self.parameters, self.held, self.experiment.source)

    def points(
        self, inputs: Mapping[str, Floats], seeds: Sequence[str], outputs: Sequence[str], what: str
    ) -> PointModel:
        """Return the model about operating points that `what` needs."""
        found = None if self.model is None else PointModel(self.model, inputs, seeds, outputs, {})
        if found is None or not found.is_open:
            raise InputError(f"{self.system.label}: {what} needs Model Exchange and accessible states.")
        return found

    def parameter(self, name: str, thetas: Floats) -> Floats:
        """Return the values (m,) of a parameter of the FMU."""
        if name in self.parameters:
            return thetas[:, self.parameters.index(name)]
        value = self.held.get(name, self.system.variable(name, "parameter").start)
        if not isinstance(value, int | float):
            raise InputError(f"{self.system.label}: {name!r} has no value. Set it in [model.fixed].")
        return np.full(len(thetas), float(value))
