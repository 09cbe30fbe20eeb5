"""Simulations whose states an observer corrects at each sample: for plants that integrate, whose output error drifts.

A plant that integrates keeps every error of its model to the end of the record: simulated in open loop, its parameters
are pulled to where the drift is least, not to where the model is right. An observer forgets: x += L (y* − y) at each
sample, with the poles of its error at a few samples. What is compared is a prediction over that time, so the estimates
are no longer those of output error: noise of the measurements enters the states, and biases them the more, the faster
the observer is.

The error of the observer is e ← (I − L C) exp(A T) e from sample to sample. L places its poles by Ackermann's formula,
for one output; A and C are secants over the nominal sizes of the states, so that a step such as that of dry friction
counts with its mean slope.

References
----------
J. Ackermann, "Der Entwurf linearer Regelungssysteme im Zustandsraum", Regelungstechnik 20, 1972.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.identification.problem import Problem
from fmuid.simulation import RightHandSide, Simulator

TOLERANCE = 1e-7  # of the integration
# What is observed through less than this, relative to the largest, is not observed.
UNOBSERVED = 1e-12
TINY = 1e-300


def with_observer(problem: Problem, samples: float = 3.0) -> Problem:
    """Return a problem whose states an observer corrects at each sample, for `fmuid.identify`.

    What is identified by it is predicted over a few samples, and is no output error: its result says so
    (`Result.observer`). Its simulation is compared with nothing finer, and there are no remedies.

    Parameters
    ----------
    problem : Problem
        Of a single FMU that offers model exchange, with one output that observes all its states.
    samples : float
        The time constant of the observer's error, in sampling intervals (their median).

    Raises
    ------
    InputError
        If the model shows no right-hand side, has several outputs, states that its output does not observe, or
        parameters that take few values.
    """
    if not samples > 0.0:
        raise InputError(f"the observer's time constant must be a positive number of samples, not {samples:g}")
    if problem.choices:
        raise InputError(f"an observer is for one model, and {next(iter(problem.choices))!r} takes few values: hold it")
    start = problem.parameters.start
    simulators = [_observed(problem, index, start, samples) for index in range(len(problem.simulators))]
    return problem.simulated_by(simulators, observer=samples)


def _observed(problem: Problem, index: int, start: Floats, samples: float) -> Simulator:
    simulator, experiment = problem.simulators[index], problem.experiments[index]
    side = RightHandSide.of(simulator)
    if side is None:
        raise InputError("an observer needs a single FMU that offers model exchange and shows its states")
    if len(simulator.output_names) != 1:
        raise InputError(
            f"an observer is for one output, and {simulator.experiment.source} has {len(simulator.output_names)}"
        )
    theta = start[problem.parameters.for_experiment(index)[1]]
    slopes, outputs = side.secants(theta)
    interval = float(np.median(np.diff(experiment.times)))
    gain = observer_gain(slopes, outputs[0] / simulator.output_factors[0], interval, samples)
    return side.corrected(side.nominals[:, None] * gain, TOLERANCE)


def observer_gain(slopes: Floats, output: Floats, interval: float, samples: float) -> Floats:
    """Return L (n_x, 1) that places all poles of (I − L C) exp(A T) at exp(−1/samples).

    Parameters
    ----------
    slopes : (n_x, n_x) array
        A.
    output : (n_x,) array
        C.
    interval : float
        T, s.
    samples : float

    Raises
    ------
    InputError
        If the output does not observe all states.
    """
    count = len(slopes)
    step = scipy.linalg.expm(slopes * interval)
    powers = [np.linalg.matrix_power(step, k) for k in range(count + 1)]
    rows = np.array([output @ power for power in powers[1:]])
    values = np.linalg.svd(rows / np.maximum(np.abs(rows).max(axis=0), TINY), compute_uv=False)
    if not np.isfinite(rows).all() or not values[-1] > UNOBSERVED * values[0]:
        raise InputError("the output does not observe all states of the model: they cannot be corrected from it")
    pole = math.exp(-1.0 / samples)
    wanted = np.poly(np.full(count, pole))
    polynomial = sum(factor * power for factor, power in zip(wanted, powers[::-1], strict=True))
    last = np.zeros((count, 1))
    last[-1] = 1.0
    return np.asarray(polynomial @ np.linalg.solve(rows, last), dtype=np.float64)
