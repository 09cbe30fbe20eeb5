"""Preprocessing of data files: columns before and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from fmuid.reports.chart import LIMITS, Axis, Chart, ChartGrid, Color, Layer, Units, named, stacked
from fmuid.reports.document import Section, capitalized
from fmuid.runs import PreprocessedTable

CAPTION = "Grey: as recorded. Blue: as used. Unchanged columns are not drawn."
STAGES: tuple[tuple[str, str, Color, float], ...] = (
    ("before", "as recorded", "grey", 1.2),
    ("after", "as used", "blue", 1.6),
)


def preprocessing_charts(table: pd.DataFrame, units: Units | None = None) -> ChartGrid:
    """Return the changed columns before and after, over time."""
    times = table["time"].to_numpy(np.float64)
    across = Axis("time (s)", reach=(float(times.min()), float(times.max())), linked="time", ticks=8)
    charts = []
    for name in list(dict.fromkeys(table["column"]))[: LIMITS.outputs]:
        rows, layers = table[table["column"] == name], []
        for stage, text, color, width in STAGES:
            part = rows[rows["stage"] == stage]
            data = {"x": part["time"].to_numpy(np.float64), "y": part["value"].to_numpy(np.float32)}
            hover = ((text, "@y{0.00000}"), ("time", "@x{0.0000} s"))
            layers += [Layer("line", data, color, width=width, label=text, hover=hover)] if len(part) else []
        charts.append(Chart(across, Axis(named(str(name), units)), tuple(layers), 200, crosshair=True))
    return stacked(charts)


def preprocessing_sections(
    prepared: Sequence[PreprocessedTable], several: bool, key: str = "preparation"
) -> list[Section]:
    """Return a section per preprocessed data file."""
    shown: list[Section] = []
    for each in [one for one in prepared if one.words and len(one.table)][: LIMITS.experiments]:
        heading = "Preprocessing" + (f": {each.experiment}" if several else "")
        caption = f"{preparation_words(each.words)}." + ("" if shown else f" {CAPTION}")
        anchor = key if not shown else f"{key}-{len(shown) + 1}"
        charts = (preprocessing_charts(each.table, each.units),)
        shown.append(Section(anchor, heading, caption, charts=charts, beside=1))
    return shown


def preparation_words(words: Mapping[str, Any]) -> str:
    """Return the preprocessing steps as text."""
    done = list(_done(words))
    return capitalized("; ".join(done)) if done else "None"


def _done(words: Mapping[str, Any]) -> Iterator[str]:
    if words.get("computed_columns"):
        yield f"computed columns: {', '.join(f'{name} = {text}' for name, text in words['computed_columns'].items())}"
    if words.get("fill_missing"):
        gap = f" up to {words['max_gap']:g} s" if words.get("max_gap") else ""
        yield f"gaps{gap} filled ({', '.join(f'{name}: {how}' for name, how in words['fill_missing'].items())})"
    for each in words.get("park", ()):
        yield f"transformed from {', '.join(each['source'])} to {', '.join(each['target'])}"
    if "lowpass_frequency" in words:
        yield f"low-pass filter of {words['lowpass_frequency']:g} Hz without delay"
    ends = {"from": "start_time", "to": "end_time"}
    if cut := [f"{word} {words[key]:g} s" for word, key in ends.items() if key in words]:
        yield f"cut {' '.join(cut)}"
    if "resample_interval" in words:
        yield f"resampled to {words['resample_interval']:g} s"
    if "detrend" in words:
        given = words["detrend"]
        each = ", ".join(f"{name}: {how}" for name, how in given.items()) if isinstance(given, dict) else given
        yield f"detrended ({each})"
