"""The first page, and the files of the folder."""

from __future__ import annotations

import mimetypes
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tornado.web import HTTPError, RequestHandler

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.jobs import Jobs
from fmuid.apps.workbench.page_layout import own_file, style, template, variables
from fmuid.apps.workbench.project_folder import Folder, FoundResult, FoundStudy
from fmuid.errors import InputError
from fmuid.formatting import counted, listed, with_std
from fmuid.reports.render.html import text as escaped

# Readable files that commands write; models and others are not served.
_SERVED = {".html", ".csv", ".json", ".toml", ".txt", ".log", ".ssv", ".png", ".svg", ".pdf"}


DONE = {"diagnosis": "diagnosed", "monitoring": "monitored", "batch": "batch run"}
"""States of studies by their kind of result."""


class HomeHandler(RequestHandler):
    """Page of the studies and results of the folder."""

    def initialize(self, folder: Folder, jobs: Jobs) -> None:
        """Take the folder and the running commands."""
        self.folder, self.jobs = folder, jobs

    def get(self) -> None:
        """Write the page."""
        folder = self.folder
        studies, results = folder.look()
        running = {job.study for job in self.jobs.running()}
        pieces = [(_studies(folder, studies, results, running), ""), (_results(folder, results), "")]
        title = folder.root.name or str(folder.root)
        scheme = self.get_argument(SCHEME, "light")
        self.write(template().render(variables(title, pieces, scheme)))


def address(page: str, folder: Folder, path: Path) -> str:
    """Return the address of a page about a file."""
    return f"/{page}?file={quote(folder.name(path))}"


def file_address(folder: Folder, path: Path) -> str:
    """Return the address of a file."""
    return f"/file/{quote(folder.name(path))}"


def badge(word: str, *, good: bool | None = None) -> str:
    """Return a state as an HTML badge."""
    return f'<span class="badge {"plain" if good is None else "good" if good else "bad"}">{escaped(word)}</span>'


def _studies(folder: Folder, studies: Sequence[FoundStudy], results: Sequence[FoundResult], running: set[Path]) -> str:
    if not studies:
        return (
            "<section><h2>Studies</h2><p>No study in this folder.</p>"
            "<a class=go href=/new>New study from an FMU and data files</a></section>"
        )
    cards = "".join(_study(folder, each, results, running=each.path.resolve() in running) for each in studies)
    new = "<section><h2>New study</h2><a class=go href=/new>Create from an FMU and data files</a></section>"
    return f'<h2 id="studies">Studies</h2><div class="grid">{cards}{new}</div>'


def _study(folder: Folder, study: FoundStudy, results: Sequence[FoundResult], *, running: bool) -> str:
    name = escaped(folder.name(study.path))
    if study.error:
        state = badge("cannot be read", good=False)
        return f"<section><h2>{name} {state}</h2><p class=error>{escaped(study.error)}</p></section>"
    own = sorted(filter(study.has_run, results), key=lambda each: each.path.stat().st_mtime)
    last = next((each for each in reversed(own) if each.kind == "identification"), own[-1] if own else None)
    state = badge("running") if running else badge("not run yet") if last is None else _state(last, study)
    what = f"{len(study.parameters)} parameters, {counted(len(study.tables), 'data file')}"
    more = f"; also {listed(study.asks)}" if study.asks else ""
    study_page = f'<a class=go href="{address("study", folder, study.path)}">Simulate and identify</a>'
    links = study_page if study.parameters else ""
    if "diagnosis" in study.asks:
        links += f'<a class=go href="{address("faults", folder, study.path)}">Faults</a>'
    if last is not None:
        links += f'<a class=go href="{address(_page(last), folder, last.folder)}">Last result</a>'
    values = "" if last is None else _values(last.content)
    heading = f"<h2>{escaped(study.title)} {state}</h2><p class=soft>{name}: {what}{more}</p>"
    return f"<section>{heading}{values}{links}</section>"


