"""Observers for plants that integrate: simulations whose states are corrected at each sample.

x += L (y* − y) with the poles of (I − L C) exp(A T) at a few samples (Ackermann's formula, one output; Regelungstechnik
20, 1972). A and C are secants over the nominal sizes of the states: dry friction counts with its mean slope. Estimates
are no longer those of output error: faster observers bias them more.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.data import usual_step
from fmuid.errors import InputError
from fmuid.identification.problem import Problem
from fmuid.simulation import RightHandSide, Simulator


def with_observer(problem: Problem, samples: float = 3.0) -> Problem:
    """Return a problem with a state observer, corrected at each sample.

    Its time constant is in (median) sampling intervals. The model has Model Exchange and one output that
    observes all states; else an `InputError`. The result says so (`Setup.observer`). There are no solver check and no
    restarts.
    """
    if not samples > 0.0:
        raise InputError(f"an observer needs a positive memory in samples, not {samples:g}.")
    if problem.choices:
        raise InputError(f"an observer excludes discrete parameters. Fix {next(iter(problem.choices))!r}.")
    simulators = [_observed(problem, index, samples) for index in range(len(problem.simulators))]
    return problem.simulated_by(simulators, observer=samples)


def _observed(problem: Problem, index: int, samples: float) -> Simulator:
    simulator, experiment = problem.simulators[index], problem.experiments[index]
    if experiment.observation is not None:
        raise InputError(f"an observer excludes an observation. Remove one from {experiment.source}.")
    side = RightHandSide.of(simulator) if isinstance(simulator, Simulator) else None
    if side is None or not isinstance(simulator, Simulator):
        raise InputError("an observer needs Model Exchange and accessible states.")
    if len(simulator.output_names) != 1:
        raise InputError(f"an observer needs one output; {experiment.source} has {len(simulator.output_names)}.")
    slopes, outputs = side.secants(problem.parameters.start[problem.parameters.for_experiment(index)[1]])
    gain = observer_gain(slopes, outputs[0] / simulator.output_factors[0], usual_step(experiment.times), samples)
    return side.corrected(side.nominals[:, None] * gain, tolerance=1e-7)


def observer_gain(slopes: Floats, output: Floats, interval: float, samples: float) -> Floats:
    """Return L (n_x, 1) by Ackermann's formula; from A (n_x, n_x), C (n_x,) and T, all poles at exp(−1/samples)."""
    count = len(slopes)
    step = scipy.linalg.expm(slopes * interval)
    powers = [np.linalg.matrix_power(step, k) for k in range(count + 1)]
    rows = np.array([output @ power for power in powers[1:]])
    values = np.linalg.svd(rows / np.maximum(np.abs(rows).max(axis=0), 1e-300), compute_uv=False)
    if not np.isfinite(rows).all() or not values[-1] > 1e-12 * values[0]:
        raise InputError("not all states of the model are observable from the output.")
    pole = math.exp(-1.0 / samples)
    wanted = np.poly(np.full(count, pole))
    polynomial = sum(factor * power for factor, power in zip(wanted, powers[::-1], strict=True))
    last = np.zeros((count, 1))
    last[-1] = 1.0
    return np.asarray(polynomial @ np.linalg.solve(rows, last), dtype=np.float64)
