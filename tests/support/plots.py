"""What a figure shows, and a result to be drawn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from bokeh.models import BoxAnnotation, Legend


def plots(model: Any) -> list[Any]:
    """Return the plots of a figure in their order."""
    return [plot for plot, *_ in sorted(model.children, key=lambda child: child[1:])]


def drawn(plot: Any, glyph: str) -> list[dict[str, Any]]:
    """Return the data of all glyphs of a kind: what its x, y and so on are, fields looked up."""
    found = []
    for renderer in plot.renderers:
        if type(renderer.glyph).__name__ == glyph:
            data, values = renderer.data_source.data, {}
            for key in ("x", "y", "left", "right", "top", "x0", "x1", "y1"):
                field = getattr(renderer.glyph, key, None)
                values[key] = np.asarray(data[field]) if isinstance(field, str) else field
            found.append(values)
    return found


def marks(plot: Any, kind: type) -> list[Any]:
    """Return what lies over a plot, without the tools' own."""
    return [each for each in plot.center if isinstance(each, kind)]


def labels(plot: Any) -> tuple[str, str]:
    return plot.xaxis.axis_label, plot.yaxis.axis_label


def entries(plot: Any) -> list[str]:
    return [item.label["value"] for legend in plot.above if isinstance(legend, Legend) for item in legend.items]


def bands(plot: Any) -> Iterator[tuple[float, float]]:
    for box in marks(plot, BoxAnnotation):
        if isinstance(box.bottom, float) and math.isfinite(box.bottom):
            yield box.bottom, box.top
