"""Findings in notebooks: tables as HTML, and the same figures as on the page of a report."""

from __future__ import annotations

import html as markup
import json
from collections.abc import Callable, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from fmuid.data import Experiment
from fmuid.diagnosis import Diagnosis
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.formatting import unit_text
from fmuid.models import FMU
from fmuid.reports.chart import Figure, Units
from fmuid.reports.document import Section, Table, table_of
from fmuid.reports.documents import describe
from fmuid.reports.render.console import PLAIN_WIDTH, plain_table
from fmuid.reports.render.html import bokeh_library, embedded, table
from fmuid.reports.topics.batch import charts_of
from fmuid.reports.topics.batch_tables import tables_of
from fmuid.reports.topics.diagnosis import diagnosis_sections
from fmuid.reports.topics.estimates import estimates_table
from fmuid.reports.topics.identification import identification_sections
from fmuid.reports.topics.prior_and_data import parabola_charts
from fmuid.runs import Batch, BatchResult, IdentificationRun
from fmuid.runs import predict_experiments as predict_experiments
from fmuid.simulation import OutputFit
from fmuid.studies import Study

if TYPE_CHECKING:
    import pandas as pd

SUMMARY_LINES, HEAD_LINES = 25, 2
"""Lines that a result takes where it is printed, those of the table's head among them."""
DRAW = """(function draw(left) {
  if (typeof Bokeh !== "undefined") Bokeh.embed.embed_items(%s, %s);
  else if (left > 0) setTimeout(draw, 20, left - 1);
})(250);"""
"""What draws figures once the library is there, which another cell may bring."""
# Rows of a table; a notebook is no place for ten thousand variables.
MAX_ROWS = 25


# --- tables


def html(found: object) -> str | None:
    """Return what a notebook shows of a finding, a study, a model or a table, as HTML."""
    match found:
        case IdentificationRun():
            return _with_words(found.result, estimates_table(found.result, found.assessment.level))
        case Result():
            return _with_words(found, estimates_table(found))
        case Diagnosis():
            return _with_words(found, diagnosis_sections(found)[0].table)
        case Study():
            return _study(found)
        case FMU():
            return _fmu(found)
        case Experiment():
            return _experiment(found)
        case Batch():
            return _batch(found)
        case BatchResult():
            head = _heading(f"{found.finished} of {found.total} cases", str(found.folder))
            return head + "".join(table(each.table) for each in tables_of(found.summary()[0]))
    return None


def text(found: object) -> str:
    """Return what is printed of a finding."""
    return _summary(found) if isinstance(found, Result) else repr(found)


