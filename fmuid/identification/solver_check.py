"""Solver error in σ, and solver refinement: a strategy.

Before a search, Co-Simulation is compared with Model Exchange; at the optimum, a refined solver with the one in use.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    Evaluator,
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
    usable,
    with_shift,
    would_fit_better,
)
from fmuid.identification.problem import Problem, run_fields
from fmuid.identification.strategies import START_LIMIT, Searches, Trial
from fmuid.simulation import Refinement, is_controlled, is_free, next_refinement, replaces_interface

ACCURACIES = ("refine", "report", "off")  # what may be done about the solver error


@dataclass(frozen=True)
class SolverCheckSettings:
    """Numbers of the solver check."""

    start_tolerance: float = 1e-6  # of Model Exchange at the starting point, relative
    start_divisions: int = 2  # of the step after a failed start; further failures have other reasons
    sure_shift: float = SHIFT_LIMIT / 3.0  # σ; smaller shifts stay small within a cell of the cache
    richardson: float = 2.0  # error of a step over its change by half the step, at order 1
    optima: int = 10  # of a box, from which a refined search goes on


SETTINGS = SolverCheckSettings()
EQUAL_COST = 3.84  # cost above the best optimum, 95 % quantile of χ²(1); optima below it are as good

Found = TypeVar("Found")
Steps = Generator[Trial, Result, Found]


def check_solver(trial: Trial, *, refine: bool) -> Searches:
    """Search, check the solver error, and go on by refined solvers."""
    return _SolverChecking(trial, refine=refine).run()


class _SolverChecking:
    """One search with its optima, solver refinements and latest check."""

    def __init__(self, trial: Trial, *, refine: bool) -> None:
        self.trial, self.origin, self.refine = trial, trial.evaluator, refine
        self.before = trial.evaluator.simulations
        self.switches: list[RefinementStep] = []
        self.refused = self.foreseen = 0
        self.returned = False

    @property
    def evaluator(self) -> Evaluator[Problem]:
        return self.trial.evaluator

    @property
    def problem(self) -> Problem:
        return self.evaluator.problem

    def run(self) -> Searches:
        if self.refine:
            start = self.trial.start
            self._compare_start(self.problem.parameters.start if start is None else numbers(start, "start"))
        first = yield self.trial
        self.optima = first.history.optima or (Optimum(first.values, first.fit.cost, 1, first.outcome, first),)
        self.found = SolverCheck(AccuracyOutcome.INTERRUPTED, np.full(len(first.names), np.nan))
        if first.fit.linearization is not None and first.outcome is not TerminationReason.INTERRUPTED:
            try:
                yield from self._settle()
                yield from self._return()
            except KeyboardInterrupt:
                self.found = replace(self.found, outcome=AccuracyOutcome.INTERRUPTED)
        return self._concluded(first)

    # --- at the start

    def _compare_start(self, at: Floats) -> None:
        """Use Model Exchange where Co-Simulation fails or is far off."""
        problem = self.problem
        finer = next_refinement(problem.system, problem.refinement, surely=True)
        if problem.refinement.any or finer is None or not is_free(problem.system):
            return
        if at.shape != (len(problem.parameters),):
            return  # the search refuses it
        predicted = self.evaluator.predict_start(at[None])[0]  # shared with the search
        self.foreseen = self.evaluator.simulations - self.before
        if replaces_interface(problem.system, finer):
            wrong = self._wrong_start(finer, at, predicted)
            if wrong is not None:
                self._switch(finer, *wrong)
        elif finer.tolerance is None and not usable(predicted):
            self._shorten_steps(finer, at)

    def _shorten_steps(self, finer: Refinement | None, at: Floats) -> None:
        """Use shorter steps where Co-Simulation fails at a start (N,)."""
        for _ in range(SETTINGS.start_divisions):
            if finer is None:
                return
            if usable(self.evaluator.predict_by(finer, at)):
                self._switch(finer, SwitchCause.START_FAILED, math.nan)
                return
            finer = next_refinement(self.problem.system, finer, surely=True)

    def _wrong_start(self, finer: Refinement, at: Floats, predicted: Floats) -> tuple[SwitchCause, float] | None:
        """Return the reason to leave the solver that gives `predicted` (n,)."""
        exact = self.evaluator.predict_by(replace(finer, tolerance=SETTINGS.start_tolerance), at, start=True)
        if not np.isfinite(exact).all():
            return None
        if not np.isfinite(predicted).all():
            return SwitchCause.START_FAILED, math.nan
        size = self._difference(predicted, exact)
        return (SwitchCause.START_DIFFERED, size) if size > self.trial.start_limit else None

    def _difference(self, one: Floats, other: Floats) -> float:
        """Return the largest difference of an output, over its spread."""
        problem, shares = self.problem, []
        for j in range(problem.counts.size):
            there = problem.groups == j
            spread = max(float(np.std(problem.measured[there])), float(np.std(other[there])))
            with np.errstate(over="ignore"):  # of diverging simulations
                gap = math.sqrt(float(np.mean((one[there] - other[there]) ** 2)))
            shares.append(gap / spread if spread > 0 else 0.0)
        return max(shares)

    # --- at the optimum

    def _settle(self) -> Steps[None]:
        """Check the best optima; refine the solver until one passes."""
        while True:
            best = self.optima[0]
            close = [each for each in self.optima if each is best or each.criterion - best.criterion < EQUAL_COST]
            checks = [self._check(each.fit) for each in close]
            sound = [found for found in checks if not found.doubtful]
            if sound and len(sound) < len(checks):
                moved = [each for each, found in zip(close, checks, strict=True) if found.doubtful]
                self.refused += len(moved)
                self.optima = tuple(each for each in self.optima if each not in moved)
            self.found = (sound or checks)[0]
            if sound or self.found.outcome not in (AccuracyOutcome.SHIFTED, AccuracyOutcome.UNKNOWN):
                return
            kept = yield from self._go_on()
            if kept is not None:
                self.found = replace(self.found, kept=kept)
                return

    def _check(self, fit: Result) -> SolverCheck:
        """Return the effect of the solver error on a fit."""
        problem, finer = self.problem, next_refinement(self.problem.system, self.problem.refinement)
        if finer is None:
            exact = not any(map(problem.system.integrates, problem.system.components))
            exact &= all(model.kind == "model-exchange" for model in problem.system.components.values())
            outcome = AccuracyOutcome.PASSED if exact else AccuracyOutcome.UNCHECKABLE
            return SolverCheck(outcome, np.full(fit.values.size, 0.0 if exact else np.nan))
        controlled = is_controlled(problem.system, problem.refinement)
        error = self.evaluator.error_near(finer, fit.values, fit.std)
        if error is not None:
            found = estimate_solver_error(problem, fit, error, controlled=controlled)
            if (
                found.outcome is AccuracyOutcome.UNCHECKABLE
                or found.change < SHIFT_LIMIT
                or found.largest < SETTINGS.sure_shift
            ):
                return replace(found, finer=self._how_run(finer))
        # to the last bit where the FMU may step as it likes: what the fit has kept is rounded
        predicted = stack_simulated(problem, fit) if finer.tolerance else self.evaluator.predict(fit.values[None])[0]

        def compared(other: Refinement) -> SolverCheck:
            error = self.evaluator.predict_by(other, fit.values) - predicted
            found = estimate_solver_error(problem, fit, error, controlled=controlled)
            return replace(found, finer=self._how_run(other))

        found = compared(finer)
        if found.outcome is AccuracyOutcome.FAILED and finer.tolerance is None:
            return self._suggested(fit, found, predicted)
        sure = next_refinement(problem.system, problem.refinement, surely=True)
        if not found.doubtful or sure == finer:
            return found
        if sure is not None and (inside := compared(sure)).doubtful:
            return inside
        return replace(found, outcome=AccuracyOutcome.COUPLED)

    def _suggested(self, fit: Result, failed: SolverCheck, predicted: Floats) -> SolverCheck:
        """Return a failed check with the shift by half the communication step.

        By Richardson, the error of a step h is 2^p / (2^p − 1) times its change by h / 2: twice at order p = 1.
        """
        half = Refinement(None, 2 * self.problem.refinement.divisor)
        error = SETTINGS.richardson * (self.evaluator.predict_by(half, fit.values) - predicted)
        if not np.isfinite(error).all():
            return failed
        bound = estimate_solver_error(self.problem, fit, error)
        return replace(failed, shift=bound.shift, change=bound.change, finer=self._how_run(half))

    def _go_on(self) -> Steps[RefinementRefusal | None]:
        """Search on by the next refined solver; return any refusal."""
        problem = self.problem
        finer = next_refinement(problem.system, problem.refinement, surely=True)
        if not self.refine or not is_free(problem.system):
            return RefinementRefusal.ASKED
        if finer is None or next_refinement(problem.system, finer, surely=True) is None:
            return RefinementRefusal.FINEST
        better, spent = yield from self._optima_by(self.evaluator.finer(finer))
        if not better:
            return RefinementRefusal.NO_SEARCH
        # what it is kept from by a bound is no fault of a simulation
        bounded = bool(better[0].fit.estimates.at_bounds) and not self.optima[0].fit.estimates.at_bounds
        if fits_worse(problem, better[0].fit, self.optima[0].fit) and not bounded:
            return RefinementRefusal.FITS_BETTER
        self.optima = better
        self._switch(finer, SwitchCause.SHIFT, self.found.largest, spent)
        return None

    def _optima_by(self, other: Evaluator[Problem]) -> Steps[tuple[tuple[Optimum, ...], int]]:
        """Search on by another solver; return optima and simulations."""
        fits: list[Result] = []
        for each in self.optima[: SETTINGS.optima]:
            method = self.trial.method.marquardt
            try:
                found = yield replace(self.trial, evaluator=other, method=method, start=each.fit.values)
            except (InputError, SimulationError):
                continue
            if found.outcome is TerminationReason.INTERRUPTED:
                raise KeyboardInterrupt
            if found.converged or not each.fit.converged:
                fits.append(found.after(each.fit))
        return merge_optima(other.problem, fits), sum(fit.history.simulations for fit in fits)

    def _return(self) -> Steps[None]:
        """Return to the solver left at the start if it fits better."""
        problem, best = self.problem, self.optima[0].fit
        if not self.switches or self.switches[0].cause is SwitchCause.SHIFT:
            return
        if not best.converged or best.estimates.at_bounds:
            return
        if self.trial.start_limit < START_LIMIT and self.switches[0].size <= START_LIMIT:
            return  # left for a smoother simulation alone, not for another model
        error = self.origin.predict(best.values[None])[0] - stack_simulated(problem, best)
        if would_fit_better(problem, best, self.origin, estimate_solver_error(problem, best, error).shift):
            found, _ = yield from self._optima_by(self.origin)
            if found and fits_worse(problem, best, found[0].fit):
                self.trial.evaluator = self.origin
                self.optima, self.switches, self.returned = found, [], True
                self.found = self._check(found[0].fit)
                self.found = replace(self.found, kept=RefinementRefusal.FITS_BETTER if self.found.doubtful else None)

    def _switch(self, finer: Refinement, cause: SwitchCause, size: float, simulations: int = 0) -> None:
        """Simulate by a refined solver from now on, and note the reason."""
        before, after = (self._how_run(each) for each in (self.problem.refinement, finer))
        self.switches.append(RefinementStep(cause, size, before, after, simulations))
        self.trial.evaluator, self.foreseen = self.evaluator.finer(finer), 0

    def _how_run(self, refinement: Refinement) -> dict[str, RunFields]:
        try:
            return self.evaluator.finer(refinement).problem.how_run
        except InputError:  # an FMU that takes no such steps
            return run_fields(self.problem.system, refinement)

    def _concluded(self, first: Result) -> Result:
        problem, best = self.problem, self.optima[0].fit if self.switches or self.refused or self.returned else first
        spent = self.evaluator.simulations - self.before
        found = replace(
            self.found,
            used=problem.how_run,
            switches=tuple(self.switches),
            refused=self.refused,
            simulations=spent - first.history.simulations - self.foreseen,
            tolerance=problem.refinement.tolerance,
            divisor=problem.refinement.divisor,
        )
        optima = self.optima if first.history.optima else ()
        history = replace(best.history, optima=optima, fits=first.history.fits)
        result = replace(best, history=history, accuracy=found)
        return with_shift(result, found) if found.outcome is AccuracyOutcome.SHIFTED else result
