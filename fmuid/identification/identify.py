"""Identification: strategies, one after the other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from numpy.typing import ArrayLike

from fmuid.blas import single_threaded
from fmuid.errors import InputError, check_kind
from fmuid.estimation import Evaluator, LeastSquares, Marquardt, Method, Result
from fmuid.events import Progress
from fmuid.formatting import nearest
from fmuid.identification.acquisition_delay import include_delay
from fmuid.identification.discrete_parameters import search_combinations
from fmuid.identification.final_covariance import include_uneven_noise
from fmuid.identification.problem import Problem
from fmuid.identification.solver_check import ACCURACIES, check_solver
from fmuid.identification.starting_points import search_starting_points
from fmuid.identification.strategies import Strategy, Trial, walk


@single_threaded
def identify(
    problem: LeastSquares | Evaluator[LeastSquares],
    optimizer: Method | None = None,
    progress: Progress | None = None,
    start: ArrayLike | None = None,
    *,
    solver_check: str = "refine",
    restart: bool = True,
) -> Result:
    """Identify the parameters of a problem, and check the solver error.

    Only a `Problem` is checked and restarted, and only without an observer (`fmuid.identification.with_observer`).

    Parameters
    ----------
    problem : LeastSquares or Evaluator
        An `fmuid.estimation.Evaluator` of a problem counts its simulations and may share a `Cache`.
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
    Result(converged: R = 3.9985 ± 0.0016, L = 0.100042 ± 0.000058)
    """
    given = problem.problem if isinstance(problem, Evaluator) else problem
    check_kind(given, LeastSquares, "problem (of a study file: fmuid.run) must be a fmuid.Problem")
    method = optimizer or Marquardt()
    check_kind(method, Method, "optimizer must be fmuid.Marquardt() or fmuid.GlobalSearch()")
    if solver_check not in ACCURACIES:
        near = nearest(str(solver_check), ACCURACIES)
        raise InputError(f"solver_check: unknown value {solver_check!r}{near}. Choose {', '.join(ACCURACIES)}.")
    evaluator = problem if isinstance(problem, Evaluator) else Evaluator(problem)
    problem = evaluator.problem
    if not isinstance(problem, Problem):
        return method.search(evaluator, progress, start)
    strategies: list[Strategy] = []
    if problem.choices:
        strategies.append(search_combinations)
    if restart and not method.whole_box and not problem.corrected:
        strategies.append(search_starting_points)
    in_time = any(each.kind == "time" for each in problem.experiments)  # steady states have no solver error
    if solver_check != "off" and not problem.corrected and in_time:
        strategies.append(partial(check_solver, refine=solver_check == "refine"))
    found = walk(strategies, Trial(evaluator.of(problem), method, progress, start))
    if not problem.corrected:
        found = include_delay(evaluator, include_uneven_noise(problem.as_in(found), found))
    setup = replace(found.setup, made_with=problem.made_with, observer=problem.observer)
    return replace(found, setup=setup)
