"""Short cuts of the quick tests: some of the parameters of a test, no drawing."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from fmuid.files import replacing


def first(count: int, values: Iterable[Any]) -> list[Any]:
    """Return the values; those after the first ones run with the slow tests."""
    return [
        value if k < count else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow)
        for k, value in enumerate(values)
    ]


def draw_nothing(patch: pytest.MonkeyPatch) -> None:
    """Have figures be made and written without a layout and drawing, and reports be empty."""
    patch.setattr("matplotlib.figure.Figure.get_layout_engine", lambda _: None)
    patch.setattr("matplotlib.backends.backend_agg.FigureCanvasAgg.draw", lambda self: self.get_renderer())
    patch.setattr("fmuid.reports.publish._write_page", _blank_page)


def _blank_page(folder: Path, _documents: object) -> Path:
    with replacing(folder / "report.html") as draft:
        draft.write_text("")
    return folder / "report.html"
