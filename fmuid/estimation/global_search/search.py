"""Search of a whole box: settings, and the fits from its most promising points."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.estimation.cost_components import fitted, refuse_loss
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.global_search.box import Box
from fmuid.estimation.global_search.exploration import Exploration
from fmuid.estimation.global_search.optima import merge_optima
from fmuid.estimation.identification import estimate, point_result
from fmuid.estimation.method import Marquardt
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.search.loop import TerminationReason
from fmuid.formatting import nearest
from fmuid.progress import Progress

Strategy = Literal["differential-evolution", "multi-start"]

DEFAULT_STARTS = 50
# A generation of 50 agrees after 30 to 50 generations on problems of four parameters.
MOST_GENERATIONS = 300
# Fewer are too few to cross (scipy refuses them).
LEAST_POPULATION = 5
# From the points of an evolution that are better than their neighbours, at most so many fits are made ...
MAX_TOPOGRAPH_FITS = 10
# ... and none from where the criterion rises at none of these points of the way to an optimum found before.
WAY_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
# Fits from hopeless starts crawl; one that needs more steps than this is given up unless it is the best of all.
FIT_ITERATIONS = 300


@dataclass(frozen=True)
class GlobalSearch:
    """Settings of the search of the whole box.

    Parameters
    ----------
    method : "differential-evolution" or "multi-start"
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

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> box = {name: fmuid.Parameter(each.start, min=1e-3, max=10.0) for name, each in coil.parameters.items()}
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, box)
    >>> len(fmuid.identify(problem, fmuid.GlobalSearch("multi-start", starts=3)).optima)
    1
    """

    method: Strategy = "differential-evolution"
    starts: int = DEFAULT_STARTS
    seed: int = 0
    generations: int = MOST_GENERATIONS
    marquardt: Marquardt = field(default_factory=Marquardt)

    def __post_init__(self) -> None:
        if self.method not in get_args(Strategy):
            known = " or ".join(map(repr, get_args(Strategy)))
            hint = nearest(str(self.method), get_args(Strategy))
            raise InputError(f"the method of a global search must be {known}, not {self.method!r}{hint}")
        least = {
            "starts": LEAST_POPULATION if self.method == "differential-evolution" else 1,
            "seed": 0,
            "generations": 1,
        }
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

    @single_threaded
    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Search the box of the bounds for the best optimum, and list the others that were met (`Result.optima`).

        Parameters
        ----------
        evaluator : Evaluator
            Of a problem with every parameter with finite bounds or a prior. Its own starts take part.
        progress : callable, optional
            Called with a `fmuid.progress.GlobalStep` after each batch of points, generation or fit.
        start : (N,) array, optional
            Search from there instead, by Marquardt's method alone.

        Returns
        -------
        Result
            Of the best fit; its `simulations` and `elapsed_s` are those of the whole search. Where that was interrupted
            from the keyboard, of the best of all points tried; if no fit has led there, with nothing but its values.

        Raises
        ------
        InputError
            If a parameter has neither bounds nor a prior, all simulations in the box fail, or no fit is possible.
        """
        if start is not None:
            return self.marquardt.search(evaluator, progress, start)
        refuse_loss(evaluator.problem, "a global search")
        with np.errstate(over="ignore", invalid="ignore"):  # far from the truth models may explode
            return _BoxSearch(evaluator, self, progress).run()


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fit, and the concentrated criterion where it ended."""

    result: Result
    reached: float


class _BoxSearch:
    """One global search and what it knows so far."""

    def __init__(self, evaluator: Evaluator[LeastSquares], settings: GlobalSearch, progress: Progress | None) -> None:
        self.evaluator, self.problem, self.settings = evaluator, evaluator.problem, settings
        self.clock = time.perf_counter()
        self.explored = Exploration(evaluator, settings.seed, progress)
        self.fits: list[_Fit] = []

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
                if self.settings.method == "differential-evolution" and self._known(start):
                    continue
                self._keep(estimate(self.evaluator, short, start=start))
            except (InputError, SimulationError) as caught:  # a start from which nothing moves, for instance
                error = error or caught
            self.explored.report("fits", number, len(starts))
        if not self.fits and error is not None:
            raise error

    def _keep(self, result: Result) -> None:
        """Keep the result of a fit and the criterion there, which is known from the fit itself."""
        end = fitted(self.problem, result)
        self.fits.append(_Fit(result, float(self.explored.remember(result.values[None], end)[0])))
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt

    def _known(self, start: Floats) -> bool:
        """Whether no fit is needed from a point: it lies in the valley of an optimum, or enough are made."""
        if not 0 < len(self.fits) < MAX_TOPOGRAPH_FITS:
            return bool(self.fits)
        box = self.explored.box
        here, ends = box.units(start[None]), box.units(np.array([fit.result.values for fit in self.fits]))
        way = here + WAY_SHARES[:, None, None] * (ends - here)
        values = self.explored.evaluate(box.thetas(way.reshape(-1, start.size))).reshape(WAY_SHARES.size, -1)
        return bool((values <= self.explored.evaluate(start[None])).all(axis=0).any())

    def _finish(self) -> None:
        """Go on with the best fit where only its few iterations ended it."""
        best = self._best()
        if best.result.outcome is TerminationReason.ITERATION_LIMIT:
            self._keep(estimate(self.evaluator, self.settings.marquardt, start=best.result.values))
            self.fits.remove(best)

    def _best(self) -> _Fit:
        return min(self.fits, key=lambda fit: fit.reached)

    def _conclude(self, interrupted: bool) -> Result:
        """Put the fits in order, and merge those that ended at one optimum; nothing is simulated for it."""
        optima = merge_optima(self.problem, [fit.result for fit in self.fits])
        return dataclasses.replace(
            self._best_so_far() if interrupted else optima[0].fit,
            simulations=self.explored.simulations,
            elapsed_s=time.perf_counter() - self.clock,
            optima=optima,
            fits=len(self.fits),
        )

    def _best_so_far(self) -> Result:
        """Return the best of all points tried: as its fit found it, or by itself where none has led there."""
        tried = int(np.argmin(self.explored.values))
        if self.fits and self._best().reached <= self.explored.values[tried]:
            return dataclasses.replace(self._best().result, outcome=TerminationReason.INTERRUPTED)
        return point_result(self.evaluator, self.explored.thetas[tried])
