"""Measured against simulated outputs, and the residual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import evenly, extremes
from fmuid.formatting import counted, fit_text, label, with_unit
from fmuid.identification import ResidualStretch, squared_residual
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Color, Data, Layer, short, stacked
from fmuid.reports.document import Document, Message, Remark, Section, doubt, plain, table_of_rows
from fmuid.reports.topics.row_charts import CAPTIONS, row_charts
from fmuid.simulation import OutputFit

ZOOM_SHARE, ZOOM_SAMPLES = 0.06, 120  # zoom for print: fraction of the experiment, and minimum number of samples
CAPTION = (
    "Dots: measured. Line: simulated with the estimates. Below: residual, which should be noise without a pattern. "
    "The warm-up is grey. Then the share of each stretch in the squared residual, and the inputs. "
    "Drag to zoom; all charts follow."
)
INPUT_COLORS: tuple[Color, ...] = ("ink", "grey", "blue", "amber")
Band = tuple[Floats | None, float]
"""Half widths (K, n_outputs) of the band around the lines, NaN where there is none, and its level."""


class FitMessage(Message, section="fit"):
    """Agreement of measured and simulated outputs."""

    FIT = plain("Fit ({measure}): {scores}.", "NRMSE as in MATLAB; 0 %: no better than the mean")
    LEAST = plain("Lowest fit ({measure}): {scores}.")
    STRETCH = doubt(
        "{share} of the squared residual{where} lies in {start} to {end} s ({time} of the time).",
        "an event, an outlier, or a state that starts elsewhere",
        "Look at this stretch; set `warmup` if it is the first.",
    )


CONSTANT = "constant as measured: no fit"  # in place of a fit in % of an output without spread


def fit_remarks(fits: Sequence[OutputFit]) -> list[Remark]:
    """Return the fit of the outputs; of many the worst."""
    counts = [(fit, j) for fit in fits for j in np.flatnonzero(fit.counted.any(axis=0)).tolist()]
    known = [(fit, j) for fit, j in counts if math.isfinite(fit.fit[j])]
    if len(counts) > 4 and known:
        least, j = min(known, key=lambda each: each[0].fit[each[1]])
        named = f"{least.outputs[j]} in {least.experiment}" if len(fits) > 1 else least.outputs[j]
        scores = f"{named} {_score(least.fit[j], least.rmse[j], least.units[j])}"
        return [FitMessage.LEAST.said(measure=fit_measure([least]), scores=scores)]
    scores = fit_scores(fits)
    return [FitMessage.FIT.said(measure=fit_measure(fits), scores=scores)] if scores else []


def fit_measure(fits: Sequence[OutputFit]) -> str:
    """Return the names of the measures of fit."""
    return " or ".join(dict.fromkeys("relative error" if fit.kind == "frequency" else "NRMSE" for fit in fits))


def stretch_remarks(found: Sequence[ResidualStretch], experiments: int) -> list[Remark]:
    """Return the stretches with most of the residual."""
    return [
        FitMessage.STRETCH.said(
            share=f"{100 * each.share:.0f} %",
            where=f" of {each.experiment}" if experiments > 1 else "",
            start=f"{each.start:.4g}",
            end=f"{each.end:.4g}",
            time=f"{100 * each.time_share:.2g} %",
        )
        for each in found
    ]


def fit_scores(fits: Sequence[OutputFit]) -> str:
    """Return fit and RMSE of each measured output as text."""
    said = []
    for each in fits:
        scores = zip(each.outputs, each.fit, each.rmse, each.units, each.counted.T, strict=True)
        told = [f"{name} {_score(fit, rmse, unit)}" for name, fit, rmse, unit, counted in scores if counted.any()]
        if told:
            said.append((f"{each.experiment}: " if len(fits) > 1 else "") + ", ".join(told))
    return "; ".join(said)


def _score(fit: float, rmse: float, unit: str | None) -> str:
    error = f"RMSE {with_unit(rmse, unit)}"
    return f"{error} ({CONSTANT})" if math.isnan(fit) and math.isfinite(rmse) else f"{fit_text(fit)} ({error})"


def simulation_document(fits: Sequence[OutputFit]) -> Document:
    """Return the document of a simulation: fit and RMSE."""
    state, said = counted(len(fits), "experiment"), tuple(fit_remarks(fits))
    return Document("simulation", "Simulation", state, "good", said, (scores_section(fits),))


def scores_section(fits: Sequence[OutputFit]) -> Section:
    """Return the table of fit and RMSE."""
    rows = []
    for fit in fits:
        for k, (output, percent, rmse) in enumerate(zip(fit.outputs, fit.fit, fit.rmse, strict=True)):
            counted = int(fit.counted[:, k].sum())
            said = (fit_text(percent), with_unit(rmse, fit.units[k])) if counted else ("not measured", "")
            name = fit.experiment if len(fits) > 1 else ""
            rows.append((name, label(output, fit.units[k]), *said, str(counted)))
    heads = ("experiment", "output", "fit", "RMSE", "samples")
    return Section("scores", "Measured against simulated", table=table_of_rows(heads, rows, ("output",)))


def fit_sections(
    fits: Sequence[OutputFit],
    heading: str = "Measured and simulated",
    caption: str = CAPTION,
    bands: Mapping[str, Band] | None = None,
    key: str = "fit",
) -> list[Section]:
    """Return a section per experiment, of many those that fit worst."""
    shown, sections = worst(fits), []
    if len(shown) < len(fits):
        caption += f" Drawn: the {LIMITS.experiments} of {len(fits)} experiments with the lowest fit."
    if any(len(fit.outputs) > LIMITS.outputs for fit in shown):
        caption += f" Drawn: the {LIMITS.outputs} outputs with the lowest fit."
    for k, fit in enumerate(shown):
        band = (bands or {}).get(fit.experiment)
        words = heading + (f": {fit.experiment}" if len(fits) > 1 else "")
        anchor, text = (key, caption) if k == 0 else (f"{key}-{k + 1}", "")
        if fit.kind != "time":
            half = None if band is None else band[0]
            told = CAPTIONS[fit.kind] if text else ""
            sections.append(Section(anchor, words, told, charts=(row_charts(fit, half),), beside=1))
            continue
        charts, zoom = (fit_charts(fit, band),), fit_charts(fit, band, zoomed(fit))
        sections.append(Section(anchor, words, text, charts=charts, beside=1, zoom=zoom))
    return sections


def worst(fits: Sequence[OutputFit]) -> tuple[OutputFit, ...]:
    """Return the `LIMITS.experiments` experiments of least fit, in their order."""
    kept = sorted(fits, key=lambda fit: np.nanmin([100.0, *fit.fit]))[: LIMITS.experiments]
    return tuple(fit for fit in fits if fit in kept)


def drawn_outputs(fit: OutputFit) -> list[int]:
    """Return the `LIMITS.outputs` outputs of least fit, in their order."""
    order = np.argsort(np.nan_to_num(np.asarray(fit.fit), nan=100.0), kind="stable")
    return sorted(int(output) for output in order[: LIMITS.outputs])


def zoomed(fit: OutputFit) -> slice:
    """Return the rows with the largest total variation of the simulated outputs."""
    samples = len(fit.times)
    width = min(samples, max(ZOOM_SAMPLES, round(ZOOM_SHARE * samples)))
    moves = np.abs(np.diff(fit.simulated[:, drawn_outputs(fit)], axis=0, prepend=0.0))
    moves[0] = 0.0
    moves[~fit.counted.any(axis=1)] = 0.0
    total = moves.sum(axis=0)
    activity = (moves / np.where(total > 0, total, 1.0)).sum(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(activity)])
    start = int(np.argmax(summed[width:] - summed[:-width])) if samples > width else 0
    return slice(start, start + width)


def fit_charts(fit: OutputFit, band: Band | None = None, rows: slice = slice(None)) -> ChartGrid:
    """Return measured and simulated outputs with their residuals."""
    outputs, scores = drawn_outputs(fit), fit.fit
    half = None if band is None else band[0]
    times, measured, simulated = fit.times[rows], fit.measured[rows][:, outputs], fit.simulated[rows][:, outputs]
    with np.errstate(invalid="ignore", over="ignore"):
        residual = measured - simulated
    kept = extremes(np.hstack([simulated, residual]), LIMITS.rows)
    some = kept if len(kept) == len(times) <= LIMITS.dots else evenly(len(times), LIMITS.dots)
    thin = times[kept]
    dots = thin if some is kept else times[some]
    across = Axis("time (s)", reach=(float(times[0]), float(times[-1])), linked="time", ticks=8)
    grey = uncounted(fit, rows)
    charts = []
    for k, j in enumerate(outputs):
        line, rest = (short(each[kept, k]) for each in (simulated, residual))
        seen = short(measured[some, k])
        own = short(measured[kept, k]) if some is not kept else seen
        name = "simulated" if math.isnan(scores[j]) else f"simulated, fit {fit_text(scores[j])}"
        upper: list[Layer] = [*grey]
        lower: list[Layer] = [*grey]
        if half is not None and band is not None:
            width = half[rows][kept, j]
            sides = {"y0": short(simulated[kept, k] - width), "y1": short(simulated[kept, k] + width)}
            upper.append(Layer("band", {"x": thin, **sides}, alpha=0.18, label=f"{100 * band[1]:.4g} % band"))
            lower.append(Layer("band", {"x": thin, "y0": short(-width), "y1": short(width)}, alpha=0.18))
        size = 3 if len(dots) > 600 else 5
        upper.append(Layer("points", {"x": dots, "y": seen}, "grey", alpha=0.6, size=size, label="measured"))
        numbers = (("measured", "@m{0.00000}"), ("simulated", "@y{0.00000}"), ("residual", "@r{0.00000}"))
        hover = (("time", "@x{0.0000} s"), *numbers)
        upper.append(Layer("line", {"x": thin, "y": line, "m": own, "r": rest}, label=name, hover=hover))
        lower.append(Layer("line", {"x": thin, "y": rest}, "red", width=0.9))
        lower.append(Layer("rule", {"y": 0.0}, "ink"))
        text, error = label(fit.outputs[j], fit.units[j]), label("residual", fit.units[j])
        charts.append(Chart(across, Axis(text), tuple(upper), 220, crosshair=True))
        charts.append(Chart(across, Axis(error, ticks=3), tuple(lower), 110, crosshair=True))

    charts += [_location_chart(fit, rows, across), *_input_charts(fit, rows, across)]

    def of(start: float, end: float) -> ChartGrid:
        first, last = np.searchsorted(fit.times, [start, end])
        return fit_charts(fit, band, slice(max(0, int(first) - 1), min(len(fit.times), int(last) + 1)))

    return replace(stacked(charts), live=of)


def _location_chart(fit: OutputFit, rows: slice, across: Axis) -> Chart:
    """Return the share of each stretch in the squared residual."""
    times, shares = fit.times[rows], squared_residual(fit)[rows]
    edges = np.linspace(times[0], times[-1], LIMITS.stretches + 1)
    sums = np.histogram(times, edges, weights=shares)[0] * 100.0
    data: Data = {"x": edges, "y": np.append(sums, sums[-1])}
    hover = (("from", "@x{0.0000} s"), ("share", "@y{0.0} %"))
    layers = (Layer("step", data, "red", hover=hover), *uncounted(fit, rows))
    height = 110 if fit.inputs is not None else 140
    return Chart(across, Axis("residual² (%)", ticks=3, reach=(0.0, None)), layers, height, crosshair=True)


def _input_charts(fit: OutputFit, rows: slice, across: Axis) -> list[Chart]:
    """Return the inputs over time, those of one unit in one chart."""
    given = fit.inputs
    if given is None:
        return []
    times, values = fit.times[rows], given.values[rows]
    groups: dict[str | None, list[int]] = {}
    for j, unit in enumerate(given.units[: LIMITS.outputs]):
        groups.setdefault(unit, []).append(j)
    charts = []
    for unit, columns in groups.items():
        kept = extremes(values[:, columns], LIMITS.rows)
        layers = [
            Layer(
                "step" if given.held[j] else "line",
                {"x": times[kept], "y": short(values[kept, j])},
                INPUT_COLORS[k % len(INPUT_COLORS)],
                1.2,
                label=given.names[j] if len(columns) > 1 else "",
                hover=(("time", "@x{0.0000} s"), (given.names[j], "@y{0.00000}")),
            )
            for k, j in enumerate(columns)
        ]
        name = given.names[columns[0]] if len(columns) == 1 else "inputs"
        charts.append(Chart(across, Axis(label(name, unit), ticks=3), tuple(layers), 130, crosshair=True))
    return [*charts[:-1], replace(charts[-1], height=160)]


def uncounted(fit: OutputFit, rows: slice = slice(None)) -> list[Layer]:
    """Return the grey zone of the warm-up."""
    counted = np.asarray(fit.counted[rows].any(axis=1))
    if fit.kind != "time" or not counted.any() or counted[0]:
        return []
    return [Layer("zone", {"right": float(fit.times[rows][int(counted.argmax())])}, "grey", alpha=0.18)]
