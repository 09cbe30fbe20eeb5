"""Process noise: a disturbance of a state explains colored residuals (Ljung 1999, section 4.3).

Residual r_k = C x_k + v_k, x_{k+1} = E x_k + K v_k, with the stationary Kalman gain K of white noise in one state. Its
innovations v compete with those of autoregressions by BIC.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, Result
from fmuid.identification.directed_tests import is_colored
from fmuid.identification.linearized_record import DiscreteStateSpace, LinearizedRecord
from fmuid.identification.model_errors import ProcessNoise
from fmuid.simulation import AnySimulator, Simulator


@dataclass(frozen=True)
class ProcessNoiseSettings:
    """Numbers of the search for process noise."""

    ratios: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # to the variance of the sensors' noise
    orders: int = 6  # of autoregressions
    better: float = 4.0  # of −2 ln L; alternatives of directed tests are as close
    floor: float = 1e-9  # of the disturbance in all states: the gain is unique
    doublings: int = 12  # of the samples after an impulse
    least_seen: float = 1e-12  # of the outputs' squares; less is a state that they do not show


SETTINGS = ProcessNoiseSettings()


def _observable(space: DiscreteStateSpace, spread: Floats) -> tuple[DiscreteStateSpace, Floats]:
    """Return the space that outputs show, and mean squares of outputs.

    Outputs are in units of their spread (n_y,); squares (n_x,) are those after unit rates.
    """
    e, c = space.transition, space.observed / spread[:, None]
    gramian, power = c.T @ c, e
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(SETTINGS.doublings):
            gramian = gramian + power.T @ gramian @ power
            power = power @ power
    if not np.isfinite(gramian).all():  # unstable
        return space, np.zeros(len(e))
    sizes, vectors = np.linalg.eigh(gramian)
    seen = vectors[:, sizes > SETTINGS.least_seen * sizes.max()]
    squares = np.einsum("ij,ik,kj->j", space.by_rate, gramian, space.by_rate) / len(c)
    return DiscreteStateSpace(seen.T @ e @ seen, seen.T @ space.by_rate, c @ seen), squares


def _gains(space: DiscreteStateSpace, state: int, square: float) -> Iterator[Floats]:
    """Yield the Kalman gain (n_x, n_y) of each ratio."""
    e, c, g = space.transition, space.observed, space.by_rate[:, state]
    for ratio in SETTINGS.ratios:
        variance = ratio / square * np.outer(g, g)
        variance += SETTINGS.floor * np.trace(variance) * np.eye(len(e))
        p = scipy.linalg.solve_discrete_are(e.T, c.T, variance, np.eye(len(c)))
        yield np.asarray(np.linalg.solve(c @ p @ c.T + np.eye(len(c)), c @ p @ e.T).T)


def process_noise_of(problem: LeastSquares, simulators: Sequence[AnySimulator], result: Result) -> ProcessNoise | None:
    """Return the process noise of a result.

    None without color, where phases rotate, outputs of experiments differ, or the model shows no derivatives.
    """
    local, noise, records = result.fit.linearization, result.fit.noise, []
    assert local is not None and noise is not None, "a result from a file has neither"
    if not is_colored(noise) or len({each.output_names for each in problem.experiments}) > 1:
        return None
    for index, simulator in enumerate(simulators):
        if not isinstance(simulator, Simulator) or simulator.observed is not None:
            return None
        theta = result.values[problem.parameters.for_experiment(index)[1]]
        record = LinearizedRecord.of(simulator.model_at(theta), theta)
        if record is None:
            return None
        records.append(record)
    residuals = problem.tables(problem.unscaled(local.residual * local.levels))
    return find_process_noise(records[0].states, [each.state_space for each in records], residuals)


def find_process_noise(
    states: Sequence[str], spaces: Sequence[DiscreteStateSpace], residuals: Sequence[Floats]
) -> ProcessNoise | None:
    """Return the disturbance that explains residuals better than autoregressions; None without one.

    Residuals (K, n_y) of each experiment are NaN where a sample does not count.
    """
    whole = np.concatenate(list(residuals))
    counted, spread = np.isfinite(whole).all(axis=1), np.sqrt(np.nanmean(whole**2, axis=0))
    rows = [np.nan_to_num(each / spread) for each in residuals]
    best = min(_autoregressions(rows, counted)) - SETTINGS.better
    seen = [_observable(each, spread) for each in spaces]
    named, gains = [], []
    for j, name in enumerate(states):
        if not all(squares[j] > 0.0 for _, squares in seen):
            continue
        try:
            gains.append([np.stack([*_gains(space, j, squares[j])]) for space, squares in seen])
        except np.linalg.LinAlgError:  # no stationary gain
            continue
        named.append(name)
    if not named:
        return None
    parts = [
        _innovations(space, np.concatenate(own), table)
        for (space, _), own, table in zip(seen, zip(*gains, strict=True), rows, strict=True)
    ]
    values = _bic(np.concatenate(parts, axis=1)[:, counted], 1).reshape(len(named), -1)
    ratios = [SETTINGS.ratios[k] for k in values.argmin(axis=1)]
    least = zip(values.min(axis=1).tolist(), named, ratios, strict=True)
    likely = sorted(each for each in least if each[0] < best)
    if not likely:
        return None
    names = tuple(name for value, name, _ in likely if value < likely[0][0] + SETTINGS.better)
    return ProcessNoise(names, likely[0][2] / (1.0 + likely[0][2]))


def _innovations(space: DiscreteStateSpace, gains: Floats, rows: Floats) -> Floats:
    """Return the innovations (m, K, n_y) of gains (m, n_x, n_y)."""
    c = space.observed
    closed, driven = space.transition - gains @ c, np.moveaxis(gains @ rows.T, 2, 0)
    x = np.zeros((len(rows), len(gains), len(c.T)))
    for k in range(len(rows) - 1):
        x[k + 1] = np.matmul(closed, x[k, :, :, None])[:, :, 0] + driven[k]
    return np.asarray(np.moveaxis(rows[:, None] - x @ c.T, 1, 0))


def _autoregressions(rows: Sequence[Floats], counted: Floats) -> Iterator[float]:
    """Yield BIC of each order."""
    lags = [np.concatenate([_late(each, i) for each in rows])[counted] for i in range(SETTINGS.orders + 1)]
    for order in range(SETTINGS.orders + 1):
        left = np.array(lags[0])
        for j in range(left.shape[1]):
            own = np.stack([lags[i][:, j] for i in range(1, order + 1)], axis=1) if order else np.zeros((len(left), 1))
            left[:, j] -= own @ np.linalg.lstsq(own, left[:, j], rcond=None)[0]
        yield float(_bic(left[None], order * left.shape[1])[0])


def _late(rows: Floats, lag: int) -> Floats:
    return np.vstack([np.zeros((lag, rows.shape[1])), rows[: len(rows) - lag]])


def _bic(innovations: Floats, count: int) -> Floats:
    """Return BIC (m,) of innovations (m, n, n_y)."""
    n = innovations.shape[1]
    return np.asarray(n * np.linalg.slogdet(np.moveaxis(innovations, 1, 2) @ innovations / n)[1] + count * np.log(n))
