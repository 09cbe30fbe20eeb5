"""The page on the faults of a study: diagnosis and monitoring, begun here or elsewhere, and what they find."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Select, Toggle

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address, escaped
from fmuid.apps.workbench.jobs import command_text
from fmuid.apps.workbench.page_layout import LINE, SHEET, argument, dress, words
from fmuid.apps.workbench.pages.command_panel import CommandPanel
from fmuid.apps.workbench.pages.results_view import ResultsView
from fmuid.apps.workbench.project_folder import Folder, beside, read_study, tables
from fmuid.errors import InputError

KINDS = ("monitoring", "diagnosis")


def build(doc: Any, bench: Any) -> None:
    """Fill a document with the page of the study that its address names."""
    folder: Folder = bench.folder
    FaultsPage(doc, bench, folder.path(argument(doc, "file")), argument(doc, SCHEME))


class FaultsPage:
    """What one tab shows of the faults of a study."""

    def __init__(self, doc: Any, bench: Any, path: Path, scheme: str) -> None:
        self.folder, self.path = bench.folder, path
        study = read_study(path)
        if study is None or study.error or "diagnosis" not in study.asks:
            raise InputError(f"{path} has no [diagnosis]: it names the faults to look for")
        self.run = CommandPanel(
            doc, bench.jobs, study.results, {"Diagnose": self.diagnose, "Monitor": self.monitor}, ended=self._look
        )
        found = [self.folder.name(each) for each in tables(self.folder)]
        places = sorted({f"{Path(name).parent.as_posix()}/" for name in found})
        self.records = Select(title="records to monitor", options=["", *places, *found], value="", name="records")
        self.follow = Toggle(label="follow", name="follow", active=False)
        self.command = words("command")
        for each in (self.records, self.follow):
            each.stylesheets = [SHEET]
        self.records.on_change("value", lambda _attr, _old, _new: self._tell())
        self.follow.on_change("active", lambda _attr, _old, _new: self._tell())
        self.shown = ResultsView(doc, study.results, scheme, KINDS)
        if self.run.job is not None and self.run.job.running:
            self.run.follow()
        self._tell()
        line = row(self.records, self.follow, stylesheets=[LINE], sizing_mode="stretch_width")
        controls = column(line, self.run.layout, self.command, name="controls", sizing_mode="stretch_width")
        for root in (controls, self.shown.layout):
            doc.add_root(root)
        link = f'<p><a href="{address("study", self.folder, path)}">What-if and identify</a></p>'
        pieces = [
            (f"{link if study.parameters else ''}<section><h3>Look for faults</h3>", "controls"),
            ("</section><section>", "shown"),
            ("</section>", ""),
        ]
        dress(doc, f"{study.title}: faults", pieces, "bokeh-widgets")

    def words(self) -> list[str]:
        """Return the command that monitors what is chosen."""
        where = beside(self.folder.path(self.records.value), self.path) if self.records.value else "RECORDS"
        return ["monitor", self.path.name, where, *(["--follow"] if self.follow.active else [])]

    def diagnose(self) -> None:
        """Begin ``fmuid diagnose``."""
        self.run.begin(self.path, ["diagnose", self.path.name])

    def monitor(self) -> None:
        """Begin ``fmuid monitor`` of what is chosen."""
        if not self.records.value:
            self.run.refuse("choose a record, or a folder of records")
            return
        self.run.begin(self.path, self.words())

    def _look(self, _job: object) -> None:
        self.shown.look()

    def _tell(self) -> None:
        lines = (command_text(["diagnose", self.path.name]), command_text(self.words()))
        self.command.text = f"<h3>The same from a terminal</h3><pre>{escaped(lines[0])}<br>{escaped(lines[1])}</pre>"
