"""Searches whose simulation is checked, and goes on by a finer one where its error moves the estimates.

One simulation that is finer tells at the optimum what the error does to each estimate
(`fmuid.estimation.solver_check`). Before the search co-simulation and model exchange are compared: where the former
fails, or is far off, nothing that the search meets would be worth its time. Which way is finer says
`fmuid.simulation.solver_refinement`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    LeastSquares,
    Marquardt,
    Method,
    Optimum,
    RefinementRefusal,
    RefinementStep,
    Result,
    SolverCheck,
    SwitchCause,
    TerminationReason,
    estimate_solver_error,
    fits_worse,
    merge_optima,
    stack_simulated,
    with_shift,
    would_fit_better,
)
from fmuid.formatting import nearest
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check_region import CheckedRegion, Verdict
from fmuid.progress import Progress
from fmuid.simulation import Refinement, is_controlled, is_free, next_refinement, replaces_interface

ACCURACIES = ("refine", "report", "off")
"""What may be done about the error of the simulation."""
# The search goes by model exchange where the outputs at the start differ by more than this share of their spread.
START_LIMIT = 0.01
START_TOLERANCE = 1e-6  # which that does not ask more of
# Where a start fails its steps are divided so often at most: what fails in the sixteenth of a step has other reasons.
START_DIVISIONS = 2
# Shifts below this are known to be small from the error at another point of the same cell of a region.
SURE_SHIFT = SHIFT_LIMIT / 3.0
# Optima whose criterion is higher by less are as good as the best: χ² of one parameter is larger in 5 % of all cases.
RIVAL_CRITERION = 3.84
# By a finer simulation the search goes on from so many of the best optima of a box at most.
MOST_OPTIMA = 10


def identify(
    problem: LeastSquares,
    settings: Method | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    accuracy: str = "refine",
    region: CheckedRegion | None = None,
    start_limit: float = START_LIMIT,
) -> Result:
    """Identify as `fmuid.identify` does, without remedies.

    Parameters
    ----------
    problem, settings, progress, start, accuracy, region
        As there.
    start_limit : float
        The search goes by model exchange where the outputs at the start differ by more than this share of their spread.
    """
    if accuracy not in ACCURACIES:
        raise InputError(
            f"accuracy {accuracy!r} is not known{nearest(str(accuracy), ACCURACIES)}: give {' or '.join(ACCURACIES)}"
        )
    method = settings or Marquardt()
    if accuracy == "off" or not isinstance(problem, Problem):
        return method.search(problem, progress, start)
    return _CheckedSearch(problem, method, progress, region, start_limit, switching=accuracy == "refine").run(start)


class _CheckedSearch:
    """One search, what it found so far, and what was done about its simulation."""

    def __init__(
        self,
        problem: Problem,
        method: Method,
        progress: Progress | None,
        region: CheckedRegion | None = None,
        start_limit: float = START_LIMIT,
        *,
        switching: bool,
    ) -> None:
        self.problem, self.method, self.progress, self.region = problem, method, progress, region
        self.start_limit = start_limit
        self.switching = switching
        self.clock, self.before = time.perf_counter(), problem.simulations
        self.switches: list[RefinementStep] = []
        self.refused = self.foreseen = 0
        self.origin, self.returned = problem.refinement, False

    def run(self, start: ArrayLike | None) -> Result:
        """Compare at the start, search, check."""
        problem = self.problem
        if self.switching:
            self._compare_start(problem.parameters.start if start is None else numbers(start, "start"))
        first = self.method.search(problem, self.progress, start)
        self.optima = first.optima or (Optimum(first.values, first.criterion, 1, first.outcome, first),)
        self.found = SolverCheck(AccuracyOutcome.INTERRUPTED, np.full(len(first.names), np.nan))
        if first.local is not None and first.outcome is not TerminationReason.INTERRUPTED:
            try:
                self._settle()
                self._return()
            except KeyboardInterrupt:
                self.found = replace(self.found, outcome=AccuracyOutcome.INTERRUPTED)
        return self._concluded(first)

    # --- at the start

    def _compare_start(self, at: Floats) -> None:
        """Go by model exchange where co-simulation fails at a start (N,), or is far off there."""
        problem, finer = self.problem, self.problem.next_sure_refinement
        if problem.refinement.any or finer is None or not is_free(problem.system):
            return
        if at.shape != (len(problem.parameters),):
            return  # which the search will say
        if not replaces_interface(problem.system, finer):
            if finer.tolerance is None and self.region is None:
                self._shorten_steps(at)
            return
        if self.region is not None and self.region.one_start:
            wrong = self.region.start(problem, lambda: self._wrong_start(finer, at, problem.predict(at[None])[0]))
        else:
            predicted = problem.predict(at[None])[0]
            fails = not np.isfinite(predicted).all()
            wrong = self._wrong_start(finer, at, predicted) if fails or self.region is None else None
            if wrong is None:  # the search is spared its simulation of the start
                problem.remember(at, predicted)
                self.foreseen = 1
        if wrong is not None:
            self._switch(finer, *wrong)

    def _shorten_steps(self, at: Floats) -> None:
        """Go by shorter steps where there is nothing else and co-simulation fails at a start (N,)."""
        problem, finer = self.problem, self.problem.next_sure_refinement
        predicted = problem.predict(at[None])[0]
        for _ in range(0 if _is_sound(predicted) else START_DIVISIONS):
            if finer is None:
                break
            if _is_sound(problem.predict_by(finer, at)):
                self._switch(finer, SwitchCause.START_FAILED, math.nan)
                return
            finer = next_refinement(problem.system, finer, surely=True)
        problem.remember(at, predicted)
        self.foreseen = 1

    def _wrong_start(self, finer: Refinement, at: Floats, predicted: Floats) -> Verdict:
        """Return why the start (N,), simulated as `predicted` (n,), should not be simulated that way."""
        exact = self.problem.predict_by(replace(finer, tolerance=START_TOLERANCE), at)
        if not np.isfinite(exact).all():
            return None
        if not np.isfinite(predicted).all():
            return SwitchCause.START_FAILED, math.nan
        size = self._difference(predicted, exact)
        return (SwitchCause.START_DIFFERED, size) if size > self.start_limit else None

    def _difference(self, one: Floats, other: Floats) -> float:
        """Return the largest difference of an output between two simulations (n,), as a share of its spread."""
        problem, shares = self.problem, []
        for j in range(problem.counts.size):
            there = problem.groups == j
            spread = max(float(np.std(problem.measured[there])), float(np.std(other[there])))
            with np.errstate(over="ignore"):  # of what explodes without failing
                gap = math.sqrt(float(np.mean((one[there] - other[there]) ** 2)))
            shares.append(gap / spread if spread > 0 else 0.0)
        return max(shares)

    # --- at the optimum

    def _settle(self) -> None:
        """Check the optima that are as good as the best, and go on by finer simulations until one passes."""
        while True:
            best = self.optima[0]
            rivals = [each for each in self.optima if each is best or each.criterion - best.criterion < RIVAL_CRITERION]
            checks = [self._check(each.fit) for each in rivals]
            sound = [found for found in checks if not found.doubtful]
            if sound and len(sound) < len(checks):
                moved = [each for each, found in zip(rivals, checks, strict=True) if found.doubtful]
                self.refused += len(moved)
                self.optima = tuple(each for each in self.optima if each not in moved)
            self.found = (sound or checks)[0]
            if sound or self.found.outcome not in (AccuracyOutcome.SHIFTED, AccuracyOutcome.UNKNOWN):
                return
            kept = self._go_on()
            if kept is not None:
                self.found = replace(self.found, kept=kept)
                return

    def _check(self, fit: Result) -> SolverCheck:
        """Return what the error of the simulation does to the estimates of a fit."""
        problem, finer = self.problem, self.problem.next_refinement
        if finer is None:
            exact = not any(map(problem.system.integrates, problem.system.components))
            exact &= all(model.kind == "model-exchange" for model in problem.system.components.values())
            outcome = AccuracyOutcome.PASSED if exact else AccuracyOutcome.UNCHECKABLE
            return SolverCheck(outcome, np.full(fit.values.size, 0.0 if exact else np.nan))
        controlled = is_controlled(problem.system, problem.refinement)
        if self.region is not None:
            found = estimate_solver_error(
                problem, fit, self.region.error(problem, finer, fit.values), controlled=controlled
            )
            if found.outcome is AccuracyOutcome.UNCHECKABLE or found.change < SHIFT_LIMIT or found.largest < SURE_SHIFT:
                return replace(found, finer=problem.how_run(finer))
        # to the last bit where the FMU may step as it likes: what the fit has kept is rounded
        predicted = stack_simulated(problem, fit) if finer.tolerance else problem.predict(fit.values[None])[0]
        found = estimate_solver_error(
            problem, fit, problem.predict_by(finer, fit.values) - predicted, controlled=controlled
        )
        found = replace(found, finer=problem.how_run(finer))
        sure = problem.next_sure_refinement
        if not found.doubtful or sure == finer:
            return found
        if sure is not None:
            inside = estimate_solver_error(
                problem, fit, problem.predict_by(sure, fit.values) - predicted, controlled=controlled
            )
            if inside.doubtful:
                return replace(inside, finer=problem.how_run(sure))
        return replace(found, outcome=AccuracyOutcome.COUPLED)

    def _go_on(self) -> RefinementRefusal | None:
        """Search on from the optima by the next finer simulation; return why nothing came of it, if so."""
        problem, finer = self.problem, self.problem.next_sure_refinement
        if not self.switching or not is_free(problem.system):
            return RefinementRefusal.ASKED
        if finer is None or problem.refined(finer).next_sure_refinement is None:
            return RefinementRefusal.FINEST
        other = problem.refined(finer)
        better, spent = self._optima_by(other)
        problem.count(other)
        if not better:
            return RefinementRefusal.NO_SEARCH
        # what it is kept from by a bound is no fault of a simulation
        bounded = bool(better[0].fit.at_bounds) and not self.optima[0].fit.at_bounds
        if fits_worse(problem, better[0].fit, self.optima[0].fit) and not bounded:
            return RefinementRefusal.FITS_BETTER
        self.optima = better
        self._switch(finer, SwitchCause.SHIFT, self.found.largest, spent)
        return None

    def _optima_by(self, other: Problem) -> tuple[tuple[Optimum, ...], int]:
        """Search on from the optima by another simulation; return where that ends, and what it took."""
        fits = [fit for each in self.optima[:MOST_OPTIMA] if (fit := self._searched(other, each.fit)) is not None]
        found = merge_optima(other, fits) if self.problem.loss is None else _single(fits)
        return found, sum(fit.simulations for fit in fits)

    def _return(self) -> None:
        """Go back to the simulation that was left at the start, if that fits clearly better after all."""
        problem, best = self.problem, self.optima[0].fit
        if not self.switches or self.switches[0].cause is SwitchCause.SHIFT or not best.converged or best.at_bounds:
            return
        if self.start_limit < START_LIMIT and self.switches[0].size <= START_LIMIT:
            return  # left for a smoother simulation alone, not for another model
        other = problem.refined(self.origin)
        error = problem.predict_by(self.origin, best.values) - stack_simulated(problem, best)
        if would_fit_better(problem, best, other, estimate_solver_error(problem, best, error).shift):
            found, _ = self._optima_by(other)
            if found and fits_worse(problem, best, found[0].fit):
                problem.simulate_by(self.origin)
                self.optima, self.switches, self.returned = found, [], True
                self.found = self._check(found[0].fit)
                self.found = replace(self.found, kept=RefinementRefusal.FITS_BETTER if self.found.doubtful else None)
        problem.count(other)

    def _searched(self, other: Problem, fit: Result) -> Result | None:
        """Go on from a fit by another simulation; None where that comes to no better end."""
        try:
            found = self.method.marquardt.search(other, self.progress, fit.values)
        except (InputError, SimulationError):
            return None
        if found.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        if fit.converged and not found.converged:
            return None
        return found.after(fit)

    def _switch(self, finer: Refinement, cause: SwitchCause, size: float, simulations: int = 0) -> None:
        """Simulate in a finer way from now on, and note why."""
        problem = self.problem
        before, after = (problem.how_run(each) for each in (problem.refinement, finer))
        self.switches.append(RefinementStep(cause, size, before, after, simulations))
        problem.simulate_by(finer)

    # --- the result

    def _concluded(self, first: Result) -> Result:
        """Return the best fit with all that was found out about its simulation."""
        problem, best = self.problem, self.optima[0].fit if self.switches or self.refused or self.returned else first
        spent = problem.simulations - self.before
        found = replace(
            self.found,
            used=problem.how_run(problem.refinement),
            switches=tuple(self.switches),
            refused=self.refused,
            simulations=spent - first.simulations - self.foreseen,
            tolerance=problem.refinement.tolerance,
            divisor=problem.refinement.divisor,
        )
        result = replace(
            best,
            simulations=spent,
            elapsed_s=time.perf_counter() - self.clock,
            optima=self.optima if first.optima else (),
            fits=first.fits,
            accuracy=found,
        )
        return with_shift(result, found) if found.outcome is AccuracyOutcome.SHIFTED else result


def _is_sound(predicted: Floats) -> bool:
    """Return whether simulated samples (n,) are finite, and not so large that their squares are not."""
    with np.errstate(over="ignore", invalid="ignore"):
        return math.isfinite(float(predicted @ predicted))


def _single(fits: Sequence[Result]) -> tuple[Optimum, ...]:
    """Return the one fit of a problem whose loss no search of the whole box knows."""
    return tuple(Optimum(fit.values, fit.criterion, 1, fit.outcome, fit) for fit in fits)
