"""From "not determined" to what helps: hold the parameter, give it a prior, or find a record that shows it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from bokeh.layouts import column, row

from fmuid.estimation import Result
from fmuid.text import of_parameter
from fmuid.workbench.folder import beside, tables
from fmuid.workbench.home import address, escaped
from fmuid.workbench.jobs import Job
from fmuid.workbench.pages.running import Run
from fmuid.workbench.pages.sliders import ParameterRow
from fmuid.workbench.shell import LINE, WIDE, button, several, words

DESIGN = "design"
"""The folder in that of the results into which excitations are compared."""


class Page(Protocol):
    """What a part of the page of a study needs of the whole."""

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

    def note(self) -> None:
        """Keep a state to which one can go back, and say the command anew."""

    def show_result(self, folder: Path, *, move: bool = False) -> None:
        """Show a result as the last optimum."""


class Remedies:
    """What stands below a result that does not determine all parameters.

    Parameters
    ----------
    page : Page

    Attributes
    ----------
    layout : Bokeh model
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self.folder = page.results / DESIGN
        self.run = Run(page.doc, page.bench.jobs, self.folder, {"Compare excitations": self.compare}, ended=self._end)
        known = [page.bench.folder.name(path) for path in tables(page.bench.folder)]
        self.tables = several("excitations, tables of inputs", known, "excitations")
        self.compared = words("compared")
        self.layout = column([], name="remedies", **WIDE)

    def tell(self, folder: Path) -> None:
        """Offer what helps for each parameter that the result in a folder does not determine."""
        result = Result.from_json(folder / "result.json")
        names = undetermined(result)
        rows = [each for each in self.page.rows if any(of_parameter(name, each.name) for name in names)]
        if not rows:
            self.layout.children = []
            return
        lines = []
        for each in rows:
            hold = button(f"Hold {each.name}", partial(self._hold, each.name))
            prior = button(f"Give {each.name} a prior", partial(self._prior, each.name))
            text = words("which", f"<p><b>{escaped(each.name)}</b> is not determined:</p>")
            text.sizing_mode, text.width = "fixed", 190
            lines.append(row(text, hold, prior, sizing_mode="stretch_width", stylesheets=[LINE]))
        heading = words("remedy", "<h3>What would help</h3>")
        advice = words(
            "advice",
            "<p>Or measure what shows it: <code>fmuid design</code> compares excitations before they are measured.</p>",
        )
        self.layout.children = [heading, *lines, advice, self.tables, self.run.layout, self.compared]

    def _hold(self, name: str) -> None:
        self._row(name).hold.active = True

    def _prior(self, name: str) -> None:
        self._row(name).give_prior()

    def _row(self, name: str) -> Any:
        return next(each for each in self.page.rows if each.name == name)

    def compare(self) -> None:
        """Begin ``fmuid design`` with the tables that are chosen."""
        where = self.page.bench.folder
        if not self.tables.value:
            self.run.refuse("choose tables: what the inputs would be, such as of a faster or longer record")
            return
        design, study, *settings = self.page.words("design")
        given = [beside(path, self.page.path) for path in map(where.path, self.tables.value)]
        output = beside(self.folder, self.page.path)
        self.run.begin(self.page.path, [design, study, *given, "--output", output, *settings])

    def _end(self, job: Job) -> None:
        link = address("results", self.page.bench.folder, self.folder)
        done = job.code == 0 and self.page.bench.folder.has(self.folder)
        self.compared.text = f'<p><a href="{link}">The excitations compared</a></p>' if done else ""


def undetermined(result: Result) -> list[str]:
    """Return the parameters of a result that the data do not determine, or hardly."""
    open_ = [name for name, std in zip(result.names, result.std, strict=True) if not math.isfinite(std)]
    return list(
        dict.fromkeys([*open_, *(name for each in (*result.undetermined, *result.weak) for name in each.names)])
    )
