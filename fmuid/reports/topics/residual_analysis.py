"""Residuals: defects, tests, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.formatting import listed, two_digits, unit_text
from fmuid.identification import (
    LEAST_STD_FACTOR,
    RESIDUAL_LEVEL,
    RESIDUAL_SETTINGS,
    ResidualAnalysis,
    ResidualDefect,
    ResidualFinding,
    ResidualSeries,
)
from fmuid.reports.chart import DENSITY, LIMITS, Axis, Chart, Color, Dash, Data, Layer, normal
from fmuid.reports.document import Section
from fmuid.reports.topics.fit import worst
from fmuid.simulation import OutputFit

# An autocorrelation from which on a residual is called far from white.
FAR_FROM_WHITE = 0.5


def residual_words(found: ResidualAnalysis, units: Mapping[str, str | None] | None = None) -> tuple[str, ...]:
    """Return the remarks on the residuals, at least one."""
    large = [each for each in found.findings if each.large]
    coloured = [each for each in large if each.trait is ResidualDefect.COLOURED]
    said = [_large(found, each, units or {}) for each in coloured]
    said += _widening(found, coloured=bool(coloured))
    said += [_large(found, each, units or {}) for each in large if each.trait is not ResidualDefect.COLOURED]
    said += _correlated(found)
    return (*said, *_slow(found), *_summary(found, quiet=not said))


def _name(found: ResidualAnalysis, output: str, *experiments: str) -> str:
    several = len({each.experiment for each in found.series}) > 1
    return f"{output} in {listed(experiments)}" if several else output


def _series_name(found: ResidualAnalysis, series: ResidualSeries) -> str:
    return _name(found, series.output, series.experiment)


def _large(found: ResidualAnalysis, finding: ResidualFinding, units: Mapping[str, str | None]) -> str:
    series, name = finding.series, _series_name(found, finding.series)
    if finding.trait is ResidualDefect.COLOURED:
        lag, largest = series.whiteness.strongest
        far = "far from white" if abs(largest) >= FAR_FROM_WHITE else "not white"
        return (
            f"The residual of {name} is {far} (autocorrelation {largest:.2f} at a lag of {_count(lag, 'sample')}): "
            "the model or the noise has dynamics of its own"
        )
    if finding.trait is ResidualDefect.OFFSET:
        mean = f"{series.mean:.3g} {unit_text(units.get(series.output))}".rstrip()
        return (
            f"The residual of {name} has the mean {mean}, {abs(series.mean) / series.std:.2g} of its standard "
            "deviation: a sensor's offset, or something constant that the model lacks"
        )
    if finding.input is not None:
        one = finding.input
        delay = f"{one.lag:.3g} s later" if one.lag > 0 else "at the same time"
        return (
            f"The residual of {name} is correlated with the input {one.input} ({one.correlation:+.2f}, {delay}; "
            f"by chance within {one.band:.2g}): part of how {one.input} acts is not in the model"
        )
    shape = series.normality
    traits = ["is lopsided"] if series.is_lopsided else []
    traits += [f"has {'heavy' if shape.kurtosis > 0 else 'light'} tails"] if series.is_tailed else []
    remedy = ": look for outliers, or use a robust loss" if shape.kurtosis > RESIDUAL_SETTINGS.large_kurtosis else ""
    return (
        f"The residual of {name} {listed(traits)}, unlike normal noise (skewness {two_digits(shape.skewness)}, "
        f"excess kurtosis {two_digits(shape.kurtosis)}, {_count(series.outliers, 'sample')} beyond "
        f"{RESIDUAL_SETTINGS.outlier_stds:g} standard deviations){remedy}"
    )


def _widening(found: ResidualAnalysis, *, coloured: bool) -> list[str]:
    known = {name: factor for name, factor in found.widening.items() if math.isfinite(factor)}
    other = {name: f for name, f in known.items() if not 1.0 / LEAST_STD_FACTOR < f < LEAST_STD_FACTOR}
    if not other:
        here = "For the estimates this makes little difference; their standard deviations allow for it"
        return [here] if coloured and known else []
    low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
    about = f"{two_digits(known[high])} times"
    if known[high] > LEAST_STD_FACTOR * known[low]:
        about = f"{two_digits(known[low])} ({low}) to {two_digits(known[high])} times ({high})"
    sure = any(each.trait is ResidualDefect.COLOURED for each in found.findings)
    why = "Since neighbouring samples are not independent, the"
    if not sure:
        why = "Neighbouring samples of the residual look correlated, if not strongly enough to rule out chance: the"
    return [f"{why} standard deviations are {about} those that white noise of this size would give"]


def _correlated(found: ResidualAnalysis) -> list[str]:
    """Return where the standard deviations allow for samples on no grid, and for periodic model errors."""
    said = [
        f"In the residual of {_name(found, each.output, each.experiment)} something comes back with each "
        f"cycle of the excitation, every {each.period:.3g} s ({two_digits(100 * each.share)} % of its variance): an "
        "error of the model, which no number of cycles averages out; the standard deviations allow for it"
        for each in found.returning
    ]
    if not found.off_grid:
        return said
    names = listed([_name(found, output, experiment) for experiment, output in found.off_grid])
    return [
        f"The samples of {names} stand on no grid: how neighbouring ones depend on each other is judged as if "
        "they were equally spaced",
        *said,
    ]


def _slow(found: ResidualAnalysis) -> list[str]:
    """Return where the standard deviations allow for weak slow noise, and noise that is slow for its data file."""
    said = [
        f"In the residual of {_name(found, each.output, *each.experiments)} there is slow noise "
        f"beneath the rest ({two_digits(100 * each.share)} % of its variance, with a time constant of about "
        f"{each.time_constant:.1g} s), for which the standard deviations allow; one white residual in a hundred looks "
        "so by chance"
        for each in found.slow
    ]
    return said + [
        f"The noise of {_name(found, each.output, *each.experiments)} is slow for its record (a "
        f"time constant of about {each.time_constant:.1g} s, in {each.record:.3g} s): how slow is hardly told, and the "
        "standard deviations that it acts on are uncertain themselves; a longer record tells more"
        for each in found.long_memory
    ]


def _summary(found: ResidualAnalysis, *, quiet: bool) -> list[str]:
    idle = [_series_name(found, each) for each in found.series if not each.is_tested]
    lines = [f"The residual of {listed(idle)} is too short, or nothing but rounding, to be examined"] if idle else []
    examined = [each for each in found.series if each.is_tested]
    if not quiet or not examined:
        return lines
    slight = {
        _series_name(found, each): [_slight(one) for one in found.findings if one.series is each] for each in examined
    }
    slight = {name: traits for name, traits in slight.items() if traits}
    said = "significant, but slight"
    lines += [f"The residual of {name} has {listed(traits)}: {said}" for name, traits in slight.items()]
    names = [_series_name(found, each) for each in examined]
    which = f"residual of {names[0]} looks" if len(names) == 1 else f"residuals of {listed(names)} look"
    like = "otherwise like" if slight or found.slow else "like"
    return [
        *lines,
        f"The {which} {like} white normal noise that has nothing to do with the inputs, as far as was tested: "
        f"{_tested(examined)}; nothing more was tested: an error of the model that the parameters make up for does "
        "not show there, nor does slow noise too weak for so many samples",
    ]


def _slight(finding: ResidualFinding) -> str:
    series = finding.series
    if finding.trait is ResidualDefect.COLOURED:
        lag, largest = series.whiteness.strongest
        return f"an autocorrelation of {largest:.2g} at a lag of {_count(lag, 'sample')}"
    if finding.trait is ResidualDefect.OFFSET:
        return f"a mean of {series.mean / series.std:.2g} standard deviations"
    if finding.input is not None:
        return f"a correlation of {finding.input.correlation:+.2g} with the input {finding.input.input}"
    shape = series.normality
    return f"a skewness of {two_digits(shape.skewness)} and an excess kurtosis of {two_digits(shape.kurtosis)}"


def _tested(series: list[ResidualSeries]) -> str:
    inputs = list(dict.fromkeys(one.input for each in series for one in each.inputs))
    lags, samples = _range([each.whiteness.lags for each in series]), _range([each.samples for each in series])
    crossed = [f"correlation with {listed(inputs)}"] if inputs else []
    tests = listed([f"whiteness (Ljung–Box over {lags} lags)", "mean", *crossed, "normality (Jarque–Bera)"])
    return f"{tests}, each at a level of {100 * RESIDUAL_LEVEL:g} %, with {samples} samples"


def _range(numbers: list[int]) -> str:
    return f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


CAPTION = (
    "Left: the residual's distribution should follow the normal curve. Middle: its autocorrelation should stay in the "
    "band; else the model or the noise has dynamics of its own and the intervals are not as stated. Right: outside the "
    "band, the residual depends on an input, which the model does not take up rightly."
)
SHOWN_STDS, BARS, FEW_BARS, MANY_SAMPLES = 4.0, 41, 21, 300
"""The histogram reaches so many standard deviations to both sides, with what lies beyond in its last bars; its bars,
with many samples and with few."""
BANDS = 3.0
"""Correlations are drawn to a scale of at least so many half-widths of the band, so that white noise looks harmless."""
INPUT_LOOKS: tuple[tuple[Color, Dash], ...] = (
    ("red", "solid"),
    ("blue", "solid"),
    ("amber", "solid"),
    ("grey", "dashed"),
)
"""Of the inputs with the largest correlations. More lines cannot be told apart."""


def residual_section(fits: Sequence[OutputFit], correlations: pd.DataFrame) -> Section:
    """Return the section on the residuals."""
    charts = []
    for fit in worst(fits):
        for j, output in list(enumerate(fit.outputs))[: LIMITS.outputs]:
            rows = correlations[(correlations["experiment"] == fit.experiment) & (correlations["output"] == output)]
            values = np.where(fit.counted[:, j], fit.measured[:, j] - fit.simulated[:, j], np.nan)
            own, others = rows[rows["with"] == output], rows[rows["with"] != output]
            charts += [_histogram(values, output)]
            charts += [_autocorrelation(own, output)] if len(own) else []
            charts += [_with_inputs(others, output)] if len(others) else []
    return Section("residuals", "Residuals", CAPTION, charts=tuple(charts))


def _histogram(residual: Floats, output: str) -> Chart:
    known = residual[np.isfinite(residual)]
    scaled = (known - known.mean()) / (known.std() or 1.0)
    edges = np.linspace(-SHOWN_STDS, SHOWN_STDS, BARS if known.size > MANY_SAMPLES else FEW_BARS)
    density, _ = np.histogram(np.clip(scaled, -SHOWN_STDS, SHOWN_STDS), bins=edges, density=True)
    fine = np.linspace(-SHOWN_STDS, SHOWN_STDS, 121)
    boxes: Data = {"left": edges[:-1], "right": edges[1:], "bottom": 0.0, "top": density}
    layers = (
        Layer("cells", boxes, "red", alpha=0.45, edge="white", label="residual"),
        Layer("line", {"x": fine, "y": normal(fine, 0.0, 1.0)}, "ink", width=1.4, label="normal"),
    )
    return Chart(Axis(f"residual of {output} / its std"), DENSITY, layers)


def _autocorrelation(table: pd.DataFrame, output: str) -> Chart:
    lags, values = (table[key].to_numpy(np.float64) for key in ("lag", "correlation"))
    data: Data = {"x0": lags, "y0": 0.0, "x1": lags, "y1": values}
    points: Data = {"x": lags, "y": values, "t": table["time"].to_numpy(np.float64)}
    hover = (("lag", "@x samples, @t{0.00000} s"), ("autocorrelation", "@y{0.000}"))
    text = "residual; in the band 95 % of white noise"
    layers = (
        Layer("segments", data, "red", width=1.6),
        Layer("points", points, "red", size=4, label=text, hover=hover),
    )
    return _correlations(table, f"lag (samples), residual of {output}", "autocorrelation", layers)


def _with_inputs(table: pd.DataFrame, output: str) -> Chart:
    largest = table.groupby("with", sort=False)["correlation"].apply(lambda one: float(one.abs().max()))
    names = [name for name in largest.index if name in set(largest.nlargest(len(INPUT_LOOKS)).index)]
    layers = []
    hover = (("lead", "@x samples, @t{0.00000} s"), ("correlation", "@y{0.000}"))
    for name, (color, dash) in zip(names, INPUT_LOOKS, strict=False):
        part = table[table["with"] == name]
        data = {
            key: part[name].to_numpy(np.float64) for key, name in (("x", "lag"), ("y", "correlation"), ("t", "time"))
        }
        layers.append(Layer("line", data, color, dash=dash, width=1.4, label=str(name), hover=hover))
    return _correlations(table, f"input's lead (samples), residual of {output}", "correlation", layers)


def _correlations(table: pd.DataFrame, x: str, y: str, layers: Sequence[Layer]) -> Chart:
    """Return correlations over a band of those by chance."""
    band, values = float(table["band"].max()), table["correlation"].to_numpy(np.float64)
    most = min(1.15 * max(BANDS * band, float(np.nanmax(np.abs(values), initial=0.0))), 1.05)
    ground = (Layer("zone", {"bottom": -band, "top": band}, alpha=0.14), Layer("rule", {"y": 0.0}, "ink"))
    return Chart(Axis(x), Axis(y, reach=(-most, most)), (*ground, *layers))
