"""Opening of the first page in the user's browser; no command line carries a secret."""

from __future__ import annotations

import contextlib
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path

from fmuid.apps.workbench.access_control import redirecting_page
from fmuid.apps.workbench.server import Workbench

FILE = "open.html"


@contextlib.contextmanager
def entry_file(bench: Workbench) -> Iterator[Path]:
    """Provide a file that leads to the first page; only its owner can read it.

    Every user of a machine can read the arguments of a browser. They name this file and no secret.

    Parameters
    ----------
    bench : Workbench

    Yields
    ------
    Path
        In a folder of its own, removed at the end.
    """
    with tempfile.TemporaryDirectory(prefix="fmuid-open-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, FILE)
        path.touch(mode=0o600)  # before there is a secret in it
        path.write_text(redirecting_page(bench.single_use_address()), encoding="utf-8")
        yield path


def start_browser(path: Path, failed: Callable[[], object]) -> threading.Thread:
    """Open a file in the user's browser; one in the foreground blocks only the thread that is returned.

    Parameters
    ----------
    path : Path
    failed : callable
        Called in the thread if no browser could be started.
    """

    def start() -> None:
        with contextlib.suppress(webbrowser.Error, OSError, ValueError):  # ValueError: quotes in $BROWSER do not close
            if webbrowser.open(path.as_uri()):
                return
        failed()

    thread = threading.Thread(target=start, daemon=True)
    thread.start()
    return thread
