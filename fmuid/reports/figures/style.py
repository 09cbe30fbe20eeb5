"""The look of figures for print, and saving them.

They are drawn with matplotlib's objects directly, without pyplot: no window, no global state, and a faster start.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fmuid.files import replacing
from fmuid.reports.interactive.style import AMBER, BLUE, FAINT, GREY, INK, RED

# Wide enough to be read at the width of a README, about 1000 pixels.
WIDTH, DPI = 9.2, 110
__all__ = ["AMBER", "BLUE", "DPI", "GREY", "INK", "RED", "WIDTH", "save", "style"]
STYLE: Any = {
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.formatter.useoffset": False,
    "axes.axisbelow": True,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "text.color": INK,
    "svg.hashsalt": "fmuid",
}


def save(figures: dict[str, Figure], folder: Path, kind: str = "png") -> list[Path]:
    """Write figures into `folder` (made where needed) and return their paths.

    Parameters
    ----------
    figures : dict of str to Figure
        By the names of their files.
    folder : Path
    kind : str
        ``png``, ``svg`` or ``pdf``.

    Raises
    ------
    InputError
        If one cannot be written.
    """
    paths = []
    with style():  # ticks take theirs when they are drawn
        for name, figure in figures.items():
            path = folder / f"{name}.{kind}"
            if kind != "png":
                with replacing(path) as draft:
                    figure.savefig(draft, format=kind, metadata=_UNDATED[kind])
                paths.append(path)
                continue
            figure.set_dpi(DPI)
            # what savefig does, without drawing everything twice
            layout = figure.get_layout_engine()
            if layout is not None:
                layout.execute(figure)
                figure.set_layout_engine("none")
            canvas: Any = FigureCanvasAgg(figure)
            with replacing(path) as draft:
                canvas.print_png(draft)
            paths.append(path)
    return paths


# The same figure is the same file.
_UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None, "ModDate": None}}


def style() -> Any:
    """Return the context in which every figure is drawn."""
    return matplotlib.rc_context(STYLE)
