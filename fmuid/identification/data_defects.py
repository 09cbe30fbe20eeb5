"""Defects of recorded outputs: coarse steps, clipping, repeated samples, uneven noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeVar

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, NoiseModel, Result

AnyProblem = TypeVar("AnyProblem", bound=LeastSquares)


@dataclass(frozen=True)
class DataDefectSettings:
    """Limits of the defects."""

    coarse: float = 2.0  # residual stds of a step of the converter: finer ones are noise of their own
    grid_error: float = 0.02  # of a step, within which values are its multiples
    most_levels: float = 0.5  # of the samples: with more different values there is no step
    near_limit: float = 3.0  # residual stds: samples of a model so near a clipped end do not count
    clipped_samples: int = 5  # at the end of the range; with steps only where the model goes beyond it
    repeated: float = 0.1  # of the samples that repeat the one before, without a step
    least_samples: int = 50


SETTINGS = DataDefectSettings()


class DefectKind(Enum):
    """Kind of a defect; ``kind`` in ``result.json``."""

    QUANTIZED = "quantized"
    CLIPPED = "clipped"
    EXCLUDED = "excluded"  # clipped stretches do not count
    REPEATED = "repeated"
    UNEVEN = "uneven"  # the noise variance follows the signal, its slope or the time: σ allows for it

    @property
    def is_doubt(self) -> bool:
        """True if estimates or intervals may be wrong."""
        return self not in (DefectKind.UNEVEN, DefectKind.EXCLUDED)


@dataclass(frozen=True)
class DataDefect:
    """Defect of a recorded output.

    Attributes
    ----------
    kind : DefectKind
    output, experiment : str
    values : mapping of str to float
        ``ratio`` of step to residual std; ``limit`` and ``samples``; ``share``; ``factor`` of std, 95 to 5 %.
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
            found += list(
                _defects(model, measured, own, None if noise.levels is None else noise.levels[model.series.rows])
            )
    return tuple(found)


def _defects(model: NoiseModel, measured: Floats, simulated: Floats, levels: Floats | None) -> Iterator[DataDefect]:
    names, std = (model.series.output, model.series.experiment), float(np.std(measured - simulated))
    step = converter_step(measured)
    if step > SETTINGS.coarse * std:
        yield DataDefect(DefectKind.QUANTIZED, *names, {"ratio": step / std})
    for limit, sign in ((float(measured.max()), 1.0), (float(measured.min()), -1.0)):
        at = measured == limit
        # without steps no two samples are alike by chance
        beyond = not step or sign * float((simulated[at] - limit).mean()) > 0.5 * step
        if at.sum() >= SETTINGS.clipped_samples and beyond:
            yield DataDefect(DefectKind.CLIPPED, *names, {"limit": limit, "samples": float(at.sum())})
    inside = (measured[1:] < measured.max()) & (measured[1:] > measured.min())
    share = float(np.mean((np.diff(measured) == 0.0) & inside))
    if not step and share > SETTINGS.repeated:
        yield DataDefect(DefectKind.REPEATED, *names, {"share": share})
    if levels is not None and np.ptp(levels) > 0.0:
        low, high = np.quantile(levels, (0.05, 0.95))
        yield DataDefect(DefectKind.UNEVEN, *names, {"factor": float(high / low)})


def converter_step(values: Floats) -> float:
    """Return the step of which all values are multiples, 0 without one."""
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > SETTINGS.most_levels * len(values):
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.ptp(levels)]
    multiples = steps / steps.min()
    return float(steps.min()) if np.abs(multiples - np.rint(multiples)).max() < SETTINGS.grid_error else 0.0


def without_clipped(problem: AnyProblem, result: Result) -> tuple[AnyProblem, tuple[DataDefect, ...]] | None:
    """Return the problem without clipped stretches, with what was excluded; None without any.

    Samples go where the model is near the limit: their noise alone must not decide.
    """
    clipped = [each for each in find_data_defects(problem, result) if each.kind is DefectKind.CLIPPED]
    if not clipped:
        return None
    experiments, excluded = list(problem.experiments), []
    for each in clipped:
        k = [one.name for one in experiments].index(each.experiment)
        experiment, limit = experiments[k], each.values["limit"]
        j = experiment.output_names.index(each.output)
        near = SETTINGS.near_limit * math.sqrt(result.fit.noise_variance[each.output])
        sign = 1.0 if limit == np.nanmax(problem.experiments[k].output_values[:, j]) else -1.0
        beyond = (sign * (result.fit.simulated[k][:, j] - limit) > -near) & experiment.counted[:, j]
        values = experiment.output_values[:, j].copy()
        values[beyond] = np.nan
        experiments[k] = replace(experiment, frame=experiment.frame.assign(**{experiment.columns[each.output]: values}))
        excluded.append(
            replace(each, kind=DefectKind.EXCLUDED, values={"limit": limit, "samples": float(beyond.sum())})
        )
    return problem.measuring(experiments), tuple(excluded)
