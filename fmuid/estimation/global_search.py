"""Global search: the box, its exploration, fits from the best points (docs/method/starting-points.md)."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation.cost_components import CostComponents, fitted, misfits, refuse_loss, variances
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.local_search import Marquardt, estimate, point_result
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.result_groups import Optimum
from fmuid.estimation.search.loop import TerminationReason
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
    most_topograph_fits: int = 10  # after an evolution
    fit_iterations: int = 300  # more only for the best fit


SETTINGS = ExplorationSettings()
# Two optima are one up to these differences: parameters in σ or relative to their magnitude; cost (0.3²).
SAME_STDS, SAME_SHARE, SAME_CRITERION = 0.3, 1e-4, 0.1
WAY_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])  # ... none if the cost never rises here towards a known optimum


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

    @property
    def whole_box(self) -> bool:
        """True."""
        return True

    def check(self, problem: LeastSquares) -> None:
        """Check the problem: linear loss, and bounds or a prior for each parameter.

        Raises
        ------
        InputError
            If the check fails.
        """
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
        refuse_loss(evaluator.problem, "a global search")
        with np.errstate(over="ignore", invalid="ignore"):  # far from the truth models may explode
            return _BoxSearch(evaluator, self, progress).run()


class Exploration:
    """Tried points (m, N) and concentrated costs (m,), +inf if failed."""

    def __init__(self, evaluator: Evaluator[LeastSquares], seed: int, progress: Progress | None) -> None:
        self.evaluator, self.problem, self.progress = evaluator, evaluator.problem, progress
        self._before = evaluator.simulations
        self.box = Box(self.problem.parameters)
        self._rng = np.random.default_rng(seed)
        self.thetas = np.empty((0, len(self.problem.parameters)))
        self.values = np.empty(0)

    @property
    def simulations(self) -> int:
        """Number of simulations of the search."""
        return self.evaluator.simulations - self._before

    @property
    def any_succeeded(self) -> bool:
        """True if any simulation succeeded."""
        return bool(np.isfinite(self.values).any())

    def evaluate(self, thetas: Floats) -> Floats:
        """Simulate thetas (m, N); return their concentrated costs, +inf if failed."""
        return self.remember(thetas, misfits(self.evaluator, thetas))

    def remember(self, thetas: Floats, found: CostComponents) -> Floats:
        """Store thetas (m, N) and return their concentrated costs."""
        values = found.concentrated(self.problem)
        values = np.where(np.isnan(values), np.inf, values)
        self.thetas, self.values = np.vstack([self.thetas, thetas]), np.append(self.values, values)
        return values

    def _points(self, count: int) -> Floats:
        """Return the initial guess and Sobol points, (count, N)."""
        points = sobol_points(self.box.lower.size, count, self._rng)
        return np.vstack([self.problem.parameters.start, self.box.thetas(points)])[:count]

    def spread(self, wanted: int) -> Floats:
        """Return points (wanted, N) with a successful simulation, as far as possible."""
        points = self._points(SETTINGS.most_tries * wanted)
        while np.isfinite(self.values).sum() < wanted and len(self.values) < len(points):
            done = len(self.values)
            self.evaluate(points[done : done + wanted])
            self.report("spread", len(self.values), len(points))
        self._check_any()
        return self.thetas[np.isfinite(self.values)][:wanted]

    def evolve(self, size: int, generations: int) -> Floats:
        """Run differential evolution; return the best point and other local bests."""
        from scipy.optimize import Bounds, differential_evolution  # slow to import

        count = self.box.lower.size
        generation = 0

        def after(intermediate_result: OptimizeResult) -> None:
            nonlocal generation
            generation += 1
            self.report("evolution", generation, generations)
            if self._agreed(intermediate_result.population, intermediate_result.population_energies):
                raise StopIteration  # the way to end it (scipy)

        differential_evolution(
            cast(Any, lambda units: self.evaluate(self.box.thetas(units.T))),  # the stubs know single points only
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
        """Return True if a generation agrees, or if all of it fails."""
        good = np.isfinite(values)
        if not good.all():
            return not good.any()
        given = ~np.isnan(self.problem.variance)
        size = self.problem.counts[~given].sum() + (values.min() if given.all() else 0.0)
        agreed = values.std() <= SETTINGS.agreed_spread * size
        return bool(agreed or population.std(axis=0).max() <= SETTINGS.collapsed_share)

    def _topograph(self) -> Floats:
        """Return the points better than all nearest neighbors, the best first."""
        from scipy.spatial import KDTree  # slow to import

        units, first = np.unique(self.box.units(self.thetas), axis=0, return_index=True)
        values = self.values[first]
        neighbours = min(2 * units.shape[1] + 2, len(units))  # of a grid all nearest ones, and the point itself
        _, near = KDTree(units).query(units, neighbours)
        lows = np.flatnonzero(np.isfinite(values) & (values <= values[near].min(axis=1)))
        return self.thetas[first[lows[np.argsort(values[lows])]]]

    def report(self, phase: Literal["spread", "evolution", "fits"], done: int, total: int) -> None:
        """Call the progress callback."""
        if self.progress is None:
            return
        best = int(np.argmin(self.values))
        step = GlobalStep(
            task=phase,
            done=done,
            total=total,
            cost=float(self.values[best]),
            values=dict(zip(self.problem.parameters.names, self.thetas[best].tolist(), strict=True)),
            simulations=self.simulations,
        )
        self.progress(step)

    def _check_any(self) -> None:
        if not self.any_succeeded:
            why = self.evaluator.failure(self.thetas[0])
            raise InputError(
                f"all {len(self.values)} simulations of the global search fail{f' (the first: {why})' if why else ''}. "
                "Narrow the bounds."
            )


class _BoxSearch:
    """State of one global search."""

    def __init__(self, evaluator: Evaluator[LeastSquares], settings: GlobalSearch, progress: Progress | None) -> None:
        self.evaluator, self.problem, self.settings = evaluator, evaluator.problem, settings
        self.clock = time.perf_counter()
        self.explored = Exploration(evaluator, settings.seed, progress)
        self.fits: list[tuple[float, Result]] = []  # with their concentrated costs

    def run(self) -> Result:
        interrupted = False
        try:
            starts, generations = self.settings.starts, self.settings.generations
            evolved = self.settings.method == "differential-evolution"
            self._fit(self.explored.evolve(starts, generations) if evolved else self.explored.spread(starts))
            self._finish()
        except KeyboardInterrupt:
            if not self.explored.any_succeeded:
                raise
            interrupted = True
        return self._conclude(interrupted)

    def _fit(self, starts: Floats) -> None:
        """Fit from each starting point; an interrupted fit is kept."""
        settings = self.settings.marquardt
        short = dataclasses.replace(settings, max_iterations=min(SETTINGS.fit_iterations, settings.max_iterations))
        error: FmuidError | None = None
        for number, start in enumerate(starts, 1):
            try:
                if self.settings.method == "differential-evolution" and self._known(start):
                    continue
                self._keep(estimate(self.evaluator, short, start=start))
            except (InputError, SimulationError) as caught:  # a start from which nothing moves, for instance
                error = error or caught
            self.explored.report("fits", number, len(starts))
        if not self.fits and error is not None:
            raise error

    def _keep(self, result: Result) -> None:
        """Store a fit and its cost."""
        end = fitted(self.problem, result)
        self.fits.append((float(self.explored.remember(result.values[None], end)[0]), result))
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt

    def _known(self, start: Floats) -> bool:
        """Return True if a known optimum or the limit spares a fit."""
        if not 0 < len(self.fits) < SETTINGS.most_topograph_fits:
            return bool(self.fits)
        box = self.explored.box
        here, ends = box.units(start[None]), box.units(np.array([fit.values for _, fit in self.fits]))
        way = here + WAY_SHARES[:, None, None] * (ends - here)
        values = self.explored.evaluate(box.thetas(way.reshape(-1, start.size))).reshape(WAY_SHARES.size, -1)
        return bool((values <= self.explored.evaluate(start[None])).all(axis=0).any())

    def _finish(self) -> None:
        """Continue the best fit if it ended at its iteration limit."""
        best = min(range(len(self.fits)), key=lambda i: self.fits[i][0])
        fit = self.fits[best][1]
        if fit.outcome is TerminationReason.ITERATION_LIMIT:
            self._keep(estimate(self.evaluator, self.settings.marquardt, start=fit.values))
            del self.fits[best]

    def _conclude(self, interrupted: bool) -> Result:
        optima = merge_optima(self.problem, [fit for _, fit in self.fits])
        best: Result = self._best_so_far() if interrupted else optima[0].fit
        history = dataclasses.replace(
            best.history,
            simulations=self.explored.simulations,
            elapsed_s=time.perf_counter() - self.clock,
            optima=optima,
            fits=len(self.fits),
        )
        return dataclasses.replace(best, history=history)

    def _best_so_far(self) -> Result:
        """Return the best tried point, with its fit if available."""
        tried = int(np.argmin(self.explored.values))
        reached, fit = min(self.fits, key=lambda each: each[0], default=(math.inf, None))
        if fit is not None and reached <= self.explored.values[tried]:
            return dataclasses.replace(fit, outcome=TerminationReason.INTERRUPTED)
        return point_result(self.evaluator, self.explored.thetas[tried])


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
    stds = SAME_STDS * math.sqrt(excess) * white
    reach = np.maximum(stds, SAME_SHARE * problem.parameters.magnitudes(there))
    near = (np.abs(results[i].values - there) <= reach).all()
    return bool(near and criteria[i] - criteria[best] <= SAME_CRITERION * excess)
