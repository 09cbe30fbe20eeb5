"""Simulations of a problem: counts, failures, and values that many problems share."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.errors import InputError, SensitivityUnavailableError
from fmuid.estimation.finite_differences import SensitivityMethod
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.simulation_noise import noise_level, noise_steps, shares_of

AnyProblem = TypeVar("AnyProblem", bound=LeastSquares, covariant=True)
OtherProblem = TypeVar("OtherProblem", bound=LeastSquares)
Item = TypeVar("Item")


@dataclass(frozen=True)
class CellSettings:
    """Cells of parameter space at whose centers values are shared."""

    jacobian_width: float = 0.1  # relative; a Jacobian this near serves far from the optimum, wider ones cost steps
    error_width: float = 0.25  # relative; an error that grows with the fourth power is known within a factor of 1.6
    step: float = 1e-3  # of central differences, relative: small against the cell, large against simulation noise
    scatter_stds: float = 4.0  # width of the region in which estimates of like problems lie
    least_uses: float = 3.0  # a cell costs as much as two uses save


CELLS = CellSettings()


class Cache:
    """Values shared by many problems; the least recently used are dropped first.

    Each value is a pure function of its key, so the order of the problems does not matter.

    Parameters
    ----------
    memory : int
        Maximum size of the arrays, bytes.
    problems : int
        Expected number of problems with one layout (`LeastSquares.layout`).

    Examples
    --------
    >>> coil, cache = fmuid.datasets.coil(), fmuid.Cache(problems=20)
    >>> fmuid.identify(fmuid.estimation.Evaluator(coil.problem(), cache)).converged
    True
    """

    def __init__(self, memory: int = 256_000_000, problems: int = 1) -> None:
        self.memory, self.problems = memory, problems
        self._kept: OrderedDict[tuple[str, Hashable], object] = OrderedDict()
        self._size = 0

    def get(self, shelf: str, key: Hashable, make: Callable[[], Item]) -> Item:
        """Return the value of a key; make it if it is missing."""
        place = shelf, key
        if place in self._kept:
            self._kept.move_to_end(place)
            return cast(Item, self._kept[place])
        value = make()
        self._kept[place] = value
        self._size += _bytes(value)
        while self._size > self.memory and self._kept:
            self._size -= _bytes(self._kept.popitem(last=False)[1])
        return value


def _bytes(value: object) -> int:
    if isinstance(value, tuple):
        return sum(map(_bytes, value))
    return value.nbytes if isinstance(value, np.ndarray) else 0


class Evaluator(Generic[AnyProblem]):
    """Simulates one problem and counts simulations and failures; problems of the same layout share a cache.

    `scatter` (N,) are expected standard deviations of the estimates, if the cache serves many problems.
    """

    def __init__(
        self,
        problem: AnyProblem,
        cache: Cache | None = None,
        _family: tuple[Counter[str], dict[Hashable, Evaluator[AnyProblem]]] | None = None,
    ) -> None:
        self._problem, self.cache = problem, cache or Cache()
        self._counts, self._by_refinement = _family or (Counter(), {})
        self._by_refinement[problem.refinement] = self
        self._reasons: dict[int, tuple[Floats, Exception | None]] = {}  # of the last failure, by experiment
        self._counted: set[bytes] = set()  # thetas at starting points that were counted
        self._refusal = ""
        self.scatter: Floats | None = None

    @property
    def problem(self) -> AnyProblem:
        """The simulated problem."""
        return self._problem

    @property
    def simulations(self) -> int:
        """Number of simulated experiments."""
        return self._counts["simulations"]

    @property
    def failures(self) -> int:
        """Number of parameter vectors with a failed simulation."""
        return self._counts["failures"]

    def finer(self, refinement: Hashable) -> Evaluator[AnyProblem]:
        """Return the evaluator with a solver refinement, counting together; `InputError` if an FMU cannot use it."""
        if refinement not in self._by_refinement:
            Evaluator(self.problem.finer(refinement), self.cache, (self._counts, self._by_refinement))
        return self._by_refinement[refinement]

    def of(self, problem: OtherProblem) -> Evaluator[OtherProblem]:
        """Return the evaluator of another problem; both count together."""
        return Evaluator(problem, self.cache, (self._counts, {}))

    # --- simulations

    def predict(self, thetas: Floats) -> Floats:
        """Simulate thetas (m, N); return counted samples (m, n), NaN rows if failed; the caller may change them."""
        rows, simulations = self._rows(thetas)
        self._count(rows, simulations)
        return rows

    def predict_start(self, thetas: Floats) -> Floats:
        """Simulate like `predict`, but share results at starting points."""
        key = thetas.tobytes()
        rows, simulations = self.cache.get("outputs", (self.problem.layout, key), lambda: self._rows(thetas))
        if key not in self._counted:
            self._counted.add(key)
            self._count(rows, simulations)
        return rows.copy(order="K")  # sums of another layout differ in their last bits

    def predict_by(self, refinement: Hashable, theta: Floats, *, start: bool = False) -> Floats:
        """Simulate theta (N,) with a solver refinement; return (n,), NaN if failed; a shared start does not count."""
        try:
            other = self.finer(refinement)
        except InputError:  # an FMU that takes no such steps
            return np.full(self.problem.measured.size, np.nan)
        if start and self.cache.problems > 1:
            key = other.problem.layout, theta.tobytes()
            return np.asarray(self.cache.get("outputs", key, lambda: other._rows(theta[None]))[0][0])
        return np.asarray(other.predict(theta[None])[0])

    def _count(self, rows: Floats, simulations: int) -> None:
        self._counts["simulations"] += simulations
        self._counts["failures"] += int(np.isnan(rows[:, 0]).sum())

    def _rows(self, thetas: Floats) -> tuple[Floats, int]:
        """Return counted samples (m, n) and the number of simulations."""
        problem, blocks, simulations = self.problem, [], 0
        for index, kept in enumerate(problem.kept):
            outputs, taken = self._outputs(index, thetas)
            flat = outputs.reshape(len(thetas), -1)
            simulations += taken
            blocks.append(flat if kept.size == flat.shape[1] else flat[:, kept])
        # failed simulations are NaN throughout; an experiment may have no sample
        failed = np.any([np.isnan(block[:, :1]).any(axis=1) for block in blocks], axis=0)
        stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)
        stacked[failed] = np.nan
        return problem.scaled(stacked), simulations

    def _outputs(self, index: int, thetas: Floats) -> tuple[Floats, int]:
        """Return an experiment's outputs (m, K, n_outputs) and the number of simulations."""
        _, columns = self.problem.parameters.for_experiment(index)
        if columns.size == thetas.shape[1] or len(thetas) == 1:
            return self._simulated(index, thetas[:, columns]), len(thetas)
        # parameters of other experiments have no effect
        own, back = np.unique(thetas[:, columns], axis=0, return_inverse=True)
        return self._simulated(index, own)[back.ravel()], len(own)

    def _simulated(self, index: int, thetas: Floats) -> Floats:
        found = self.problem.predictors[index].many(thetas)
        first = next((i for i, error in enumerate(found.errors) if error is not None), None)
        if first is not None:  # the one whose reason was asked for
            self._reasons[index] = thetas[first].copy(), found.errors[first]
        return found.outputs

    def outputs(self, theta: ArrayLike, predicted: Floats | None = None, *, simulate: bool = True) -> list[Floats]:
        """Simulate theta (N,); return each experiment's outputs (K, n_outputs), NaN if failed.

        Complete experiments are taken from `predicted` (n,). Without `simulate`, other samples are NaN.
        """
        problem, thetas = self.problem, np.array(theta, dtype=np.float64)[None]
        known = None if predicted is None else problem.tables(problem.unscaled(predicted))
        found = []
        for index, (experiment, kept) in enumerate(zip(problem.experiments, problem.kept, strict=True)):
            if known is None or (simulate and kept.size < experiment.output_values.size):
                outputs, taken = self._outputs(index, thetas)
                self._counts["simulations"] += taken
                found.append(outputs[0])
            else:
                found.append(known[index])
        return found

    def failure(self, theta: Floats) -> Exception | None:
        """Return the simulation error at theta (N,), None if it succeeds."""
        for index, predictor in enumerate(self.problem.predictors):
            _, columns = self.problem.parameters.for_experiment(index)
            known, error = self._reasons.get(index, (None, None))
            if known is None or not np.array_equal(known, theta[columns]):  # what fails may take its time about it
                (error,) = predictor.many(theta[None, columns]).errors
            if error is not None:
                return error
        return None

    def noise_near(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return samples (n,) at a starting point, and each output's simulation noise."""
        given = self.problem.parameters
        steps = noise_steps(given.magnitudes(theta), theta - given.lower, given.upper - theta)
        return noise_level(self.predict_start, theta, steps, shares_of(self.problem.groups, self.problem.counts.size))

    # --- derivatives by the model

    def derivatives(self, theta: Floats) -> Floats | None:
        """Return the model's derivatives (N, n) of counted samples; None once refused."""
        blocks, problem = [], self.problem
        if self._refusal or not problem.derivatives:
            return None
        for index, (kept, derivatives) in enumerate(zip(problem.kept, problem.derivatives, strict=True)):
            _, columns = problem.parameters.for_experiment(index)
            self._counts["simulations"] += 1
            block = np.zeros((theta.size, kept.size))
            try:
                np.add.at(block, columns, derivatives(theta[columns]).reshape(columns.size, -1)[:, kept])
            except SensitivityUnavailableError as error:
                self._refusal = str(error)
                return None
            blocks.append(block)
        return problem.scaled(np.concatenate(blocks, axis=1))

    @property
    def used_sensitivity(self) -> SensitivityMethod:
        """Method of the derivatives."""
        by_differences = any(getattr(each, "by_differences", False) for each in self.problem.derivatives)
        return SensitivityMethod(self.problem.sensitivity, by_differences, self._refusal)

    # --- cells

    def jacobian_near(self, theta: Floats) -> Floats | None:
        """Return derivatives (N, n) at the center of theta's cell, if available; they do not count as simulations."""
        if self.scatter is None or not self._pays(theta, self.scatter, CELLS.jacobian_width):
            return None
        center, key = self._cell(theta, CELLS.jacobian_width)
        return self.cache.get("jacobian", key, lambda: self._center_jacobian(center))

    def _center_jacobian(self, center: Floats) -> Floats | None:
        other = Evaluator(self.problem.afresh())
        if other.problem.derivatives:
            return other.derivatives(center)
        parameters = self.problem.parameters
        step = np.diag(CELLS.step * parameters.magnitudes(center))
        points = np.clip(np.vstack([center + step, center - step]), parameters.lower, parameters.upper)
        above, below = np.split(other.predict(points), 2)
        ahead, behind = np.split(points, 2)
        found = (above - below) / np.diag(ahead - behind)[:, None]
        return found if np.isfinite(found).all() else None

    def error_near(self, refinement: Hashable, theta: Floats, std: Floats) -> Floats | None:
        """Return the solver error (n,) at the center of an estimate's cell; NaN if a simulation fails.

        None if estimates with standard deviations `std` (N,) need too many cells.
        """
        if not self._pays(theta, std, CELLS.error_width):
            return None
        center, key = self._cell(theta, CELLS.error_width)
        return self.cache.get("solver error", (refinement, key), lambda: self._center_error(refinement, center))

    def _center_error(self, refinement: Hashable, center: Floats) -> Floats:
        other = Evaluator(self.problem.afresh())
        return np.asarray(other.predict_by(refinement, center) - other.predict(center[None])[0])

    def _cell(self, theta: Floats, width: float) -> tuple[Floats, Hashable]:
        """Return the center (N,) and key of the cell of theta."""
        parameters = self.problem.parameters
        cell = np.round(np.arcsinh(theta / parameters.scale) / width)
        center = np.clip(parameters.scale * np.sinh(width * cell), parameters.lower, parameters.upper)
        return center, (self.problem.layout, cell.tobytes())

    def _pays(self, theta: Floats, std: Floats, width: float) -> bool:
        """Return True if each cell serves enough problems."""
        reach = width * np.hypot(theta, self.problem.parameters.scale)
        with np.errstate(over="ignore"):
            cells = np.prod(1.0 + CELLS.scatter_stds * np.nan_to_num(std, nan=np.inf) / reach)
        return bool(self.cache.problems >= CELLS.least_uses * cells)
