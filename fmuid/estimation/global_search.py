"""Global search: the box, its exploration, fits from the best points (docs/method/starting-points.md)."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation.cost_components import CostComponents, fitted, misfits, refuse_loss, variances
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.local_search import Marquardt, point_result
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.result_groups import Optimum
from fmuid.estimation.search.state import TerminationReason
from fmuid.estimation.starting_points import Box, sobol_points
from fmuid.events import GlobalStep, Progress
from fmuid.formatting import nearest

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

Strategy = Literal["differential-evolution", "multi-start"]


@dataclass(frozen=True)
class ExplorationSettings:
    """Numbers of exploration, fits, and equal optima."""

    most_tries: int = 10  # points tried per wanted point, if simulations fail
    agreed_spread: float = 0.01  # relative spread of the cost at which a generation agrees ...
    collapsed_share: float = 1e-3  # ... or spread of the parameters, share of the box; fits are faster from here on
    least_population: int = 5  # scipy's
    most_fits: int = 10  # after an evolution; ...
    way_shares: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)  # ... none if the cost does not rise on these ways
    fit_iterations: int = 300  # more only for the best fit
    same_stds: float = 0.3  # two optima are one up to these differences: parameters in σ ...
    same_share: float = 1e-4  # ... or relative to their magnitude; ...
    same_cost: float = 0.1  # ... cost, 0.3²


SETTINGS = ExplorationSettings()


@dataclass(frozen=True)
class GlobalSearch:
    """Settings of the global search.

    Parameters
    ----------
    method : "differential-evolution" or "multi-start"
    starts : int
        Population of the evolution (about ten per parameter), or number of starting points.
    seed : int
        Seed of the random numbers.
    generations : int
        Maximum number of generations.
    marquardt : Marquardt
        Settings of the fits.

    Raises
    ------
    InputError
        If a setting is unknown or out of range.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> box = {name: fmuid.Parameter(each.start, min=1e-3, max=10.0) for name, each in coil.parameters.items()}
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, box)
    >>> len(fmuid.identify(problem, fmuid.GlobalSearch("multi-start", starts=3)).history.optima)
    1
    """

    method: Strategy = "differential-evolution"
    starts: int = 50
    seed: int = 0
    generations: int = 300  # four parameters need 30 to 50
    marquardt: Marquardt = field(default_factory=Marquardt)

    def __post_init__(self) -> None:
        if self.method not in get_args(Strategy):
            known = " or ".join(map(repr, get_args(Strategy)))
            hint = nearest(str(self.method), get_args(Strategy))
            raise InputError(f"the method of a global search must be {known}, not {self.method!r}{hint}")
        starts = SETTINGS.least_population if self.method == "differential-evolution" else 1
        for name, value in {"starts": starts, "seed": 0, "generations": 1}.items():
            given = getattr(self, name)
            if isinstance(given, bool) or not isinstance(given, int) or given < value:
                raise InputError(f"{name} of a global search must be a whole number from {value} on, not {given!r}")

    whole_box: ClassVar[bool] = True

    def check(self, problem: LeastSquares) -> None:
        """Check for linear loss, and bounds or a prior for each parameter; raise `InputError`."""
        refuse_loss(problem, "a global search")
        Box(problem.parameters)

    @single_threaded
    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Search the box for the best optimum; list other optima in the result.

        Parameters
        ----------
        evaluator : Evaluator
        progress : callable, optional
            Receives a `fmuid.events.GlobalStep` after each batch, generation or fit.
        start : (N,) array, optional
            Optimize from there instead, without a global search.

        Returns
        -------
        Result
            The best fit; if interrupted, the best point.

        Raises
        ------
        InputError
            If a parameter has no box, all simulations fail, or no fit is possible.
        """
        if start is not None:
            return self.marquardt.search(evaluator, progress, start)
        self.check(evaluator.problem)
        with np.errstate(over="ignore", invalid="ignore"):  # far from the truth models may explode
            return _BoxSearch(evaluator, self, progress).run()


