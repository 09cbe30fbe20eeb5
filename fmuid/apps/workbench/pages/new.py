"""Page of a new study, as by ``fmuid init``."""

from __future__ import annotations

from typing import Any

from bokeh.layouts import column
from bokeh.models import Select

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address
from fmuid.apps.workbench.jobs import Job, command_text
from fmuid.apps.workbench.page_layout import argument, dress, sections
from fmuid.apps.workbench.pages.live import in_scheme
from fmuid.apps.workbench.pages.panels import CommandPanel
from fmuid.apps.workbench.project_folder import Folder, choices, tables
from fmuid.apps.workbench.widgets import WIDE, choice, line, on_change, several, typed, words
from fmuid.data import first_lines
from fmuid.errors import FmuidError, InputError
from fmuid.reports.render.html import details, table
from fmuid.reports.render.html import text as escaped
from fmuid.reports.topics.init import heading, links_table, notes, remarks, rows_table
from fmuid.reports.topics.preprocessing import preprocessing_charts
from fmuid.runs import prepared_columns
from fmuid.studies import KINDS, InitOptions, MatchedDataFile, match_data_files, parse_column, value_of
from fmuid.units import TIME_UNITS

GUESSED, NONE = "(guess)", "(none)"  # a guessed column, and none
LABELS = {
    "lowpass_frequency": "low-pass (Hz)",
    "start_time": "from (s)",
    "end_time": "to (s)",
    "resample_interval": "resample (s)",
}
"""Offered keys of ``[experiments.preprocess]``, beside detrend."""


