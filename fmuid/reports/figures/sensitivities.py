"""Figures of sensitivity functions: what relative changes of the parameters do to each output."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from fmuid.files import file_name
from fmuid.reports.figures.style import MAX_EXPERIMENTS, MAX_OUTPUTS, WIDTH, style, thin
from fmuid.text import label

if TYPE_CHECKING:
    from fmuid.model_problem import SensitivityFunctions


def sensitivity_figures(found: Sequence[SensitivityFunctions]) -> dict[str, Figure]:
    """Draw θ ∂ŷ/∂θ (1.33) of each output over time, a line for each parameter.

    Parameters
    ----------
    found : sequence of SensitivityFunctions
        Of more than `MAX_EXPERIMENTS` the first are drawn, of more than `MAX_OUTPUTS` outputs likewise.

    Returns
    -------
    dict of str to Figure
        ``sensitivities``, followed by ``-name`` of the experiment where there are several.
    """
    several = len(found) > 1
    return {
        f"sensitivities-{file_name(each.experiment)}" if several else "sensitivities": _experiment(each)
        for each in found[:MAX_EXPERIMENTS]
    }


def _experiment(found: SensitivityFunctions) -> Figure:
    outputs = found.outputs[:MAX_OUTPUTS]
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 2.0 * len(outputs)), layout="constrained")
        panels = figure.subplots(len(outputs), 1, squeeze=False, sharex=True)[:, 0]
        for j, (axes, output) in enumerate(zip(panels, outputs, strict=True)):
            for i, name in enumerate(found.parameters):
                axes.plot(*thin(found.times, found.values[:, j, i]), lw=1.0, label=name)
            axes.set_ylabel(label(output, found.units[j]))
            axes.margins(x=0.01)
        panels[0].set_title("What relative changes of the parameters do, θ ∂y/∂θ")
        panels[-1].set_xlabel("time (s)")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure
