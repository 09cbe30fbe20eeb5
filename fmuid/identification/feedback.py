"""Test for feedback: inputs that follow the noise of outputs (docs/method/directed-tests.md).

An input is predicted from its own past and that of the other inputs. In open loop, innovations of the residual predict
it no better (Caines and Chan, IEEE Trans. Autom. Control 20, 1975). Large model errors tell the time since the last
step of an input, and so the next of regular steps: they are freed first, and only samples where the input moves count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.estimation import LeastSquares
from fmuid.identification.model_errors import Feedback


@dataclass(frozen=True)
class FeedbackSettings:
    """Numbers of the test."""

    level: float = 1e-3  # beside the directed tests at 1 %
    inputs: int = 20  # past samples of the inputs
    residuals: int = 5  # past samples of the residual
    rows: int = 5  # samples a coefficient
    predictable: float = 1e-10  # share of an input's variance: less is rounding


SETTINGS = FeedbackSettings()


def find_feedback(problem: LeastSquares, innovations: Floats) -> Feedback | None:
    """Return the input that follows innovations (n,) most, or None."""
    found = [
        each
        for experiment, table in zip(problem.experiments, problem.tables(innovations), strict=True)
        if experiment.kind == "time"
        for each in _tests(experiment, np.nan_to_num(table))
    ]
    strongest = min(found, key=lambda each: each.probability, default=None)
    if strongest is None or strongest.probability * len(found) > SETTINGS.level:
        return None
    return strongest


def _tests(experiment: Experiment, residual: Floats) -> Iterator[Feedback]:
    """Yield the test of each input; a held input may follow the residual of the same sample."""
    values, lags = experiment.input_values, SETTINGS.inputs
    moving = np.flatnonzero(np.ptp(values, axis=0) > 0.0).tolist()
    least = SETTINGS.rows * (1 + lags * len(moving) + (SETTINGS.residuals + 1) * residual.shape[1])
    if len(values) - lags < least:
        return
    inputs = values[:, moving] - values[:, moving].mean(axis=0)
    inputs /= np.abs(inputs).max(axis=0)
    own = np.hstack([np.ones((len(values) - lags, 1)), *(inputs[lags - k : -k] for k in range(1, lags + 1))])
    for column, j in enumerate(moving):
        moves = np.diff(inputs[lags - 1 :, column]) != 0.0
        if (count := int(moves.sum())) < least:
            continue
        first = 0 if experiment.held[j] else 1
        past = [residual[lags - k : len(values) - k] for k in range(first, SETTINGS.residuals + 1)]
        rows, basis = np.column_stack([inputs[lags:, column], *past])[moves], np.linalg.qr(own[moves])[0]
        scale = float(np.sum(rows[:, 0] ** 2))
        rows -= basis @ (basis.T @ rows)
        left = rows[:, 0]
        if left @ left <= SETTINGS.predictable * scale:
            continue
        explained = float(np.sum((np.linalg.qr(rows[:, 1:])[0].T @ left) ** 2))
        more, free = rows.shape[1] - 1, count - own.shape[1] - rows.shape[1] + 1
        ratio = (explained / more) / (float(left @ left - explained) / free)
        yield Feedback(experiment.input_names[j], experiment.name, float(special.fdtrc(more, free, ratio)))
