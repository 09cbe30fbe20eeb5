"""Points spread over the box of a global search, and those that are worth a fit."""

from __future__ import annotations

from typing import Any, Literal, cast

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution
from scipy.spatial import KDTree

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation.cost_components import CostComponents, misfits
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.global_search.box import Box
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.starting_points.sobol import sobol_points
from fmuid.progress import GlobalStep, Progress

# Points whose simulation fails are replaced by further points of the sequence, until so many times `starts` are tried.
MOST_TRIES_RATIO = 10
# The generation agrees where the criterion varies by this share of itself (1 % of the residual variance) ...
AGREED_SPREAD = 0.01
# ... or no parameter by more than this share of the box: from here on Marquardt's search is much faster.
COLLAPSED_SHARE = 1e-3


class Exploration:
    """The points of the box that were tried, with the concentrated criterion there.

    Attributes
    ----------
    box : Box
    thetas : (m, N) array
        Every point tried.
    values : (m,) array
        The criterion there, +inf where the simulation failed.
    """

    def __init__(self, evaluator: Evaluator[LeastSquares], seed: int, progress: Progress | None) -> None:
        self.evaluator, self.problem, self.progress = evaluator, evaluator.problem, progress
        self._before = evaluator.simulations
        self.box = Box(self.problem.parameters)
        self._rng = np.random.default_rng(seed)
        self.thetas = np.empty((0, len(self.problem.parameters)))
        self.values = np.empty(0)

    @property
    def simulations(self) -> int:
        """How many simulations the search has made."""
        return self.evaluator.simulations - self._before

    @property
    def any_succeeded(self) -> bool:
        """Whether the simulation of any point succeeded."""
        return bool(np.isfinite(self.values).any())

    def evaluate(self, thetas: Floats) -> Floats:
        """Return the concentrated criterion at thetas (m, N), +inf where the simulation failed, and remember it."""
        return self.remember(thetas, misfits(self.evaluator, thetas))

    def remember(self, thetas: Floats, found: CostComponents) -> Floats:
        """Return the concentrated criterion at thetas (m, N) whose misfits are known, and remember it."""
        values = found.concentrated(self.problem)
        values = np.where(np.isnan(values), np.inf, values)
        self.thetas, self.values = np.vstack([self.thetas, thetas]), np.append(self.values, values)
        return values

    def _points(self, count: int) -> Floats:
        """Return the parameters' own start and the first points of a Sobol sequence, (count, N)."""
        points = sobol_points(self.box.lower.size, count, self._rng)
        return np.vstack([self.problem.parameters.start, self.box.thetas(points)])[:count]

    def spread(self, wanted: int) -> Floats:
        """Return so many points (m, N) whose simulation succeeds, as far as they can be found."""
        points = self._points(MOST_TRIES_RATIO * wanted)
        while np.isfinite(self.values).sum() < wanted and len(self.values) < len(points):
            done = len(self.values)
            self.evaluate(points[done : done + wanted])
            self.report("spread", len(self.values), len(points))
        self._check_any()
        return self.thetas[np.isfinite(self.values)][:wanted]

    def evolve(self, size: int, generations: int) -> Floats:
        """Return the best point of an evolution of so many a generation, and those better than all neighbours."""
        count = self.box.lower.size
        generation = 0

        def criterion(units: Floats) -> Floats:
            return self.evaluate(self.box.thetas(units.T))

        def after(intermediate_result: OptimizeResult) -> None:
            nonlocal generation
            generation += 1
            self.report("evolution", generation, generations)
            if self._agreed(intermediate_result.population, intermediate_result.population_energies):
                raise StopIteration  # the way to end it (scipy)

        differential_evolution(
            cast(Any, criterion),  # the stubs know single points only
            Bounds(np.zeros(count), np.ones(count)),
            init=self.box.units(self._points(size)),
            maxiter=generations,
            callback=after,
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=self._rng,
        )
        self._check_any()
        return self._topograph()

    def _agreed(self, population: Floats, values: Floats) -> bool:
        """Whether an evolution has nothing more to find: one place, one value, or no simulation that succeeds."""
        good = np.isfinite(values)
        if not good.all():
            return not good.any()
        given = ~np.isnan(self.problem.variance)
        size = self.problem.counts[~given].sum() + (values.min() if given.all() else 0.0)
        return bool(values.std() <= AGREED_SPREAD * size or population.std(axis=0).max() <= COLLAPSED_SHARE)

    def _topograph(self) -> Floats:
        """Return the best point tried and the best of those that are better than all their nearest neighbours."""
        units, first = np.unique(self.box.units(self.thetas), axis=0, return_index=True)
        values = self.values[first]
        neighbours = min(2 * units.shape[1] + 2, len(units))  # of a grid all nearest ones, and the point itself
        _, near = KDTree(units).query(units, neighbours)
        lows = np.flatnonzero(np.isfinite(values) & (values <= values[near].min(axis=1)))
        return self.thetas[first[lows[np.argsort(values[lows])]]]

    def report(self, phase: Literal["spread", "evolution", "fits"], done: int, total: int) -> None:
        """Call the progress."""
        if self.progress is None:
            return
        best = int(np.argmin(self.values))
        step = GlobalStep(
            task=phase,
            done=done,
            total=total,
            criterion=float(self.values[best]),
            values=dict(zip(self.problem.parameters.names, self.thetas[best].tolist(), strict=True)),
            simulations=self.simulations,
        )
        self.progress(step)

    def _check_any(self) -> None:
        if not self.any_succeeded:
            why = self.evaluator.failure(self.thetas[0])
            raise InputError(
                f"all {len(self.values)} simulations of the global search fail: narrow the bounds to where the model "
                f"is sound{f' (the first: {why})' if why else ''}"
            )
