"""How findings are shown in a notebook: `fmuid/__init__.py` says by whom, as those who find know nothing of it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_by: list[str] = []


def shown_by(module: str) -> None:
    """Say which module shows findings: its ``html(found)``, ``text(found)`` and ``plots(found)``."""
    _by[:] = [module]


class Text(str):
    """A text of several lines that a shell shows as it is."""

    __slots__ = ()

    __repr__ = str.__str__


def text_of(found: object) -> Text:
    """Return what is printed of a finding; its ``repr`` where nobody shows it."""
    return Text(import_module(_by[0]).text(found) if _by else repr(found))


class Displayed:
    """What a notebook shows as a table."""

    def _repr_html_(self) -> str | None:
        """Return it as HTML; None where nobody shows it, and its ``repr`` is shown."""
        shown: str | None = import_module(_by[0]).html(self) if _by else None
        return shown


class Plotted(Displayed):
    """What can be drawn too: ``found.plot.fit()``."""

    @property
    def plot(self) -> Any:
        """Its figures, a method each: interactive in a notebook, HTML elsewhere."""
        return import_module(_by[0]).plots(self)
