"""Tests of the residual of one output: whiteness, correlation with inputs, distribution."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.codec import Layout
from fmuid.data import Experiment
from fmuid.estimation import (
    FitProjection,
    LaggedSeries,
    NoiseModel,
    NormalityTest,
    WhitenessTest,
    normality,
    output_series,
    whiteness,
)


@dataclass(frozen=True)
class ResidualSettings:
    """Numbers of the tests of a residual."""

    least_samples: int = 20  # for a test
    rounding_share: float = 1e-9  # of the measured values; smaller residuals are rounding errors
    large_skewness: float = 0.5  # of noise that is not normal, ...
    large_kurtosis: float = 1.0  # ... excess kurtosis likewise
    outlier_stds: float = 4.0  # from the mean; 1 in 15 000 samples of normal noise is beyond


RESIDUAL_SETTINGS = ResidualSettings()
NOT_WHITENESS_TESTED = WhitenessTest(0, math.nan, math.nan, np.ones(1), math.nan)
NOT_NORMALITY_TESTED = NormalityTest(math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class InputCorrelation:
    """Correlation of a residual with present and past inputs."""

    input: str
    lags: Floats  # (m,), time by which the input comes before, s
    values: Floats  # (m,)
    band: float  # half of the 95 % range without a relation
    lag: float  # of the largest correlation, s
    correlation: float
    probability: float  # of as much by chance at any lag


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residual of one output in one experiment, in the output's unit.

    Tests of fewer than 20 samples, or of rounding errors, are NaN.

    Attributes
    ----------
    noise : NoiseModel
        Of the fit, or of the residual itself without a fit.
    times : (K,) array
        s.
    residual : (K,) array
        NaN where a sample is missing or does not count.
    mean, std : float
    mean_probability : float
        Of such a mean by chance, for colored noise.
    whiteness : WhitenessTest
    normality : NormalityTest
    outliers : int
        Samples beyond 4 standard deviations.
    inputs : tuple of InputCorrelation
        Of inputs that move.
    """

    noise: NoiseModel
    times: Floats
    residual: Floats
    mean: float
    std: float
    mean_probability: float = math.nan
    whiteness: WhitenessTest = NOT_WHITENESS_TESTED
    normality: NormalityTest = NOT_NORMALITY_TESTED
    outliers: int = 0
    inputs: tuple[InputCorrelation, ...] = ()

    json_layout: ClassVar = Layout(
        omitted={"times", "residual"}, derived=("experiment", "output", "samples", "correlation_samples")
    )

    @property
    def experiment(self) -> str:
        """Name of the experiment."""
        return self.noise.series.experiment

    @property
    def output(self) -> str:
        """Name of the output."""
        return self.noise.series.output

    @property
    def samples(self) -> int:
        """Number of samples that count."""
        return self.noise.series.rows.size

    @property
    def correlation_samples(self) -> float:
        """Integrated correlation time in samples, 1 of white noise; NaN if not tested."""
        return self.noise.variance_factor() if self.is_tested else math.nan

    @property
    def is_tested(self) -> bool:
        """True if there are enough samples, and more than rounding errors."""
        return self.whiteness.lags > 0

    @property
    def is_abnormal(self) -> bool:
        """True if skewness or tails differ much from normal noise."""
        skewed = abs(self.normality.skewness) > RESIDUAL_SETTINGS.large_skewness
        return skewed or abs(self.normality.kurtosis) > RESIDUAL_SETTINGS.large_kurtosis

    def row(self) -> dict[str, Any]:
        """Return the row of `ResidualAnalysis.table`."""
        strongest = min(self.inputs, key=lambda each: each.probability, default=None)
        white, normal, unknown = self.whiteness, self.normality, math.nan
        factor = self.correlation_samples
        return {
            "experiment": self.experiment,
            "output": self.output,
            "samples": self.samples,
            "mean": self.mean,
            "mean_probability": self.mean_probability,
            "std": self.std,
            "lag1": float(white.autocorrelation[1]) if self.is_tested else unknown,
            "lags": white.lags,
            "ljung_box": white.statistic,
            "whiteness_probability": white.probability,
            "correlation_samples": factor,
            "correlation_time": factor * self.noise.series.step,
            "skewness": normal.skewness,
            "excess_kurtosis": normal.kurtosis,
            "normality_probability": normal.probability,
            "outliers": self.outliers,
            "input": strongest.input if strongest else "",
            "input_lag": strongest.lag if strongest else unknown,
            "input_correlation": strongest.correlation if strongest else unknown,
            "input_probability": strongest.probability if strongest else unknown,
        }