class _BoxSearch:
    """One global search: tried points and their concentrated costs, and fits from the best of them."""

    def __init__(self, evaluator: Evaluator[LeastSquares], settings: GlobalSearch, progress: Progress | None) -> None:
        self.evaluator, self.problem, self.settings, self.progress = evaluator, evaluator.problem, settings, progress
        self.clock, self.before = time.perf_counter(), evaluator.simulations
        self.box, self.rng = Box(self.problem.parameters), np.random.default_rng(settings.seed)
        self.evolves = settings.method == "differential-evolution"
        self.thetas, self.costs = np.empty((0, len(self.problem.parameters))), np.empty(0)  # +inf if failed
        self.fits: list[tuple[float, Result]] = []  # with their concentrated costs

    def run(self) -> Result:
        interrupted = False
        try:
            self._fit(self._evolved() if self.evolves else self._spread())
            self._finish()
        except KeyboardInterrupt:
            if not np.isfinite(self.costs).any():
                raise
            interrupted = True
        optima = merge_optima(self.problem, [fit for _, fit in self.fits])
        best: Result = self._best_so_far() if interrupted else optima[0].fit
        history = dataclasses.replace(
            best.history,
            simulations=self.evaluator.simulations - self.before,
            elapsed_s=time.perf_counter() - self.clock,
            optima=optima,
            fits=len(self.fits),
        )
        return dataclasses.replace(best, history=history)

    # --- exploration

    def _evaluate(self, thetas: Floats) -> Floats:
        """Simulate thetas (m, N); return their costs, +inf if failed."""
        return self._remember(thetas, misfits(self.evaluator, thetas))

    def _remember(self, thetas: Floats, found: CostComponents) -> Floats:
        costs = found.concentrated(self.problem)
        costs = np.where(np.isnan(costs), np.inf, costs)
        self.thetas, self.costs = np.vstack([self.thetas, thetas]), np.append(self.costs, costs)
        return costs

    def _points(self, count: int) -> Floats:
        """Return the initial guess and Sobol points, (count, N)."""
        points = sobol_points(self.box.lower.size, count, self.rng)
        return np.vstack([self.problem.parameters.start, self.box.thetas(points)])[:count]

    def _spread(self) -> Floats:
        """Return the wanted points with a successful simulation, as far as possible."""
        wanted = self.settings.starts
        points = self._points(SETTINGS.most_tries * wanted)
        while np.isfinite(self.costs).sum() < wanted and len(self.costs) < len(points):
            done = len(self.costs)
            self._evaluate(points[done : done + wanted])
            self._report("spread", len(self.costs), len(points))
        self._check_any()
        return self.thetas[np.isfinite(self.costs)][:wanted]

    def _evolved(self) -> Floats:
        """Run differential evolution; return the best point and other local bests."""
        from scipy.optimize import Bounds, differential_evolution  # slow to import

        count, generation = self.box.lower.size, 0

        def after(intermediate_result: OptimizeResult) -> None:
            nonlocal generation
            generation += 1
            self._report("evolution", generation, self.settings.generations)
            if self._agreed(intermediate_result.population, intermediate_result.population_energies):
                raise StopIteration  # the way to end it (scipy)

        differential_evolution(
            cast(Any, lambda units: self._evaluate(self.box.thetas(units.T))),  # the stubs know single points only
            Bounds(np.zeros(count), np.ones(count)),
            init=self.box.units(self._points(self.settings.starts)),
            maxiter=self.settings.generations,
            callback=after,
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=self.rng,
        )
        self._check_any()
        return self._local_bests()

    def _agreed(self, population: Floats, costs: Floats) -> bool:
        """Return True if a generation agrees, or if all of it fails."""
        good = np.isfinite(costs)
        if not good.all():
            return not good.any()
        given = ~np.isnan(self.problem.variance)
        size = self.problem.counts[~given].sum() + (costs.min() if given.all() else 0.0)
        agreed = costs.std() <= SETTINGS.agreed_spread * size
        return bool(agreed or population.std(axis=0).max() <= SETTINGS.collapsed_share)

    def _local_bests(self) -> Floats:
        """Return the points better than all nearest neighbors, the best first."""
        from scipy.spatial import KDTree  # slow to import

        units, first = np.unique(self.box.units(self.thetas), axis=0, return_index=True)
        costs = self.costs[first]
        neighbours = min(2 * units.shape[1] + 2, len(units))  # of a grid all nearest ones, and the point itself
        _, near = KDTree(units).query(units, neighbours)
        lows = np.flatnonzero(np.isfinite(costs) & (costs <= costs[near].min(axis=1)))
        return self.thetas[first[lows[np.argsort(costs[lows])]]]

    def _report(self, phase: Literal["spread", "evolution", "fits"], done: int, total: int) -> None:
        if self.progress is None:
            return
        best = int(np.argmin(self.costs))
        step = GlobalStep(
            task=phase,
            done=done,
            total=total,
            cost=float(self.costs[best]),
            values=dict(zip(self.problem.parameters.names, self.thetas[best].tolist(), strict=True)),
            simulations=self.evaluator.simulations - self.before,
        )
        self.progress(step)

    def _check_any(self) -> None:
        if not np.isfinite(self.costs).any():
            why = self.evaluator.failure(self.thetas[0])
            raise InputError(
                f"all {len(self.costs)} simulations of the global search fail{f' (the first: {why})' if why else ''}. "
                "Narrow the bounds."
            )

    # --- fits

    def _fit(self, starts: Floats) -> None:
        """Fit from each starting point; an interrupted fit is kept."""
        settings = self.settings.marquardt
        short = dataclasses.replace(settings, max_iterations=min(SETTINGS.fit_iterations, settings.max_iterations))
        error: FmuidError | None = None
        for number, start in enumerate(starts, 1):
            try:
                if self.evolves and self._known(start):
                    continue
                self._keep(short.search(self.evaluator, start=start))
            except (InputError, SimulationError) as caught:  # a start from which nothing moves, for instance
                error = error or caught
            self._report("fits", number, len(starts))
        if not self.fits and error is not None:
            raise error

    def _keep(self, result: Result) -> None:
        end = fitted(self.problem, result)
        self.fits.append((float(self._remember(result.values[None], end)[0]), result))
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt

    def _known(self, start: Floats) -> bool:
        """Return True if the limit or a known optimum spares a fit."""
        if not 0 < len(self.fits) < SETTINGS.most_fits:
            return bool(self.fits)
        here, ends = self.box.units(start[None]), self.box.units(np.array([fit.values for _, fit in self.fits]))
        shares = np.array(SETTINGS.way_shares)
        way = here + shares[:, None, None] * (ends - here)
        costs = self._evaluate(self.box.thetas(way.reshape(-1, start.size))).reshape(shares.size, -1)
        return bool((costs <= self._evaluate(start[None])).all(axis=0).any())

    def _finish(self) -> None:
        """Continue the best fit if it ended at its iteration limit."""
        best = min(range(len(self.fits)), key=lambda i: self.fits[i][0])
        fit = self.fits[best][1]
        if fit.outcome is TerminationReason.ITERATION_LIMIT:
            self._keep(self.settings.marquardt.search(self.evaluator, start=fit.values))
            del self.fits[best]

    def _best_so_far(self) -> Result:
        """Return the best tried point, with its fit if available."""
        tried = int(np.argmin(self.costs))
        reached, fit = min(self.fits, key=lambda each: each[0], default=(math.inf, None))
        if fit is not None and reached <= self.costs[tried]:
            return dataclasses.replace(fit, outcome=TerminationReason.INTERRUPTED)
        return point_result(self.evaluator, self.thetas[tried])


