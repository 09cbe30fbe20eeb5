"""Findings in notebooks: HTML tables and interactive figures."""

from __future__ import annotations

import html as markup
import json
from collections.abc import Callable, Sequence
from textwrap import wrap

import numpy as np
import pandas as pd

from fmuid.data import Experiment
from fmuid.diagnosis import Diagnosis
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.formatting import unit_text
from fmuid.models import FMU, facts
from fmuid.reports.chart import Figure, Units
from fmuid.reports.document import Document, Section, Table, table_of
from fmuid.reports.documents import document as document
from fmuid.reports.documents import result_document
from fmuid.reports.render.console import PLAIN_WIDTH, plain_table
from fmuid.reports.render.html import bokeh_library, embedded, table
from fmuid.reports.render.html import verdict as verdict
from fmuid.reports.topics.batch import charts_of
from fmuid.reports.topics.batch_tables import tables_of
from fmuid.reports.topics.diagnosis import diagnosis_sections
from fmuid.reports.topics.estimates import estimates_table
from fmuid.reports.topics.identification import identification_sections
from fmuid.reports.topics.models import facts_document
from fmuid.reports.topics.prior_and_data import parabola_charts
from fmuid.runs import Batch, BatchResult, IdentificationRun
from fmuid.simulation import OutputFit
from fmuid.studies import Study

SUMMARY_LINES, HEAD_LINES = 25, 2  # lines that a result takes where it is printed, those of the table's head among them
DRAW = """(function draw(left) {
  if (typeof Bokeh !== "undefined") Bokeh.embed.embed_items(%s, %s);
  else if (left > 0) setTimeout(draw, 20, left - 1);
})(250);"""
"""What draws figures once the library is there, which another cell may bring."""


def html(found: object) -> str | None:
    """Return a finding, study, model or data file as HTML."""
    match found:
        case IdentificationRun():
            return result_document(found.result, found.assessment.level).html()
        case Result() | Diagnosis():
            return Document.of(found).html()
        case FMU():
            return facts_document(facts(found), PLAIN_WIDTH).html()
        case BatchResult():
            head = _titled(f"{found.finished} of {found.total} cases", str(found.folder), ())
            return head + "".join(table(each.table) for each in tables_of(found.summary()))
        case Study():
            return _study(found)
        case Experiment():
            return _experiment(found)
        case Batch():
            return _batch(found)
    return None


def text(found: object) -> str:
    """Return a finding as text."""
    return _summary(found) if isinstance(found, Result) else repr(found)


