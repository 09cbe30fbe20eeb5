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
from fmuid.reports.document import Message, Remark, Section, doubt, plain
from fmuid.reports.topics.fit import worst
from fmuid.simulation import OutputFit


class ResidualMessage(Message, section="residuals"):
    """Tests of the residuals, measured − simulated."""

    WHITE = plain(
        "{residuals} white{inputs}.",
        "parameters can absorb model errors, and weak low-frequency noise hides",
        "Test on new data: `fmuid predict`.",
    )
    TESTS = plain("Tests: {tests}; {samples} samples, level {level} %.")
    COLORED = doubt(
        "Residual of {name} is {degree}colored (autocorrelation {value} at lag {lag}).",
        "a model error, or colored noise; if weak, the intervals allow for it",
        "Check the model structure and sensor filters.",
    )
    WIDENED = plain("σ is {factors} wider because {reason}.", "fewer independent samples than rows")
    NOT_WIDENED = plain("Colored noise changes σ little.")
    CORRELATED = doubt(
        "Residual of {name} correlates with {input} ({value} at {lag}, limit ±{band}).",
        remedy="Check interpolation, delay and unit of {input}.",
    )
    OFFSET = doubt(
        "Residual of {name} has an offset of {mean} ({share} × its standard deviation).",
        "of the sensor, or a constant effect that the model omits",
        "Add an offset parameter or `detrend`.",
    )
    OUTLIERS = doubt(
        "Residual of {name} has outliers ({outliers} beyond 4 σ; excess kurtosis {kurtosis}).",
        remedy="Remove them or set a robust `loss`.",
    )
    SHAPE = doubt(
        "Residual of {name} is not normal (skewness {skewness}, excess kurtosis {kurtosis}).",
        "saturation, for example",
        "Check for saturation and rectified signals.",
    )
    LOW_FREQUENCY = plain(
        "Residual of {name} contains low-frequency noise ({share} %, {seconds} s); σ includes it.",
        "a drift; one white residual in a hundred looks like it",
    )
    LONG_MEMORY = plain(
        "Noise of {name} is slow ({seconds} s) for {record} s of data; σ is uncertain.",
        remedy="Measure longer; or `detrend` if the sensor drifts.",
    )
    PERIODIC = doubt(
        "Residual of {name} repeats every {period} s ({share} % of variance); σ includes it.",
        "a model error; more cycles do not reduce it",
        "Improve the model or vary the excitation.",
    )
    IRREGULAR = plain(
        "{names}: unequal sampling intervals, treated as equal.", remedy="Set `resample_interval` if they differ much."
    )
    SLIGHT = plain("Residual of {name}: significant but small {traits}.")
    UNTESTED = plain("Residual of {names} is too short, rounding only or without an order: not tested.")


def residual_remarks(found: ResidualAnalysis, units: Mapping[str, str | None] | None = None) -> list[Remark]:
    """Return the remarks on the residuals, at least one."""
    large = [
        (each.trait is ResidualDefect.COLORED, _large(found, each, units or {}))
        for each in found.findings
        if each.large
    ]
    colored = [said for is_colored, said in large if is_colored]
    said = [*colored, *_widening(found, colored=bool(colored)), *(said for is_colored, said in large if not is_colored)]
    quiet = not said and not found.returning and not found.off_grid
    return [*said, *_memory(found), *_summary(found, quiet=quiet)]