class NewPage:
    """Page of a new study, in a document."""

    def __init__(self, doc: Any, bench: Any) -> None:
        self.folder: Folder = bench.folder
        self.scheme, self.records = argument(doc, SCHEME), tuple[MatchedDataFile, ...]()
        fmus = [self.folder.name(path) for path in choices(self.folder, (".fmu",))]
        known = [self.folder.name(path) for path in tables(self.folder)]
        self.fmu = choice("FMU", ["", *fmus], "fmu", fmus[0] if len(fmus) == 1 else "")
        self.tables = several("data files, one per experiment", known, "chosen")
        self.kind = choice("rows", KINDS, "kind", KINDS[0])
        self.time = typed("time column", "time", "time")
        self.unit = choice("time unit", ["", *TIME_UNITS], "time-unit")
        self.rate = typed("sample rate (Hz)", "", "rate")
        self.sheet = typed("sheet", "", "sheet")
        self.output = typed("study file", "study.toml", "output")
        self.prepare: dict[str, Any] = {each: typed(LABELS[each], "", each) for each in LABELS}
        self.prepare["detrend"] = choice("detrend", ["", "mean", "linear"], "detrend")
        self.maps: dict[str, Select] = {}
        self.mapping = line([], name="mapping")
        self.said, self.command = words("said"), words("command")
        self.drawn = column([], name="drawn", **WIDE)
        self.run = CommandPanel(
            doc, bench.jobs, self.folder.root / "init", {"Write study": self.write}, ended=self._end
        )
        how = (self.kind, self.time, self.unit, self.rate, self.sheet)
        on_change(self.look, self.fmu, self.tables, *how, self.output, *self.prepare.values())
        lines = [line(*some) for some in (how, self.prepare.values())]
        wide = {"sizing_mode": "stretch_width"}
        roots = {
            "Model and data files": column(self.fmu, self.tables, lines[0], name="tables", **wide),
            "Columns": column(self.mapping, self.said, name="mapping", **WIDE),
            "Preprocessing": column(lines[1], self.drawn, name="prepare", **wide),
            "Study file": column(self.output, self.run.layout, self.command, name="write", **wide),
        }
        pieces = sections(doc, {f"<h3>{k}. {head}</h3>": root for k, (head, root) in enumerate(roots.items(), 1)})
        dress(doc, "New study", pieces, "bokeh-widgets")
        self.look()

    @property
    def asked(self) -> InitOptions:
        """The options of the form; raises `InputError` for a wrong number."""
        rate = value_of(self.rate.value) if self.rate.value.strip() else None
        if rate is not None and not (isinstance(rate, int | float) and rate > 0):
            raise InputError(f"sample rate: {rate!r} is not a number above 0.")
        given = {name: each.value for name, each in self.maps.items() if each.value != GUESSED}
        columns = {name: "" if value == NONE else value for name, value in given.items()}
        how = {word: value_of(each.value) for word, each in self.prepare.items() if each.value.strip()}
        sheet = parse_column(self.sheet.value) if self.sheet.value.strip() else None
        time, kind = parse_column(self.time.value or "time"), self.kind.value
        return InitOptions(time, self.unit.value or None, rate, sheet, columns, how, kind=kind)

    def words(self) -> list[str]:
        """Return the command, for the opened folder."""
        asked = self.asked
        options = [("--output", self.output.value), ("--time", str(asked.time) if asked.time != "time" else "")]
        options += [("--time-unit", asked.time_unit or ""), ("--sample-rate", self.rate.value.strip())]
        options += [("--sheet", self.sheet.value.strip()), ("--kind", asked.kind if asked.kind != "time" else "")]
        options += [("--map", f"{name}={value}") for name, value in asked.columns.items()]
        options += [
            ("--preprocess", f"{word}={each.value}") for word, each in self.prepare.items() if each.value.strip()
        ]
        return ["init", self.fmu.value, *self.tables.value, *(each for pair in options if pair[1] for each in pair)]

    def look(self) -> None:
        """Read the data files, and show how they are understood."""
        self.records, self.drawn.children = (), []
        self.run.buttons[0].disabled = True
        if not self.fmu.value or not self.tables.value:
            self.said.text = "<p class=soft>Choose an FMU and data files.</p>"
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
        drawn = [record for record in self.records if record.in_time and record.experiment is not None]
        self.drawn.children = [self._figure(record) for record in drawn]
        self.run.buttons[0].disabled = False

    def _offer(self) -> None:
        """Offer columns for each variable if the variables changed."""
        options = [GUESSED, NONE, *dict.fromkeys(name for record in self.records for name in record.columns)]
        names = list(dict.fromkeys(link.variable for record in self.records for link in record.links))
        if names == list(self.maps) and all(each.options == options for each in self.maps.values()):
            return
        before = {name: each.value for name, each in self.maps.items()}
        self.maps = {}
        for name in names:
            value = before.get(name, GUESSED)
            value = value if value in options else GUESSED
            self.maps[name] = choice(name, options, f"map {name}", value, width=150)
        on_change(self.look, *self.maps.values())
        self.mapping.children = list(self.maps.values())

    def _figure(self, record: MatchedDataFile) -> Any:
        assert record.experiment is not None
        drawn = prepared_columns(record.settings, record.experiment, record.frame, whole=True)
        return in_scheme([preprocessing_charts(drawn, record.frame.attrs.get("units", {}))], self.scheme)[0]

    def write(self) -> None:
        """Start ``fmuid init``."""
        try:
            path = self.folder.root / self.output.value
            if path.suffix != ".toml" or not self.folder.has(path):
                raise InputError(f"{self.output.value}: not a .toml file in this folder.")
            self.run.begin(self.folder.root / "init", self.words())
        except InputError as error:
            self.run.refuse(error)

    def _end(self, job: Job) -> None:
        path = self.folder.root / self.output.value
        if path.is_file() and job.code in (0, 1):
            link = address("study", self.folder, path)
            self.run.state.text += f'<p><a href="{link}">Simulate and identify</a></p>'


def _record(record: MatchedDataFile, folder: Folder) -> str:
    """Return a data file, as read and as matched, as HTML."""
    read, clock = table(rows_table(record)), ", time in s" if record.in_time else ""
    file = "\n".join(first_lines(record.path, 10))[:1200]
    file = details("First lines of the file", file) if file else ""
    said = "".join(f"<li>{escaped(each.text)}</li>" for each in [*notes(record), *remarks(record)])
    doubts = f"<ul class=doubts>{said}</ul>" if said else ""
    title = escaped(heading(record, folder.name(record.path)))
    return f"<h3>{title}</h3>{table(links_table(record))}{doubts}<p class=soft>As read{clock}:</p>{read}{file}"
