"""Identification: strategies, one after the other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from numpy.typing import ArrayLike

from fmuid.blas import single_threaded
from fmuid.errors import InputError, check_kind
from fmuid.estimation import Cache, Evaluator, LeastSquares, Marquardt, Method, Result
from fmuid.events import Progress
from fmuid.formatting import nearest
from fmuid.identification.discrete_parameters import search_combinations
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check import ACCURACIES, check_solver
from fmuid.identification.starting_points import search_starting_points
from fmuid.identification.strategies import Strategy, Trial, walk


@single_threaded
def identify(
    problem: LeastSquares,
    optimizer: Method | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    solver_check: str = "refine",
    restart: bool = True,
    cache: Cache | None = None,
) -> Result:
    """Identify the parameters of a problem, and check the solver error.

    Only a `Problem` is checked and restarted, and only without an observer (`fmuid.identification.with_observer`).

    Parameters
    ----------
    problem : LeastSquares
    optimizer : Marquardt or GlobalSearch, optional
        Default `Marquardt`.
    progress : callable, optional
        Called with every `fmuid.events.SearchStep` and `GlobalStep`.
    start : (N,) array, optional
        Initial guess in place of that of the parameters.
    solver_check : "refine", "report" or "off"
        Refine the solver if it moves an estimate by more than `SHIFT_LIMIT` σ, report it, or no check.
    restart : bool
        Restart where a search fails or a residual exceeds `MAX_NOISE_RATIO` times the noise level (`History.restarts`).
    cache : Cache, optional
        Shared by problems that differ in their measurements only (`Problem.measuring`).

    Returns
    -------
    Result
        Also if it did not converge or was interrupted: see `Result.outcome`.

    Raises
    ------
    SimulationError
        If no starting point can be simulated.
    InputError
        If a parameter without prior acts on no output, or a search of the box lacks bounds.
    KeyboardInterrupt
        If interrupted before the first step.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> fmuid.identify(problem)
    Result(converged: R = 3.9989 ± 0.0015, L = 0.100016 ± 0.000050)
    """
    check_kind(problem, LeastSquares, "what is identified (a study file: fmuid.run) must be a fmuid.Problem")
    method = optimizer or Marquardt()
    check_kind(method, Method, "optimizer must be fmuid.Marquardt() or fmuid.GlobalSearch()")
    if solver_check not in ACCURACIES:
        raise InputError(
            f"solver_check {solver_check!r} is not known{nearest(str(solver_check), ACCURACIES)}: "
            f"give {' or '.join(ACCURACIES)}"
        )
    return identify_by(Evaluator(problem, cache), method, progress, start, solver_check=solver_check, restart=restart)


def identify_by(
    evaluator: Evaluator[LeastSquares],
    method: Method,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    solver_check: str,
    restart: bool,
) -> Result:
    """Identify as `identify` does, by an evaluator, which counts the simulations."""
    problem = evaluator.problem
    if not isinstance(problem, Problem):
        return method.search(evaluator, progress, start)
    strategies: list[Strategy] = []
    if problem.choices:
        strategies.append(search_combinations)
    if restart and not method.whole_box and not problem.corrected:
        strategies.append(search_starting_points)
    if solver_check != "off" and not problem.corrected:
        strategies.append(partial(check_solver, refine=solver_check == "refine"))
    found = walk(strategies, Trial(evaluator.of(problem), method, progress, start))
    setup = replace(found.setup, made_with=problem.made_with, observer=problem.observer)
    return replace(found, setup=setup)
