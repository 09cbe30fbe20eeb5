"""The page of results: what a report says of a folder, or several identifications side by side."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import FileInput, Select
from markupsafe import Markup

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address, escaped, file_address
from fmuid.apps.workbench.jobs import Job, command_text
from fmuid.apps.workbench.page_layout import LINE, SHEET, WIDE, argument, arguments, dress, words
from fmuid.apps.workbench.pages.command_panel import CommandPanel
from fmuid.apps.workbench.pages.live import ZoomedFit
from fmuid.apps.workbench.pages.remedy_panel import ExcitationComparison, UndeterminedResult
from fmuid.apps.workbench.project_folder import TABLES, Folder, FoundResult, choices, tables
from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import file_name, is_file, replacing
from fmuid.formatting import label, with_std
from fmuid.reports import documents_of
from fmuid.reports.chart import MAX_DOTS, MAX_ROWS, ChartGrid
from fmuid.reports.document import Document, Section, table_of
from fmuid.reports.render.html import place_of, written
from fmuid.reports.render.style import DARK
from fmuid.reports.topics.fit import fit_sections, worst
from fmuid.reports.topics.model_comparison import estimate_charts
from fmuid.reports.topics.prediction import prediction_fits
from fmuid.runs import estimate_rows, read_identification, read_prediction
from fmuid.studies import read_toml

# The place of what would help.
REMEDIES = "remedies"


def build(doc: Any, bench: Any) -> None:
    """Fill a document with the page of the folders that its address names."""
    folder: Folder = bench.folder
    places = [folder.path(name) for name in dict.fromkeys(arguments(doc, "file"))]
    if not places:
        raise InputError("choose results on the first page")
    if len(places) > 1:
        title, body, drawings, live = "Results side by side", *_compared(folder, places), dict[str, str]()
    else:
        title, body, drawings, live = _one(doc, bench, places[0])
    pieces = re.split(f"({'|'.join(map(re.escape, live))})", body) if live else [body]
    shown = [(text, live.get(place, "")) for text, place in zip(pieces[::2], [*pieces[1::2], ""], strict=True)]
    if len(places) == 1:
        shown = [_elsewhere(folder, places[0]), *shown, *_acts(doc, bench, places[0])]
    # the others as in a report: models of a server would take it seconds, in which it answers nobody
    colors = DARK if argument(doc, SCHEME) == "dark" else {}
    figures = json.dumps({"drawings": drawings, "colors": colors})  # in this order: what is referred to comes before
    doc.template_variables["figures"] = Markup(figures.replace("<", "\\u003c"))
    dress(doc, title, shown, "bokeh-widgets")


def _one(doc: Any, bench: Any, place: Path) -> tuple[str, str, Any, dict[str, str]]:
    """Return title, HTML and figures of the documents of a folder, and what the document follows, by its place."""
    documents = list(documents_of(place).values())
    title = next((each.title for each in documents if each.title), "") or place.parent.name
    live = _zoomed(doc, place, documents)
    body, drawings = written(documents, frozenset(live))
    names = {place_of(key): key for key in live}
    open_ = UndeterminedResult(bench.folder, place)
    if open_.names:
        layout = ExcitationComparison(doc, bench, open_.study, place, lambda: open_.designing).layout
        doc.add_root(layout)
        names[place_of(REMEDIES)] = layout.name
        more = f"<h3 id={REMEDIES}>What would help</h3>{open_.links()}{place_of(REMEDIES)}</section>"
        body = body.replace("</section>", more, 1)  # after the verdict
    return title, body, drawings, names


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


def _zoomed(doc: Any, place: Path, documents: Sequence[Document]) -> list[str]:
    """Have the document follow fits with more samples than can be seen; return the keys of their sections.

    Such a figure is thinned anew for the stretch of time that is looked at.
    """
    found: list[tuple[Section, Floats]] = []
    for each in documents:
        if each.kind == "identification":
            fits = read_identification(place).fits
            found += zip(fit_sections(fits), (fit.times for fit in worst(fits)), strict=True)
        elif each.kind == "prediction":
            predicted = read_prediction(place)
            fits = tuple(one.fit for one in predicted.predictions)
            found += zip(prediction_fits(predicted), (fit.times for fit in worst(fits)), strict=True)
    keys = []
    for section, times in found:
        (grid,) = section.charts
        if len(times) > min(MAX_ROWS, MAX_DOTS) and isinstance(grid, ChartGrid):
            figure = ZoomedFit(doc.add_next_tick_callback, times, grid, argument(doc, SCHEME)).figure
            doc.add_root(column(figure, name=section.key, **WIDE))
            keys.append(section.key)
    return keys


def _compared(folder: Folder, places: Sequence[Path]) -> tuple[str, Any]:
    """Return HTML and figures of results side by side."""
    results, wrong = dict[str, Result](), ""
    for place in places:
        try:
            results[folder.name(place)] = Result.from_json(place / "result.json")
        except InputError as error:
            wrong += f"<p class=error>{escaped(error)}</p>"
    if not results:
        return written([Document("compared", "Side by side", "cannot be read", "bad")])[0] + wrong, []
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
    charts = estimate_charts([each for key, result in results.items() for each in estimate_rows(key, result)])
    sections = (
        Section("values", "", table=table_of(columns)),
        Section("estimates", "Estimates and their 95 % intervals", charts=tuple(charts), beside=2),
    )
    document = Document("compared", "Side by side", f"{len(results)} results", "good", (), sections)
    words = command_text(["compare", *results])
    note = f"{wrong}<h3>Which of them the data prefer says</h3><pre>{escaped(words)}</pre>"
    note += "".join(f"<h3>{escaped(folder.name(place))}</h3>{_onward(folder, place)}" for place in places)
    body, drawings = written([document])
    return body.replace("</section>", f"{note}</section>", 1), drawings


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
