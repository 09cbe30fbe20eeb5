"""What the residuals say of the model and of the stated uncertainty: whiteness, inputs, distribution.

Output errors are unbiased whatever the colour of the noise (1.29), and their covariance allows for it
(`fmuid.estimation.noise.sandwich`): `ResidualAnalysis.widening` says by how much, parameter by parameter. Where the
residual is an error of the model that comes back with every cycle of the experiment, that is rather too little.

With thousands of samples the slightest imperfection is significant: findings tell what is unlikely by chance and large
enough to matter from what is significant but slight. An error of the model that its parameters make up for leaves a
residual in which no test finds anything.

References
----------
L. Ljung, "System Identification: Theory for the User", 2nd ed., 1999, section 16.6 (residual analysis); and
those of `fmuid.estimation.noise.whiteness_tests`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import FitProjection, LeastSquares, NoiseModel, ResidualNoise, Result
from fmuid.identification.residual_series import InputCorrelation, ResidualSeries, examine_outputs

CORRELATIONS = ("experiment", "output", "with", "lag", "time", "correlation", "band")
# What is found is less likely by chance than this, over all residuals and inputs together ...
RESIDUAL_LEVEL = 0.01


@dataclass(frozen=True)
class FindingLimits:
    """What matters in a residual."""

    large_autocorrelation: float = 0.1
    """An autocorrelation this large, ..."""
    large_correlation: float = 0.1
    """... a correlation with an input: it explains a hundredth of the residual's variance, ..."""
    large_offset_stds: float = 0.1
    """... or a mean in standard deviations."""
    more_likely: float = 0.5
    """What returns with each cycle is worth a sentence where it is more likely there than not, ..."""
    least_returning: float = 0.01
    """... and has so much of the residual's variance: by chance it has a little."""
    long_memory: float = 0.2
    """Noise is slow for a record of which its time constant is more than this share."""


SETTINGS = FindingLimits()
# standard deviations that are wider or narrower than those of white noise by this factor,
LEAST_STD_FACTOR = 1.25


class ResidualDefect(Enum):
    """In what a residual differs from white normal noise."""

    COLOURED = "coloured"
    """An autocorrelation."""
    OFFSET = "offset"
    """A mean."""
    INPUT = "input"
    """A correlation with an input."""
    SHAPE = "shape"
    """Another distribution than the normal one."""


