"""Display of findings by a renderer of a higher package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_load: list[Callable[[], Any]] = []


def set_renderer(load: Callable[[], Any]) -> None:
    """Set what imports the module with ``document``, ``html``, ``plots``, ``text`` and ``verdict``."""
    _load[:] = [load]


def renderer() -> Any:
    """Return the module that shows findings."""
    return _load[0]()


class MultilineText(str):
    """Text of several lines that a shell shows without quotes."""

    __slots__ = ()

    __repr__ = str.__str__


def text_of(found: object) -> MultilineText:
    """Return the printed text of a finding."""
    return MultilineText(renderer().text(found))


class HtmlTableMixin:
    """Table in a notebook."""

    def _repr_html_(self) -> str | None:
        shown: str | None = renderer().html(self)
        return shown


class PlotMixin(HtmlTableMixin):
    """Figures: ``found.plot.fit()``."""

    @property
    def plot(self) -> Any:
        """Figures, one method each: interactive in a notebook, HTML elsewhere."""
        return renderer().plots(self)
