"""The server of the workbench: its addresses, and how it begins and ends."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.server.server import BaseServer
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets

from fmuid.apps.workbench.access_control import LARGEST_MESSAGE, Guard
from fmuid.apps.workbench.home import FileHandler, HomeHandler, OwnHandler, escaped
from fmuid.apps.workbench.jobs import Jobs
from fmuid.apps.workbench.page_layout import argument, dress
from fmuid.apps.workbench.project_folder import Folder
from fmuid.errors import FmuidError, InputError

# Pages with figures: the address, and the module that has the page.
_PAGES = {
    "/study": "fmuid.apps.workbench.pages.study",
    "/results": "fmuid.apps.workbench.pages.results",
    "/batch": "fmuid.apps.workbench.pages.batch",
    "/faults": "fmuid.apps.workbench.pages.faults",
    "/new": "fmuid.apps.workbench.pages.new",
}
LOCAL = "127.0.0.1"


@dataclass(frozen=True)
class Certificate:
    """What a server proves with by TLS who it is.

    Attributes
    ----------
    chain, key : Path
        PEM files.
    """

    chain: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        """Return it as a server needs it.

        Raises
        ------
        InputError
            If a file is not there, or is none.
        """
        found = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        try:
            found.load_cert_chain(self.chain, self.key)
        except (OSError, ssl.SSLError) as error:
            raise InputError(
                f"{self.chain} and {self.key} are no certificate and key ({error.strerror or error}): give PEM files"
            ) from None
        return found


class Workbench:
    """A server for one user and one folder.

    Parameters
    ----------
    folder : Folder
    study : Path, optional
        That the first page shows, in the folder.
    host : str
        The name or address by which a browser reaches it; other machines only with a certificate.
    port : int
        Default: any free one.
    certificate : Certificate, optional

    Attributes
    ----------
    address : str
        Of the first page, with a token that lets a browser in as long as the server runs.
    jobs : Jobs
        What it has begun.

    Raises
    ------
    InputError
        If there is no such host on this machine, or the port is taken.
    """

    def __init__(
        self,
        folder: Folder,
        study: Path | None = None,
        *,
        host: str = LOCAL,
        port: int = 0,
        certificate: Certificate | None = None,
    ) -> None:
        if host != LOCAL and certificate is None:
            raise InputError(
                f"--listen {host} lets other machines in, who could read along what they do here: give --certificate "
                "and --key too, PEM files for TLS"
            )
        self.folder, self.jobs = folder, Jobs()
        context = None if certificate is None else certificate.context()
        try:
            sockets = bind_sockets(port, host)
        except OSError as error:
            raise InputError(
                f"{host}:{port or ''} cannot be listened to ({error.strerror or error}): give an address of this "
                "machine by which browsers reach it, and a free port"
            ) from None
        port = sockets[0].getsockname()[1]
        hosts = [f"{host}:{port}", *([f"localhost:{port}"] if host == LOCAL else [])]
        self._loop: IOLoop | None = None
        self._guard = Guard(
            {where: _application(module, self) for where, module in _PAGES.items()},
            hosts,
            [(r"/", HomeHandler, {"folder": folder, "jobs": self.jobs}), (r"/own/(.*)", OwnHandler), self._files()],
            secure=context is not None,
        )
        self._http = HTTPServer(self._guard, ssl_options=context, max_buffer_size=2 * LARGEST_MESSAGE)
        self._sockets = sockets
        page = "/?" if study is None else f"/study?file={quote(folder.name(study))}&"
        self._first = f"http{'' if context is None else 's'}://{hosts[0]}{page}token="
        self.address = self._first + self._guard.token

    def single_use_address(self) -> str:
        """Return the address of the first page with a token that lets a browser in once."""
        return self._first + self._guard.single_use_token()

    @property
    def awaits_browser(self) -> bool:
        """Whether a single-use address has not been used."""
        return self._guard.awaits_browser

    def _files(self) -> tuple[str, type[FileHandler], dict[str, Any]]:
        return r"/file/(.*)", FileHandler, {"folder": self.folder}

    def run(self, ready: Callable[[], object] = lambda: None) -> None:
        """Serve until it is interrupted or stopped; runs that it has begun are interrupted then, and saved.

        Parameters
        ----------
        ready : callable
            Called when it answers.
        """
        self._loop = IOLoop(make_current=True)  # of this thread
        self._http.add_sockets(self._sockets)
        served = BaseServer(self._loop, self._guard, self._http)
        served.start()
        threading.Thread(target=_preload, daemon=True).start()
        self._loop.add_callback(ready)
        try:
            self._loop.start()
        finally:
            self.jobs.close()
            served.stop(wait=False)
            self._loop.run_sync(self._http.close_all_connections)
            self._loop.close(all_fds=True)

    def stop(self) -> None:
        """Have `run` return; from any thread."""
        if self._loop is not None:
            self._loop.add_callback(self._loop.stop)


def _application(module: str, workbench: Workbench) -> Application:
    """Return the application of a page, whose module is imported when it is first asked for."""
    return Application(FunctionHandler(partial(_build, module, workbench)))


def _build(module: str, workbench: Workbench, doc: Any) -> None:
    doc.template_variables["home"] = workbench.folder.root.name or "folder"
    try:
        import_module(module).build(doc, workbench)
    except FmuidError as error:
        doc.clear()
        dress(doc, argument(doc, "file") or "fmuid", [(f"<section><p class=error>{escaped(error)}</p></section>", "")])


def _preload() -> None:
    """Import what the next page needs while the first one is read."""
    for module in _PAGES.values():
        import_module(module)
