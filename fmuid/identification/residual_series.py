"""The residual of one output in one experiment: whiteness, correlation with the inputs, distribution."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from fmuid.array_types import Floats, Indices
from fmuid.data import Experiment, Measurements
from fmuid.estimation import (
    CrossCorrelation,
    LaggedSeries,
    Taken,
    autocorrelation,
    lag_sum,
    noise_model,
    normality,
    on_grid,
    positions,
    whiteness,
)

# Whiteness is tested over so many lags, the habit of the field, but not more than a fifth of the samples.
TESTED_LAGS, LAGS_DIVISOR = 25, 5
# The autocorrelation is kept for figures to this lag.
SHOWN_LAGS = 40
# Fewer samples say nothing.
LEAST_SAMPLES = 20
# A residual below this share of the measured values is rounding.
ROUNDING_SHARE = 1e-9
# A skewness and excess kurtosis beyond which noise no longer looks normal.
LARGE_SKEWNESS, LARGE_KURTOSIS = 0.5, 1.0
# A sample this many standard deviations away is an outlier: of normal noise, 1 in 15 000.
OUTLIER_STDS = 4.0


@dataclass(frozen=True, eq=False)
class InputCorrelation:
    """The correlation of a residual with what an input was at the same time and before.

    Attributes
    ----------
    input : str
    lags : (m,) array
        By how much the input comes before the residual, s.
    values : (m,) array
        The correlation at each lag.
    band : float
        Half-width of the 95 % band of each of them, if the residual had nothing to do with the input.
    lag, correlation : float
        Where its magnitude is largest, s, and its value there.
    probability : float
        That chance gives as much at any of the lags.
    """

    input: str
    lags: Floats
    values: Floats
    band: float
    lag: float
    correlation: float
    probability: float


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """The residual of one output in one experiment, measured − simulated in the output's unit.

    What cannot be told, of fewer than 20 samples or of a residual that is rounding, is NaN.

    Attributes
    ----------
    experiment, output : str
    times : (K,) array
        s.
    residual : (K,) array
        NaN where a sample is missing or does not count.
    samples : int
        That count.
    step : float
        Of the lags, s.
    mean, std : float
    mean_probability : float
        That noise of this colour has such a mean by chance.
    tested_lags : int
        Over which whiteness was tested.
    ljung_box, whiteness_probability : float
        The statistic, and the probability that white noise exceeds it.
    autocorrelation : (m,) array
        From lag 0 on, for figures.
    band : float
        Half-width of the 95 % band of each of them, if the residual were white.
    noise_correlation : (k,) array
        ρ of the autoregressive model of the residual (`fmuid.estimation.noise.whiteness_tests.noise_model`).
    skewness, kurtosis : float
        Of the normal distribution 0 and (excess) 0.
    normality_probability : float
        That normal noise of this colour shows as much.
    outliers : int
        Samples beyond 4 standard deviations.
    inputs : tuple of InputCorrelation
        Those of inputs that move.
    rows, places : (samples,) arrays of int
        Which rows of the problem's residual these are, and where they stand on the grid of their step.
    """

    experiment: str
    output: str
    times: Floats
    residual: Floats
    samples: int
    step: float
    mean: float
    std: float
    mean_probability: float
    tested_lags: int
    ljung_box: float
    whiteness_probability: float
    autocorrelation: Floats
    band: float
    noise_correlation: Floats
    skewness: float
    kurtosis: float
    normality_probability: float
    outliers: int
    inputs: tuple[InputCorrelation, ...]
    rows: Indices
    places: Indices

    @property
    def examined(self) -> bool:
        """Whether there were samples enough, and more than rounding, to say anything."""
        return not math.isnan(self.whiteness_probability)

    @property
    def strongest_autocorrelation(self) -> tuple[int, float]:
        """The lag, in samples, at which the autocorrelation is largest, of those tested, and its value there."""
        tested = np.nan_to_num(self.autocorrelation[: self.tested_lags + 1])
        lag = 1 + int(np.argmax(np.abs(tested[1:])))
        return lag, float(tested[lag])

    @property
    def lopsided(self) -> bool:
        """Whether the skewness is larger than looks normal."""
        return abs(self.skewness) > LARGE_SKEWNESS

    @property
    def tailed(self) -> bool:
        """Whether the tails are heavier or lighter than looks normal."""
        return abs(self.kurtosis) > LARGE_KURTOSIS

    @property
    def correlation_samples(self) -> float:
        """Integrated correlation time in samples, 1 of white noise."""
        return lag_sum(self.noise_correlation, self.samples)

    @property
    def variance_samples(self) -> float:
        """How many independent samples the residual's mean square is worth (Bartlett)."""
        return self.samples / lag_sum(self.noise_correlation, self.samples, 2)

    def row(self) -> dict[str, Any]:
        """Return the line of `Diagnostics.table`."""
        strongest = min(self.inputs, key=lambda each: each.probability, default=None)
        return {
            "experiment": self.experiment,
            "output": self.output,
            "samples": self.samples,
            "mean": self.mean,
            "mean_probability": self.mean_probability,
            "std": self.std,
            "lag1": float(self.autocorrelation[1]) if self.examined else math.nan,
            "lags": self.tested_lags,
            "ljung_box": self.ljung_box,
            "whiteness_probability": self.whiteness_probability,
            "correlation_samples": self.correlation_samples if self.examined else math.nan,
            "correlation_time": self.correlation_samples * self.step if self.examined else math.nan,
            "skewness": self.skewness,
            "excess_kurtosis": self.kurtosis,
            "normality_probability": self.normality_probability,
            "outliers": self.outliers,
            "input": strongest.input if strongest else "",
            "input_lag": strongest.lag if strongest else math.nan,
            "input_correlation": strongest.correlation if strongest else math.nan,
            "input_probability": strongest.probability if strongest else math.nan,
        }


