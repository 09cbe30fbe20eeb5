"""Identification on the page of a study: options, iterations, result, remedies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Spinner

from fmuid.apps.workbench.home import address, file_address
from fmuid.apps.workbench.jobs import Job
from fmuid.apps.workbench.pages.panels import CommandPanel, models, side_by_side
from fmuid.apps.workbench.pages.remedy_panel import RemedyPanel, StudyPageProtocol
from fmuid.apps.workbench.project_folder import Folder
from fmuid.apps.workbench.widgets import SHEET, WIDE, choice, on_change, several, words
from fmuid.errors import InputError
from fmuid.events import Event, SearchStep
from fmuid.files import is_file
from fmuid.formatting import of_parameter
from fmuid.reports import documents_of
from fmuid.reports.chart import LIMITS, Axis, Chart, Data, Layer
from fmuid.reports.render.bokeh_models import live
from fmuid.reports.render.bokeh_renderer import DrawnCharts, drawing
from fmuid.reports.render.html import text as escaped

SEARCHES = {
    "local": [],
    "differential evolution": ["estimation.method=differential-evolution"],
    "multi-start": ["estimation.method=multi-start"],
}
"""Optimizer options, and their study values."""
PROFILES, POSTERIOR = "profile likelihood", "posterior"
OTHERS = " <code>results</code> contains a result of another study, which will be overwritten."
UNCERTAIN = ("profiles", "maps", "posterior")  # sections on uncertainty


class IdentificationPanel:
    """Controls, iterations and result of ``fmuid identify``."""

    def __init__(self, page: StudyPageProtocol) -> None:
        self.page = page
        self.run = CommandPanel(page.doc, page.bench.jobs, page.results, {"Identify": self.begin}, self._add, self._end)
        names = [each.name for each in page.rows]
        self.how = choice("method", list(SEARCHES), "how", "local")
        self.starts = Spinner(title="starting points", value=20, low=1, step=1, visible=False, width=80, name="starts")
        self.starts.stylesheets = [SHEET]
        maps = [f"cost map of {first}, {second}" for first, second in combinations(names, 2)][:28]
        self.pairs = dict(zip(maps, combinations(names, 2), strict=False))
        self.also = several("uncertainty", [PROFILES, POSTERIOR, *maps], "also")
        on_change(self._asked, self.how, self.also, self.starts)
        self.controls = column(self.how, self.starts, self.also, self.run.layout, sizing_mode="stretch_width")
        self.names = names[: LIMITS.parameters - 1]
        self.trace: dict[str, list[float]] = {key: [] for key in ("k", "c", *(f"v{i}" for i in range(len(self.names))))}
        self.refused: dict[str, list[float]] = {"x": [], "y": []}
        self.drawn: DrawnCharts | None = None
        self.shown: list[Chart] = []
        self.hint = words("hint", "<p>Identify shows its iterations here.</p>")
        self.search = column(self.hint, **WIDE)
        self.text, self.remedies, self.more = words("found"), RemedyPanel(page), column([], **WIDE)
        self.found = column(self.text, self.remedies.layout, self.more, **WIDE)
        if self.run.job is not None and self.run.job.running:
            self.run.follow()
            self._clear()
        self._tell_result()

    def _charts(self) -> list[Chart]:
        """Return the cost and the parameters over the iterations."""
        columns = {key: np.array(values, dtype=np.float64) for key, values in self.trace.items()}
        away: Data = {key: np.array(values, dtype=np.float64) for key, values in self.refused.items()}
        free = [i for i, name in enumerate(self.names) if np.isfinite(columns[f"v{i}"]).any() and name]
        charts = []
        for key, text in [("c", "cost"), *((f"v{i}", self.page.rows[i].text) for i in free)]:
            data: Data = {"x": columns["k"], "y": columns[key]}
            layers = [Layer("line", data), Layer("points", data, size=5)]
            layers += [Layer("points", away, "red", marker="x", size=8)] if key == "c" else []
            y = Axis(text, "log" if key == "c" else "linear")
            charts.append(Chart(Axis("iteration", whole=True), y, tuple(layers), 190))
        return charts

    def _draw(self) -> None:
        charts = self._charts()
        if self.drawn is None or len(charts) != len(self.shown):
            self.drawn = drawing(charts, source=ColumnDataSource)
            self.search.children = [side_by_side(live(self.drawn.figures, dark=self.page.scheme == "dark"))]
        else:
            self.drawn.refill(charts, self.shown)
        self.shown = charts

    def settings(self) -> list[str]:
        """Return the study values that the options replace."""
        found = list(SEARCHES[self.how.value])
        found += [f"estimation.n_starts={int(self.starts.value or 20)}"] if self.starts.visible else []
        found += ["uncertainty.profile_likelihood=true"] if PROFILES in self.also.value else []
        found += ["uncertainty.posterior={}"] if POSTERIOR in self.also.value else []
        pairs = [self.pairs[each] for each in self.also.value if each in self.pairs]
        quoted = ", ".join(f'["{first}", "{second}"]' for first, second in pairs)
        return found + ([f"uncertainty.cost_map=[{quoted}]"] if pairs else [])

    def _asked(self) -> None:
        self.starts.visible = "multi-start" in "".join(SEARCHES[self.how.value])
        self.page.note()

    def begin(self) -> None:
        """Start, or follow the command of another tab."""
        self.run.begin(self.page.path, self.page.words("identify"))
        self._clear()

    def _clear(self) -> None:
        for columns in (self.trace, self.refused):
            for each in columns.values():
                each.clear()
        self.drawn = None
        self.hint.text = "<p>Starting …</p>"
        self.search.children = [self.hint]

    def _add(self, events: Sequence[Event]) -> None:
        steps = [each for each in events if isinstance(each, SearchStep)]
        taken = [each for each in steps if each.accepted]
        for each in taken:
            values = [_of(each.values, name) for name in self.names]
            for column_, value in zip(self.trace.values(), [each.number, each.cost, *values], strict=True):
                column_.append(value)
        away = [each for each in steps if not each.accepted and math.isfinite(each.cost)]
        self.refused["x"] += [each.number for each in away]
        self.refused["y"] += [each.cost for each in away]
        if self.trace["k"] and steps:
            self._draw()
        if taken:
            last = taken[-1].values
            self.page.put({name: _of(last, name) for name in self.names if math.isfinite(_of(last, name))}, note=False)

    def _end(self, job: Job) -> None:
        self.page.show_result(self.page.results, move=job.code == 0)
        self._tell_result()

    def _tell_result(self) -> None:
        """Show the results folder: verdict, table, remedies, uncertainty."""
        folder: Path = self.page.results
        where: Folder = self.page.bench.folder
        if not self.page.has_result(folder):
            more = "" if not is_file(folder / "result.json") else OTHERS
            self.text.text = f"<p>No result yet. Press Identify.{more}</p>"
            return
        try:
            document = documents_of(folder)["identification"]
            self.remedies.tell(folder)
        except (InputError, KeyError) as error:
            self.text.text = f"<p class=error>{escaped(error)}</p>"
            return
        said, *drawn = models(
            [replace(document, sections=tuple(each for each in document.sections if each.key in UNCERTAIN))],
            self.page.scheme,
        )
        links = ""
        if where.has(folder):
            links = f'<p><a href="{address("results", where, folder)}">All figures</a>'
            if (folder / "report.html").is_file():
                links += f' · <a href="{file_address(where, folder / "report.html")}">report.html</a>'
            links += "</p>"
        self.text.text, self.more.children = said.text + links, drawn


def _of(values: Mapping[str, float], name: str) -> float:
    """Return the value of a parameter, the first of several experiments."""
    if name in values:
        return values[name]
    return next((value for each, value in values.items() if of_parameter(each, name)), math.nan)