def _state(result: FoundResult, study: FoundStudy) -> str:
    """Return the state of a result, and any change of its study."""
    content = result.content
    if result.error:
        return badge("cannot be read", good=False)
    if result.kind == "identification":
        grade = str((content.get("verdict") or {}).get("grade", "unknown"))
        told = badge(grade.replace("_", " ").upper(), good={"passed": True, "not_usable": False}.get(grade))
    else:
        told = badge(DONE.get(result.kind, result.kind))
    changed = study.path.stat().st_mtime > result.path.stat().st_mtime
    return told + (" " + badge("study changed since") if changed else "")


def _values(content: Any) -> str:
    rows = list((content.get("parameters") or {}).items())
    told = [
        f"{escaped(name)} = {escaped(with_std(each['value'], each['std']))}"
        for name, each in rows[:6]
        if isinstance(each.get("value"), float) and isinstance(each.get("std"), float)
    ]
    more = ", …" if len(rows) > 6 else ""
    return f"<p>{', '.join(told)}{more}</p>" if told else ""


def _results(folder: Folder, results: Sequence[FoundResult]) -> str:
    if not results:
        return ""
    rows = "".join(_row(folder, each) for each in sorted(results, key=lambda each: -each.path.stat().st_mtime))
    heads = "".join(f"<th>{each}</th>" for each in ("", "folder", "kind", "state", "date", ""))
    return (
        f'<section><h2>Results</h2><form action="/results"><div class=scroll><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div><button>Side by side</button></form></section>"
    )


def _page(result: FoundResult) -> str:
    return "batch" if result.kind == "batch" else "results"


def _row(folder: Folder, result: FoundResult) -> str:
    name = escaped(folder.name(result.folder))
    report = result.folder / "report.html"
    link = f'<a href="{file_address(folder, report)}">report</a>' if report.is_file() else ""
    date = datetime.fromtimestamp(result.path.stat().st_mtime).strftime("%Y-%m-%d %H:%M")
    outcome = str(result.content.get("outcome", "") or "").replace("_", " ")
    state = f"<span class=error>{escaped(result.error)}</span>" if result.error else escaped(outcome)
    first = f'<a href="{address(_page(result), folder, result.folder)}">{name}</a>'
    box = f'<input type=checkbox name=file value="{name}" aria-label="choose {name}">'
    cells = "".join(f"<td>{each}</td>" for each in (result.kind, state, date, link))
    return f"<tr><td>{box if result.kind == 'identification' else ''}</td><th scope=row>{first}</th>{cells}</tr>"


class AssetHandler(RequestHandler):
    """Style and script of the pages."""

    def get(self, name: str) -> None:
        """Write one of the two."""
        if name == "style.css":
            self.set_header("Content-Type", "text/css; charset=utf-8")
            self.write(style())
        elif name == "workbench.js":
            self.set_header("Content-Type", "text/javascript; charset=utf-8")
            self.write(own_file(name))
        else:
            raise HTTPError(404)


class FileHandler(RequestHandler):
    """Files of the folder."""

    def initialize(self, folder: Folder) -> None:
        """Take the folder."""
        self.folder = folder

    def get(self, name: str) -> None:
        """Write a file of a served type."""
        try:
            path = self.folder.path(name)
        except InputError:
            raise HTTPError(404) from None
        hidden = any(part.startswith(".") for part in path.relative_to(self.folder.root).parts)
        if not path.is_file() or hidden or path.suffix.lower() not in _SERVED:
            raise HTTPError(404)
        kind = mimetypes.guess_type(path.name)[0] or "text/plain"
        shown = kind if kind.startswith(("image/", "application/pdf")) or kind == "text/html" else "text/plain"
        self.set_header("Content-Type", shown if shown.startswith("image") else f"{shown}; charset=utf-8")
        self.write(path.read_bytes())
