"""The page of results: what a report says of a folder, or several identifications side by side."""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from bokeh.layouts import column, row
from bokeh.models import FileInput, Select
from markupsafe import Markup

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address, escaped, file_address
from fmuid.apps.workbench.jobs import Job, command_text
from fmuid.apps.workbench.page_layout import LINE, SHEET, WIDE, argument, arguments, dress, words
from fmuid.apps.workbench.pages.command_panel import CommandPanel
from fmuid.apps.workbench.pages.remedy_panel import ExcitationComparison, UndeterminedResult
from fmuid.apps.workbench.project_folder import TABLES, Folder, FoundResult, choices, tables
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import file_name, is_file, replacing
from fmuid.formatting import label, with_std
from fmuid.reports.interactive import comparison
from fmuid.reports.interactive.live import ZoomedFit, in_scheme
from fmuid.reports.interactive.style import DARK, MAX_DOTS, MAX_ROWS
from fmuid.reports.page.document import Part, Section, table, written_parts
from fmuid.reports.page.write import contents
from fmuid.reports.render import html
from fmuid.reports.render.document_json import DOCUMENT_FILE, read_documents
from fmuid.runs import estimate_rows
from fmuid.studies import read_toml

# Where a figure that the document follows stands in the text of a page.
PLACE = "<!-- figure -->"
# The place of what would help.
REMEDIES = "remedies"


def build(doc: Any, bench: Any) -> None:
    """Fill a document with the page of the folders that its address names."""
    folder: Folder = bench.folder
    places = [folder.path(name) for name in dict.fromkeys(arguments(doc, "file"))]
    if not places:
        raise InputError("choose results on the first page")
    title, parts = contents(places[0]) if len(places) == 1 else _compared(folder, places)
    parts, zoomed = _zoomed(doc, parts)
    if len(places) == 1:
        parts, helping = _helped(doc, bench, places[0], parts)
        zoomed = [*helping, *zoomed]
    body, drawings = written_parts(parts)
    if len(places) == 1 and is_file(places[0] / DOCUMENT_FILE):
        documents = list(read_documents(places[0]).values())
        more, drawn = html.written(documents)
        title = next((each.title for each in documents if each.title), title)
        body, drawings = body + more, [*drawings, *drawn]
    shown = list(zip(body.split(PLACE), [*zoomed, ""], strict=True))
    if len(places) == 1:
        shown = [_elsewhere(folder, places[0]), *shown, *_acts(doc, bench, places[0])]
    # the others as in a report: models of a server would take it seconds, in which it answers nobody
    colors = DARK if argument(doc, SCHEME) == "dark" else {}
    figures = json.dumps({"drawings": drawings, "colors": colors})  # in this order: what is referred to comes before
    doc.template_variables["figures"] = Markup(figures.replace("<", "\\u003c"))
    dress(doc, title, shown, "bokeh-widgets")


def _elsewhere(folder: Folder, place: Path) -> tuple[str, str]:
    """Return the piece of a page that leads from a result to its study and its report."""
    study, report = next(map(FoundResult.of, filter(is_file, [place / "result.json"])), None), place / "report.html"
    links = {}
    if study is not None and study.study is not None and folder.has(study.study):
        links["What-if and identify"] = address("study", folder, study.study)
    if is_file(report):
        links["The same as a page to be mailed"] = file_address(folder, report)
    return "<p>" + " ".join(f'<a class=go href="{link}">{text}</a>' for text, link in links.items()) + "</p>", ""


def _acts(doc: Any, bench: Any, place: Path) -> list[tuple[str, str]]:
    """Add to the document what can be done with a result, and return the pieces of the page that have it."""
    found = (
        {"Predict another record": PredictAction(doc, bench, place).layout} if is_file(place / "result.json") else {}
    )
    found["Pass it on"] = WriteAction(doc, bench, place).layout
    for layout in found.values():
        doc.add_root(layout)
    pieces = ((f"<section><h3>{head}</h3>", layout.name) for head, layout in found.items())
    return [each for piece in pieces for each in (piece, ("</section>", ""))]