def optima_table(names: Sequence[str], optima: Sequence[Optimum]) -> pd.DataFrame:
    """Return the optima as a frame: cost, hits, converged, parameters."""
    rows = [(o.criterion, o.hits, o.converged, *o.theta.tolist()) for o in optima]
    return pd.DataFrame(rows, columns=["cost", "hits", "converged", *names])


def merge_optima(problem: LeastSquares, results: Sequence[Result]) -> tuple[Optimum, ...]:
    """Return the distinct optima of fits, the best first, without simulation."""
    if not results:
        return ()
    ends = [fitted(problem, result) for result in results]
    squares, prior = (np.concatenate([getattr(end, part) for end in ends]) for part in ("squares", "prior"))
    every = CostComponents(squares, prior)
    criteria = every.compound(variances(problem, results[int(np.argmin(every.concentrated(problem)))]))
    groups: list[list[int]] = []  # of fits that ended at one optimum, the best of each first
    for i in map(int, np.argsort(criteria)):
        home = next((group for group in groups if _same(problem, results, criteria, i, group[0])), None)
        if home is None:
            groups.append([i])
        else:
            home.append(i)
    found = []
    for group in groups:
        chosen = next((i for i in group if results[i].converged), group[0])
        fit = results[chosen]
        found.append(Optimum(fit.values, float(criteria[chosen]), len(group), fit.outcome, fit))
    return tuple(sorted(found, key=lambda each: each.criterion))


def _same(problem: LeastSquares, results: Sequence[Result], criteria: Floats, i: int, best: int) -> bool:
    """Return True if a better fit ended at the same optimum."""
    # away from the best optimum residuals are larger than their variances, and standard deviations too small
    excess = max(1.0, criteria[best] / max(problem.measured.size - len(problem.parameters), 1))
    there = results[best].values
    white = np.nan_to_num(results[best].estimates.std_white_noise, nan=0.0, posinf=np.inf)
    stds = SETTINGS.same_stds * math.sqrt(excess) * white
    reach = np.maximum(stds, SETTINGS.same_share * problem.parameters.magnitudes(there))
    near = (np.abs(results[i].values - there) <= reach).all()
    return bool(near and criteria[i] - criteria[best] <= SETTINGS.same_cost * excess)
