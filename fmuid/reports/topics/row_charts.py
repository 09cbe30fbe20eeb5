"""Figures of experiments without a time: Bode, Nyquist and load curves, and points that pull most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.data import RESPONSE_PARTS, complex_values, response_of
from fmuid.formatting import label, two_digits
from fmuid.identification import Contributions
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Layer, short
from fmuid.reports.document import PAGE, Section, table_of_rows
from fmuid.simulation import OutputFit
from fmuid.units import parse_unit

CAPTIONS = {
    "frequency": "Dots: measured. Line: simulated. Band: where a new measurement is expected. Below: relative error.",
    "steady": "Dots: measured. Crosses: simulated. Bars: where a new measurement is expected. Below: residual.",
}


@dataclass(frozen=True)
class RowChartSettings:
    """Numbers of the charts."""

    points: int = 10  # in the table of those that pull most
    wide: float = 30.0  # ratio of inputs from which their axis is logarithmic


SETTINGS = RowChartSettings()


def row_charts(fit: OutputFit, half: Floats | None) -> ChartGrid:
    """Return the charts of a fit without a time; `half` (K, n_outputs) are half widths of the band."""
    if fit.kind == "frequency":
        return _bode(fit, half)
    return _load_curves(fit, half)


def _bode(fit: OutputFit, half: Floats | None) -> ChartGrid:
    """Return Bode and Nyquist charts of responses, with relative errors."""
    frequency = fit.axis["frequency"]
    order = np.argsort(frequency, kind="stable")
    x, rows = frequency[order], list[tuple[Chart | None, ...]]()
    assert fit.readings is not None, "of a response"
    across = Axis(label("frequency", "Hz"), "log", linked="frequency")
    for j, name in enumerate(fit.outputs[: LIMITS.outputs]):
        measured, simulated = fit.measured[order, j], fit.simulated[order, j]
        log = name.endswith(".magnitude") and bool((measured > 0.0).all() and (simulated > 0.0).all())
        layers = [] if half is None else [_band(x, simulated, half[order, j], log)]
        layers += [
            Layer("points", {"x": x, "y": short(measured)}, "grey", alpha=0.6, size=5, label="measured"),
            Layer("line", {"x": x, "y": short(simulated)}, label="simulated", hover=(("value", "@y{0.00000}"),)),
        ]
        percent = 100.0 / fit.readings[order, j]
        error = Layer("points", {"x": x, "y": short(percent * (measured - simulated))}, "red", size=4)
        parts = [] if half is None else [_band(x, np.zeros(x.size), percent * half[order, j], False)]
        parts += [error, Layer("rule", {"y": 0.0}, "ink")]
        minus = "−" if response_of(name) in fit.conjugate and name.endswith((".imaginary", ".phase")) else ""
        above = Axis(label(f"{minus}{name}", fit.units[j]), "log" if log else "linear")
        rows += [
            (Chart(across, above, tuple(layers), 200),),
            (Chart(across, Axis("error (%)", ticks=3), tuple(parts), 110),),
        ]
    return ChartGrid((*rows, *((each,) for each in _nyquist(fit, order))))


def _band(x: Floats, y: Floats, half: Floats, log: bool) -> Layer:
    low = np.maximum(y - half, 1e-3 * y) if log else y - half
    return Layer("band", {"x": x, "y0": short(low), "y1": short(y + half)}, alpha=0.18, label="95 % band")


def _nyquist(fit: OutputFit, order: Indices) -> Iterator[Chart]:
    """Yield the complex plane of each response with two parts."""
    for name in dict.fromkeys(map(response_of, fit.outputs)):
        measured, simulated = (_complex(fit, name, table) for table in (fit.measured, fit.simulated))
        if measured is None or simulated is None:
            continue
        unit = next(unit for each, unit in zip(fit.outputs, fit.units, strict=True) if response_of(each) == name)
        unit = None if unit == "dB" else unit
        capacitive = name in fit.conjugate or (_is_impedance(unit) and np.nansum(measured.imag) < 0.0)
        sign, minus = (-1.0, "−") if capacitive else (1.0, "")  # as of batteries: arcs point upwards
        points, line = (
            {"x": short(each.real[order]), "y": short(sign * each.imag[order])} for each in (measured, simulated)
        )
        layers = (
            Layer("points", points, "grey", alpha=0.6, size=5, label="measured"),
            Layer("line", line, label="simulated"),
        )
        yield Chart(Axis(label(f"Re {name}", unit)), Axis(label(f"{minus}Im {name}", unit)), layers, 300)


def _is_impedance(unit: str | None) -> bool:
    """Return whether a unit is that of an impedance."""
    own, ohm = None if unit is None else parse_unit(unit), parse_unit("Ohm")
    return own is not None and ohm is not None and own.exponents == ohm.exponents


def _complex(fit: OutputFit, name: str, table: Floats) -> np.ndarray | None:
    """Return a response (K,) by its parts; None of one part alone."""
    own = {part: f"{name}.{part}" for part in RESPONSE_PARTS if f"{name}.{part}" in fit.outputs}
    parts = {part: table[:, fit.outputs.index(output)] for part, output in own.items()}
    if len(parts) < 2:
        return None
    return np.conj(complex_values(parts)) if name in fit.conjugate else complex_values(parts)


def _load_curves(fit: OutputFit, half: Floats | None) -> ChartGrid:
    """Return each output over the input with most values, with its residual."""
    inputs = {name: each for name, each in fit.axis.items() if name != "row"}
    name = max(inputs, key=lambda each: len(np.unique(inputs[each]))) if inputs else "row"
    x, rows = fit.axis[name], list[tuple[Chart | None, ...]]()
    wide = bool((x > 0.0).all()) and x.max() > SETTINGS.wide * x.min()
    across = Axis(name, "log" if wide else "linear", linked="points")
    for j, output in enumerate(fit.outputs[: LIMITS.outputs]):
        measured, simulated = fit.measured[:, j], fit.simulated[:, j]
        layers = []
        if half is not None:
            ends = {"x0": x, "x1": x, "y0": short(simulated - half[:, j]), "y1": short(simulated + half[:, j])}
            layers.append(Layer("segments", ends, width=2, alpha=0.5, label="95 % band"))
        hover = (("row", "@row"), ("measured", "@y{0.00000}"), ("simulated", "@s{0.00000}"))
        data = {"x": x, "y": short(measured), "s": short(simulated), "row": fit.times}
        layers += [
            Layer("points", data, "grey", alpha=0.6, size=8, label="measured", hover=hover),
            Layer("points", {"x": x, "y": short(simulated)}, marker="x", size=8, label="simulated"),
        ]
        rest = Layer("points", {"x": x, "y": short(measured - simulated)}, "red", size=5)
        parts = [rest, Layer("rule", {"y": 0.0}, "ink")]
        if half is not None:
            ends = {"x0": x, "x1": x, "y0": short(-half[:, j]), "y1": short(half[:, j])}
            parts.insert(0, Layer("segments", ends, width=2, alpha=0.4))
        axis, unit = Axis(label(output, fit.units[j])), fit.units[j]
        error = Axis(label("residual", unit), ticks=3)
        rows += [(Chart(across, axis, tuple(layers), 220),), (Chart(across, error, tuple(parts), 120),)]
    return ChartGrid(tuple(rows))


def bands(found: Contributions | None, fits: Sequence[OutputFit], factor: float) -> Mapping[str, Floats]:
    """Return half widths (K, n_outputs) of bands, by experiment."""
    if found is None:
        return {}
    pairs = zip(fits, found.std, found.noise, strict=True)
    return {fit.experiment: factor * np.hypot(std, noise) for fit, std, noise in pairs if fit.kind != "time"}


def contribution_sections(
    found: Contributions | None, names: Sequence[str], fits: Sequence[OutputFit]
) -> list[Section]:
    """Return what each experiment brings, and points that pull most."""
    if found is None:
        return []
    sections, rows = [], []
    for each in found.parts:
        own = each.widening[: len(names)]  # sizes of freed errors follow
        factors = (f"× {factor:.3g}" if np.isfinite(factor) else "only here" for factor in own)
        agreement = "" if np.isnan(each.probability) else f"p = {each.probability:.2g}"
        rows.append((each.experiment, *factors, agreement))
    if rows:
        text = (
            "σ of each parameter without this experiment, relative to σ with all. Last column: probability of such a "
            "difference from the others by chance; below 0.01 it contradicts them."
        )
        table = table_of_rows(("without", *names, "agreement"), rows)
        sections.append(Section("contributions", "What each experiment brings", text, table=table))
    pulls = [
        (found.leverage[i][k, j], fit, int(k), j)
        for i, fit in enumerate(fits)
        if fit.kind != "time"
        for k, j in zip(*np.nonzero(np.nan_to_num(found.leverage[i]) > 0.0), strict=True)
    ]
    pulls = sorted(pulls, key=lambda each: -each[0])[: SETTINGS.points]
    if pulls:
        heads, cells = ("experiment", "row", "output", "leverage", "residual"), []
        for pull, fit, k, j in pulls:
            rest = two_digits(fit.measured[k, j] - fit.simulated[k, j])
            cells.append((fit.experiment, str(k + 1), fit.outputs[j], f"{pull:.2f}", rest))
        text = "Leverage: share of a point in its own fit. Points near 1 decide a parameter alone; measure them twice."
        table = table_of_rows(heads, cells, ("output",))
        chart = _leverage_chart(found, fits)
        sections.append(Section("leverage", "Points that pull most", text, table, (chart,), shown=PAGE))
    return sections


def _leverage_chart(found: Contributions, fits: Sequence[OutputFit]) -> Chart:
    """Return the residual of each point over its leverage."""
    x, y = [], []
    for fit, pull, noise in zip(fits, found.leverage, found.noise, strict=True):
        if fit.kind != "time":
            there = np.isfinite(pull) & fit.counted
            x.append(pull[there])
            y.append(((fit.measured - fit.simulated) / noise)[there])
    data = {"x": short(np.concatenate(x)), "y": short(np.concatenate(y))}
    hover = (("leverage", "@x{0.00}"), ("residual", "@y{0.0} σ"))
    layers = Layer("points", data, alpha=0.7, hover=hover), Layer("rule", {"y": 0.0}, "ink")
    return Chart(Axis("leverage", reach=(0.0, 1.0)), Axis("residual (σ)"), layers, 260)