def _helped(doc: Any, bench: Any, place: Path, parts: Sequence[Part]) -> tuple[list[Part], list[str]]:
    """Have a verdict that not all is determined be followed by what would help; return parts, and names of places."""
    open_ = UndeterminedResult(bench.folder, place)
    if not open_.names:
        return list(parts), []
    layout = ExcitationComparison(doc, bench, open_.study, place, lambda: open_.designing).layout
    doc.add_root(layout)
    more = f"<h3 id={REMEDIES}>What would help</h3>{open_.links()}{PLACE}"
    return [replace(parts[0], table=parts[0].table + more), *parts[1:]], [layout.name]


def _zoomed(doc: Any, parts: Sequence[Part]) -> tuple[list[Part], list[str]]:
    """Have the document follow fits with more samples than can be seen; return parts with places for them, and names.

    Such a figure is thinned anew for the stretch of time that is looked at.
    """
    names: list[str] = []

    def placed(section: Section) -> Section:
        if not section.fit or len(section.fit[0].times) <= min(MAX_ROWS, MAX_DOTS):
            return section
        figure = ZoomedFit(doc.add_next_tick_callback, *section.fit).figure
        doc.add_root(column(in_scheme(figure, argument(doc, SCHEME)), name=section.name, **WIDE))
        names.append(section.name)
        return replace(section, figures=(), body=section.body + PLACE)

    return [replace(part, sections=[placed(each) for each in part.sections]) for part in parts], names


def _compared(folder: Folder, places: Sequence[Path]) -> tuple[str, list[Part]]:
    """Return the title and the part of a page that shows results side by side."""
    results, wrong = dict[str, Result](), ""
    for place in places:
        try:
            results[folder.name(place)] = Result.from_json(place / "result.json")
        except InputError as error:
            wrong += f"<p class=error>{escaped(error)}</p>"
    if not results:
        return "Results side by side", [Part("Side by side", "cannot be read", False, [], wrong, [])]
    units = {name: unit for each in results.values() for name, unit in each.units.items()}
    labels = {  # of a result that says no unit as others have it; those in another unit are in another row
        key: [label(name, each.units.get(name, units.get(name))) for name in each.names]
        for key, each in results.items()
    }
    names = list(dict.fromkeys(name for each in labels.values() for name in each))
    columns = {"parameter": names}
    for key, result in results.items():
        known = dict(zip(labels[key], zip(result.values.tolist(), result.std.tolist(), strict=True), strict=True))
        columns[key] = [_estimate(known.get(name)) for name in names]
    rows = pd.DataFrame([each for key, result in results.items() for each in estimate_rows(key, result)])
    sections = [Section("estimates", "Estimates and their 95 % intervals", "", comparison.estimates(rows), 2)]
    part = Part("Side by side", f"{len(results)} results", True, [], table(columns, numbers=list(results)), sections)
    words = command_text(["compare", *results])
    note = f"<h3>Which of them the data prefer says</h3><pre>{escaped(words)}</pre>"
    note += "".join(f"<h3>{escaped(folder.name(place))}</h3>{_onward(folder, place)}" for place in places)
    return "Results side by side", [replace(part, table=wrong + part.table + note)]


def _onward(folder: Folder, place: Path) -> str:
    """Return links from one of several results to its own page, and to what would help."""
    link, open_ = address("results", folder, place), UndeterminedResult(folder, place)
    more = f'<p><a class=go href="{link}#{REMEDIES}">Compare excitations</a></p>' if open_.names else ""
    return f'<p><a class=go href="{link}">All figures</a></p>{open_.links()}{more}'


def _estimate(known: tuple[float, float] | None) -> str:
    if known is None:
        return ""
    return with_std(*known) if math.isfinite(known[1]) else f"{known[0]:.6g}, not determined"