def examine_outputs(
    experiment: Experiment,
    simulated: Floats,
    models: Sequence[NoiseModel] | None = None,
    taken: FitProjection | None = None,
    even: Floats | None = None,
) -> list[ResidualSeries]:
    """Test the residuals of an experiment's outputs; noise and projection are of a fit or their own.

    `even` (n,) are residuals of equal variance in each output, which are tested instead.
    """
    outputs = experiment.output_names
    series = output_series([experiment], outputs) if models is None else [each.series for each in models]
    found = []
    for index, own in enumerate(series):
        column = outputs.index(own.output)
        counted, measured = experiment.counted[:, column], experiment.output_values[:, column]
        residual = np.where(counted, measured - simulated[:, column], np.nan)
        values = residual[counted]
        model = NoiseModel.of(own, values) if models is None else models[index]
        found.append(ResidualSeries(model, experiment.times, residual, float(values.mean()), float(values.std())))
        rounding = RESIDUAL_SETTINGS.rounding_share * float(np.sqrt(np.mean(measured[counted] ** 2)))
        if own.ordered and values.size >= RESIDUAL_SETTINGS.least_samples and found[-1].std > rounding:
            left = FitProjection.nothing(values.size) if taken is None else taken.of(own.rows)
            found[-1] = _tested(found[-1], values if even is None else even[own.rows], left)
    related = _related(experiment, [each for each in found if each.is_tested])
    return [replace(each, inputs=related.get(each.output, ())) for each in found]


def _tested(found: ResidualSeries, values: Floats, taken: FitProjection) -> ResidualSeries:
    """Test a residual by its samples (n,), without the inputs."""
    series, mean, std = found.noise.series, float(values.mean()), float(values.std())
    # in the model of the fit a mean passes for slow noise
    factor = NoiseModel.of(series, values).variance_factor()
    score = mean / std * math.sqrt(values.size / factor)
    return replace(
        found,
        mean_probability=2.0 * float(special.ndtr(-abs(score))),
        whiteness=whiteness(series.on_grid(values)[series.places[0] :], taken),
        normality=normality(values, found.noise),
        outliers=int((np.abs(values - mean) > RESIDUAL_SETTINGS.outlier_stds * std).sum()),
    )


def _related(experiment: Experiment, series: Sequence[ResidualSeries]) -> dict[str, tuple[InputCorrelation, ...]]:
    """Correlate residuals with each input that moves, by output."""
    found: dict[str, list[InputCorrelation]] = {each.output: [] for each in series}
    alike: dict[bytes, list[ResidualSeries]] = {}  # residuals that count at the same times share the lagged inputs
    for each in series if experiment.input_names else ():
        alike.setdefault(np.isfinite(each.residual).tobytes(), []).append(each)
    for group in alike.values():
        lags = group[0].noise.series.step * np.arange(group[0].whiteness.lags + 1.0)
        for name, lagged in _lagged_inputs(experiment, group[0], lags):
            for each in group:
                values = each.residual[np.isfinite(each.residual)]
                cross = lagged.correlate(values, each.noise.correlation)
                at, band = cross.strongest, 1.96 * cross.std
                strongest = float(lags[at]), float(cross.values[at]), cross.probability
                found[each.output].append(InputCorrelation(name, lags, cross.values, band, *strongest))
    return {name: tuple(some) for name, some in found.items()}


def _lagged_inputs(experiment: Experiment, series: ResidualSeries, lags: Floats) -> Iterator[tuple[str, LaggedSeries]]:
    """Yield moving inputs, at the samples of a residual and before."""
    clock, times = experiment.times, series.times[np.isfinite(series.residual)]
    places = series.noise.series.places - series.noise.series.places[0]
    grid_times = np.interp(np.arange(places[-1] + 1), places, times)
    before = times[:, None] - lags
    begun = before >= clock[0] - 1e-6 * (lags[1] if lags.size > 1 else 0.0)
    for name, column in zip(experiment.input_names, experiment.input_values.T, strict=True):
        grid = np.interp(grid_times, clock, column)
        if np.ptp(grid) > RESIDUAL_SETTINGS.rounding_share * np.abs(grid).max():
            yield name, LaggedSeries(np.where(begun, np.interp(before, clock, column), np.nan), grid)
