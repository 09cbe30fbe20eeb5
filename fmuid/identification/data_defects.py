"""Defects of recorded outputs: coarse steps, clipping, repeated samples, hum, uneven noise, doubtful rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeVar

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, NoiseModel, Result, spectral_lines
from fmuid.identification.outlying_rows import find_outlying_rows, repeated_shares

AnyProblem = TypeVar("AnyProblem", bound=LeastSquares)


@dataclass(frozen=True)
class DataDefectSettings:
    """Limits of the defects."""

    coarse: float = 2.0  # residual stds of a step of the converter: finer ones are noise of their own
    grid_error: float = 0.02  # of a step, within which values are its multiples
    most_levels: float = 0.5  # of the samples: with more different values there is no step
    near_limit: float = 3.0  # residual stds: samples of a model so near a clipped end do not count
    clipped_samples: int = 5  # at the end of the range; with steps only where the model goes beyond it
    same: float = 1e-6  # of the range: a simulated sample at the end
    uneven: float = 2.0  # ratio of noise levels of few rows: closer ones are next to constant
    repeated: float = 0.1  # of the samples that repeat the one before, without a step
    least_samples: int = 50


SETTINGS = DataDefectSettings()


class DefectKind(Enum):
    """Kind of a defect; ``kind`` in ``result.json``."""

    QUANTIZED = "quantized"
    CLIPPED = "clipped"
    EXCLUDED = "excluded"  # clipped stretches do not count
    REPEATED = "repeated"
    HUM = "hum"  # a line of the residual: σ allows for it
    OUTLYING = "outlying"  # rows without a time that the model does not reach
    TWICE = "twice"  # such rows that stand twice, to the last digit
    SEVERAL = "several"  # stable steady states of a row at the estimates
    EVENT = "event"  # at the steady state of a row
    CONJUGATE = "conjugate"  # the imaginary part of a response has the reversed sign
    SIGN = "sign"  # a signal or a response has the reversed sign
    RADIANS = "radians"  # phases of a response are in radians
    LINE_VOLTAGE = "line_voltage"  # the voltage of a supply is that between lines
    PHASE_VOLTAGE = "phase_voltage"  # ... or that of a phase
    UNEVEN = "uneven"  # the noise variance follows the signal, its slope or the time: σ allows for it
    EITHER = "either"  # few rows: the noise may be constant or follow the signal, σ allows for both

    @property
    def is_doubt(self) -> bool:
        """True if estimates or intervals may be wrong."""
        return self not in (DefectKind.UNEVEN, DefectKind.EITHER, DefectKind.EXCLUDED, DefectKind.HUM)

    @property
    def explains_misfit(self) -> bool:
        """True if the data fit once this is corrected."""
        signs, voltages = (DefectKind.CONJUGATE, DefectKind.SIGN), (DefectKind.LINE_VOLTAGE, DefectKind.PHASE_VOLTAGE)
        return self in (*signs, DefectKind.RADIANS, *voltages)


@dataclass(frozen=True)
class DataDefect:
    """Defect of a recorded output.

    Attributes
    ----------
    kind : DefectKind
    output, experiment : str
    values : mapping of str to float
        ``ratio`` of step to residual std; ``limit`` and ``samples``; ``share``; worst ``row``, its ``size`` in σ and
        number of ``rows``; ``factor`` of std, 95 to 5 %; ``frequency``, Hz; ``fit``, %, after the remedy.
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
    found = list(_of_rows(problem, result))
    doubted = {each.experiment for each in found}  # rows that tell nothing of the noise
    for model in noise.models:
        index = [each.name for each in problem.experiments].index(model.series.experiment)
        experiment, simulated = problem.experiments[index], result.fit.simulated[index]
        column = experiment.output_names.index(model.series.output)
        counted = experiment.counted[:, column]
        measured, own = experiment.output_values[counted, column], simulated[counted, column]
        if len(measured) >= SETTINGS.least_samples and np.isfinite(own).all() and np.std(measured - own) > 0.0:
            found += _defects(model, measured, own)
        if noise.levels is not None and model.series.experiment not in doubted:
            found += _uneven(model, noise.levels[model.series.rows])
    return tuple(found)


