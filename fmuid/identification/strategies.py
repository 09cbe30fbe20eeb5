"""Strategies of an identification: each asks the next ones for searches."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

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


Searches = Generator[Trial, Result, Result]
"""Searches asked for one after the other, and the result of all of them."""
Strategy = Callable[[Trial], Searches]


def walk(strategies: Sequence[Strategy], trial: Trial) -> Result:
    """Search as the first strategy asks, by the others; raise errors of a search where it was asked for."""
    if not strategies:
        return trial.method.search(trial.evaluator, trial.progress, trial.start)
    asked = strategies[0](trial)
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
        return result
