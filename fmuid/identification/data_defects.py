"""Defects of recorded outputs: coarse steps, clipping, repeated samples, uneven noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, NoiseModel, Result
from fmuid.identification.directed_tests import largest_scores, probability_of
from fmuid.identification.model_errors import LEVEL


@dataclass(frozen=True)
class DataDefectSettings:
    """Limits of the defects."""

    coarse: float = 2.0  # residual stds of a step of the converter: finer ones are noise of their own
    grid_error: float = 0.02  # of a step, within which values are its multiples
    most_levels: float = 0.5  # of the samples: with more different values there is no step
    clipped_samples: int = 5  # at the end of the range, where the model goes beyond it
    repeated: float = 0.1  # of the samples that repeat the one before, without a step
    least_samples: int = 50


SETTINGS = DataDefectSettings()


class DefectKind(Enum):
    """Kind of a defect; ``kind`` in ``result.json``."""

    QUANTIZED = "quantized"
    CLIPPED = "clipped"
    REPEATED = "repeated"
    UNEVEN = "uneven"  # the noise variance follows the signal, its slope or the time


@dataclass(frozen=True)
class DataDefect:
    """Defect of a recorded output.

    Attributes
    ----------
    kind : DefectKind
    output, experiment : str
    values : mapping of str to float
        ``ratio`` of step to residual std; ``limit`` and ``samples``; ``share``; ``factor`` of largest to least std.
    """

    kind: DefectKind
    output: str
    experiment: str
    values: Mapping[str, float] = field(default_factory=dict)


def find_data_defects(problem: LeastSquares, result: Result) -> tuple[DataDefect, ...]:
    """Return the defects of all measured outputs of a result."""
    noise = result.fit.noise
    if noise is None:
        return ()
    found = []
    for model in noise.models:
        index = [each.name for each in problem.experiments].index(model.series.experiment)
        experiment, simulated = problem.experiments[index], result.fit.simulated[index]
        column = experiment.output_names.index(model.series.output)
        counted = experiment.counted[:, column]
        measured, own = experiment.output_values[counted, column], simulated[counted, column]
        if len(measured) >= SETTINGS.least_samples and np.isfinite(own).all() and np.std(measured - own) > 0.0:
            found += list(_defects(model, measured, own, len(noise.models)))
    return tuple(found)


def _defects(model: NoiseModel, measured: Floats, simulated: Floats, outputs: int) -> Iterator[DataDefect]:
    names, std = (model.series.output, model.series.experiment), float(np.std(measured - simulated))
    step = converter_step(measured)
    if step > SETTINGS.coarse * std:
        yield DataDefect(DefectKind.QUANTIZED, *names, {"ratio": step / std})
    for limit, sign in ((float(measured.max()), 1.0), (float(measured.min()), -1.0)):
        at = measured == limit
        beyond = sign * (simulated[at] - limit)
        if at.sum() >= SETTINGS.clipped_samples and beyond.mean() > 0.0:
            yield DataDefect(DefectKind.CLIPPED, *names, {"limit": limit, "samples": float(at.sum())})
    share = float(np.mean(np.diff(measured) == 0.0))
    if not step and share > SETTINGS.repeated:
        yield DataDefect(DefectKind.REPEATED, *names, {"share": share})
    factor = uneven_noise(model.whiten(measured - simulated), simulated, outputs)
    if factor:
        yield DataDefect(DefectKind.UNEVEN, *names, {"factor": factor})


def converter_step(values: Floats) -> float:
    """Return the step of which all values are multiples, 0 without one."""
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > SETTINGS.most_levels * len(values):
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.ptp(levels)]
    multiples = steps / steps.min()
    return float(steps.min()) if np.abs(multiples - np.rint(multiples)).max() < SETTINGS.grid_error else 0.0


def uneven_noise(innovations: Floats, simulated: Floats, outputs: int = 1) -> float:
    """Return the ratio of largest to least noise std, 0 without pattern.

    Koenker's test (J. Econometrics 17, 1981) of squared innovations (n,) against signal², slope² and time.
    """
    squares = innovations**2
    signals = [simulated**2, np.gradient(simulated) ** 2, np.arange(len(simulated), dtype=np.float64)]
    columns = [each - each.mean() for each in signals if np.ptp(each) > 0.0]
    if not columns or not squares.any():
        return 0.0
    unit = np.stack([each / np.linalg.norm(each) for each in columns], axis=1)
    centered = squares - squares.mean()
    scores = unit.T @ centered / math.sqrt(float(np.mean(centered**2)))
    i = int(np.argmax(np.abs(scores)))
    if probability_of(largest_scores(unit.T @ unit), abs(float(scores[i]))) > LEVEL / outputs:
        return 0.0
    order = np.argsort(unit[:, i])
    tenth = max(1, len(order) // 10)
    low, high = float(squares[order[:tenth]].mean()), float(squares[order[-tenth:]].mean())
    return math.sqrt(max(low, high) / max(min(low, high), 1e-12))
