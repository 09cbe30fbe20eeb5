"""A start by simulations whose states the measurements correct at each sample: x += C⁺ (y* − y), C = ∂y/∂x.

What is measured cannot drift away then, so that the criterion has few secondary optima; what is not is simulated, and
must be stable. The noise of the measurements enters the states, and biases what is found: a start, and never a result.
It is searched for roughly, by simulations that are rough too.
"""

from __future__ import annotations

import numpy as np

from fmuid.arrays import Floats
from fmuid.errors import FmuidError
from fmuid.estimation import Marquardt, Outcome
from fmuid.model_problem.problem import Problem
from fmuid.progress import Progress
from fmuid.simulation import RightHandSide, Simulator

ROUGH = Marquardt(max_iterations=25, tolerance=1e-3)
TOLERANCE = 1e-5  # of its integration
# Directions of the states that change the outputs by less than this share of the most are not corrected.
UNSEEN = 1e-6


def corrected_start(problem: Problem, start: Floats, progress: Progress | None = None) -> Floats | None:
    """Return a start (N,) by corrected simulations, None where it cannot be had.

    Parameters
    ----------
    problem : Problem
        Its simulations are counted.
    start : (N,) array
        Where the search for it sets out.
    progress : callable, optional

    Raises
    ------
    KeyboardInterrupt
        If the search for it is interrupted.
    """
    simulators = [_corrected(problem, index, start) for index in range(len(problem.experiments))]
    found = [each for each in simulators if each is not None]
    if len(found) < len(simulators):
        return None
    other = problem.simulated_by(found)
    try:
        result = ROUGH.search(other, progress, start)
    except FmuidError:
        return None
    finally:
        problem.count(other)
    if result.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    return result.values


def _corrected(problem: Problem, index: int, start: Floats) -> Simulator | None:
    simulator = problem.simulators[index]
    try:
        side = RightHandSide.of(simulator)
        if side is None:
            return None
        slopes, _, _ = side.output_slopes(start[problem.parameters.for_experiment(index)[1]])
    except FmuidError:
        return None
    if not np.isfinite(slopes).all() or not slopes.any():
        return None
    of_fmu = slopes / simulator.output_factors[:, None]
    sizes = np.nanstd(problem.experiments[index].output_values, axis=0) / np.abs(simulator.output_factors)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    gain = side.nominals[:, None] * np.linalg.pinv(of_fmu / sizes[:, None], rcond=UNSEEN) / sizes
    return side.corrected(gain, TOLERANCE)
