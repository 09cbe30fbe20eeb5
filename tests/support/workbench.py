"""Workbenches that tests open: served in a thread, or only what pages see of one."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from bokeh.document import Document

from fmuid import Result
from fmuid.apps.workbench import Folder, Workbench
from fmuid.apps.workbench.jobs import Jobs
from fmuid.reports.documents import document
from fmuid.reports.render.document_json import write_documents
from fmuid.runs import IdentificationRun
from tests.support.coil_study import STUDY, coil_table

PATIENCE = 60.0


@contextmanager
def running(bench: Workbench) -> Iterator[Workbench]:
    """Serve a workbench in a thread."""
    ready = threading.Event()
    thread = threading.Thread(target=bench.run, args=(ready.set,))
    thread.start()
    try:
        assert ready.wait(PATIENCE)
        yield bench
    finally:
        bench.stop()
        thread.join(PATIENCE)
    assert not thread.is_alive()


def bench_of(path: Path) -> Any:
    """Return what pages see of a workbench."""
    return SimpleNamespace(folder=Folder(path), jobs=Jobs())


def described(path: Path) -> None:
    """Write the document of a ``result.json``."""
    write_documents(path.parent, {"identification": document(IdentificationRun(Result.from_json(path)))})


def asked_for(*files: str, settings: Sequence[str] = ()) -> Any:
    """Return the document of a page that is asked for these files, with values of a study."""
    doc: Any = Document()
    arguments = {"file": files, "set": settings, "fmuid-scheme": ["light"]}
    request = SimpleNamespace(arguments={name: [each.encode() for each in given] for name, given in arguments.items()})
    doc._session_context = lambda: SimpleNamespace(request=request)
    return doc


def coil_study(folder: Path, text: str = STUDY) -> Path:
    """Write a study of a coil with its data file."""
    folder.mkdir(exist_ok=True)
    coil_table(folder / "first.csv", 0.0, seed=1)
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


def finished(panel: Any) -> Any:
    """Wait for the command of a panel, and show its end; return the command."""
    assert panel.job is not None, panel.state.text
    panel.job.close(2 * PATIENCE)
    panel.look()
    return panel.job
