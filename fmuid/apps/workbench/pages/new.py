"""The page that begins a study from an FMU and tables, by the steps of ``fmuid init``."""

from __future__ import annotations

from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Select, TextInput

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address, escaped
from fmuid.apps.workbench.jobs import Job, command_text
from fmuid.apps.workbench.page_layout import LINE, SHEET, WIDE, argument, dress, several, words
from fmuid.apps.workbench.pages.command_panel import CommandPanel
from fmuid.apps.workbench.pages.live import in_scheme
from fmuid.apps.workbench.project_folder import Folder, choices, tables
from fmuid.data import first_lines
from fmuid.errors import FmuidError, InputError
from fmuid.reports.document import table_of
from fmuid.reports.render.html import details, table
from fmuid.reports.topics.init import LINK_HEADS, heading, link_cells, remarks
from fmuid.reports.topics.preprocessing import preprocessing_charts
from fmuid.runs import prepared_columns
from fmuid.studies import InitOptions, MatchedDataFile, match_data_files, parse_column, value_of
from fmuid.units import TIME_UNITS

GUESSED, NONE = "(guess)", "(none)"
"""What stands for a column that is not said, and for none."""
LABELS = {
    "lowpass_frequency": "low-pass (Hz)",
    "start_time": "from (s)",
    "end_time": "to (s)",
    "resample_interval": "resample (s)",
}
"""Words of ``[experiments.preprocess]`` that are asked for, beside detrend; the file has room for all."""
ROWS = 5
"""Of a table that are shown."""
CHARACTERS = 1200


def build(doc: Any, bench: Any) -> None:
    """Fill a document with the page."""
    NewPage(doc, bench, argument(doc, SCHEME))


