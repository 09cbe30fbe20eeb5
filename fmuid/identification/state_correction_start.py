"""A start by simulations whose states the measurements correct at each sample: x += C⁺ (y* − y), C = ∂y/∂x.

What is measured cannot drift away then, so that the criterion has few secondary optima; what is not is simulated, and
must be stable. The noise of the measurements enters the states, and biases what is found, so that a search without
corrections follows: a start, and never a result. Both are rough, by simulations that are rough too: parameters that are
far away often make a model stiff, and an accurate simulation of such a one takes many times as long. A model of many
states is corrected at fewer samples.
"""

from __future__ import annotations

import math

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import ParameterSet
from fmuid.errors import FmuidError
from fmuid.estimation import Marquardt, TerminationReason
from fmuid.identification.equation_error_start import FARTHEST
from fmuid.identification.problem import Problem
from fmuid.progress import Progress
from fmuid.simulation import RightHandSide, Simulator

# The searches with corrections and without: how far they go, and the tolerance of their integration.
ROUGH = Marquardt(max_iterations=25, tolerance=1e-3), Marquardt(max_iterations=60, tolerance=1e-3)
TOLERANCE = 1e-5
# Of the integrator between two samples; where there are more, something else than the start is looked for.
MOST_STEPS = 1000
# A correction begins the integration anew, for which cvode takes a Jacobian of one evaluation a state. So many states
# are worth one sample: then it takes no more evaluations than the steps that follow.
STATES_PER_SAMPLE = 20
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
    found = [_corrected(problem, index, start) for index in range(len(problem.experiments))]
    pairs = [each for each in found if each is not None]
    if len(pairs) < len(found):
        return None
    parameters, theta = _near(problem, start), start
    for method, simulators in zip(ROUGH, zip(*pairs, strict=True), strict=True):
        other = problem.simulated_by(simulators)
        other.parameters = parameters
        try:
            result = method.search(other, progress, theta)
        except FmuidError:  # the exact search sets out from where this one did
            break
        finally:
            problem.count(other)
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        theta = result.values
    return None if theta is start else theta


def _near(problem: Problem, start: Floats) -> ParameterSet:
    """Return the parameters within `FARTHEST` of a start: a rough search does not come back from where one vanishes."""
    reach, sign = np.abs(start), np.sign(start)
    least = np.where(sign > 0.0, reach / FARTHEST, -FARTHEST * reach)
    most = np.where(sign < 0.0, -reach / FARTHEST, FARTHEST * reach)
    zero = sign == 0.0
    return problem.parameters.within(np.where(zero, -np.inf, least), np.where(zero, np.inf, most))


def _corrected(problem: Problem, index: int, start: Floats) -> tuple[Simulator, Simulator] | None:
    """Return the simulators of an experiment with corrections and without, None where there are none."""
    simulator = problem.simulators[index]
    try:
        side = RightHandSide.of(simulator)
        if side is None:
            return None
        slopes, _, _ = side.output_slopes(start[problem.parameters.for_experiment(index)[1]])
    except FmuidError:  # a start is not worth an error: the search itself says what is wrong with the model
        return None
    if not np.isfinite(slopes).all() or not slopes.any():
        return None
    of_fmu = slopes / simulator.output_factors[:, None]
    sizes = np.nanstd(problem.experiments[index].output_values, axis=0) / np.abs(simulator.output_factors)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    gain = side.nominals[:, None] * np.linalg.pinv(of_fmu / sizes[:, None], rcond=UNSEEN) / sizes
    every = math.ceil(len(side.states) / STATES_PER_SAMPLE)
    return side.corrected(gain, TOLERANCE, MOST_STEPS, every), side.simulator(TOLERANCE, MOST_STEPS)
