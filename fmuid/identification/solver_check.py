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
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    Evaluator,
    Method,
    Optimum,
    RefinementRefusal,
    RefinementStep,
    Result,
    RunFields,
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
from fmuid.identification.problem import Problem
from fmuid.progress import Progress
from fmuid.simulation import Refinement, how_run, is_controlled, is_free, next_refinement, replaces_interface

ACCURACIES = ("refine", "report", "off")
"""What may be done about the error of the simulation."""
# The search goes by model exchange where the outputs at the start differ by more than this share of their spread.
START_LIMIT = 0.01
START_TOLERANCE = 1e-6  # which that does not ask more of
# Where a start fails its steps are divided so often at most: what fails in the sixteenth of a step has other reasons.
START_DIVISIONS = 2
# Shifts below this are known to be small from the error at another point of the same cell.
SURE_SHIFT = SHIFT_LIMIT / 3.0
# Optima whose criterion is higher by less are as good as the best: χ² of one parameter is larger in 5 % of all cases.
RIVAL_CRITERION = 3.84
# By a finer simulation the search goes on from so many of the best optima of a box at most.
MOST_OPTIMA = 10


class SolverCheckedSearch:
    """A search whose solver error is checked at the optimum, and which goes on by refinements where it is too large.

    Parameters
    ----------
    evaluator : Evaluator
    method, progress, accuracy
        As for `fmuid.identify`.
    start_limit : float
        The search goes by model exchange where the outputs at the start differ by more than this share of their spread.

    Attributes
    ----------
    evaluator : Evaluator
        Of the problem as it is simulated now.
    """

    def __init__(
        self,
        evaluator: Evaluator[Problem],
        method: Method,
        progress: Progress | None,
        accuracy: str,
        start_limit: float = START_LIMIT,
    ) -> None:
        self.origin = self.evaluator = evaluator
        self.method, self.progress, self.start_limit, self.accuracy = method, progress, start_limit, accuracy
        self.clock, self.before = time.perf_counter(), evaluator.simulations
        self.switches: list[RefinementStep] = []
        self.refused = self.foreseen = 0
        self.returned = False

    @property
    def problem(self) -> Problem:
        """As it is simulated now."""
        return self.evaluator.problem

    def run(self, start: ArrayLike | None) -> Result:
        """Compare at the start (N,), search, check."""
        if self.accuracy == "off":
            return self.method.search(self.evaluator, self.progress, start)
        if self.accuracy == "refine":
            self._compare_start(self.problem.parameters.start if start is None else numbers(start, "start"))
        first = self.method.search(self.evaluator, self.progress, start)
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
        predicted = self._predict_start(at)
        if replaces_interface(problem.system, finer):
            wrong = self._wrong_start(finer, at, predicted)
            if wrong is not None:
                self._switch(finer, *wrong)
        elif finer.tolerance is None and not _is_sound(predicted):
            self._shorten_steps(finer, at)

    def _predict_start(self, at: Floats) -> Floats:
        """Return the simulation (n,) of a start, which spares the search its own."""
        before = self.evaluator.simulations
        predicted = self.evaluator.predict_start(at[None])[0]
        self.foreseen = self.evaluator.simulations - before
        return np.asarray(predicted)

    def _shorten_steps(self, finer: Refinement | None, at: Floats) -> None:
        """Go by shorter steps where there is nothing else and co-simulation fails at a start (N,)."""
        for _ in range(START_DIVISIONS):
            if finer is None:
                break
            if _is_sound(self.evaluator.predict_by(finer, at)):
                self._switch(finer, SwitchCause.START_FAILED, math.nan)
                return
            finer = next_refinement(self.problem.system, finer, surely=True)

    def _wrong_start(self, finer: Refinement, at: Floats, predicted: Floats) -> tuple[SwitchCause, float] | None:
        """Return why the start (N,), simulated as `predicted` (n,), should not be simulated that way."""
        exact = self.evaluator.predict_by(replace(finer, tolerance=START_TOLERANCE), at, start=True)
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
        error = self.evaluator.error_near(finer, fit.values, fit.std)
        if error is not None:
            found = estimate_solver_error(problem, fit, error, controlled=controlled)
            if found.outcome is AccuracyOutcome.UNCHECKABLE or found.change < SHIFT_LIMIT or found.largest < SURE_SHIFT:
                return replace(found, finer=self._how_run(finer))
        # to the last bit where the FMU may step as it likes: what the fit has kept is rounded
        predicted = stack_simulated(problem, fit) if finer.tolerance else self.evaluator.predict(fit.values[None])[0]
        found = estimate_solver_error(
            problem, fit, self.evaluator.predict_by(finer, fit.values) - predicted, controlled=controlled
        )
        found = replace(found, finer=self._how_run(finer))
        sure = problem.next_sure_refinement
        if not found.doubtful or sure == finer:
            return found
        if sure is not None:
            inside = estimate_solver_error(
                problem, fit, self.evaluator.predict_by(sure, fit.values) - predicted, controlled=controlled
            )
            if inside.doubtful:
                return replace(inside, finer=self._how_run(sure))
        return replace(found, outcome=AccuracyOutcome.COUPLED)

    def _go_on(self) -> RefinementRefusal | None:
        """Search on from the optima by the next finer simulation; return why nothing came of it, if so."""
        problem, finer = self.problem, self.problem.next_sure_refinement
        if self.accuracy != "refine" or not is_free(problem.system):
            return RefinementRefusal.ASKED
        if finer is None or next_refinement(problem.system, finer, surely=True) is None:
            return RefinementRefusal.FINEST
        better, spent = self._optima_by(self.evaluator.finer(finer))
        if not better:
            return RefinementRefusal.NO_SEARCH
        # what it is kept from by a bound is no fault of a simulation
        bounded = bool(better[0].fit.at_bounds) and not self.optima[0].fit.at_bounds
        if fits_worse(problem, better[0].fit, self.optima[0].fit) and not bounded:
            return RefinementRefusal.FITS_BETTER
        self.optima = better
        self._switch(finer, SwitchCause.SHIFT, self.found.largest, spent)
        return None

    def _optima_by(self, other: Evaluator[Problem]) -> tuple[tuple[Optimum, ...], int]:
        """Search on from the optima by another simulation; return where that ends, and what it took."""
        fits = [fit for each in self.optima[:MOST_OPTIMA] if (fit := self._searched(other, each.fit)) is not None]
        found = merge_optima(other.problem, fits) if self.problem.loss is None else _single(fits)
        return found, sum(fit.simulations for fit in fits)

    def _return(self) -> None:
        """Go back to the simulation that was left at the start, if that fits clearly better after all."""
        problem, best = self.problem, self.optima[0].fit
        if not self.switches or self.switches[0].cause is SwitchCause.SHIFT or not best.converged or best.at_bounds:
            return
        if self.start_limit < START_LIMIT and self.switches[0].size <= START_LIMIT:
            return  # left for a smoother simulation alone, not for another model
        error = self.origin.predict(best.values[None])[0] - stack_simulated(problem, best)
        if would_fit_better(problem, best, self.origin, estimate_solver_error(problem, best, error).shift):
            found, _ = self._optima_by(self.origin)
            if found and fits_worse(problem, best, found[0].fit):
                self.evaluator = self.origin
                self.optima, self.switches, self.returned = found, [], True
                self.found = self._check(found[0].fit)
                self.found = replace(self.found, kept=RefinementRefusal.FITS_BETTER if self.found.doubtful else None)

    def _searched(self, other: Evaluator[Problem], fit: Result) -> Result | None:
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
        before, after = (self._how_run(each) for each in (self.problem.refinement, finer))
        self.switches.append(RefinementStep(cause, size, before, after, simulations))
        self.evaluator, self.foreseen = self.evaluator.finer(finer), 0

    def _how_run(self, refinement: Refinement) -> dict[str, RunFields]:
        """Return how each component is run with a refinement, as far as it is known which are stiff."""
        try:
            return self.evaluator.finer(refinement).problem.how_run
        except InputError:  # an FMU that takes no such steps
            return {
                name: cast(RunFields, dict(vars(run))) for name, run in how_run(self.problem.system, refinement).items()
            }

    # --- the result

    def _concluded(self, first: Result) -> Result:
        """Return the best fit with all that was found out about its simulation."""
        problem, best = self.problem, self.optima[0].fit if self.switches or self.refused or self.returned else first
        spent = self.evaluator.simulations - self.before
        found = replace(
            self.found,
            used=problem.how_run,
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
