"""Figure for print: the criterion of prior, data and both over parameters, as figure 1.1 of the chapter has it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from fmuid.assessment import both_known
from fmuid.assessment import parabolas as parabolas_of
from fmuid.errors import InputError
from fmuid.reports.figures.style import AMBER, BLUE, GREY, MAX_PARAMETERS, WIDTH, style
from fmuid.text import label

PARTS = (("prior", "prior", AMBER, "--"), ("data", "data alone", GREY, "-."), ("both", "both", BLUE, "-"))
HEIGHT = 1.05
"""Of a panel, in the greatest value of the sum."""


def parabolas(
    reading: pd.DataFrame, names: Sequence[str] = (), units: Mapping[str, str | None] | None = None
) -> Figure:
    """Draw the parabolas of prior, data and both, a panel each parameter.

    Parameters
    ----------
    reading : DataFrame
        `fmuid.assessment.Reading.table`, or ``reading.csv``.
    names : sequence of str
        Default: all that prior and data both speak of.
    units : mapping of str to str, optional
        Of the parameters.

    Raises
    ------
    InputError
        If there is no such parameter, it has no standard deviation, or none has both prior and data.
    """
    shown = list(names or both_known(reading))[:MAX_PARAMETERS]
    if not shown:
        raise InputError("there are no parabolas to draw: prior and data both speak of no parameter")
    columns = min(len(shown), 2)
    rows = math.ceil(len(shown) / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 0.55 + 2.2 * rows), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, name in zip(panels, shown, strict=False):
            curves = parabolas_of(reading, name)
            for part, text, color, dashes in PARTS:
                axes.plot(curves["value"], curves[part], color=color, ls=dashes, label=text)
            axes.set_xlim(curves["value"].iloc[0], curves["value"].iloc[-1])
            axes.set_ylim(0.0, HEIGHT * float(curves["both"].max()))
            axes.set_xlabel(label(name, (units or {}).get(name)))
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[: len(shown) : columns]:
            axes.set_ylabel("criterion")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
