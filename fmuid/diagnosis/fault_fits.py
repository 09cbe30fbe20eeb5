"""The fits of a diagnosis, by a simulation that is checked, and is the same without and with a fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats
from fmuid.codec import from_json
from fmuid.estimation import LeastSquares, Marquardt, Result, SolverCheck, merge_optima
from fmuid.identification import Problem, identify
from fmuid.progress import Progress


@dataclass(frozen=True, eq=False)
class FitSolverCheck:
    """What the error of the simulation does to the parameters of a fit.

    Attributes
    ----------
    names : tuple of str
        The parameters, in the order of `SolverCheck.shift`.
    accuracy : SolverCheck or None
        None where it was not looked at.
    """

    names: tuple[str, ...] = ()
    accuracy: SolverCheck | None = None

    @classmethod
    def of(cls, result: Result) -> Self:
        """Return what a fit found out."""
        return cls(result.names, result.accuracy)

    def to_json_dict(self) -> dict[str, Any] | None:
        """Return what ``diagnosis.json`` has of it."""
        if self.accuracy is None:
            return None
        return {**vars(self.accuracy), "shift": dict(zip(self.names, self.accuracy.shift.tolist(), strict=True))}

    @classmethod
    def of_json(cls, data: Mapping[str, Any] | None) -> Self:
        """Return it as ``diagnosis.json`` has it."""
        if data is None:
            return cls()
        shift = [np.nan if each is None else float(each) for each in data["shift"].values()]
        return cls(tuple(data["shift"]), from_json(SolverCheck, {**data, "shift": np.array(shift)}))


@dataclass(frozen=True)
class _Starts:
    """A search from other starts, too: a method of `fmuid.identify`, whose other optima are checked like the best."""

    others: Sequence[Floats]
    marquardt: Marquardt
    whole_box = False

    def check(self, problem: LeastSquares) -> None:
        """Any problem can be searched."""

    def search(self, problem: LeastSquares, progress: Progress | None = None, start: ArrayLike | None = None) -> Result:
        """Return the best fit from all starts."""
        before = problem.simulations
        fits = [self.marquardt.search(problem, progress, each) for each in (start, *self.others)]
        best = min(fits, key=lambda each: each.criterion)
        if len(fits) == 1:
            return best
        optima = merge_optima(problem, fits)
        # the best fit itself, whatever the others say of how well it converged
        optima = (replace(optima[0], theta=best.values, outcome=best.outcome, fit=best), *optima[1:])
        return replace(best, simulations=problem.simulations - before, optima=optima)


def fit_both(
    without: Problem,
    problem: Problem,
    start: Floats,
    starts: Callable[[Result], Sequence[Floats]],
    search: Marquardt,
    accuracy: str,
) -> tuple[Result, Result]:
    """Fit a model without and with a fault by the same simulation, so that the criteria can be compared.

    Parameters
    ----------
    without, problem : Problem
        Without and with the fault.
    start : (N,) array
        Of the fit without.
    starts : callable
        Returns the starts with the fault from the fit without.
    search : Marquardt
    accuracy : "refine", "report" or "off"
        As for `fmuid.identify`.
    """
    healthy = identify(without, search, start=start, accuracy=accuracy, remedies=False)
    problem.simulate_by(without.refinement)
    found = starts(healthy)
    best = identify(problem, _Starts(found[1:], search), start=found[0], accuracy=accuracy, remedies=False)
    if problem.refinement != without.refinement:
        without.simulate_by(problem.refinement)
        accuracy = "report" if accuracy == "refine" else accuracy
        healthy = identify(without, search, start=healthy.values, accuracy=accuracy, remedies=False)
    return healthy, replace(best, optima=())
