"""Server of the workbench: addresses, begin, end; start of the browser."""

from __future__ import annotations

import contextlib
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.server.server import BaseServer
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets

from fmuid.apps.workbench.access_control import LARGEST_MESSAGE, Guard, redirecting_page
from fmuid.apps.workbench.home import AssetHandler, FileHandler, HomeHandler
from fmuid.apps.workbench.jobs import Jobs
from fmuid.apps.workbench.page_layout import argument, dress
from fmuid.apps.workbench.project_folder import Folder
from fmuid.errors import FmuidError, InputError
from fmuid.reports.render.html import text as escaped

_ADDRESSES = ("/study", "/results", "/batch", "/faults", "/new")
LOCAL = "127.0.0.1"
_ENTRY = "open.html"


class Workbench:
    """Server for one user and one folder; `address` is that of the first page, with a token."""

    def __init__(self, folder: Folder, study: Path | None = None, *, port: int = 0) -> None:
        self.folder, self.jobs = folder, Jobs()
        try:
            self._sockets = bind_sockets(port, LOCAL)
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror or error}). Give a free --port.") from None
        port = self._sockets[0].getsockname()[1]
        hosts = [f"{LOCAL}:{port}", f"localhost:{port}"]
        self._loop: IOLoop | None = None
        self._guard = Guard(
            {where: Application(FunctionHandler(partial(_build, where, self))) for where in _ADDRESSES},
            hosts,
            [
                (r"/", HomeHandler, {"folder": folder, "jobs": self.jobs}),
                (r"/own/(.*)", AssetHandler),
                (r"/file/(.*)", FileHandler, {"folder": folder}),
            ],
        )
        self._http = HTTPServer(self._guard, max_buffer_size=2 * LARGEST_MESSAGE)
        page = "/?" if study is None else f"/study?file={quote(folder.name(study))}&"
        self._first = f"http://{hosts[0]}{page}token="
        self.address = self._first + self._guard.token

    def single_use_address(self) -> str:
        """Return the address of the first page, valid once."""
        return self._first + self._guard.single_use_token()

    @property
    def awaits_browser(self) -> bool:
        """Whether a single-use address is unused."""
        return self._guard.awaits_browser

    def run(self, ready: Callable[[], object] = lambda: None) -> None:
        """Serve until interrupted or stopped, then interrupt its commands; `ready` is called once it answers."""
        self._loop = IOLoop(make_current=True)  # of this thread
        self._http.add_sockets(self._sockets)
        served = BaseServer(self._loop, self._guard, self._http)
        served.start()
        threading.Thread(target=_pages, daemon=True).start()
        self._loop.add_callback(ready)
        try:
            self._loop.start()
        finally:
            self.jobs.close()
            for session in (each for where in _ADDRESSES for each in served.get_sessions(where)):
                for end in session.document.session_destroyed_callbacks:
                    end(None)  # simulations of a page end with it
            served.stop(wait=False)
            self._loop.run_sync(self._http.close_all_connections)
            self._loop.close(all_fds=True)

    def stop(self) -> None:
        """Have `run` return; from any thread."""
        if self._loop is not None:
            self._loop.add_callback(self._loop.stop)


@contextlib.contextmanager
def entry_file(bench: Workbench) -> Iterator[Path]:
    """Provide a file that leads to the first page; a browser's arguments, which all users read, name it alone."""
    with tempfile.TemporaryDirectory(prefix="fmuid-open-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, _ENTRY)
        path.touch(mode=0o600)  # before it has a secret
        path.write_text(redirecting_page(bench.single_use_address()), encoding="utf-8")
        yield path


def start_browser(path: Path, failed: Callable[[], object]) -> threading.Thread:
    """Open a file in the browser, in a thread; it calls `failed` if none starts."""

    def start() -> None:
        with contextlib.suppress(webbrowser.Error, OSError, ValueError):  # ValueError: unclosed quotes in $BROWSER
            if webbrowser.open(path.as_uri()):
                return
        failed()

    thread = threading.Thread(target=start, daemon=True)
    thread.start()
    return thread


def _build(where: str, workbench: Workbench, doc: Any) -> None:
    doc.template_variables["home"] = workbench.folder.root.name or "folder"
    try:
        _pages()[where](doc, workbench)
    except FmuidError as error:
        doc.clear()
        dress(doc, argument(doc, "file") or "fmuid", [(f"<section><p class=error>{escaped(error)}</p></section>", "")])


@cache
def _pages() -> dict[str, Callable[[Any, Workbench], object]]:
    """Return the builders of pages, whose modules are slow to import."""
    from fmuid.apps.workbench.pages.batch import BatchPage
    from fmuid.apps.workbench.pages.faults import FaultsPage
    from fmuid.apps.workbench.pages.new import NewPage
    from fmuid.apps.workbench.pages.results import build
    from fmuid.apps.workbench.pages.study import StudyPage

    return dict(zip(_ADDRESSES, (StudyPage, build, BatchPage, FaultsPage, NewPage), strict=True))
