"""Estimates: table, precision, correlation, confidence ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.estimation import Result, TerminationReason
from fmuid.formatting import listed, rounded, unit_text, with_std
from fmuid.identification import CONFIDENCE_LEVEL, ellipse, region_rise
from fmuid.reports.chart import LIMITS, Axis, Chart, Data, Layer, Shades, Units, intervals, kinds, named, rows_of
from fmuid.reports.document import Message, Remark, Section, Table, plain, table_of
from fmuid.reports.render.style import ON_PALE, ON_STRONG
from fmuid.reports.topics.solver_check import shift_text

CAPTION = (
    "Near ±1 two estimates are strongly correlated: use the ellipse instead of their intervals (dashed). Drawn are the "
    "pairs with the largest correlations."
)


FOREST = "Bars: {level:.4g} % intervals. Amber: prior. Rings: initial guesses near them."


class EstimateMessage(Message, section="correlation"):
    """Precision of the estimates."""

    NONE = plain("No σ for {names}.")
    ONE = plain("Relative σ of {name}: {share}.")
    SEVERAL = plain("Relative σ: {least} ({best}) to {most} ({worst}).")


def precision_remarks(result: Result) -> list[Remark]:
    """Return the relative σ of the best and the worst parameter."""
    pairs = zip(result.names, result.values.tolist(), result.std.tolist(), strict=True)
    shares = {name: std / abs(value) for name, value, std in pairs if value and math.isfinite(std)}
    lost = [name for name, std in zip(result.names, result.std.tolist(), strict=True) if math.isinf(std)]
    said = [EstimateMessage.NONE.said(names=listed(lost))] if lost else []
    if len(shares) == 1:
        ((name, share),) = shares.items()
        said.append(EstimateMessage.ONE.said(name=name, share=_percent(share)))
    elif shares:
        best, worst = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
        ends = {"least": _percent(shares[best]), "best": best, "most": _percent(shares[worst]), "worst": worst}
        said.append(EstimateMessage.SEVERAL.said(**ends))
    return said


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def estimates_section(result: Result, level: float = CONFIDENCE_LEVEL) -> Section:
    """Return the table of the estimates with intervals of a level."""
    return Section("estimates", "", table=estimates_table(result, level))


def estimates_table(result: Result, level: float = CONFIDENCE_LEVEL) -> Table:
    """Return the table of estimates with intervals of a level."""
    rows = list(zip(result.names, result.values.tolist(), result.std.tolist(), strict=True))
    ends = result.intervals(level).to_numpy().tolist()
    # digits of a value without σ would be misleading
    value = [f"{value:.2g} ± ?" if std == math.inf else with_std(value, std) for _, value, std in rows]
    columns = {"parameter": list(result.names), "estimate": value}
    if result.outcome is not TerminationReason.STALLED:  # which has no intervals
        columns["relative σ"] = [
            _percent(std / abs(value)) if value and math.isfinite(std) else "" for _, value, std in rows
        ]
        columns[f"{100 * level:.4g} % interval"] = [
            f"{rounded(low, std)} to {rounded(high, std)}" if math.isfinite(std) else "not identifiable"
            for (low, high), (_, _, std) in zip(ends, rows, strict=True)
        ]
    if result.accuracy is not None:
        columns["solver error"] = [shift_text(shift) for shift in result.solver_error.tolist()]
    columns["unit"] = [unit_text(result.estimates.units.get(name)) for name in result.names]
    if np.isfinite(result.estimates.prior_mean).any():
        pairs = zip(result.estimates.prior_mean.tolist(), result.estimates.prior_std.tolist(), strict=True)
        columns["prior"] = [with_std(mean, std) if math.isfinite(mean) else "" for mean, std in pairs]
    columns["initial"] = [f"{start:.6g}" for start in result.estimates.start.tolist()]
    bounded = {bound.name for bound in result.estimates.at_bounds}
    columns["note"] = ["at bound" * (name in bounded) for name in result.names]
    words = [head for head in columns if head not in ("relative σ", "solver error", "initial")]
    return table_of(columns, words, ("initial", "prior", "relative σ", "solver error", "note"))


def forest_section(result: Result, level: float, said: Sequence[Remark]) -> Section:
    """Return estimates with their intervals and priors, in % of each estimate."""
    ends = result.intervals(level).to_numpy()
    kept = np.flatnonzero(np.isfinite(ends).all(axis=1) & (result.values != 0.0))[: LIMITS.parameters]
    if not kept.size:
        return Section("forest", "Estimates")
    scale = np.abs(result.values[kept])
    names = tuple(np.array(result.names, dtype=object)[kept])

    def percent(values: Floats) -> Floats:
        return np.asarray(100.0 * (values - result.values[kept]) / scale)

    low, high, start = percent(ends[kept, 0]), percent(ends[kept, 1]), percent(result.estimates.start[kept])
    middle, half = percent(result.estimates.prior_mean[kept]), 100.0 * result.estimates.prior_std[kept] / scale
    reach, width = 1.6 * float(np.max(np.abs([low, high]))), float(special.ndtri(0.5 + 0.5 * level))
    shown = np.isfinite(half) & (np.abs(middle) - half < reach)
    prior_low, prior_high = np.maximum(middle - width * half, -reach), np.minimum(middle + width * half, reach)
    prior: Data = {"x0": prior_low, "y0": names, "x1": prior_high, "y1": names}
    near = np.abs(start) < reach
    layers = [
        Layer("rule", {"x": 0.0}, "grey", width=1),
        *kinds("segments", prior, [("prior", "amber", shown)], width=9, alpha=0.45),
        *intervals(names, np.zeros(kept.size), low, high, word="deviation, %"),
        *kinds("points", {"x": start, "y": names}, [("initial guess", "white", near)], size=8, edge="ink"),
    ]
    axis = Axis("deviation from the estimate (%)", reach=(-reach, reach))
    chart = rows_of(names, axis, layers, 80)
    return Section(
        "forest", "Estimates", FOREST.format(level=100 * level), charts=(chart,), beside=1, remarks=tuple(said)
    )


def correlation_sections(result: Result, units: Units, level: float = CONFIDENCE_LEVEL) -> list[Section]:
    """Return correlation matrix and ellipses, if any σ is known."""
    if len(result.names) < 2 or not np.isfinite(result.std).any():
        return []
    charts = (_matrix(result.estimates.correlation), *_ellipses(result, units, level))
    return [Section("correlation", "Correlation of the estimates", CAPTION, charts=charts)]


def _matrix(matrix: pd.DataFrame) -> Chart:
    shown = matrix.iloc[: LIMITS.parameters, : LIMITS.parameters]
    names, flat = tuple(map(str, shown.columns)), shown.to_numpy(np.float64).ravel()
    count = len(names)
    across, down = np.meshgrid(np.arange(count), np.arange(count))
    texts = ["?" if math.isnan(v) else "1" if v > 0.9995 else f"{v:+.2f}".replace("-", "−") for v in flat]
    data: Data = {
        "x": tuple(names[i] for i in across.ravel()),
        "y": tuple(names[i] for i in down.ravel()),
        "value": flat,
        "text": tuple(texts) if count <= 12 else ("",) * flat.size,
        "ink": tuple(ON_STRONG if abs(v) > 0.6 else ON_PALE for v in flat),
    }
    hover = (("", "@x, @y"), ("correlation", "@value{0.0000}"))
    layers = (Layer("cells", data, shades=Shades("diverging", -1.0, 1.0), hover=hover), Layer("text", data))
    x = Axis(kind="names", names=names, turned=0.8 if count > 6 else 0.0, grid=False)
    return Chart(x, Axis(kind="names", names=names[::-1], grid=False), layers, max(240, 60 + 34 * count))


def _ellipses(result: Result, units: Units, level: float) -> list[Chart]:
    """Return confidence ellipses of pairs.

    (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) = χ²(2), or 2 F(2, ν) with estimated noise.
    """
    matrix, intervals = result.estimates.correlation.to_numpy(), result.intervals(level).to_numpy()
    known = [i for i in range(len(result.names)) if math.isfinite(result.std[i]) and result.std[i] > 0]
    pairs = sorted(combinations(known, 2), key=lambda pair: -abs(matrix[pair]))[:6]  # as many as are read
    charts = []
    for i, j in sorted(pairs):
        freedom = result.estimates.test_dof([result.names[i], result.names[j]])
        radius = math.sqrt(region_rise(level, freedom))
        x, y = ellipse(result.values[[i, j]], result.covariance[np.ix_([i, j], [i, j])], radius).T
        border: Data = {"x": x, "y": y}
        text = f"{100 * level:g} % region, correlation {matrix[i, j]:+.2f}"
        estimate: Data = {"x": result.values[[i]], "y": result.values[[j]]}
        layers = (
            Layer("line", border, width=2, label=text),
            Layer("patch", border, alpha=0.12, label=text),
            Layer("rule", {"x": intervals[i], "y": intervals[j]}, "grey", dash="dashed"),
            Layer("points", estimate, "amber", size=8, edge="ink", hover=(("estimate", "@x{0.000000}, @y{0.000000}"),)),
        )
        axes = (Axis(named(result.names[i], units), ticks=4), Axis(named(result.names[j], units)))
        charts.append(Chart(*axes, layers, 260))
    return charts
