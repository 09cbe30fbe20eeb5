"""How findings are shown, and predict: `fmuid/__init__.py` says by whom, as those who find know nothing of it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_by: list[str] = []


def shown_by(module: str) -> None:
    """Name the module with ``html(found)``, ``text(found)``, ``plots(found)`` and ``predict_experiments(found, …)``."""
    _by[:] = [module]


class MultilineText(str):
    """A text of several lines that a shell shows as it is."""

    __slots__ = ()

    __repr__ = str.__str__


def text_of(found: object) -> MultilineText:
    """Return what is printed of a finding; its ``repr`` where nobody shows it."""
    return MultilineText(import_module(_by[0]).text(found) if _by else repr(found))


class HtmlTableMixin:
    """What a notebook shows as a table."""

    def _repr_html_(self) -> str | None:
        """Return it as HTML; None where nobody shows it, and its ``repr`` is shown."""
        shown: str | None = import_module(_by[0]).html(self) if _by else None
        return shown


class PlotMixin(HtmlTableMixin):
    """What can be drawn too: ``found.plot.fit()``."""

    @property
    def plot(self) -> Any:
        """Its figures, a method each: interactive in a notebook, HTML elsewhere."""
        return import_module(_by[0]).plots(self)


class PredictMixin(PlotMixin):
    """What can be simulated over other records too."""

    def predict(
        self, experiment: Any, model: Any = None, *, values: Any = None, free: Any = (), level: float = 0.95
    ) -> Any:
        """Simulate it over a record that it was not made from, as `fmuid.predict` does.

        Parameters
        ----------
        experiment : Experiment
            The record.
        model : System, FMU or path, optional
            Default: what it was made with, also where it was read from a ``result.json`` that names its study.
        values : mapping of str to float, int, bool or str, optional
            FMU variables held at a value, where a model is given; beside those that it was made with, where none is.
        free : sequence of str, or mapping of str to Parameter
            Values that are estimated again on this record, such as initial states.
        level : float
            Of the band.

        Returns
        -------
        Prediction

        Raises
        ------
        InputError
            If it does not know its model and none is given, or as `fmuid.predict`.
        SimulationError
            If the simulation fails.
        """
        return import_module(_by[0]).predict_experiments(self, experiment, model, values=values, free=free, level=level)