class PredictAction:
    """Prediction of a data file that is chosen or dropped, by ``fmuid predict``."""

    def __init__(self, doc: Any, bench: Any, place: Path) -> None:
        self.folder: Folder = bench.folder
        self.place, self.said = place, words("written")
        self.run = CommandPanel(doc, bench.jobs, self.place / "prediction", {"Predict": self.begin}, ended=self._end)
        known = [self.folder.name(path) for path in tables(self.folder)]
        self.chosen = Select(title="a table of the folder", options=["", *known], value="", name="table")
        self.dropped = FileInput(value="", filename="", title="or drop one here", accept=",".join(TABLES), name="drop")
        for each in (self.chosen, self.dropped):
            each.stylesheets = [SHEET]
        inputs = row(self.chosen, self.dropped, sizing_mode="stretch_width", stylesheets=[LINE])
        self.layout = column(inputs, self.run.layout, self.said, name="predict", sizing_mode="stretch_width")

    def begin(self) -> None:
        """Begin with what was chosen or dropped."""
        try:
            path = self._given()
        except InputError as error:
            self.run.refuse(error)
            return
        self.run.begin(self.place / "result.json", ["predict", str(self.place), str(path)])

    def _given(self) -> Path:
        """Return the table; one that was dropped is written beside the predictions.

        Raises
        ------
        InputError
            If there is none, or it is not of a kind that tables are.
        """
        if self.dropped.value:
            name = file_name(Path(str(self.dropped.filename)).name)
            if not name.lower().endswith(TABLES):
                raise InputError(f"{name} is no table: give a file of the kinds {', '.join(TABLES)}")
            try:
                content = base64.b64decode(self.dropped.value, validate=True)
            except binascii.Error:
                raise InputError(f"{name} did not arrive whole: drop it again") from None
            path = self.place / "prediction" / "dropped" / name.lstrip(".")
            with replacing(path) as draft:
                draft.write_bytes(content)
            return path
        if not self.chosen.value:
            raise InputError("choose a table, or drop one")
        return self.folder.path(self.chosen.value)

    def _end(self, job: Job) -> None:
        link = address("results", self.folder, self.place / "prediction")
        self.said.text = f'<p><a href="{link}">The prediction</a></p>' if job.code == 0 else ""


class WriteAction:
    """Report of a result, by ``fmuid report``, and an FMU with its values, by ``fmuid apply``."""

    def __init__(self, doc: Any, bench: Any, place: Path) -> None:
        self.folder: Folder = bench.folder
        self.place, self.said = place, words("written")
        acts = {"Write the report": lambda: self.begin(self.reporting)}
        self.fmus = _fmus(self.folder, self.place) if is_file(self.place / "result.json") else {}
        names = list(self.fmus)
        self.fmu = Select(title="FMU", options=names, value=names[0] if names else "", name="fmu", stylesheets=[SHEET])
        self.fmu.on_change("value", lambda _attr, _old, _new: self._tell())
        self.command = words("commands")
        if names:
            acts["Apply to the FMU"] = lambda: self.begin(self.applying)
        self.run = CommandPanel(doc, bench.jobs, self.place, acts, ended=self._end)
        parts = [self.fmu, self.run.layout] if names else [self.run.layout]
        self.layout = column(*parts, self.said, self.command, name="writing", sizing_mode="stretch_width")
        self._tell()

    @property
    def reporting(self) -> list[str]:
        """The command that writes the report."""
        return ["report", str(self.place)]

    @property
    def applying(self) -> list[str]:
        """The command that writes a copy of the FMU."""
        fmu = self.fmus[self.fmu.value]
        return ["apply", str(self.place), str(fmu), "--output", str(self.place / f"{fmu.stem}{APPLIED}")]

    def begin(self, given: list[str]) -> None:
        """Begin one of the commands."""
        self.run.begin(self.place / "result.json", given)

    def _tell(self) -> None:
        lines = [command_text(self.reporting)] + ([command_text(self.applying)] if self.fmu.value in self.fmus else [])
        self.command.text = f"<pre>{'<br>'.join(map(escaped, lines))}</pre>"

    def _end(self, job: Job) -> None:
        report = self.place / "report.html"
        said = f'<a href="{file_address(self.folder, report)}">{escaped(self.folder.name(report))}</a>'
        if job.words[0] == "apply":
            said = escaped(self.folder.name(Path(job.words[-1])))
        self.said.text = f"<p>Written: {said}</p>" if job.code == 0 else ""


APPLIED = "-identified.fmu"
"""How the copy of an FMU ends that has the values of a result."""


def _fmus(folder: Folder, place: Path) -> dict[str, Path]:
    """Return the FMUs that the values of a result may go into, by their names: first that of its study."""
    study = FoundResult.of(place / "result.json").study
    try:
        model = read_toml(study)["model"] if study is not None else {}
        own = [(study.parent / str(model["fmu"])).resolve()] if study is not None and "fmu" in model else []
    except (InputError, KeyError, TypeError):
        own = []
    known = [*(path for path in own if is_file(path)), *choices(folder, (".fmu",))]
    return {folder.name(path): path for path in known if not path.name.endswith(APPLIED)}