class NewPage:
    """What one tab shows of a study that is to be."""

    def __init__(self, doc: Any, bench: Any, scheme: str) -> None:
        self.folder: Folder = bench.folder
        self.scheme, self.records = scheme, tuple[MatchedDataFile, ...]()
        fmus = [self.folder.name(path) for path in choices(self.folder, (".fmu",))]
        known = [self.folder.name(path) for path in tables(self.folder)]
        self.fmu = Select(title="FMU", options=["", *fmus], value=fmus[0] if len(fmus) == 1 else "", name="fmu")
        self.tables = several("tables, one an experiment", known, "chosen")
        self.time = _typed("column of time", "time", "time")
        self.unit = Select(title="its unit", options=["", *TIME_UNITS], value="", name="time-unit")
        self.rate = _typed("samples per second", "", "rate")
        self.sheet = _typed("sheet", "", "sheet")
        self.output = _typed("study file to write", "study.toml", "output")
        self.prepare = {each: _typed(LABELS[each], "", each) for each in LABELS}
        self.prepare["detrend"] = Select(title="detrend", options=["", "mean", "linear"], value="", name="detrend")
        self.maps: dict[str, Select] = {}
        self.mapping = row([], name="mapping", stylesheets=[LINE], sizing_mode="stretch_width")
        self.said, self.command = words("said"), words("command")
        self.drawn = column([], name="drawn", **WIDE)
        self.run = CommandPanel(
            doc, bench.jobs, self.folder.root / "init", {"Write study": self.write}, ended=self._end
        )
        how = (self.time, self.unit, self.rate, self.sheet)
        for each in (self.fmu, self.tables, *how, self.output, *self.prepare.values()):
            each.stylesheets = [SHEET]
            each.on_change("value", lambda _attr, _old, _new: self.look())
        lines = [row(*some, stylesheets=[LINE], sizing_mode="stretch_width") for some in (how, self.prepare.values())]
        first = column(self.fmu, self.tables, lines[0], name="tables", sizing_mode="stretch_width")
        roots = {"tables": first, "mapping": column(self.mapping, self.said, name="mapping", **WIDE)}
        roots["prepare"] = column(lines[1], self.drawn, name="prepare", sizing_mode="stretch_width")
        roots["write"] = column(self.output, self.run.layout, self.command, name="write", sizing_mode="stretch_width")
        for root in roots.values():
            doc.add_root(root)
        heads = ("Model and tables", "Which column is which", "What is done with the tables first", "The study")
        pieces = [
            (("</section>" if k else "") + f"<section><h3>{k + 1}. {head}</h3>", root)
            for k, (head, root) in enumerate(zip(heads, roots, strict=True))
        ]
        dress(doc, "New study", [*pieces, ("</section>", "")], "bokeh-widgets")
        self.look()

    # --- what is asked for

    @property
    def asked(self) -> InitOptions:
        """What is said of the tables.

        Raises
        ------
        InputError
            If what stands for a number is none.
        """
        rate = value_of(self.rate.value) if self.rate.value.strip() else None
        if rate is not None and not (isinstance(rate, int | float) and rate > 0):
            raise InputError(f"samples per second are a number above 0, not {rate!r}")
        given = {name: each.value for name, each in self.maps.items() if each.value != GUESSED}
        columns = {name: "" if value == NONE else value for name, value in given.items()}
        how = {word: value_of(each.value) for word, each in self.prepare.items() if each.value.strip()}
        sheet = parse_column(self.sheet.value) if self.sheet.value.strip() else None
        return InitOptions(parse_column(self.time.value or "time"), self.unit.value or None, rate, sheet, columns, how)

    def words(self) -> list[str]:
        """Return the command, to be given in the opened folder."""
        asked = self.asked
        options = [("--output", self.output.value), ("--time", str(asked.time) if asked.time != "time" else "")]
        options += [("--time-unit", asked.time_unit or ""), ("--sample-rate", self.rate.value.strip())]
        options += [("--sheet", self.sheet.value.strip())]
        options += [("--map", f"{name}={value}") for name, value in asked.columns.items()]
        options += [
            ("--preprocess", f"{word}={each.value}") for word, each in self.prepare.items() if each.value.strip()
        ]
        return ["init", self.fmu.value, *self.tables.value, *(each for pair in options if pair[1] for each in pair)]

    # --- what is shown

    def look(self) -> None:
        """Read the tables as it is said, and show what they are taken for."""
        self.records, self.drawn.children = (), []
        self.run.buttons[0].disabled = True
        if not self.fmu.value or not self.tables.value:
            self.said.text = "<p class=soft>Choose an FMU and tables of this folder.</p>"
            self.mapping.children, self.maps = [], {}
            return
        try:
            where = [self.folder.path(name) for name in self.tables.value]
            self.records = match_data_files(self.folder.path(self.fmu.value), where, self.asked)
            self.command.text = f"<pre>{escaped(command_text(self.words()))}</pre>"
        except FmuidError as error:
            self.said.text, self.command.text = f"<p class=error role=alert>{escaped(error)}</p>", ""
            return
        self._offer()
        self.said.text = "".join(_record(record, self.folder) for record in self.records)
        self.drawn.children = [self._figure(record) for record in self.records if record.experiment is not None]
        self.run.buttons[0].disabled = False

    def _offer(self) -> None:
        """Let the column of each variable be chosen, where that is another set of variables than before."""
        options = [GUESSED, NONE, *dict.fromkeys(name for record in self.records for name in record.columns)]
        names = list(dict.fromkeys(link.variable for record in self.records for link in record.links))
        if names == list(self.maps) and all(each.options == options for each in self.maps.values()):
            return
        before = {name: each.value for name, each in self.maps.items()}
        self.maps = {}
        for name in names:
            value = before.get(name, GUESSED)
            made = Select(title=name, options=options, value=value if value in options else GUESSED, width=150)
            made.name, made.stylesheets = f"map {name}", [SHEET]
            made.on_change("value", lambda _attr, _old, _new: self.look())
            self.maps[name] = made
        self.mapping.children = list(self.maps.values())

    def _figure(self, record: MatchedDataFile) -> Any:
        assert record.experiment is not None
        drawn = prepared_columns(record.settings, record.experiment, record.frame, whole=True)
        return in_scheme([preprocessing_charts(drawn, record.frame.attrs.get("units", {}))], self.scheme)[0]

    # --- writing

    def write(self) -> None:
        """Begin ``fmuid init``."""
        try:
            path = self.folder.root / self.output.value
            if path.suffix != ".toml" or not self.folder.has(path):
                raise InputError(f"{self.output.value}: a study is a .toml file of this folder")
            self.run.begin(self.folder.root / "init", self.words())
        except InputError as error:
            self.run.refuse(error)

    def _end(self, job: Job) -> None:
        path = self.folder.root / self.output.value
        if path.is_file() and job.code in (0, 1):
            link = address("study", self.folder, path)
            self.run.state.text += f'<p><a href="{link}">What-if and identify</a></p>'


def _typed(title: str, value: str, name: str) -> TextInput:
    return TextInput(title=title, value=value, name=name, width=150)


def _record(record: MatchedDataFile, folder: Folder) -> str:
    """Return what a table has and what it is taken for, as HTML."""
    links = [link_cells(link) for link in record.links]
    taken = table(table_of({head: [cells[k] for cells in links] for k, head in enumerate(LINK_HEADS)}, LINK_HEADS))
    first = record.frame.head(ROWS)
    columns = {
        str(name): [f"{each:.6g}" if isinstance(each, float) else str(each) for each in first[name]]
        for name in [record.time, *record.columns]
    }
    read = table(table_of(columns, columns))
    file = "\n".join(first_lines(record.path, 2 * ROWS))[:CHARACTERS]
    file = details("The beginning of the file", file) if file else ""
    said = "".join(f"<li>{escaped(each)}</li>" for each in remarks(record))
    doubts = f"<ul class=doubts>{said}</ul>" if said else ""
    title = escaped(heading(record, folder.name(record.path)))
    return f"<h3>{title}</h3>{taken}{doubts}<p class=soft>As it is read, time in s:</p>{read}{file}"