def residual_phrases(found: ResidualAnalysis) -> str:
    """Return the defects of the residuals for one line of a terminal."""
    tested = [each for each in found.series if each.is_tested]
    if not tested:
        return f"not tested: {'too short, or rounding only' if is_ordered(found) else 'rows have no order'}"
    large = [each for each in found.findings if each.large]

    def named(trait: ResidualDefect) -> list[ResidualSeries]:
        return [each.series for each in large if each.trait is trait]

    colored = [f"{_name(found, each)} {each.whiteness.strongest[1]:.2f}" for each in named(ResidualDefect.COLORED)]
    white = "not clearly white" if widening_words(found) else "white"
    said = [f"colored ({', '.join(colored)})" if colored else white]
    inputs = list(dict.fromkeys(each.input.input for each in large if each.input is not None))
    driven = list(dict.fromkeys(one.input for each in tested for one in each.inputs))
    if driven or inputs:
        said.append(f"correlated with {', '.join(inputs)}" if inputs else f"not correlated with {', '.join(driven)}")
    clean = not colored and not inputs
    for trait, words in ((ResidualDefect.OFFSET, "offset"), (ResidualDefect.SHAPE, "not normal")):
        if series := named(trait):
            said.append(f"{words} ({', '.join(_name(found, each) for each in series)})")
            clean = False
    said += ["periodic"] if found.returning else []
    samples = f" ({_range([each.samples for each in tested])} samples)"
    return "; ".join(said) + samples * (clean and not found.returning)


def _name(found: ResidualAnalysis, series: ResidualSeries) -> str:
    return _in(found, series.output, series.experiment)


def _in(found: ResidualAnalysis, output: str, *experiments: str) -> str:
    several = len({each.experiment for each in found.series}) > 1
    return f"{output} in {listed(experiments)}" if several else output


def _large(found: ResidualAnalysis, finding: ResidualFinding, units: Mapping[str, str | None]) -> Remark:
    series, name = finding.series, _name(found, finding.series)
    if finding.trait is ResidualDefect.COLORED:
        lag, largest = series.whiteness.strongest
        degree = "strongly " if abs(largest) >= 0.5 else ""
        return ResidualMessage.COLORED.said(name=name, degree=degree, value=f"{largest:.2f}", lag=lag)
    if finding.trait is ResidualDefect.OFFSET:
        mean = f"{series.mean:.3g} {unit_text(units.get(series.output))}".rstrip()
        return ResidualMessage.OFFSET.said(name=name, mean=mean, share=f"{abs(series.mean) / series.std:.2g}")
    if (one := finding.input) is not None:
        values = {"value": f"{one.correlation:+.2f}", "lag": f"{one.lag:.3g} s", "band": f"{one.band:.2g}"}
        return ResidualMessage.CORRELATED.said(name=name, input=one.input, **values)
    shape = series.normality
    message = ResidualMessage.OUTLIERS if shape.kurtosis > RESIDUAL_SETTINGS.large_kurtosis else ResidualMessage.SHAPE
    values = {"skewness": two_digits(shape.skewness), "kurtosis": two_digits(shape.kurtosis)}
    return message.said(name=name, outliers=series.outliers, **values)


def widening_words(found: ResidualAnalysis) -> str:
    """Return the factors of σ by the noise, if they matter."""
    known = {name: factor for name, factor in found.widening.items() if math.isfinite(factor)}
    if not any(not 1.0 / LEAST_STD_FACTOR < factor < LEAST_STD_FACTOR for factor in known.values()):
        return ""
    low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
    if known[high] > LEAST_STD_FACTOR * known[low]:
        return f"{two_digits(known[low])} ({low}) to {two_digits(known[high])} × ({high})"
    return f"{two_digits(known[high])} ×"


def is_ordered(found: ResidualAnalysis) -> bool:
    """Return True if rows of an experiment have an order; else their noise has no color."""
    return any(each.noise.series.ordered for each in found.series)


def _widening(found: ResidualAnalysis, *, colored: bool) -> list[Remark]:
    if factors := widening_words(found):
        sure = any(each.trait is ResidualDefect.COLORED for each in found.findings)
        doubted = "the noise may be colored" if is_ordered(found) else "of uneven noise"
        reason = "of colored noise" if sure else doubted
        return [ResidualMessage.WIDENED.said(factors=factors, reason=reason)]
    known = any(map(math.isfinite, found.widening.values()))
    return [ResidualMessage.NOT_WIDENED.said()] if colored and known else []


