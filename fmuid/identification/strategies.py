"""Strategies of an identification: each asks the next ones for searches."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Evaluator, Method, Result
from fmuid.events import Progress
from fmuid.identification.problem import Problem

START_LIMIT = 0.01  # largest difference of an output between two solvers at a start, over its spread


@dataclass(eq=False)
class Trial:
    """A search that a strategy asks for."""

    evaluator: Evaluator[Problem]  # another one where the solver is refined
    method: Method
    progress: Progress | None
    start: ArrayLike | None
    start_limit: float = START_LIMIT


Searches = Generator[Trial, Result, Result]  # searches asked for one after the other, and the result of all of them
Strategy = Callable[[Trial], Searches]


def walk(strategies: Sequence[Strategy], trial: Trial) -> Result:
    """Search as the first strategy asks, by the others; count the simulations and the time of all.

    Errors and interruptions of a search are raised where it was asked for.
    """
    if not strategies:
        return trial.method.search(trial.evaluator, trial.progress, trial.start)
    evaluator, asked = trial.evaluator, strategies[0](trial)
    clock, before = time.perf_counter(), evaluator.simulations
    try:
        wanted = next(asked)
        while True:
            try:
                found = walk(strategies[1:], wanted)
            except (InputError, SimulationError, KeyboardInterrupt) as error:
                wanted = asked.throw(error)
            else:
                wanted = asked.send(found)
    except StopIteration as ended:
        result: Result = ended.value
    spent, elapsed = evaluator.simulations - before, time.perf_counter() - clock
    return replace(result, history=replace(result.history, simulations=spent, elapsed_s=elapsed))