def _summary(result: Result) -> str:
    """Return estimates and remarks in at most `SUMMARY_LINES` lines."""
    said = [line for said in Document.of(result).remarks for line in wrap(said.text, PLAIN_WIDTH)]
    room = SUMMARY_LINES - HEAD_LINES
    rows, hidden = len(result.names), 0
    if rows + 1 + len(said) > room:
        shown = max(room - 2 - len(said), room // 2)
        rows, hidden = min(rows, shown), max(0, rows - shown)
        left = room - rows - 1 - (hidden > 0)
        said = said if len(said) <= left else [*said[: left - 1], "… print(fmuid.Document.of(result)) has the rest"]
    lines = plain_table(estimates_table(result), rows)
    return "\n".join([*lines, *([f"… {hidden} more"] if hidden else []), "", *said])


def _titled(name: str, words: str, rows: Table) -> str:
    return f"<p><b>{markup.escape(name)}</b> {markup.escape(words)}</p>{table(rows)}"


def _study(study: Study) -> str:
    rows = study.parameters.values()
    columns = {
        "parameter": list(study.parameters),
        "start": [f"{each.start:.6g}" for each in rows],
        "bounds": [f"{each.min:.6g} to {each.max:.6g}" for each in rows],
    }
    files = (f"{each.name} ({', '.join(each.inputs)} → {', '.join(each.output_names)})" for each in study.experiments)
    return _titled(study.title, ", ".join(files), table_of(columns))


def _batch(found: Batch) -> str:
    cases = found.cases
    columns = {"varies": list(cases.columns)}
    for head, case in (("from", cases[0]), ("to", cases[len(cases) - 1])):
        columns[head] = [str(case.settings[name]) for name in cases.columns]
    done = f"{len(cases) - found.pending.size} of {len(cases)} cases done"
    return _titled(done, str(found.folder), table_of(columns, columns))


def _experiment(given: Experiment) -> str:
    times, names = given.times, (*given.input_names, *given.output_names)
    columns = {
        "column": list(names),
        "role": ["input"] * len(given.input_names) + ["output"] * len(given.output_names),
        "unit": [unit_text(given.units.get(name)) for name in names],
    }
    span = f"{len(times)} samples, {times[0]:g} to {times[-1]:g} s"
    said = span if given.kind == "time" else f"{len(times)} rows without a time"
    return _titled(given.name, said, table_of(columns, columns))


class NotebookFigures:
    """Figures in a notebook, at most `columns` beside each other."""

    _library_in: list[str] = []  # noqa: RUF012  # the cell that carries the library of the notebook
    """One figure of a notebook carries the library, 1.3 MB; run again, it carries it again."""

    def __init__(self, charts: Sequence[Figure], columns: int = 1) -> None:
        self.charts, self.columns = charts, columns

    def __repr__(self) -> str:
        return f"{len(self.charts)} figures"

    def _repr_html_(self) -> str:
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
    """Return the number of the running cell, "" outside of notebooks."""
    try:
        from IPython import get_ipython
    except ImportError:
        return ""
    shell = get_ipython()
    parent = {} if shell is None or not hasattr(shell, "get_parent") else shell.get_parent()
    return str(parent.get("metadata", {}).get("cellId", ""))


class FigureCollection:
    """Figures of a finding, a method for each section: ``found.plot.fit()``."""

    def __init__(
        self, sections: Sequence[Section], reading: pd.DataFrame | None = None, units: Units | None = None
    ) -> None:
        self._sections = [each for each in sections if each.charts]
        self._reading, self._units = reading, units

    def __dir__(self) -> list[str]:
        """Return what can be drawn."""
        return [each.key for each in self._sections if each.key.isidentifier()]

    def __getattr__(self, name: str) -> Callable[[], NotebookFigures]:
        """Return what draws a part, of several experiments all of it."""
        shown = [each for each in self._sections if each.key.split("-")[0] == name]
        if not shown:
            raise AttributeError(f"there is nothing to draw as {name!r}: there is {', '.join(dir(self))}")
        return lambda: NotebookFigures([chart for each in shown for chart in each.charts], shown[0].beside)

    def parabolas(self, *names: str) -> NotebookFigures:
        """Draw the cost of prior, data and both over parameters."""
        if self._reading is None:
            raise InputError("what the data alone say is in the findings of fmuid.run: draw them")
        return NotebookFigures(list(parabola_charts(self._reading, names, self._units)), 3)


def plots(found: object) -> FigureCollection:
    """Return the figures of a finding."""
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
            summary, frame = found.summary(), found.frame
            drawn = charts_of(frame, summary, found.truth, found.units, given_noise=found.given_noise)
            return FigureCollection(drawn)
    raise InputError(f"a {type(found).__name__} has no figures")


def _known(result: Result) -> IdentificationRun:
    fits = []
    for k, frame in enumerate(result.fit.frames, start=1):
        names = tuple(str(name)[len("measured.") :] for name in frame.columns if str(name).startswith("measured."))
        kinds = ([f"{kind}.{name}" for name in names] for kind in ("measured", "simulated"))
        measured, simulated = (frame[columns].to_numpy(np.float64) for columns in kinds)
        times, units = frame["time"].to_numpy(np.float64), (None,) * len(names)
        fits.append(OutputFit(f"experiment {k}", times, names, units, measured, simulated, np.isfinite(measured)))
    return IdentificationRun(result, tuple(fits))