def _memory(found: ResidualAnalysis) -> list[Remark]:
    """Return unequal sampling, periodic errors, and noise of low frequency."""
    names = [_in(found, output, experiment) for experiment, output in found.off_grid]
    said = [ResidualMessage.IRREGULAR.said(names=listed(names))] if names else []
    for each in found.returning:
        values = {"period": f"{each.period:.3g}", "share": two_digits(100 * each.share)}
        said.append(ResidualMessage.PERIODIC.said(name=_in(found, each.output, each.experiment), **values))
    for slow in found.slow:
        values = {"share": two_digits(100 * slow.share), "seconds": f"{slow.time_constant:.1g}"}
        said.append(ResidualMessage.LOW_FREQUENCY.said(name=_in(found, slow.output, *slow.experiments), **values))
    for long in found.long_memory:
        values = {"seconds": f"{long.time_constant:.1g}", "record": f"{long.record:.3g}"}
        said.append(ResidualMessage.LONG_MEMORY.said(name=_in(found, long.output, *long.experiments), **values))
    return said


def _summary(found: ResidualAnalysis, *, quiet: bool) -> list[Remark]:
    idle = [_name(found, each) for each in found.series if not each.is_tested]
    said = [ResidualMessage.UNTESTED.said(names=listed(idle))] if idle else []
    tested = [each for each in found.series if each.is_tested]
    if not quiet or not tested:
        return said
    for each in tested:
        if traits := [_slight(one) for one in found.findings if one.series is each]:
            said.append(ResidualMessage.SLIGHT.said(name=_name(found, each), traits=listed(traits)))
    names, inputs = [_name(found, each) for each in tested], any(each.inputs for each in tested)
    values = {"residuals": f"Residual of {names[0]} is" if len(names) == 1 else f"Residuals of {listed(names)} are"}
    values["inputs"] = " and not correlated with the inputs" if inputs else ""
    return [*said, ResidualMessage.WHITE.said(**values), _tests(tested)]


def _slight(finding: ResidualFinding) -> str:
    series = finding.series
    if finding.trait is ResidualDefect.COLORED:
        lag, largest = series.whiteness.strongest
        return f"autocorrelation ({largest:.2g} at lag {lag})"
    if finding.trait is ResidualDefect.OFFSET:
        return f"offset ({series.mean / series.std:.2g} standard deviations)"
    if finding.input is not None:
        return f"correlation with {finding.input.input} ({finding.input.correlation:+.2g})"
    shape = series.normality
    return f"skewness ({two_digits(shape.skewness)}) and excess kurtosis ({two_digits(shape.kurtosis)})"


def _tests(series: list[ResidualSeries]) -> Remark:
    inputs = list(dict.fromkeys(one.input for each in series for one in each.inputs))
    crossed = [f"correlation with {listed(inputs)}"] if inputs else []
    lags = _range([each.whiteness.lags for each in series])
    tests = [f"whiteness (Ljung–Box, {lags} lags)", "mean", *crossed, "normality (Jarque–Bera)"]
    samples, level = _range([each.samples for each in series]), f"{100 * RESIDUAL_LEVEL:g}"
    return ResidualMessage.TESTS.said(tests=", ".join(tests), samples=samples, level=level)


def _range(numbers: list[int]) -> str:
    return f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"


CAPTION = (
    "Left: the distribution should follow the normal curve. Middle: the autocorrelation should stay in the band; else "
    "the noise is colored or the model has an error. Right: outside the band, the residual correlates with an input."
)
SHOWN_STDS = 4.0  # half width of the histogram; samples beyond it are in its last bars
INPUT_LOOKS: tuple[tuple[Color, Dash], ...] = (
    ("red", "solid"),
    ("blue", "solid"),
    ("amber", "solid"),
    ("grey", "dashed"),
)
"""Of the inputs with the largest correlations; more lines are too many."""


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
    edges = np.linspace(-SHOWN_STDS, SHOWN_STDS, 41 if known.size > 300 else 21)
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
    most = min(1.15 * max(3.0 * band, float(np.nanmax(np.abs(values), initial=0.0))), 1.05)
    ground = (Layer("zone", {"bottom": -band, "top": band}, alpha=0.14), Layer("rule", {"y": 0.0}, "ink"))
    return Chart(Axis(x), Axis(y, reach=(-most, most)), (*ground, *layers))
