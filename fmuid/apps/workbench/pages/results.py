"""Page of results: the report of a folder, or results side by side."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bokeh.layouts import column
from bokeh.models import FileInput
from markupsafe import Markup

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address, file_address
from fmuid.apps.workbench.jobs import Job, command_text
from fmuid.apps.workbench.page_layout import argument, arguments, dress, sections
from fmuid.apps.workbench.pages.live import ZoomedFit
from fmuid.apps.workbench.pages.panels import CommandPanel
from fmuid.apps.workbench.pages.remedy_panel import ExcitationComparison, UndeterminedResult
from fmuid.apps.workbench.project_folder import TABLES, Folder, FoundResult, choices, tables
from fmuid.apps.workbench.widgets import SHEET, WIDE, choice, line, on_change, words
from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import file_name, is_file, replacing
from fmuid.formatting import label, with_std
from fmuid.reports import documents_of
from fmuid.reports.chart import LIMITS, ChartGrid
from fmuid.reports.document import Document, Section, table_of
from fmuid.reports.render.html import place_of, written
from fmuid.reports.render.html import text as escaped
from fmuid.reports.render.style import DARK
from fmuid.reports.topics.fit import fit_sections, worst
from fmuid.reports.topics.model_comparison import estimate_charts
from fmuid.reports.topics.prediction import prediction_fits
from fmuid.runs import estimate_rows, read_fits, read_prediction
from fmuid.studies import read_toml

REMEDIES = "remedies"  # place of the remedies


def build(doc: Any, bench: Any) -> None:
    """Fill a document with the page of results folders."""
    folder: Folder = bench.folder
    places = [folder.path(name) for name in dict.fromkeys(arguments(doc, "file"))]
    if not places:
        raise InputError("No results chosen. Choose results on the first page.")
    if len(places) > 1:
        title, body, drawings, live = "Results side by side", *_compared(folder, places), dict[str, str]()
    else:
        title, body, drawings, live = _one(doc, bench, places[0])
    pieces = re.split(f"({'|'.join(map(re.escape, live))})", body) if live else [body]
    shown = [(text, live.get(place, "")) for text, place in zip(pieces[::2], [*pieces[1::2], ""], strict=True)]
    if len(places) == 1:
        shown = [_elsewhere(folder, places[0]), *shown, *_acts(doc, bench, places[0])]
    # other figures are drawn as in a report: server models would block for seconds
    colors = DARK if argument(doc, SCHEME) == "dark" else {}
    figures = json.dumps({"drawings": drawings, "colors": colors})  # in this order: references come first
    doc.template_variables["figures"] = Markup(figures.replace("<", "\\u003c"))
    dress(doc, title, shown, "bokeh-widgets")


def _one(doc: Any, bench: Any, place: Path) -> tuple[str, str, Any, dict[str, str]]:
    """Return title, HTML, figures and live figures of a folder."""
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
        more = f"<h3 id={REMEDIES}>Remedies</h3>{open_.links()}{place_of(REMEDIES)}</section>"
        body = body.replace("</section>", more, 1)  # after the verdict
    return title, body, drawings, names


def _elsewhere(folder: Folder, place: Path) -> tuple[str, str]:
    """Return the links from a result to its study and report."""
    study, report = next(map(FoundResult.of, filter(is_file, [place / "result.json"])), None), place / "report.html"
    links = {}
    if study is not None and study.study is not None and folder.has(study.study):
        links["Simulate and identify"] = address("study", folder, study.study)
    if is_file(report):
        links["Report file"] = file_address(folder, report)
    return "<p>" + " ".join(f'<a class=go href="{link}">{text}</a>' for text, link in links.items()) + "</p>", ""


def _acts(doc: Any, bench: Any, place: Path) -> list[tuple[str, str]]:
    """Add the actions on a result to the document; return their HTML."""
    found = (
        {"Predict validation data": PredictAction(doc, bench, place).layout} if is_file(place / "result.json") else {}
    )
    found["Export"] = WriteAction(doc, bench, place).layout
    return sections(doc, {f"<h3>{head}</h3>": layout for head, layout in found.items()})


def _zoomed(doc: Any, place: Path, documents: Sequence[Document]) -> list[str]:
    """Add fits with many samples, thinned for each time range; return their keys."""
    found: list[tuple[Section, Floats]] = []
    for each in documents:
        if each.kind == "identification":
            fits = read_fits(place)
            found += zip(fit_sections(fits), (fit.times for fit in worst(fits)), strict=True)
        elif each.kind == "prediction":
            predicted = read_prediction(place)
            fits = tuple(one.fit for one in predicted.predictions)
            found += zip(prediction_fits(predicted), (fit.times for fit in worst(fits)), strict=True)
    keys = []
    for section, times in found:
        (grid,) = section.charts
        if len(times) > min(LIMITS.rows, LIMITS.dots) and isinstance(grid, ChartGrid):
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
    units = {name: unit for each in results.values() for name, unit in each.estimates.units.items()}
    labels = {  # a missing unit is that of other results; other units have other rows
        key: [label(name, each.estimates.units.get(name, units.get(name))) for name in each.names]
        for key, each in results.items()
    }
    names = list(dict.fromkeys(name for each in labels.values() for name in each))
    columns = {"parameter": names}
    for key, result in results.items():
        known = dict(zip(labels[key], zip(result.values.tolist(), result.std.tolist(), strict=True), strict=True))
        columns[key] = [_estimate(known.get(name)) for name in names]
    charts = estimate_charts([each for key, result in results.items() for each in estimate_rows(key, result)])
    parts = (
        Section("values", "", table=table_of(columns)),
        Section("estimates", "Estimates with 95 % intervals", charts=tuple(charts), beside=2),
    )
    document = Document("compared", "Side by side", f"{len(results)} results", "good", (), parts)
    words = command_text(["compare", *results])
    note = f"{wrong}<h3>Model comparison</h3><pre>{escaped(words)}</pre>"
    note += "".join(f"<h3>{escaped(folder.name(place))}</h3>{_onward(folder, place)}" for place in places)
    body, drawings = written([document])
    return body.replace("</section>", f"{note}</section>", 1), drawings


def _onward(folder: Folder, place: Path) -> str:
    """Return links from a compared result to its page and remedies."""
    link, open_ = address("results", folder, place), UndeterminedResult(folder, place)
    more = f'<p><a class=go href="{link}#{REMEDIES}">Compare excitations</a></p>' if open_.names else ""
    return f'<p><a class=go href="{link}">All figures</a></p>{open_.links()}{more}'


def _estimate(known: tuple[float, float] | None) -> str:
    if known is None:
        return ""
    return with_std(*known) if math.isfinite(known[1]) else f"{known[0]:.6g}, not identifiable"


class PredictAction:
    """Prediction of a chosen or dropped data file, by ``fmuid predict``."""

    def __init__(self, doc: Any, bench: Any, place: Path) -> None:
        self.folder: Folder = bench.folder
        self.place, self.said = place, words("written")
        self.run = CommandPanel(doc, bench.jobs, self.place / "prediction", {"Predict": self.begin}, ended=self._end)
        known = [self.folder.name(path) for path in tables(self.folder)]
        self.chosen = choice("data file", ["", *known], "table")
        self.dropped = FileInput(
            value="", filename="", title="or drop a file here", accept=",".join(TABLES), name="drop"
        )
        self.dropped.stylesheets = [SHEET]
        inputs = line(self.chosen, self.dropped)
        self.layout = column(inputs, self.run.layout, self.said, name="predict", sizing_mode="stretch_width")

    def begin(self) -> None:
        """Start with the chosen or dropped file."""
        try:
            path = self._given()
        except InputError as error:
            self.run.refuse(error)
            return
        self.run.begin(self.place / "result.json", ["predict", str(self.place), str(path)])

    def _given(self) -> Path:
        """Return the data file; a dropped one is written beside the predictions."""
        if self.dropped.value:
            name = file_name(Path(str(self.dropped.filename)).name)
            if not name.lower().endswith(TABLES):
                raise InputError(f"{name}: not a data file. Supported: {', '.join(TABLES)}.")
            try:
                content = base64.b64decode(self.dropped.value, validate=True)
            except binascii.Error:
                raise InputError(f"{name}: upload incomplete. Drop it again.") from None
            path = self.place / "prediction" / "dropped" / name.lstrip(".")
            with replacing(path) as draft:
                draft.write_bytes(content)
            return path
        if not self.chosen.value:
            raise InputError("No data file. Choose or drop one.")
        return self.folder.path(self.chosen.value)

    def _end(self, job: Job) -> None:
        link = address("results", self.folder, self.place / "prediction")
        self.said.text = f'<p><a href="{link}">Prediction</a></p>' if job.code == 0 else ""


class WriteAction:
    """Report of a result, by ``fmuid report``; an FMU, by ``fmuid apply``."""

    def __init__(self, doc: Any, bench: Any, place: Path) -> None:
        self.folder: Folder = bench.folder
        self.place, self.said = place, words("written")
        acts = {"Write the report": lambda: self.begin(self.reporting)}
        self.fmus = _fmus(self.folder, self.place) if is_file(self.place / "result.json") else {}
        names = list(self.fmus)
        self.fmu = choice("FMU", names, "fmu", names[0] if names else "")
        on_change(self._tell, self.fmu)
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
        """Start a command."""
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


APPLIED = "-identified.fmu"  # name ending of a copy of an FMU with the values of a result


def _fmus(folder: Folder, place: Path) -> dict[str, Path]:
    """Return the FMUs for a result's values by name, its own first."""
    study = FoundResult.of(place / "result.json").study
    try:
        model = read_toml(study)["model"] if study is not None else {}
        own = [(study.parent / str(model["fmu"])).resolve()] if study is not None and "fmu" in model else []
    except (InputError, KeyError, TypeError):
        own = []
    known = [*(path for path in own if is_file(path)), *choices(folder, (".fmu",))]
    return {folder.name(path): path for path in known if not path.name.endswith(APPLIED)}