def examine_outputs(
    experiment: Measurements,
    simulated: Floats,
    rows: Sequence[Indices],
    taken: Taken | None = None,
    scale: Floats | None = None,
) -> list[ResidualSeries]:
    """Examine the residuals of those outputs of an experiment that have samples that count.

    Parameters
    ----------
    experiment : Measurements
    simulated : (K, n_outputs) array
    rows : sequence of (n,) arrays of int
        For each output, which rows of the problem's residual are its counted samples.
    taken : Taken, optional
        What a fit has taken out of the noise of all rows; default: nothing has been fitted.
    scale : (n,) array, optional
        The standard deviation of the noise of each row against that of its output: tests are of residuals over it.
    """
    found = []
    for column, its in enumerate(rows):
        if its.size:
            left = Taken.nothing(its.size) if taken is None else taken.of(its)
            levels = np.ones(its.size) if scale is None else scale[its]
            found.append(_alone(experiment, column, simulated[:, column], its, left, levels))
    related = _related(experiment, [each for each in found if each.examined])
    return [replace(each, inputs=related.get(each.output, ())) for each in found]


def _alone(
    experiment: Measurements, column: int, simulated: Floats, rows: Indices, taken: Taken, scale: Floats
) -> ResidualSeries:
    """Examine the residual of one output, the inputs aside."""
    counted, measured = experiment.counted[:, column], experiment.output_values[:, column]
    residual = np.where(counted, measured - simulated, np.nan)
    values = residual[counted]
    mean, std = float(values.mean()), float(values.std())
    there: dict[str, Any] = {
        "experiment": experiment.name,
        "output": experiment.output_names[column],
        "times": experiment.times,
        "residual": residual,
        "samples": values.size,
        "mean": mean,
        "std": std,
        "inputs": (),
        "rows": rows,
    }
    rounding = ROUNDING_SHARE * float(np.sqrt(np.mean(measured[counted] ** 2)))
    if values.size < LEAST_SAMPLES or not std > rounding:
        return ResidualSeries(**there, **_unknown(values.size))
    values = values / scale
    mean, std = float(values.mean()), float(values.std())
    places, step = positions(experiment.times[counted])
    grid = on_grid(values, places)
    lags = min(TESTED_LAGS, values.size // LAGS_DIVISOR, len(grid) - 1)
    correlations, pairs = autocorrelation(grid, min(SHOWN_LAGS, len(grid) - 1))
    statistic, probability = whiteness(correlations[: lags + 1], pairs[: lags + 1], np.isfinite(grid), taken)
    noise = noise_model(grid)
    score = mean / std * math.sqrt(values.size / lag_sum(noise, values.size))
    skewness, kurtosis, normal = normality(values, noise)
    return ResidualSeries(
        **there,
        step=step,
        mean_probability=2.0 * float(special.ndtr(-abs(score))),
        tested_lags=lags,
        ljung_box=statistic,
        whiteness_probability=probability,
        autocorrelation=correlations,
        band=1.96 / math.sqrt(values.size),
        noise_correlation=noise,
        skewness=skewness,
        kurtosis=kurtosis,
        normality_probability=normal,
        outliers=int((np.abs(values - mean) > OUTLIER_STDS * std).sum()),
        places=places,
    )


def _unknown(samples: int) -> dict[str, Any]:
    """Return what is left to say of a residual of which nothing can be told."""
    numbers = "step mean_probability ljung_box whiteness_probability band skewness kurtosis normality_probability"
    return {
        **dict.fromkeys(numbers.split(), math.nan),
        "tested_lags": 0,
        "autocorrelation": np.ones(1),
        "noise_correlation": np.ones(1),
        "outliers": 0,
        "places": np.arange(samples),
    }


def _related(experiment: Measurements, series: Sequence[ResidualSeries]) -> dict[str, tuple[InputCorrelation, ...]]:
    """Correlate residuals with each input that moves; return what was found by output.

    Residuals that count at the same times, as most do, share what an input was then and before.
    """
    if not isinstance(experiment, Experiment):
        return {}
    found: dict[str, list[InputCorrelation]] = {each.output: [] for each in series}
    alike: dict[bytes, list[ResidualSeries]] = {}
    for each in series:
        alike.setdefault(np.isfinite(each.residual).tobytes(), []).append(each)
    for group in alike.values():
        lags = group[0].step * np.arange(group[0].tested_lags + 1.0)
        for name, lagged in _lagged_inputs(experiment, group[0], lags):
            for each in group:
                values = each.residual[np.isfinite(each.residual)]
                found[each.output].append(_correlated(name, lags, lagged.correlate(values, each.noise_correlation)))
    return {name: tuple(some) for name, some in found.items()}


def _lagged_inputs(experiment: Experiment, series: ResidualSeries, lags: Floats) -> Iterator[tuple[str, LaggedSeries]]:
    """Give, one at a time, the inputs that move as they are at the samples of a residual and before."""
    clock, times = experiment.times, series.times[np.isfinite(series.residual)]
    grid_times = np.interp(np.arange(series.places[-1] + 1), series.places, times)
    before = times[:, None] - lags
    begun = before >= clock[0] - 1e-6 * (lags[1] if lags.size > 1 else 0.0)
    for name, column in zip(experiment.input_names, experiment.input_values.T, strict=True):
        grid = np.interp(grid_times, clock, column)
        if np.ptp(grid) > ROUNDING_SHARE * np.abs(grid).max():
            yield name, LaggedSeries(np.where(begun, np.interp(before, clock, column), np.nan), grid)


def _correlated(name: str, lags: Floats, cross: CrossCorrelation) -> InputCorrelation:
    strongest = cross.strongest
    return InputCorrelation(
        name,
        lags,
        cross.values,
        1.96 * cross.std,
        float(lags[strongest]),
        float(cross.values[strongest]),
        cross.probability,
    )
