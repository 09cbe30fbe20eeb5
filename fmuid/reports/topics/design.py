"""Design of experiments: ranked excitations and sensitivities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from fmuid.data import extremes
from fmuid.formatting import counted
from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Color, Dash, Layer, Units, named, short, stacked
from fmuid.reports.document import Document, Message, Remark, Section, Table, doubt, origin_of, plain, table_of
from fmuid.reports.topics.model_comparison import ranked_bars
from fmuid.runs import Provenance

LONG_ENOUGH = 1.1  # healthy data are long enough if endless data lower the detectable size by less than this factor
WORST = "Largest relative σ of the parameters. Shorter is better; the best excitation is red."
FOUND = "Minimum detectable fault size over its magnitude. Shorter is better; the best excitation is red."
SENSITIVITIES = (
    "Effect of a relative change of a parameter on each output, θ ∂y/∂θ. Small lines: weakly identifiable parameters. "
    "Similar lines: strongly correlated parameters."
)
HEADS = {"duration": "duration (s)", "log_determinant": "log-determinant"}
_COLORS: tuple[Color, ...] = ("blue", "red", "amber", "grey")
_DASHES: tuple[Dash, ...] = ("solid", "dashed")
LOOKS = [(color, dash) for dash in _DASHES for color in _COLORS]  # lines of a chart: the largest ones


class DesignMessage(Message, section="excitations"):
    """Ranking of excitations, and length of the healthy data."""

    ACCURATE = plain("{excitation}: relative σ of all parameters at most {worst:.3g} %.")
    SHOWS = plain("{excitation}: faults detectable from {worst:.3g} % of their magnitude.")
    BLIND = doubt(
        "{size}: not detectable with this excitation.",
        "it has no effect on the outputs, or that of another cause",
        "Use another excitation.",
    )
    LENGTH = doubt(
        "{size}: detectable size is {times:.3g} × its limit; with {length:g} × longer healthy data, {longer:.3g} ×.",
        "the limit is that of endless healthy data",
    )
    SENSITIVITIES = plain("Sensitivities at the initial guesses.")


def design_document(
    ranked: pd.DataFrame, cost: pd.DataFrame | None = None, origin: Provenance | None = None
) -> Document:
    """Return the document of excitations."""
    names, accuracy = [str(name) for name in ranked["excitation"]], "log_determinant" in ranked
    text, caption = ("largest relative σ", WORST) if accuracy else ("detectable fault size / magnitude", FOUND)
    worst = 100.0 * ranked["worst"].to_numpy(np.float64)
    one = f"{names[0]}, best of {len(names)} excitations" if len(names) > 1 else names[0]
    how = DesignMessage.ACCURATE if accuracy else DesignMessage.SHOWS
    said = [how.said(excitation=one, worst=worst[0])]
    chart = ranked_bars(names, worst, f"{text} (%)")
    heading = "Excitations, best first"
    sections = [Section("excitations", heading, caption, _numbers(ranked), (chart,), 1)]
    if cost is not None:
        title = f"Minimum detectable size by length of the healthy data (1: as long as {names[0]})"
        sections.append(Section("lengths", title, table=_numbers(cost)))
        said += healthy_record_remarks(cost)
    return Document("design", "Design", f"best: {names[0]}", "good", tuple(said), tuple(sections), **origin_of(origin))


def healthy_record_remarks(cost: pd.DataFrame) -> list[Remark]:
    """Return the effect of the healthy record's length on each fault size."""
    said, lengths = [], cost["healthy"]
    for column in [str(each) for each in cost if str(each).endswith(".times")]:
        name, times = column.removesuffix(".times"), cost[column]
        if not times.notna().all():
            said.append(DesignMessage.BLIND.said("lengths", size=name))
            continue
        enough = next((k for k in range(1, len(times)) if times.iloc[k] <= LONG_ENOUGH), len(times) - 1)
        values = {"times": times.iloc[0], "length": lengths.iloc[enough], "longer": times.iloc[enough]}
        said.append(DesignMessage.LENGTH.said("lengths", size=name, **values))
    return said


def _numbers(frame: pd.DataFrame) -> Table:
    columns = {HEADS.get(str(name), str(name)): [_cell(each) for each in frame[name].tolist()] for name in frame}
    return table_of(columns)


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4g}" if math.isfinite(value) else ""


def sensitivity_document(
    tables: Sequence[tuple[str, pd.DataFrame]], units: Units, origin: Provenance | None = None
) -> Document:
    """Return the document of sensitivities."""
    sections = []
    for k, (name, rows) in enumerate(tables[: LIMITS.experiments]):
        heading = f"Sensitivities: {name}" if len(tables) > 1 else "Sensitivities"
        key, caption = (f"sensitivities-{k + 1}", "") if k else ("sensitivities", SENSITIVITIES)
        sections.append(Section(key, heading, caption, charts=(sensitivity_charts(rows, units),), beside=1))
    state = counted(len(tables), "experiment")
    said = DesignMessage.SENSITIVITIES.said("sensitivities")
    return Document("sensitivities", "Sensitivities", state, "good", (said,), tuple(sections), **origin_of(origin))


def sensitivity_charts(table: pd.DataFrame, units: Units) -> ChartGrid:
    """Return θ ∂ŷ/∂θ (1.33) of each output over time, frequency or rows."""
    pairs = [str(name) for name in table.columns if "/" in str(name)]
    over = str(table.columns[0])
    times = table[over].to_numpy(np.float64)
    label, reach = "time (s)" if over == "time" else over, (float(times.min()), float(times.max()))
    across = Axis(label, "log" if over == "frequency" else "linear", reach=reach, linked=over)
    charts = []
    for output in list(dict.fromkeys(name.rpartition("/")[0] for name in pairs))[: LIMITS.outputs]:
        mine = [name for name in pairs if name.rpartition("/")[0] == output]
        values = table[mine].to_numpy(np.float64)
        largest = sorted(np.argsort(-np.nansum(values**2, axis=0), kind="stable")[: len(LOOKS)].tolist())
        kept = extremes(values[:, largest], LIMITS.rows)
        thin, layers = times[kept], []
        for k, (color, dash) in zip(largest, LOOKS, strict=False):
            data = {"x": thin, "y": short(values[kept, k])}
            layers.append(Layer("line", data, color, dash=dash, width=1.4, label=mine[k].rpartition("/")[2]))
        layers.append(Layer("rule", {"y": 0.0}, "ink"))
        charts.append(Chart(across, Axis(named(output, units)), tuple(layers), 210))
    return stacked(charts)
