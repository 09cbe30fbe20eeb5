"""Panels that pages share: a command with its progress, and the documents of a results folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bokeh.layouts import column

from fmuid.apps.workbench.jobs import Job, Jobs, command_text
from fmuid.apps.workbench.pages.live import in_scheme
from fmuid.apps.workbench.widgets import SHEET, button, line, words
from fmuid.errors import InputError
from fmuid.events import Event, SearchStep
from fmuid.files import is_file
from fmuid.reports import documents_of
from fmuid.reports.document import Document
from fmuid.reports.render.document_json import DOCUMENT_FILE
from fmuid.reports.render.html import drawn_sections, section_head, verdict
from fmuid.reports.render.html import text as escaped
from fmuid.reports.render.progress import event_words
from fmuid.runs import MONITORING_FILE

EVERY = 150  # ms between two looks at a command


class CommandPanel:
    """Buttons and progress of commands of a folder; a running one is followed.

    `acts` are the buttons; each calls `begin`. `told` gets the new events, `ended` the ended command.
    """

    def __init__(
        self,
        doc: Any,
        jobs: Jobs,
        folder: Path,
        acts: Mapping[str, Callable[[], object]],
        told: Callable[[Sequence[Event]], object] = lambda _events: None,
        ended: Callable[[Job], object] = lambda _job: None,
    ) -> None:
        self._doc, self._jobs, self._folder, self._heard, self._ended = doc, jobs, folder, told, ended
        self._position, self._callback = 0, None
        self._event: Event | None = None
        self._stage = ("", 0.0, 0.0)  # present task, its begin (s), its completed fraction then
        self.job = jobs.of(folder)
        self.buttons = [button(label, act, button_type="primary") for label, act in acts.items()]
        self.stop = button("Cancel", self.cancel, disabled=True)
        self.state = words("state")
        self.layout = column(line(*self.buttons, self.stop), self.state, sizing_mode="stretch_width")

    def begin(self, study: Path, given: Sequence[str]) -> None:
        """Start a command, or follow the running one of another tab."""
        self.job = self._jobs.begin(study, self._folder, given)
        self.follow()

    def cancel(self) -> None:
        """Ask the command to end and save."""
        if self.job is not None:
            self.job.cancel()
            self.stop.disabled = True
            self._tell()

    def refuse(self, error: object) -> None:
        """Show why nothing is started."""
        self.state.text = f"<p class=error role=alert>{escaped(error)}</p>"

    def follow(self) -> None:
        """Follow the command until it ends."""
        self._position, self._event = 0, None
        self._begun(running=True)
        self._tell()
        if self._callback is None:
            self._callback = self._doc.add_periodic_callback(self.look, EVERY)

    def look(self) -> None:
        """Show the progress since the last look."""
        job = self.job
        if job is None:
            return
        job.insist()
        running = job.running  # before its events are read: none is missed
        events, self._position = job.events(self._position)
        self._heard(events)
        if running:
            self._event = events[-1] if events else self._event
            if events and events[-1].task != self._stage[0]:
                self._stage = (events[-1].task, job.seconds, events[-1].share)
            self._tell()
            return
        if self._callback is not None:
            self._doc.remove_periodic_callback(self._callback)
            self._callback = None
        self._begun(running=False)
        self._tell_end(job)
        self._ended(job)

    def _begun(self, *, running: bool) -> None:
        for each in self.buttons:
            each.disabled = running
        self.stop.disabled = not running

    def _tell(self) -> None:
        job, event = self.job, self._event
        if job is None:
            return
        share = math.nan if event is None else event.share
        _, since, before = self._stage
        left = (job.seconds - since) * (1 - share) / (share - before) if share > before else math.nan
        bar = f"<progress value={share:.3f} max=1></progress>" if math.isfinite(share) else "<progress></progress>"
        said = [_words(event, job), f"{job.seconds:.0f} s"]
        said += [f"about {left:.0f} s left"] if math.isfinite(left) else []
        text = f"{bar}<p class=soft>{escaped(', '.join(said))}</p>"
        if job.asked:
            text = "<p role=status>Cancelling; saving the results so far …</p>"
        if text != self.state.text:
            self.state.text = text

    def _tell_end(self, job: Job) -> None:
        printed = job.printed()
        error = next((line for line in reversed(printed.splitlines()) if line.startswith("error: ")), "")
        error = error.removeprefix("error: ")
        if error and not job.asked:
            self.refuse(error)
        else:
            how = "Cancelled" if job.asked else "Done" if job.code == 0 else "Ended"
            more = f": {escaped(error)}" if error else "; results so far are saved" if job.asked else ""
            self.state.text = f"<p role=status>{how} after {job.seconds:.1f} s{more}.</p>"
        log = f"<pre>{escaped(command_text(job.words))}\n{escaped(printed)}</pre>"
        self.state.text += f"<details><summary>Output</summary>{log}</details>"


def _words(event: Event | None, job: Job) -> str:
    """Return the progress of a command: last event, or last output line."""
    if event is None:
        return next((line.strip(" .") for line in reversed(job.printed().splitlines()) if line.strip()), "starting")
    if isinstance(event, SearchStep):
        return f"iteration {event.number}, cost {event.cost:.6g}"
    return event_words(event)


# --- documents of a folder ----------------------------------------------------------------

LOOK_EVERY = 1000  # ms between two looks at the folder


class ResultsView:
    """Documents of some kinds in a results folder, kept up to date."""

    def __init__(self, doc: Any, place: Path, scheme: str, kinds: Sequence[str]) -> None:
        self.place, self.scheme, self.kinds = place, scheme, kinds
        self._seen: object = None
        self.layout = column([], name="shown", sizing_mode="stretch_width", stylesheets=[SHEET])
        self.look()
        doc.add_periodic_callback(self.look, LOOK_EVERY)

    def look(self) -> None:
        """Show changes since the last look; incomplete files wait."""
        names = (DOCUMENT_FILE, MONITORING_FILE)  # a monitoring that still runs has no document yet
        seen = [(name, (self.place / name).stat().st_mtime_ns) for name in names if is_file(self.place / name)]
        if seen == self._seen:
            return
        try:
            found = documents_of(self.place) if seen else {}
        except InputError as error:
            if not self.layout.children:
                self.layout.children = [words("wrong", f"<p class=error>{escaped(error)}</p>")]
            return
        shown = [each for kind, each in found.items() if kind in self.kinds]
        nothing = [words("nothing", "<p>No result yet.</p>")]
        self.layout.children = models(shown, self.scheme) if shown else nothing
        self._seen = seen


def models(documents: Iterable[Document], scheme: str) -> list[Any]:
    """Return documents as Bokeh models: words and figures."""
    found = []
    for document in documents:
        found.append(words("verdict", verdict(document)))
        for each in drawn_sections(document):
            found.append(words(each.key, section_head(each)))
            found.append(side_by_side(in_scheme(each.charts, scheme)))
    return found


def side_by_side(figures: Sequence[Any]) -> Any:
    """Return figures side by side, if there is room."""
    for each in figures:
        each.sizing_mode, each.width_policy, each.min_width = "stretch_width", "max", 280
        each.styles = {"flex": "1 1 280px"}
    return line(*figures)