def _summary(result: Result) -> str:
    """Return the table of estimates, of many the first ones, and the sentences on them, in `SUMMARY_LINES` at most."""
    said = [line for words in describe(result).split("\n") for line in wrap(words, PLAIN_WIDTH)]
    room = SUMMARY_LINES - HEAD_LINES
    rows, hidden = len(result.names), 0
    if rows + 1 + len(said) > room:
        shown = max(room - 2 - len(said), room // 2)
        rows, hidden = min(rows, shown), max(0, rows - shown)
        left = room - rows - 1 - (hidden > 0)
        said = said if len(said) <= left else [*said[: left - 1], "… fmuid.describe(result) says the rest"]
    lines = plain_table(estimates_table(result), rows)
    return "\n".join([*lines, *([f"… {hidden} more"] if hidden else []), "", *said])


def _with_words(found: Result | Diagnosis, rows: Table) -> str:
    first, *others = describe(found).split("\n")
    said = "".join(f"<li>{markup.escape(text)}</li>" for text in others)
    return f"<p><b>{markup.escape(first)}</b></p>{table(rows)}<ul>{said}</ul>"


def _heading(name: str, words: str = "") -> str:
    return f"<p><b>{markup.escape(name)}</b> {markup.escape(words)}</p>"


def _study(study: Study) -> str:
    rows = study.parameters.items()
    columns = {
        "parameter": [name for name, _ in rows],
        "start": [f"{each.start:.6g}" for _, each in rows],
        "bounds": [f"{each.min:.6g} to {each.max:.6g}" for _, each in rows],
    }
    tables = ", ".join(
        f"{each.name} ({', '.join(each.inputs)} → {', '.join(each.outputs)})" for each in study.experiments
    )
    return _heading(study.title, tables) + table(table_of(columns))


def _batch(found: Batch) -> str:
    """Return how many cases there are, and what changes from the first of them to the last."""
    cases = found.cases
    ends = [cases[k].settings for k in (0, len(cases) - 1)]
    columns = {"varies": list(cases.columns)}
    for head, end in zip(("from", "to"), ends, strict=True):
        columns[head] = [str(end[name]) for name in cases.columns]
    return _heading(f"{len(cases) - found.pending.size} of {len(cases)} cases done", str(found.folder)) + table(
        table_of(columns, columns)
    )


def _fmu(fmu: FMU) -> str:
    kinds = ("parameter", "input", "output")
    shown = [each for each in fmu.description.variables.values() if each.causality in kinds]
    shown.sort(key=lambda each: kinds.index(str(each.causality)))
    columns = {
        "variable": [each.name for each in shown[:MAX_ROWS]],
        "causality": [str(each.causality) for each in shown[:MAX_ROWS]],
        "start": ["" if each.start is None else str(each.start) for each in shown[:MAX_ROWS]],
        "unit": [unit_text(each.unit) for each in shown[:MAX_ROWS]],
    }
    more = f", {len(shown) - MAX_ROWS} more" if len(shown) > MAX_ROWS else ""
    return _heading(fmu.name, f"FMI {fmu.description.fmi_version}{more}") + table(
        table_of(columns, ("causality", "unit"))
    )


def _experiment(given: Experiment) -> str:
    times = given.times
    names = (*given.input_names, *given.output_names)
    columns = {
        "column": list(names),
        "role": ["input"] * len(given.input_names) + ["output"] * len(given.output_names),
        "unit": [unit_text(given.units.get(name)) for name in names],
    }
    return _heading(given.name, f"{len(times)} samples, {times[0]:g} to {times[-1]:g} s") + table(
        table_of(columns, columns)
    )


# --- figures


class Drawing:
    """Figures that a notebook shows.

    Attributes
    ----------
    charts : sequence of Chart or ChartGrid
    columns : int
        So many stand beside each other where there is room.
    """

    _library_in: list[str] = []  # noqa: RUF012  # the cell that carries the library of the notebook
    """One figure of a notebook carries the library, 1.3 MB; run again, it carries it again."""

    def __init__(self, charts: Sequence[Figure], columns: int = 1) -> None:
        self.charts, self.columns = charts, columns

    def __repr__(self) -> str:
        return f"Drawing of {len(self.charts)} figures"

    def _repr_html_(self) -> str:
        """Return the figures, with the library where no cell before has it."""
        content, where, places = embedded(self.charts)
        texts = (json.dumps(each, separators=(",", ":")).replace("<", "\\u003c") for each in (content, where))
        script = DRAW % tuple(texts)
        cell = _cell()
        if not self._library_in or (cell and self._library_in == [cell]):
            self._library_in[:] = [cell]
            script = f"{bokeh_library()}\n{script}"
        script = script.replace("</script", "<\\/script")
        width = 100 // self.columns - 1
        cells = "".join(f'<div style="flex:1 1 {width}%;min-width:260px">{place}</div>' for place in places)
        style = "display:flex;flex-wrap:wrap;gap:8px;background:#fff;color:#24292f;padding:8px;border-radius:8px"
        return f'<div style="{style}">{cells}</div><script>{script}</script>'


def _cell() -> str:
    """Return the number of the cell that is run, "" outside of notebooks."""
    try:
        from IPython import get_ipython
    except ImportError:
        return ""
    shell = get_ipython()
    parent = {} if shell is None or not hasattr(shell, "get_parent") else shell.get_parent()
    return str(parent.get("metadata", {}).get("cellId", ""))


class FigureCollection:
    """Figures of a finding, a method for each part of its page: ``found.plot.fit()``, ``found.plot.sizes()``.

    Parameters
    ----------
    sections : sequence of Section
    reading : DataFrame, optional
        What prior and data say of the parameters.
    units : mapping of str to str, optional
        Of the parameters.
    """

    def __init__(
        self, sections: Sequence[Section], reading: pd.DataFrame | None = None, units: Units | None = None
    ) -> None:
        self._sections = [each for each in sections if each.charts]
        self._reading, self._units = reading, units

    def __dir__(self) -> list[str]:
        """Return what can be drawn."""
        return [each.key for each in self._sections if each.key.isidentifier()]

    def __getattr__(self, name: str) -> Callable[[], Drawing]:
        """Return what draws a part, of several experiments all of it."""
        shown = [each for each in self._sections if each.key.split("-")[0] == name]
        if not shown:
            raise AttributeError(f"there is nothing to draw as {name!r}: there is {', '.join(dir(self))}")
        return lambda: Drawing([chart for each in shown for chart in each.charts], shown[0].beside)

    def parabolas(self, *names: str) -> Drawing:
        """Draw the criterion of prior, data and both over parameters, default all with a prior.

        Raises
        ------
        InputError
            If what prior and data say is not known here, or not of such a parameter.
        """
        if self._reading is None:
            raise InputError("what the data alone say is in the findings of fmuid.run: draw them")
        return Drawing(list(parabola_charts(self._reading, names, self._units)), 3)


def plots(found: object) -> FigureCollection:
    """Return the figures of a finding.

    Raises
    ------
    InputError
        If nothing can be drawn of it.
    """
    match found:
        case IdentificationRun():
            checks = found.assessment.prior_and_data
            reading = None if checks is None else checks.table
            return FigureCollection(identification_sections(found), reading, found.unit_of)
        case Result():
            return FigureCollection(identification_sections(_known(found)))
        case Diagnosis():
            return FigureCollection(diagnosis_sections(found))
        case BatchResult():
            summary, frame = found.summary()
            drawn = charts_of(frame, summary, found.truth, found.units, given_noise=found.given_noise)
            return FigureCollection(drawn)
    raise InputError(f"a {type(found).__name__} has no figures")


def _known(result: Result) -> IdentificationRun:
    """Return what a result knows by itself; units of the outputs are not among that."""
    fits = []
    for k, frame in enumerate(result.fit):
        names = tuple(str(name)[len("measured.") :] for name in frame.columns if str(name).startswith("measured."))
        measured, simulated = (
            frame[[f"{kind}.{name}" for name in names]].to_numpy(np.float64) for kind in ("measured", "simulated")
        )
        times, counted = frame["time"].to_numpy(np.float64), np.isfinite(measured)
        fits.append(OutputFit(f"experiment {k + 1}", times, names, (None,) * len(names), measured, simulated, counted))
    return IdentificationRun(result, tuple(fits))
