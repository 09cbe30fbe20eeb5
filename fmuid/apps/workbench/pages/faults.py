"""Page of the faults of a study: diagnosis and monitoring."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bokeh.layouts import column
from bokeh.models import Toggle

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address
from fmuid.apps.workbench.jobs import command_text
from fmuid.apps.workbench.page_layout import argument, dress, sections
from fmuid.apps.workbench.pages.panels import CommandPanel, ResultsView
from fmuid.apps.workbench.project_folder import Folder, read_study, tables
from fmuid.apps.workbench.widgets import SHEET, choice, line, on_change, words
from fmuid.errors import InputError
from fmuid.files import relative
from fmuid.reports.render.html import text as escaped

KINDS = ("monitoring", "diagnosis")


class FaultsPage:
    """Page of the faults of a study, in a document."""

    folder: Folder

    def __init__(self, doc: Any, bench: Any) -> None:
        self.folder, self.path = bench.folder, bench.folder.path(argument(doc, "file"))
        path = self.path
        study = read_study(path)
        if study is None or study.error or "diagnosis" not in study.asks:
            raise InputError(f"{path} has no [diagnosis]. Add it with the fault models.")
        self.run = CommandPanel(
            doc, bench.jobs, study.results, {"Diagnose": self.diagnose, "Monitor": self.monitor}, ended=self._look
        )
        found = [self.folder.name(each) for each in tables(self.folder)]
        places = sorted({f"{Path(name).parent.as_posix()}/" for name in found})
        self.records = choice("data to monitor", ["", *places, *found], "records")
        self.follow = Toggle(label="follow", name="follow", active=False, stylesheets=[SHEET])
        self.command = words("command")
        on_change(self._tell, self.records)
        on_change(self._tell, self.follow, name="active")
        self.shown = ResultsView(doc, study.results, argument(doc, SCHEME), KINDS)
        if self.run.job is not None and self.run.job.running:
            self.run.follow()
        self._tell()
        parts = (line(self.records, self.follow), self.run.layout, self.command)
        controls = column(*parts, name="controls", sizing_mode="stretch_width")
        link = f'<p><a href="{address("study", self.folder, path)}">Simulate and identify</a></p>'
        pieces = sections(doc, {"<h3>Diagnosis and monitoring</h3>": controls, "": self.shown.layout})
        dress(doc, f"{study.title}: faults", [(link if study.parameters else "", ""), *pieces], "bokeh-widgets")

    def words(self) -> list[str]:
        """Return the command that monitors the chosen data."""
        where = relative(self.folder.path(self.records.value), self.path.parent) if self.records.value else "DATA"
        return ["monitor", self.path.name, where, *(["--follow"] if self.follow.active else [])]

    def diagnose(self) -> None:
        """Start ``fmuid diagnose``."""
        self.run.begin(self.path, ["diagnose", self.path.name])

    def monitor(self) -> None:
        """Start ``fmuid monitor`` of the chosen data."""
        if not self.records.value:
            self.run.refuse("No data chosen. Choose a data file or a folder.")
            return
        self.run.begin(self.path, self.words())

    def _look(self, _job: object) -> None:
        self.shown.look()

    def _tell(self) -> None:
        lines = (command_text(["diagnose", self.path.name]), command_text(self.words()))
        self.command.text = f"<h3>Commands</h3><pre>{escaped(lines[0])}<br>{escaped(lines[1])}</pre>"
