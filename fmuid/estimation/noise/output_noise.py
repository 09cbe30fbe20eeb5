"""OutputNoise: lines, color and tails of a residual.

Whitened innovations e are limited to ψ(e) = max(−c, min(e, c)) (Huber, Annals of Mathematical Statistics 35, 1964).
With K = J E ψ'/√E ψ² and ε = ψ(e)/√E ψ² the information is KᵀK and the score Kᵀε, as for normal noise. Innovations are
limited beside their least-squares fit f by the columns, ψ(e − f) + f E ψ', as one step from it (P. J. Bickel, J. Am.
Stat. Assoc. 70, 1975): far from a point all of them would be at the limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.estimation.noise.autoregression import Autoregression
from fmuid.estimation.noise.model import NoiseModel, common_process
from fmuid.estimation.noise.output_series import OutputSeries, output_series


@dataclass(frozen=True)
class OutputNoiseSettings:
    """Numbers of lines and tails."""

    most_lines: int = 3
    beside: int = 30  # bins of the spectrum on each side, compared with a line
    periods: int = 16  # of a line in the record, at least
    unexplained: float = 0.2  # share of the measured power at a line that the residual has at least
    rare: float = 9.0  # −log of the probability that some bin of noise is taken for a line
    fine: int = 201  # frequencies between the bins beside a line
    block: int = 1000  # samples in which a line keeps amplitude and phase
    limits: tuple[float, ...] = (1.0, 1.5, 2.0, 2.5, 3.0)  # of innovations, in robust standard deviations
    median: float = 0.6745  # of the absolute value of a normal variable with σ = 1
    shown: float = 0.05  # mean square of innovations; a residual far below its stated noise shows no tails
    gain: float = 1.05  # of information, from which innovations are limited


SETTINGS = OutputNoiseSettings()


@dataclass(frozen=True, eq=False)
class OutputNoise:
    """Noise of an output.

    Attributes
    ----------
    process : Autoregression
        Beside the lines.
    lines : (l,) array
        Frequencies, Hz.
    limit : float
        c of the innovations in standard deviations; infinite for normal tails.
    slope, power : float
        E ψ' and E ψ².
    share : float
        2/var(ψ²/E ψ²): independent samples a sample for a variance.
    """

    process: Autoregression
    lines: Floats = field(default_factory=lambda: np.zeros(0))
    limit: float = math.inf
    slope: float = 1.0
    power: float = 1.0
    share: float = 1.0

    @classmethod
    def white(cls, variance: float) -> OutputNoise:
        """Return white normal noise."""
        return cls(Autoregression(np.zeros(0), variance, 0))

    @classmethod
    def of(
        cls, parts: Sequence[tuple[OutputSeries, Floats]], measured: Sequence[Floats], variance: float | None = None
    ) -> OutputNoise:
        """Return the common noise of residuals (n,) of one output; a given variance includes the lines."""
        longest = max(range(len(parts)), key=lambda k: parts[k][0].places.size)
        lines = spectral_lines(*parts[longest], measured[longest])
        rest = [(series, _without(series, lines, values[:, None])[:, 0]) for series, values in parts]
        if variance is not None and lines.size:
            variance *= _squares(rest) / _squares(parts)
        process = common_process(rest, variance)
        white = [NoiseModel(series, process).whiten(values) for series, values in rest]
        tails = _tails(np.concatenate(white))
        if math.isfinite(tails[0]):  # outliers hide the color
            std = math.sqrt(process.variance)
            kept = [
                values - std * (e - np.clip(e, -tails[0], tails[0])) for (_, values), e in zip(rest, white, strict=True)
            ]
            clean = common_process([(series, own) for (series, _), own in zip(rest, kept, strict=True)])
            process = clean.of_variance(process.std**2)
            tails = _tails(np.concatenate([NoiseModel(series, process).whiten(values) for series, values in rest]))
        return cls(process, lines, *tails)

    def of_variance(self, variance: float) -> OutputNoise:
        """Return the noise with another variance beside the lines."""
        return replace(self, process=self.process.of_variance(variance))

    def whiten(self, series: OutputSeries, columns: Floats, borders: Sequence[int] = ()) -> Floats:
        """Return innovations (n, 1 + N) of a residual and columns; lines are fitted anew between borders (rows)."""
        model = NoiseModel(series, self.process)
        found = _without(series, self.lines, columns, borders, model)
        residual, columns = found[:, 0], found[:, 1:]
        fitted = np.zeros_like(residual)
        if math.isfinite(self.limit) and columns.size:
            size = np.linalg.norm(columns, axis=0)
            scaled = columns / np.where(size > 0, size, 1.0)
            for first, last in pairwise(borders or (0, len(residual))):
                part = scaled[first:last]
                fitted[first:last] = part @ np.linalg.lstsq(part, residual[first:last], rcond=None)[0]
        residual = np.clip(residual - fitted, -self.limit, self.limit) + self.slope * fitted
        return np.column_stack([residual, self.slope * columns]) / math.sqrt(self.power)


def output_noise(
    records: Sequence[tuple[Experiment, Floats]], variances: Mapping[str, float] | None = None
) -> dict[str, OutputNoise]:
    """Return the noise of residuals (K, n_outputs), pooled by output; given variances stay."""
    parts: dict[str, list[tuple[OutputSeries, Floats]]] = {}
    measured: dict[str, list[Floats]] = {}
    for experiment, residual in records:
        for series in output_series([experiment], experiment.output_names):
            j = experiment.output_names.index(series.output)
            there = experiment.counted[:, j]
            parts.setdefault(series.output, []).append((series, residual[there, j]))
            measured.setdefault(series.output, []).append(experiment.output_values[there, j])
    return {name: OutputNoise.of(own, measured[name], (variances or {}).get(name)) for name, own in parts.items()}


def _squares(parts: Sequence[tuple[OutputSeries, Floats]]) -> float:
    return sum(float(values @ values) for _, values in parts) or 1.0


def spectral_lines(series: OutputSeries, values: Floats, measured: Floats) -> Floats:
    """Return the frequencies of lines, Hz: bins that exceed the median of their neighbors on both sides.

    A line in the residual that the model explains in the measured signal is one of the excitation.
    """
    found = np.zeros(0)
    count, beside, places = int(series.places[-1]) + 1, SETTINGS.beside, series.places
    if not (series.regular and series.ordered):
        return found
    window = np.hanning(count)

    def spectrum(samples: Floats) -> Floats:
        padded = np.zeros(count)
        padded[places] = samples - samples.mean()
        return np.abs(np.fft.rfft(window * padded)) ** 2

    explained = SETTINGS.unexplained * spectrum(measured)
    first, last = max(SETTINGS.periods, 3), count // 2 - 3
    for _ in range(SETTINGS.most_lines if last > first + 2 * beside else 0):
        rest = _without(series, found, (values - values.mean())[:, None])[:, 0]
        power = spectrum(rest)
        near = np.lib.stride_tricks.sliding_window_view(np.pad(power, beside, mode="reflect"), beside)
        medians = np.median(near, axis=1) / math.log(2.0)
        level = np.maximum(medians[: power.size], medians[beside + 1 : beside + 1 + power.size])
        bins = np.arange(first, last)
        ratio = power[bins] / np.maximum(level[bins], np.finfo(float).tiny)
        ratio[power[bins] < explained[bins]] = 0.0
        best = int(np.argmax(ratio))
        if not ratio[best] > math.log(count) + SETTINGS.rare:
            break
        fine = np.linspace(bins[best] - 1, bins[best] + 1, SETTINGS.fine) / (count * series.step)
        waves = np.exp(-2j * math.pi * series.step * np.outer(fine, places))
        found = np.append(found, fine[int(np.argmax(np.abs(waves @ (window[places] * rest))))])
    return found


def _without(
    series: OutputSeries, lines: Floats, columns: Floats, borders: Sequence[int] = (), model: NoiseModel | None = None
) -> Floats:
    """Return whitened columns (n, m) without the lines of each block."""
    white = columns if model is None else model.whiten(columns)
    if not lines.size:
        return white
    angle = 2.0 * math.pi * series.step * np.outer(series.places, lines)
    waves = np.hstack([np.cos(angle), np.sin(angle)])
    waves = waves if model is None else model.whiten(waves)
    white = white.copy()
    cuts = list(borders) or [
        round(each) for each in np.linspace(0, len(white), 1 + max(1, len(white) // SETTINGS.block))
    ]
    for first, last in pairwise(cuts):
        basis, size, _ = np.linalg.svd(waves[first:last], full_matrices=False)
        basis = basis[:, size > 1e-9 * size.max(initial=0.0)]
        white[first:last] -= basis @ (basis.T @ white[first:last])
    return white


def _tails(white: Floats) -> tuple[float, float, float, float]:
    """Return limit, slope, power and share of innovations (n,)."""

    def moments(limit: float) -> tuple[float, float, float, float]:
        squares = np.clip(white, -limit, limit) ** 2
        power = float(squares.mean()) or 1.0
        return limit, float(np.mean(np.abs(white) < limit)), power, 2.0 / max(float(np.var(squares / power)), 2.0)

    if float(np.mean(white**2)) < SETTINGS.shown:
        return math.inf, 1.0, 1.0, 1.0
    plain = moments(math.inf)
    scale = float(np.median(np.abs(white))) / SETTINGS.median
    best = max((moments(scale * each) for each in SETTINGS.limits), key=lambda each: each[1] ** 2 / each[2])
    if best[1] ** 2 / best[2] * plain[2] > SETTINGS.gain:
        return best
    return math.inf, 1.0, 1.0, min(1.0, plain[3])
