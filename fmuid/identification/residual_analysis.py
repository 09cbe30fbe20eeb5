"""Residual analysis: whiteness, correlation with inputs, distribution, colored noise (Ljung 1999, section 16.6).

Parameters can compensate a model error: then no test finds it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import FitProjection, LeastSquares, NoiseModel, ResidualNoise, Result, evened
from fmuid.identification.residual_series import InputCorrelation, ResidualSeries, examine_outputs

CORRELATIONS = ("experiment", "output", "with", "lag", "time", "correlation", "band")
RESIDUAL_LEVEL = 0.01  # significance level of all residuals and inputs together


@dataclass(frozen=True)
class FindingLimits:
    """Limits above which a significant defect matters."""

    large_autocorrelation: float = 0.1
    large_correlation: float = 0.1  # with an input: a hundredth of the residual's variance
    large_offset_stds: float = 0.1  # mean, in standard deviations
    more_likely: float = 0.5  # probability of a periodic error, ...
    least_returning: float = 0.01  # ... and its share of the variance; a little comes by chance
    long_memory: float = 0.2  # time constant of noise, relative to the recording
    noise_ratio: float = 10.0  # standard deviation over noise level: more color than the noise of sensors has


SETTINGS = FindingLimits()
LEAST_STD_FACTOR = 1.25  # of σ for colored noise; smaller ones are not worth a message


class ResidualDefect(Enum):
    """Difference of a residual from white normal noise."""

    COLORED = "colored"  # an autocorrelation
    OFFSET = "offset"  # a mean
    INPUT = "input"  # a correlation with an input
    SHAPE = "shape"  # another distribution than the normal one


@dataclass(frozen=True, eq=False)
class ResidualFinding:
    """Significant defect of a residual.

    Attributes
    ----------
    trait : ResidualDefect
    large : bool
        Large enough to matter.
    series : ResidualSeries
    input : InputCorrelation or None
        Of a correlation with an input.
    """

    trait: ResidualDefect
    large: bool
    series: ResidualSeries
    input: InputCorrelation | None = None

    json_layout: ClassVar = Layout(omitted={"series", "input"}, derived=("experiment", "output", "input_name"))

    @property
    def experiment(self) -> str:
        """Of the residual."""
        return self.series.experiment

    @property
    def output(self) -> str:
        """Of the residual."""
        return self.series.output

    @property
    def input_name(self) -> str:
        """The input that it is correlated with, "" for none."""
        return "" if self.input is None else self.input.input


def _findings(series: ResidualSeries, outputs: int, inputs: int) -> Iterator[ResidualFinding]:
    """Yield the significant defects of one residual among all."""
    level = RESIDUAL_LEVEL / outputs
    if series.whiteness.probability <= level:
        large = abs(series.whiteness.strongest[1]) >= SETTINGS.large_autocorrelation
        yield ResidualFinding(ResidualDefect.COLORED, large, series)
    if series.mean_probability < level:
        large = abs(series.mean) > SETTINGS.large_offset_stds * series.std
        yield ResidualFinding(ResidualDefect.OFFSET, large, series)
    for each in series.inputs:
        if each.probability < RESIDUAL_LEVEL / inputs:
            large = abs(each.correlation) > SETTINGS.large_correlation
            yield ResidualFinding(ResidualDefect.INPUT, large, series, each)
    if series.normality.probability < level:
        yield ResidualFinding(ResidualDefect.SHAPE, series.is_abnormal, series)


@dataclass(frozen=True)
class LowFrequencyNoiseFinding:
    """Low-frequency noise too weak for other tests."""

    output: str
    experiments: tuple[str, ...]  # with one model of this noise
    time_constant: float  # s
    share: float  # of the residual's variance


@dataclass(frozen=True)
class LongMemory:
    """Noise with a time constant that is long for its recordings."""

    output: str
    experiments: tuple[str, ...]  # with one model of this noise
    time_constant: float  # s
    record: float  # length of the longest recording, s


def _slow(noise: ResidualNoise) -> tuple[tuple[LowFrequencyNoiseFinding, ...], tuple[LongMemory, ...]]:
    """Return the low-frequency noise and the long memory of each noise process."""
    pools: dict[int, list[NoiseModel]] = {}
    for model in noise.models:
        pools.setdefault(model.series.pool, []).append(model)
    slow, long = [], []
    for members in pools.values():
        first, process, constant = members[0].series, members[0].process, members[0].time_constant
        names = tuple(dict.fromkeys(each.series.experiment for each in members))
        record = first.step * (1 + max(int(each.series.places[-1]) for each in members))
        if process.pole:
            decay = -first.step / math.log(process.pole)
            slow.append(LowFrequencyNoiseFinding(first.output, names, decay, process.slow_share))
        if constant > SETTINGS.long_memory * record:
            long.append(LongMemory(first.output, names, min(constant, record), record))
    return tuple(slow), tuple(long)


@dataclass(frozen=True)
class PeriodicErrorFinding:
    """Periodic model error in a residual (`fmuid.estimation.noise.periodic_error`)."""

    output: str
    experiment: str
    period: float  # of the inputs, s
    share: float  # of the residual's variance


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """Analysis of all residuals of a result.

    Attributes
    ----------
    series : tuple of ResidualSeries
        By experiment and output.
    widening : dict of str to float
        Factor of each parameter's σ for colored noise; NaN without σ.
    off_grid : tuple of (str, str)
        Experiments and outputs with unequal sampling intervals, treated as equal.
    slow : tuple of LowFrequencyNoiseFinding
    returning : tuple of PeriodicErrorFinding
        More likely there than not; σ allows for it.
    long_memory : tuple of LongMemory
    noise_ratio : float
        Largest standard deviation over the noise level of the data.
    """

    series: tuple[ResidualSeries, ...]
    widening: dict[str, float]
    off_grid: tuple[tuple[str, str], ...] = ()
    slow: tuple[LowFrequencyNoiseFinding, ...] = ()
    returning: tuple[PeriodicErrorFinding, ...] = ()
    long_memory: tuple[LongMemory, ...] = ()
    noise_ratio: float = math.nan

    json_layout: ClassVar = Layout(derived=("findings",))

    @property
    def findings(self) -> tuple[ResidualFinding, ...]:
        """All significant defects, by residual."""
        inputs = sum(len(each.inputs) for each in self.series)
        return tuple(found for each in self.series for found in _findings(each, len(self.series), inputs))

    @property
    def table(self) -> pd.DataFrame:
        """One row a residual, with the most significant input; times in s."""
        return pd.DataFrame([each.row() for each in self.series])

    @property
    def correlations(self) -> pd.DataFrame:
        """One row a residual, input or output, and lag.

        Columns experiment, output, with, lag (samples by which the other comes before), time (s), correlation, and
        band (half of the 95 % range).
        """
        parts = []
        for each in self.series:
            lags, step = np.arange(1, each.whiteness.autocorrelation.size), each.noise.series.step
            own = (each.output, lags, lags * step, each.whiteness.autocorrelation[1:], each.whiteness.band)
            others = [(one.input, one.lags / step, one.lags, one.values, one.band) for one in each.inputs]
            for name, places, times, values, band in (own, *others) if each.is_tested else ():
                columns = (each.experiment, each.output, name, np.rint(places), times, values, band)
                parts.append(pd.DataFrame(dict(zip(CORRELATIONS, columns, strict=True))))
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=CORRELATIONS)


@single_threaded
def analyze_residuals(problem: LeastSquares, result: Result) -> ResidualAnalysis:
    """Analyze the residuals of a result, without simulations.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of this problem.

    Raises
    ------
    InputError
        If the result was read from a file, which has no residuals.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> fmuid.analyze_residuals(problem, result).table["output"].tolist()
    ['i']
    """
    noise, local = result.fit.noise, result.fit.linearization
    if noise is None or local is None:
        raise InputError("a result from a file lacks the residuals. Identify the study again.")
    series: list[ResidualSeries] = []
    columns = local.jacobian @ local.root
    taken = FitProjection(columns, columns.T @ columns)
    even = None if problem.levels.scale is None else local.residual
    if noise.levels is not None:
        even = evened(local.residual, local.data_basis, noise.levels)[0]
    for experiment, fit in zip(problem.experiments, result.fit.frames, strict=True):
        simulated = fit[[f"simulated.{output}" for output in experiment.output_names]].to_numpy(np.float64)
        models = [each for each in noise.models if each.series.experiment == experiment.name]
        series += examine_outputs(experiment, simulated, models, taken, even)
    off_grid = tuple((each.series.experiment, each.series.output) for each in noise.models if not each.series.regular)
    widening = dict(zip(result.names, result.estimates.colored_noise_factor.tolist(), strict=True))
    shares: dict[tuple[str, str, float], float] = {}
    for found in noise.returning:
        for own, share in zip(found.series, found.shares.tolist(), strict=True):
            if found.probability > SETTINGS.more_likely and share > SETTINGS.least_returning:
                key = (own.output, own.experiment, found.period * own.step)
                shares[key] = min(shares.get(key, 0.0) + share, 1.0)
    returning = tuple(PeriodicErrorFinding(*key, share) for key, share in shares.items())
    slow, long = _slow(noise)
    ratio = problem.noise_ratio(result.fit.noise_variance)
    return ResidualAnalysis(tuple(series), widening, off_grid, slow, returning, long, ratio)