@dataclass(frozen=True, eq=False)
class ResidualFinding:
    """Something in a residual that is unlikely by chance.

    Attributes
    ----------
    trait : ResidualDefect
    large : bool
        Whether it is large enough to matter.
    series : ResidualSeries
        Which has the numbers.
    input : InputCorrelation or None
        The correlation, where it is one with an input.
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


def _findings(series: ResidualSeries, outputs: int, inputs: int) -> list[ResidualFinding]:
    """Return what is unlikely by chance in one of so many residuals, which go with so many inputs all together."""
    level, found = RESIDUAL_LEVEL / outputs, []
    if series.whiteness.probability <= level:
        found.append(
            ResidualFinding(
                ResidualDefect.COLOURED, abs(series.whiteness.strongest[1]) >= SETTINGS.large_autocorrelation, series
            )
        )
    if series.mean_probability < level:
        found.append(
            ResidualFinding(ResidualDefect.OFFSET, abs(series.mean) > SETTINGS.large_offset_stds * series.std, series)
        )
    for each in series.inputs:
        if each.probability < RESIDUAL_LEVEL / inputs:
            found.append(
                ResidualFinding(ResidualDefect.INPUT, abs(each.correlation) > SETTINGS.large_correlation, series, each)
            )
    if series.normality.probability < level:
        found.append(ResidualFinding(ResidualDefect.SHAPE, series.is_lopsided or series.is_tailed, series))
    return found


@dataclass(frozen=True)
class NoiseFinding:
    """Noise of an output with a long memory.

    Attributes
    ----------
    output : str
    experiments : tuple of str
        Which share one model of it.
    time_constant : float
        s.
    """

    output: str
    experiments: tuple[str, ...]
    time_constant: float


@dataclass(frozen=True)
class LowFrequencyNoiseFinding(NoiseFinding):
    """Low-frequency noise in a residual (`fmuid.estimation.noise.low_frequency`), too weak for other tests.

    Attributes
    ----------
    share : float
        Of the residual's variance.
    """

    share: float


@dataclass(frozen=True)
class LongMemory(NoiseFinding):
    """Noise so slow that its record hardly tells how slow.

    Attributes
    ----------
    record : float
        How long the longest of the experiments is, s.
    """

    record: float


def _slow(noise: ResidualNoise) -> tuple[tuple[LowFrequencyNoiseFinding, ...], tuple[LongMemory, ...]]:
    """Return the slow noise of each process that has some, and whose memory is long for the record."""
    pools: dict[int, list[NoiseModel]] = {}
    for model in noise.models:
        pools.setdefault(model.series.pool, []).append(model)
    slow, long = [], []
    for members in pools.values():
        first, process = members[0].series, members[0].process
        names = tuple(dict.fromkeys(each.series.experiment for each in members))
        constant = members[0].time_constant
        record = first.step * (1 + max(int(each.series.places[-1]) for each in members))
        if process.pole:
            slow.append(
                LowFrequencyNoiseFinding(first.output, names, -first.step / math.log(process.pole), process.slow_share)
            )
        if constant > SETTINGS.long_memory * record:
            long.append(LongMemory(first.output, names, min(constant, record), record))
    return tuple(slow), tuple(long)


@dataclass(frozen=True)
class PeriodicErrorFinding:
    """What comes back in a residual with each cycle of the excitation (`fmuid.estimation.noise.periodic_error`).

    Attributes
    ----------
    output, experiment : str
    period : float
        Of the inputs, s.
    share : float
        Of the residual's variance.
    """

    output: str
    experiment: str
    period: float
    share: float


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """All residuals of a result.

    Attributes
    ----------
    series : tuple of ResidualSeries
        Experiment by experiment, output by output.
    widening : dict of str to float
        For each parameter, by which factor the colour of the residuals widens its standard deviation; NaN where it has
        none.
    off_grid : tuple of (str, str)
        Experiments and outputs whose samples stand on no grid: the colour of their noise is taken as if they were
        equally spaced.
    slow : tuple of LowFrequencyNoiseFinding
        Where the standard deviations allow for weak slow noise.
    returning : tuple of PeriodicErrorFinding
        Where the standard deviations allow for what comes back with each cycle of the excitation, and it more likely
        does than not.
    long_memory : tuple of LongMemory
        Noise so slow that the record hardly tells how slow.
    """

    series: tuple[ResidualSeries, ...]
    widening: dict[str, float]
    off_grid: tuple[tuple[str, str], ...] = ()
    slow: tuple[LowFrequencyNoiseFinding, ...] = ()
    returning: tuple[PeriodicErrorFinding, ...] = ()
    long_memory: tuple[LongMemory, ...] = ()

    json_layout: ClassVar = Layout(derived=("findings",))

    @property
    def findings(self) -> tuple[ResidualFinding, ...]:
        """All that is unlikely by chance, residual by residual."""
        inputs = sum(len(each.inputs) for each in self.series)
        return tuple(found for each in self.series for found in _findings(each, len(self.series), inputs))

    @property
    def table(self) -> pd.DataFrame:
        """One row a residual; times in s, of the inputs the one whose correlation is least likely by chance."""
        return pd.DataFrame([each.row() for each in self.series])

    @property
    def inputs(self) -> pd.DataFrame:
        """One row for each residual and input: experiment, output, input, lag (s), correlation, band, probability."""
        names = ["input", "lag", "correlation", "band", "probability"]
        rows = [
            {"experiment": each.experiment, "output": each.output, **{name: getattr(one, name) for name in names}}
            for each in self.series
            for one in each.inputs
        ]
        return pd.DataFrame(rows, columns=["experiment", "output", *names])

    @property
    def correlations(self) -> pd.DataFrame:
        """One row for each residual, what it is held against, and lag: what figures show.

        Columns experiment, output, with (the input, or the output itself), lag (samples by which the other comes
        before), time (s), correlation, and band, the half-width of what 95 % of chance lies in.
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
    """Examine the residuals of a result; nothing is simulated.

    Parameters
    ----------
    problem : LeastSquares
        That the result was found for.
    result : Result
        As `fmuid.identify` returns it.

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
    if result.noise is None or result.local is None:
        raise InputError("a result read from a file has no residuals to examine; identify the study again")
    series: list[ResidualSeries] = []
    columns = result.local.jacobian @ result.local.root
    taken = FitProjection(columns, columns.T @ columns)
    for experiment, fit in zip(problem.experiments, result.fit, strict=True):
        simulated = fit[[f"simulated.{output}" for output in experiment.output_names]].to_numpy(np.float64)
        models = [each for each in result.noise.models if each.series.experiment == experiment.name]
        series += examine_outputs(experiment, simulated, models, taken, problem.levels.scale)
    off_grid = tuple(
        (each.series.experiment, each.series.output) for each in result.noise.models if not each.series.regular
    )
    widening = dict(zip(result.names, result.widening.tolist(), strict=True))
    shares: dict[tuple[str, str, float], float] = {}
    for found in result.noise.returning:
        for own, share in zip(found.series, found.shares.tolist(), strict=True):
            if found.probability > SETTINGS.more_likely and share > SETTINGS.least_returning:
                key = (own.output, own.experiment, found.period * own.step)
                shares[key] = min(shares.get(key, 0.0) + share, 1.0)
    returning = tuple(PeriodicErrorFinding(*key, share) for key, share in shares.items())
    slow, long = _slow(result.noise)
    return ResidualAnalysis(tuple(series), widening, off_grid, slow, returning, long)
