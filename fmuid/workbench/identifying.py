"""Identification from the page of a study: begun, followed, cancelled; its files are where the command puts them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, Div

from fmuid.errors import InputError
from fmuid.progress import Event, SearchStep
from fmuid.reports.interactive.live import in_scheme
from fmuid.reports.interactive.style import BLUE, MAX_PARAMETERS, RED, panel, whole
from fmuid.reports.page import identification
from fmuid.reports.page.document import pieces
from fmuid.workbench.folder import Folder
from fmuid.workbench.home import address, escaped, file_address
from fmuid.workbench.jobs import Job, Jobs
from fmuid.workbench.sliders import SHEET, ParameterRow

EVERY = 150
"""Milliseconds between two looks at a command that runs."""
TABLE = """
table{border-collapse:collapse;font-variant-numeric:tabular-nums;width:100%;font-size:14px}
th,td{padding:6px 12px 6px 0;text-align:left;border-bottom:1px solid var(--faint);white-space:nowrap}
.number{text-align:right}.scroll{overflow-x:auto}h2{font-size:16px}section{padding:0}
.doubts{list-style:none;padding:0}.doubts li{border-left:3px solid var(--doubt);padding-left:12px;margin:8px 0}
.badge{font-size:12.5px;font-weight:600;padding:3px 11px;border-radius:99px}
.badge.good{background:var(--good-ground);color:var(--good)}.badge.bad{background:var(--bad-ground);color:var(--bad)}
a{color:var(--link)}.error{border-left:3px solid var(--bad);padding-left:10px}
pre{white-space:pre-wrap;overflow-wrap:anywhere;font-size:12.5px}
"""
BAR = """
progress{width:100%;accent-color:var(--link)}p{margin:4px 0}.soft{color:var(--soft)}
.error{border-left:3px solid var(--bad);padding-left:10px;overflow-wrap:anywhere}
"""


class Page(Protocol):
    """What it needs of the page of a study."""

    doc: Any
    path: Path
    scheme: str
    rows: list[ParameterRow]

    @property
    def bench(self) -> Any:
        """The workbench."""

    @property
    def results(self) -> Path:
        """Where the command writes."""

    def words(self, command: str) -> list[str]:
        """Return the command."""

    def put(self, values: dict[str, float], *, note: bool = True) -> None:
        """Move sliders."""

    def show_result(self, folder: Path, *, move: bool = False) -> None:
        """Show a result as the last optimum."""


class Identifying:
    """Controls, live iterations and outcome of ``fmuid identify``.

    Parameters
    ----------
    page : Page

    Attributes
    ----------
    controls, search, found : Bokeh models
    """

    def __init__(self, page: Page) -> None:
        self.page, self._job, self._position = page, None, 0
        self._callback: Any = None
        self._job = self.jobs.of(page.results)
        self.go = Button(label="Identify", button_type="primary", name="identify", stylesheets=[SHEET])
        self.stop = Button(label="Cancel", disabled=True, name="cancel", stylesheets=[SHEET])
        self.go.on_click(self.begin)
        self.stop.on_click(self.cancel)
        self.state = Div(text="", name="state", sizing_mode="stretch_width", stylesheets=[SHEET, BAR])
        buttons = row(self.go, self.stop, sizing_mode="stretch_width")
        self.controls = column(buttons, self.state, sizing_mode="stretch_width")
        self.names = [each.name for each in page.rows][: MAX_PARAMETERS - 1]
        self.trace = ColumnDataSource({"k": [], "c": [], **{f"v{i}": [] for i in range(len(self.names))}}, name="trace")
        self.refused = ColumnDataSource({"k": [], "c": []})
        self.hint = Div(text="<p>Press Identify to see the search go on here.</p>", stylesheets=[SHEET, BAR])
        self.search = column(self.hint, sizing_mode="stretch_width", stylesheets=[SHEET])
        self.text = Div(text="", name="found", sizing_mode="stretch_width", stylesheets=[SHEET, TABLE])
        self.found = column(self.text, sizing_mode="stretch_width", stylesheets=[SHEET])
        if self._job is not None and self._job.running:
            self._follow()
        self._tell_result()

    @property
    def jobs(self) -> Jobs:
        """What the workbench has begun."""
        found: Jobs = self.page.bench.jobs
        return found

    def _figures(self) -> Any:
        plots = []
        for key, text in [("c", "criterion"), *((f"v{i}", name) for i, name in enumerate(self.names))]:
            plot = panel(x="iteration", y=text, height=190, y_axis_type="log" if key == "c" else "linear")
            plot.sizing_mode, plot.width_policy = "stretch_width", "max"
            plot.min_width = 200
            plot.line("k", key, source=self.trace, line_color=BLUE, line_width=1.8)
            plot.scatter("k", key, source=self.trace, size=5, fill_color=BLUE, line_color=None)
            if key == "c":
                plot.scatter("k", "c", source=self.refused, marker="x", size=8, line_color=RED)
            whole(plot)
            plots.append(in_scheme(plot, self.page.scheme))
        rows = [row(*plots[i : i + 3], sizing_mode="stretch_width") for i in range(0, len(plots), 3)]
        return column(*rows, sizing_mode="stretch_width")

    # --- a run

    def begin(self) -> None:
        """Begin, or follow the run that another tab has begun."""
        words = self.page.words("identify")
        self._job = self.jobs.begin(self.page.path, self.page.results, words)
        self._follow()

    def cancel(self) -> None:
        """Have it end, and save what it has found."""
        if self._job is not None:
            self._job.cancel()
            self.stop.disabled = True
            self._tell_state(None)

    def _follow(self) -> None:
        self._position = 0
        empty: dict[str, list[float]] = {key: [] for key in self.trace.data}
        self.trace.data, self.refused.data = empty, {"k": [], "c": []}
        self.go.disabled, self.stop.disabled = True, False
        self._tell_state(None)
        if self._callback is None:
            self._callback = self.page.doc.add_periodic_callback(self.look, EVERY)

    def look(self) -> None:
        """Show what has happened since the last look."""
        job = self._job
        if job is None:
            return
        job.insist()
        running = job.running  # before its events are read: none is left out
        events, self._position = job.events(self._position)
        self._add([each for each in events if isinstance(each, SearchStep)])
        if running:
            self._tell_state(events[-1] if events else None)
            return
        if self._callback is not None:
            self.page.doc.remove_periodic_callback(self._callback)
            self._callback = None
        self._end(job)

    def _add(self, steps: list[SearchStep]) -> None:
        taken = [each for each in steps if each.accepted]
        if taken:
            columns: dict[str, list[float]] = {"k": [each.number for each in taken]}
            columns["c"] = [each.criterion for each in taken]
            for i, name in enumerate(self.names):
                columns[f"v{i}"] = [_of(each.values, name) for each in taken]
            self.trace.stream(columns)
            if self.hint in self.search.children:  # empty figures have no ranges
                self.search.children = [self._figures()]
            last = taken[-1].values
            self.page.put({name: _of(last, name) for name in self.names if math.isfinite(_of(last, name))}, note=False)
        away = [each for each in steps if not each.accepted and math.isfinite(each.criterion)]
        if away:
            self.refused.stream({"k": [each.number for each in away], "c": [each.criterion for each in away]})

    def _end(self, job: Job) -> None:
        self.go.disabled, self.stop.disabled = False, True
        code = job.code
        self.page.show_result(self.page.results, move=code == 0)
        last = [line for line in job.printed().splitlines() if line.strip()]
        error = next((line for line in reversed(last) if line.startswith("error: ")), "")
        if error:
            self.state.text = f"<p class=error role=alert>{escaped(error.removeprefix('error: '))}</p>"
        else:
            how = "Cancelled; what it had found is saved" if job.asked else "Done" if code == 0 else "Ended"
            self.state.text = f"<p role=status>{how} after {job.seconds:.1f} s: see Result.</p>"
        self._tell_result()

    # --- words

    def _tell_state(self, event: Event | None) -> None:
        job = self._job
        if job is None:
            return
        if job.asked:
            self.state.text = "<p role=status>Cancelling; what it has found is being saved …</p>"
            return
        if event is None and job.seconds > 1.0 and self.state.text:
            return
        share = math.nan if event is None else event.share
        left = job.seconds * (1 - share) / share if share > 0 else math.nan
        bar = f"<progress value={share:.3f} max=1></progress>" if math.isfinite(share) else "<progress></progress>"
        what = "beginning" if event is None else _what(event)
        words = [what, f"{job.seconds:.0f} s"] + ([f"about {left:.0f} s left"] if math.isfinite(left) else [])
        self.state.text = f"{bar}<p class=soft>{escaped(', '.join(words))}</p>"

    def _tell_result(self) -> None:
        """Show verdict and table of what is in the folder of results."""
        folder: Path = self.page.results
        where: Folder = self.page.bench.folder
        if not (folder / "result.json").is_file():
            self.text.text = "<p>There is no result yet: press Identify.</p>"
            return
        try:
            part = replace(identification.part(folder), sections=())
        except InputError as error:
            self.text.text = f"<p class=error>{escaped(error)}</p>"
            return
        links = ""
        if where.has(folder):
            links = f'<p><a href="{address("results", where, folder)}">All figures</a>'
            if (folder / "report.html").is_file():
                links += f' · <a href="{file_address(where, folder / "report.html")}">report.html</a>'
            links += "</p>"
        job = self._job
        said = job.printed() if job is not None else ""
        log = f"<details><summary>What it printed</summary><pre>{escaped(said)}</pre></details>" if said else ""
        self.text.text = "".join(pieces([part])[0]) + links + log


def _of(values: Mapping[str, float], name: str) -> float:
    """Return the value of a parameter, of one per experiment the first."""
    if name in values:
        return values[name]
    return next((value for each, value in values.items() if each.startswith(f"{name}[")), math.nan)


def _what(event: Event) -> str:
    if isinstance(event, SearchStep):
        return f"iteration {event.number}, criterion {event.criterion:.6g}"
    return event.task
