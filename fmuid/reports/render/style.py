"""Style of all figures: colors, their dark twins, fonts, palettes."""

from __future__ import annotations

import numpy as np

from fmuid.reports.chart import Color

COLORS: dict[Color, str] = {
    "ink": "#24292f",
    "grey": "#6e7781",
    "faint": "#e1e5ea",
    "white": "#ffffff",
    "blue": "#0b61d0",
    "red": "#c4432b",
    "amber": "#d99a1c",
}
LINE = "#c9d1d9"  # of axes
DARK = {
    COLORS["ink"]: "#e6edf3",
    COLORS["grey"]: "#9aa4af",
    COLORS["faint"]: "#2b323b",
    LINE: "#4b5563",
    COLORS["white"]: "#151b23",
    COLORS["blue"]: "#5aa2ff",
    COLORS["red"]: "#ff7b5e",
    COLORS["amber"]: "#e8b84a",
}
"""Each color's twin on a dark page."""
FONT = "Inter, system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif"
NAME_SIZE = "11px"
MISSING = "#bbbbbb"  # of a cell without a value
BAR, BAR_BELOW = 0.55, 0.24  # thickness of a bar in rows: with its name beside it, and below its name
# Text on cells of a strong color, and on pale ones: the cells are the same on a dark page.
ON_STRONG, ON_PALE = "#fefefe", "#1b1f24"
# RdBu of ColorBrewer.
BLUE_RED = (
    *("#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7"),
    *("#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f"),
)
# Blues of ColorBrewer, red, green and blue, and so many colors between them.
_BLUES = ((8, 48, 107), (8, 81, 156), (33, 113, 181), (66, 146, 198), (107, 174, 214), (158, 202, 225), (198, 219, 239), (222, 235, 247), (247, 251, 255))  # fmt: skip  # noqa: E501
_SHADES = 129


def palette(name: str) -> list[str]:
    """Return the colors of a palette, those of low values first."""
    if name == "diverging":
        return list(BLUE_RED)
    places = np.linspace(0.0, len(_BLUES) - 1.0, _SHADES)
    parts = np.array([np.interp(places, range(len(_BLUES)), each) for each in zip(*_BLUES, strict=True)])
    return ["#" + bytes(color).hex() for color in parts.T.round().astype(np.uint8)]
