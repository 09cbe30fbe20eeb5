"""Search of a whole box before Marquardt's search, for criteria with secondary optima (docs/method.md section 4).

Two ways to spread over the box, both ending in Marquardt's search from several points:

- evolution: differential evolution (Storn and Price; scipy's), a generation in one batch of simulations. When the
  generation agrees, its best goes to Marquardt's search, and so do other points that are better than all their nearest
  neighbours among the points ever tried (Törn and Viitanen's topographs), unless they lie in the valley of an optimum
  already found, where the criterion nowhere rises on the way to it (Ursem). Secondary optima show there.
- multistart: Marquardt's search from every point of a Sobol sequence whose simulation succeeds, and from the
  parameters' own starts. How many starts led to an optimum tells how likely an ordinary search is to miss it.

The fits run one after the other: each simulates the columns of its Jacobian as a batch already, and the single
simulations of its steps are too small a share for fits in lockstep to gain more than a tenth.

What is compared: with all noise variances given, the compound criterion J_C (1.37). Where they are estimated, J_C means
nothing until they are, so the estimates σ̂_j² = J_j/K_j that any theta implies are put into the likelihood, which gives
the concentrated criterion Σ K_j ln σ̂_j² + prior rows. Its least value is where the repetition on them settles.

References
----------
R. Storn, K. Price, "Differential evolution", J. Global Optimization 11, 1997;
A. Törn, S. Viitanen, "Topographical global optimization", in Recent Advances in Global Optimization, 1992;
R. K. Ursem, "Multinational evolutionary algorithms", Congress on Evolutionary Computation, 1999;
G. A. F. Seber, C. J. Wild, "Nonlinear Regression", section 2.2.3 (concentrated likelihood), 1989.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import Bounds, OptimizeResult, differential_evolution
from scipy.spatial import KDTree
from scipy.stats import qmc

from fmuid.arrays import Floats
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation.box import Box
from fmuid.estimation.identification import identify, point_result
from fmuid.estimation.least_squares import LeastSquares
from fmuid.estimation.marquardt.outcome import Outcome
from fmuid.estimation.marquardt.search import Marquardt
from fmuid.estimation.misfit import Misfits, fitted, misfits, refuse_loss, variances
from fmuid.estimation.result import Result
from fmuid.progress import GlobalStep, Progress
from fmuid.text import nearest

Strategy = Literal["evolution", "multistart"]

STARTS = 50
# A generation of 50 agrees after 30 to 50 generations on problems of four parameters.
GENERATIONS = 300
# Fewer are too few to cross (scipy refuses them).
LEAST_POPULATION = 5
# Points whose simulation fails are replaced by further points of the sequence, until so many times `starts` are tried.
TRIES = 10
# The generation agrees where the criterion varies by this share of itself (1 % of the residual variance) ...
AGREED = 0.01
# ... or no parameter by more than this share of the box: from here on Marquardt's search is much faster.
COLLAPSED = 1e-3
# From the points of an evolution that are better than their neighbours, at most so many fits are made ...
MAX_TOPOGRAPH_FITS = 10
# ... and none from where the criterion rises at none of these points of the way to an optimum found before.
WAY = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
# Fits from hopeless starts crawl; one that needs more steps than this is given up unless it is the best of all.
FIT_ITERATIONS = 300
# Optima are one where no parameter differs by more than this share of its standard deviation, or of its magnitude, and
# the criterion by no more than 0.3². Fits end nearer than that even where large residuals make them converge slowly.
SAME_STDS, SAME_SHARE, SAME_CRITERION = 0.3, 1e-4, 0.1


@dataclass(frozen=True)
class GlobalSearch:
    """Settings of the search of the whole box.

    Parameters
    ----------
    method : "evolution" or "multistart"
    starts : int
        Points spread over the box: the first generation, which keeps this size (about ten a parameter are usual), or
        the starts of as many fits.
    seed : int
        Of the random numbers; the same seed gives the same result.
    generations : int
        Most generations of an evolution.
    marquardt : Marquardt
        Of the fits.

    Raises
    ------
    InputError
        If a setting is unknown or out of range.
    """

    method: Strategy = "evolution"
    starts: int = STARTS
    seed: int = 0
    generations: int = GENERATIONS
    marquardt: Marquardt = field(default_factory=Marquardt)

    def __post_init__(self) -> None:
        if self.method not in get_args(Strategy):
            known = " or ".join(map(repr, get_args(Strategy)))
            hint = nearest(str(self.method), get_args(Strategy))
            raise InputError(f"the method of a global search must be {known}, not {self.method!r}{hint}")
        least = {"starts": LEAST_POPULATION if self.method == "evolution" else 1, "seed": 0, "generations": 1}
        for name, value in least.items():
            given = getattr(self, name)
            if isinstance(given, bool) or not isinstance(given, int) or given < value:
                raise InputError(f"{name} of a global search must be a whole number from {value} on, not {given!r}")

    @property
    def whole_box(self) -> bool:
        """True."""
        return True

    def check(self, problem: LeastSquares) -> None:
        """Check that a problem has the plain square as its loss, and for every parameter bounds or a prior.

        Raises
        ------
        InputError
            If it has not.
        """
        refuse_loss(problem, "a global search")
        Box(problem.parameters)

    def search(self, problem: LeastSquares, progress: Progress | None = None, start: ArrayLike | None = None) -> Result:
        """Search as `search_globally` does, and from a start (N,) as `fmuid.identify` does."""
        if start is not None:
            return self.marquardt.search(problem, progress, start)
        return search_globally(problem, self, progress).result


@dataclass(frozen=True, eq=False)
class Optimum:
    """A point at which Marquardt's search ended.

    Attributes
    ----------
    theta : (N,) array
    criterion : float
        J_C (1.37) there; where noise variances are estimated, with those of the best optimum.
    hits : int
        How many of the fits ended here.
    outcome : Outcome
        How the best of these fits ended.
    """

    theta: Floats
    criterion: float
    hits: int
    outcome: Outcome

    @property
    def converged(self) -> bool:
        """Whether it is a minimum with every parameter determined."""
        return self.outcome.converged


@dataclass(frozen=True, eq=False)
class GlobalResult:
    """What a global search found.

    Attributes
    ----------
    result : Result
        Of the best fit; its `simulations` and `elapsed_s` are those of the whole search. Where the search was
        interrupted, of the best of all points tried; if no fit has led there, with nothing but its values.
    names : tuple of str
        The parameters.
    fits : int
        Searches by Marquardt that were made.
    simulations : int
    elapsed_s : float
    interrupted : bool
        Whether the keyboard ended the search before its time.
    """

    result: Result
    names: tuple[str, ...]
    fits: int
    simulations: int
    elapsed_s: float
    interrupted: bool

    @property
    def optima(self) -> tuple[Optimum, ...]:
        """All that were found, each once, the best first."""
        return self.result.optima

    @property
    def table(self) -> pd.DataFrame:
        """The optima, a row each (`optima_table`)."""
        return optima_table(self.names, self.optima)


def optima_table(names: Sequence[str], optima: Sequence[Optimum]) -> pd.DataFrame:
    """Return the optima found, a row each: criterion, hits, converged, and each parameter."""
    rows = [(o.criterion, o.hits, o.converged, *o.theta.tolist()) for o in optima]
    return pd.DataFrame(rows, columns=["criterion", "hits", "converged", *names])


def search_globally(
    problem: LeastSquares, settings: GlobalSearch | None = None, progress: Progress | None = None
) -> GlobalResult:
    """Search the box of the bounds for the best optimum, and list the others that were met.

    Parameters
    ----------
    problem : LeastSquares
        Every parameter with finite bounds or a prior. Its own starts take part.
    settings : GlobalSearch, optional
    progress : callable, optional
        Called with a `fmuid.progress.GlobalStep` after each batch of points, generation or fit.

    Returns
    -------
    GlobalResult
        Also where the search was interrupted from the keyboard after it had found something; nothing more is simulated
        then.

    Raises
    ------
    InputError
        If a parameter has neither bounds nor a prior, all simulations in the box fail, or no fit is possible.
    """
    refuse_loss(problem, "a global search")
    with np.errstate(over="ignore", invalid="ignore"):  # far from the truth models may explode
        return _Search(problem, settings or GlobalSearch(), progress).run()


class _Search:
    """One global search and what it knows so far."""

    def __init__(self, problem: LeastSquares, settings: GlobalSearch, progress: Progress | None) -> None:
        self.problem, self.settings, self.progress = problem, settings, progress
        self.clock, self.simulations = time.perf_counter(), problem.simulations
        self.box = Box(problem.parameters)
        self.rng = np.random.default_rng(settings.seed)
        self.thetas = np.empty((0, len(problem.parameters)))
        self.values = np.empty(0)
        self.results: list[Result] = []
        self.ends: list[Misfits] = []  # of the results, each of one point
        self.reached: list[float] = []  # the criterion there, as in `values`

    def run(self) -> GlobalResult:
        interrupted = False
        try:
            self._fit(self._evolve() if self.settings.method == "evolution" else self._spread())
            self._finish()
        except KeyboardInterrupt:
            if not np.isfinite(self.values).any():
                raise
            interrupted = True
        return self._conclude(interrupted)

    def _evaluate(self, thetas: Floats) -> Floats:
        """Return the concentrated criterion at thetas (m, N), +inf where the simulation failed, and remember it."""
        return self._remember(thetas, misfits(self.problem, thetas))

    def _remember(self, thetas: Floats, found: Misfits) -> Floats:
        values = found.concentrated(self.problem)
        values = np.where(np.isnan(values), np.inf, values)
        self.thetas, self.values = np.vstack([self.thetas, thetas]), np.append(self.values, values)
        return values

    def _points(self, count: int) -> Floats:
        """Return the parameters' own start and the first points of a Sobol sequence, (count, N)."""
        sequence = qmc.Sobol(self.box.lower.size, rng=self.rng)
        points = sequence.random_base2(math.ceil(math.log2(count)))
        return np.vstack([self.problem.parameters.start, self.box.thetas(points)])[:count]

    def _spread(self) -> Floats:
        """Return as many points whose simulation succeeds as there are starts, as far as they can be found."""
        wanted = self.settings.starts
        points = self._points(TRIES * wanted)
        while np.isfinite(self.values).sum() < wanted and len(self.values) < len(points):
            done = len(self.values)
            self._evaluate(points[done : done + wanted])
            self._report("spread", len(self.values), len(points))
        self._check_any()
        return self.thetas[np.isfinite(self.values)][:wanted]

    def _evolve(self) -> Floats:
        """Return the best point of an evolution and the best of those that are better than all their neighbours."""
        count = self.box.lower.size
        generation = 0

        def criterion(units: Floats) -> Floats:
            return self._evaluate(self.box.thetas(units.T))

        def after(intermediate_result: OptimizeResult) -> None:
            nonlocal generation
            generation += 1
            self._report("evolution", generation, self.settings.generations)
            if self._agreed(intermediate_result.population, intermediate_result.population_energies):
                raise StopIteration  # the way to end it (scipy)

        differential_evolution(
            cast(Any, criterion),  # the stubs know single points only
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
        return self._topograph()

    def _agreed(self, population: Floats, values: Floats) -> bool:
        """Whether an evolution has nothing more to find: one place, one value, or no simulation that succeeds."""
        good = np.isfinite(values)
        if not good.all():
            return not good.any()
        given = ~np.isnan(self.problem.variance)
        size = self.problem.counts[~given].sum() + (values.min() if given.all() else 0.0)
        return bool(values.std() <= AGREED * size or population.std(axis=0).max() <= COLLAPSED)

    def _topograph(self) -> Floats:
        """Return the best point tried and the best of those that are better than all their nearest neighbours."""
        units, first = np.unique(self.box.units(self.thetas), axis=0, return_index=True)
        values = self.values[first]
        neighbours = min(2 * units.shape[1] + 2, len(units))  # of a grid all nearest ones, and the point itself
        _, near = KDTree(units).query(units, neighbours)
        lows = np.flatnonzero(np.isfinite(values) & (values <= values[near].min(axis=1)))
        return self.thetas[first[lows[np.argsort(values[lows])]]]

    def _fit(self, starts: Floats) -> None:
        """Fit from every start.

        Raises
        ------
        KeyboardInterrupt
            If that ends a fit; how far it came is kept.
        """
        settings = self.settings.marquardt
        short = dataclasses.replace(settings, max_iterations=min(FIT_ITERATIONS, settings.max_iterations))
        error: FmuidError | None = None
        for number, start in enumerate(starts, 1):
            try:
                if self.settings.method == "evolution" and self._known(start):
                    continue
                self._keep(identify(self.problem, short, start=start))
            except (InputError, SimulationError) as caught:  # a start from which nothing moves, for instance
                error = error or caught
            self._report("fits", number, len(starts))
        if not self.results and error is not None:
            raise error

    def _keep(self, result: Result) -> None:
        """Keep the result of a fit and the criterion there, which is known from the fit itself."""
        end = fitted(self.problem, result)
        self.results.append(result)
        self.ends.append(end)
        self.reached.append(float(self._remember(result.values[None], end)[0]))
        if result.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt

    def _known(self, start: Floats) -> bool:
        """Whether no fit is needed from a point: it lies in the valley of an optimum, or enough are made."""
        if not 0 < len(self.results) < MAX_TOPOGRAPH_FITS:
            return bool(self.results)
        here, ends = self.box.units(start[None]), self.box.units(np.array([r.values for r in self.results]))
        way = here + WAY[:, None, None] * (ends - here)
        values = self._evaluate(self.box.thetas(way.reshape(-1, start.size))).reshape(WAY.size, -1)
        return bool((values <= self._evaluate(start[None])).all(axis=0).any())

    def _conclude(self, interrupted: bool) -> GlobalResult:
        """Put the fits in order, and merge those that ended at one optimum; nothing is simulated for it."""
        problem = self.problem
        optima: list[tuple[Optimum, Result]] = []
        if self.results:
            ends = Misfits(np.vstack([e.squares for e in self.ends]), np.concatenate([e.prior for e in self.ends]))
            criteria = ends.compound(variances(problem, self.results[int(np.argmin(self.reached))]))
            optima = [self._optimum(group, criteria) for group in self._groups(criteria)]
            optima.sort(key=lambda found: found[0].criterion)
        elapsed, simulations = time.perf_counter() - self.clock, problem.simulations - self.simulations
        result = self._best_so_far() if interrupted else optima[0][1]
        found = tuple(optimum for optimum, _ in optima)
        result = dataclasses.replace(
            result, simulations=simulations, elapsed_s=elapsed, optima=found, fits=len(self.results)
        )
        return GlobalResult(
            result,
            problem.parameters.names,
            len(self.results),
            simulations,
            elapsed,
            interrupted,
        )

    def _best_so_far(self) -> Result:
        """Return the best of all points tried: as its fit found it, or by itself where none has led there."""
        best = int(np.argmin(self.values))
        if self.results and min(self.reached) <= self.values[best]:
            result = self.results[int(np.argmin(self.reached))]
            return dataclasses.replace(result, outcome=Outcome.INTERRUPTED)
        return point_result(self.problem, self.thetas[best])

    def _finish(self) -> None:
        """Go on with the best fit where only its few iterations ended it."""
        best = int(np.argmin(self.reached))
        if self.results[best].outcome is Outcome.ITERATION_LIMIT:
            self._keep(identify(self.problem, self.settings.marquardt, start=self.results[best].values))
            for kept in (self.results, self.ends, self.reached):
                del kept[best]

    def _groups(self, criteria: Floats) -> list[list[int]]:
        """Return the fits that ended at one optimum, the best of each first."""
        groups: list[list[int]] = []
        for i in map(int, np.argsort(criteria)):
            home = next((group for group in groups if self._same(i, group[0], criteria)), None)
            if home is None:
                groups.append([i])
            else:
                home.append(i)
        return groups

    def _same(self, i: int, best: int, criteria: Floats) -> bool:
        """Whether a fit ended at the same optimum as a better one."""
        # away from the best optimum residuals are larger than their variances, and standard deviations too small
        excess = max(1.0, criteria[best] / max(self.problem.measured.size - len(self.problem.parameters), 1))
        there = self.results[best].values
        stds = SAME_STDS * math.sqrt(excess) * np.nan_to_num(self.results[best].std, nan=0.0, posinf=np.inf)
        reach = np.maximum(stds, SAME_SHARE * self.problem.parameters.magnitudes(there))
        near = (np.abs(self.results[i].values - there) <= reach).all()
        return bool(near and criteria[i] - criteria[best] <= SAME_CRITERION * excess)

    def _optimum(self, group: list[int], criteria: Floats) -> tuple[Optimum, Result]:
        """Return what stands for a group: its best fit, of those that converged if any did."""
        chosen = next((i for i in group if self.results[i].converged), group[0])
        result = self.results[chosen]
        return Optimum(result.values, float(criteria[chosen]), len(group), result.outcome), result

    def _report(self, phase: Literal["spread", "evolution", "fits"], done: int, total: int) -> None:
        if self.progress is None:
            return
        best = int(np.argmin(self.values))
        step = GlobalStep(
            task=phase,
            done=done,
            total=total,
            criterion=float(self.values[best]),
            values=dict(zip(self.problem.parameters.names, self.thetas[best].tolist(), strict=True)),
            simulations=self.problem.simulations - self.simulations,
        )
        self.progress(step)

    def _check_any(self) -> None:
        if not np.isfinite(self.values).any():
            why = self.problem.failure(self.thetas[0])
            raise InputError(
                f"all {len(self.values)} simulations of the global search fail: narrow the bounds to where the model "
                f"is sound{f' (the first: {why})' if why else ''}"
            )
