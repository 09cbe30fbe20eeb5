"""Figures as Bokeh's own models, which know and check every property: what a test reads back is what Bokeh takes."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from fmuid.reports.interactive import bokeh_spec as sketch


class _Live:
    """A module of figures whose functions return Bokeh's models."""

    def __init__(self, name: str) -> None:
        self._module = import_module(f"fmuid.reports.interactive.{name}")

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        return (lambda *given, **more: _live(found(*given, **more))) if callable(found) else found


def _live(found: Any) -> Any:
    if isinstance(found, sketch.BokehSpec):
        return sketch.live([found])[0]
    if isinstance(found, list) and found and isinstance(found[0], sketch.BokehSpec):
        return sketch.live(found)
    return found


comparison, diagnosis = (_Live(name) for name in ("comparison", "diagnosis"))
estimates, fit, preparation = (_Live(name) for name in ("estimates", "fit", "preparation"))
residuals, search, uncertainty = (_Live(name) for name in ("residuals", "search", "uncertainty"))