def _of_rows(problem: LeastSquares, result: Result) -> Iterator[DataDefect]:
    """Yield defects of rows without a time."""
    for each in find_outlying_rows(problem, result):
        values = {"row": each.rows[0] + 1.0, "rows": float(len(each.rows)), "size": each.size}
        yield DataDefect(DefectKind.OUTLYING, each.output, each.experiment, values)
    for name, share in repeated_shares(problem).items():
        yield DataDefect(DefectKind.TWICE, "", name, {"share": share})
    for name, (row, issue) in problem.doubtful_rows(result).items():
        yield DataDefect(DefectKind(issue), "", name, {"row": row + 1.0})
    for kind, output, name, fit in problem.other_conventions(result):
        yield DataDefect(DefectKind(kind), output, name, {"fit": fit})


def _defects(model: NoiseModel, measured: Floats, simulated: Floats) -> Iterator[DataDefect]:
    names, std = (model.series.output, model.series.experiment), float(np.std(measured - simulated))
    step = converter_step(measured)
    if step > SETTINGS.coarse * std:
        yield DataDefect(DefectKind.QUANTIZED, *names, {"ratio": step / std})
    for limit, _ in clipped_ends(measured, simulated) if model.series.ordered else ():
        samples = float((measured == limit).sum())
        yield DataDefect(DefectKind.CLIPPED, *names, {"limit": limit, "samples": samples})
    inside = (measured[1:] < measured.max()) & (measured[1:] > measured.min())
    moving = np.diff(simulated) != 0.0  # at rest without noise all samples are alike
    share = float(np.mean((np.diff(measured) == 0.0) & inside & moving))
    if model.series.ordered and not step and share > SETTINGS.repeated:
        yield DataDefect(DefectKind.REPEATED, *names, {"share": share})
    for frequency in spectral_lines(model.series, measured - simulated, measured).tolist():
        yield DataDefect(DefectKind.HUM, *names, {"frequency": frequency})


def _uneven(model: NoiseModel, levels: Floats) -> Iterator[DataDefect]:
    low, high = np.quantile(levels, (0.05, 0.95))
    is_few = len(levels) < SETTINGS.least_samples
    if high > (SETTINGS.uneven if is_few else 1.0) * low:
        kind = DefectKind.EITHER if is_few else DefectKind.UNEVEN
        yield DataDefect(kind, model.series.output, model.series.experiment, {"factor": float(high / low)})


def converter_step(values: Floats) -> float:
    """Return the step of which all values are multiples, 0 without one."""
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > SETTINGS.most_levels * len(values):
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.ptp(levels)]
    multiples = steps / steps.min()
    return float(steps.min()) if np.abs(multiples - np.rint(multiples)).max() < SETTINGS.grid_error else 0.0


def clipped_ends(measured: Floats, simulated: Floats) -> list[tuple[float, float]]:
    """Return clipped ends of the range, and their signs, of samples (n,); not those that the model has, too."""
    step, found = converter_step(measured), []
    for limit, sign in ((float(measured.max()), 1.0), (float(measured.min()), -1.0)):
        at = measured == limit
        modeled = np.isclose(simulated, limit, rtol=0.0, atol=SETTINGS.same * np.ptp(measured))
        # without steps no two samples are alike by chance
        beyond = not step or sign * float((simulated[at] - limit).mean()) > 0.5 * step
        if at.sum() >= SETTINGS.clipped_samples and beyond and modeled.sum() < at.sum() // 2:
            found.append((limit, sign))
    return found


def without_clipped(problem: AnyProblem, result: Result) -> tuple[AnyProblem, tuple[DataDefect, ...]] | None:
    """Return the problem without clipped stretches, with what was excluded; None without any.

    Samples go where the model is near the limit: their noise alone must not decide.
    """
    experiments, excluded = [], list[DataDefect]()
    for experiment, simulated in zip(problem.experiments, result.fit.simulated, strict=True):
        frame = experiment.frame
        for j, output in enumerate(experiment.output_names):
            values, own, counted = experiment.output_values[:, j], simulated[:, j], experiment.counted[:, j]
            if experiment.kind != "time" or counted.sum() < SETTINGS.least_samples:
                continue
            near = SETTINGS.near_limit * math.sqrt(result.fit.noise_variance[output])
            gone = np.zeros(len(own), np.bool_)
            for limit, sign in clipped_ends(values[counted], own[counted]):
                beyond = (sign * (own - limit) > -near) & counted
                gone |= beyond
                found = {"limit": limit, "samples": float(beyond.sum())}
                excluded.append(DataDefect(DefectKind.EXCLUDED, output, experiment.name, found))
            if gone.any():
                frame = frame.assign(**{experiment.columns[output]: np.where(gone, np.nan, values)})
        experiments.append(experiment if frame is experiment.frame else replace(experiment, frame=frame))
    return (problem.measuring(experiments), tuple(excluded)) if excluded else None
