"""What all figures share: the look of them, lines thinned to what a picture can show, and saving.

Figures are drawn with matplotlib's objects directly, without pyplot: no window, no global state, and a faster start.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fmuid.arrays import Floats
from fmuid.files import replacing
from fmuid.reports.thinning import extremes

# Wide enough to be read at the width of a README, about 1000 pixels.
WIDTH, DPI = 9.2, 110
# More panels than these make a figure nobody reads: the outputs and experiments that fit worst are kept.
MAX_OUTPUTS, MAX_EXPERIMENTS, MAX_PARAMETERS = 8, 6, 24
# Lines longer than this are drawn by the least and greatest of each stretch, which looks the same at this resolution.
MAX_POINTS = 3000

INK, GREY, FAINT, BLUE, RED, AMBER = "#24292f", "#7d8590", "#d8dee4", "#0b61d0", "#c4432b", "#d99a1c"
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


def thin(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return about `MAX_POINTS` points that draw the same line: the least and greatest of each stretch, in order."""
    kept = extremes(y[:, None], MAX_POINTS)
    return x[kept], y[kept]
