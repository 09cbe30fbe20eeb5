"""The sections of a page that show measured and simulated outputs, and what is left between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.reports.interactive import fit, residuals
from fmuid.reports.interactive.style import MAX_EXPERIMENTS, MAX_OUTPUTS
from fmuid.reports.page.document import Section
from fmuid.simulation import OutputFit

RESIDUALS = (
    "Left: the residual's distribution should follow the normal curve. Middle: its autocorrelation should stay in the "
    "band; else the model or the noise has dynamics of its own and the intervals are not as stated. Right: outside the "
    "band, the residual depends on an input, which the model does not take up rightly."
)
"""How to read them."""


def fit_sections(
    name: str,
    heading: str,
    caption: str,
    records: Sequence[OutputFit],
    bands: Mapping[str, tuple[Floats | None, float]] | None = None,
) -> list[Section]:
    """Return a section an experiment, of many for those that fit worst.

    Parameters
    ----------
    name, heading, caption : str
    records : sequence of OutputFit
    bands : mapping of str to (array or None, float), optional
        Half widths (K, n_outputs) of the bands around the lines, and their level, by the names of the experiments.
    """
    shown, sections = fit.worst(records), []
    if len(shown) < len(records):
        caption += f" Of {len(records)} experiments the {MAX_EXPERIMENTS} that fit worst are drawn."
    if any(len(record.outputs) > MAX_OUTPUTS for record in shown):
        caption += f" Of more than {MAX_OUTPUTS} outputs those that fit worst are drawn."
    for k, record in enumerate(shown):
        band = (bands or {}).get(record.experiment, ())
        whole, part = fit.fit(record, *band), fit.fit(record, *band, rows=fit.zoom(record))
        words = heading + (f": {record.experiment}" if len(records) > 1 else "")
        anchor, text = (name, caption) if k == 0 else (f"{name}-{k + 1}", "")
        sections.append(Section(anchor, words, text, [whole], 1, zoom=part, fit=(record, *band)))
    return sections


def residual_section(records: Sequence[OutputFit], correlations: pd.DataFrame) -> Section:
    """Return the section on the residuals.

    Parameters
    ----------
    records : sequence of OutputFit
    correlations : DataFrame
        As in ``correlations.csv``.
    """
    figures = []
    for record in fit.worst(records):
        for j, output in list(enumerate(record.outputs))[:MAX_OUTPUTS]:
            rows = correlations[(correlations["experiment"] == record.experiment) & (correlations["output"] == output)]
            values = np.where(record.counted[:, j], record.measured[:, j] - record.simulated[:, j], np.nan)
            own, others = rows[rows["with"] == output], rows[rows["with"] != output]
            figures += [residuals.histogram(values, output)]
            figures += [residuals.autocorrelation(own, output)] if len(own) else []
            figures += [residuals.with_inputs(others, output)] if len(others) else []
    return Section("residuals", "Residuals", RESIDUALS, figures)
