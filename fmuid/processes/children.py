"""Processes of ours: they import what this one would and nothing that lies about, and end when this one does."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

AVAILABLE = hasattr(os, "fork") and hasattr(socket, "send_fds")
"""Whether this platform can fork processes and pass files to them: Linux and macOS can."""

# -E: no PYTHONPATH, PYTHONHOME, ...; -P: neither the current folder nor a script's. Processes that `multiprocessing`
# starts from such a process (Dask's workers) get the same.
_ALONE = ("-E", "-P")
# What a process can import by itself beside, such as packages that are developed in the current folder, comes last.
_BEGIN = (
    "import sys; sys.path[:] = dict.fromkeys([*{paths!r}, *sys.path]); "
    "from runpy import run_module; run_module({module!r}, run_name='__main__', alter_sys=True)"
)

# glibc gives memory back to the system and has it mapped anew, page by page, over and over: a twelfth of the time of an
# identification, and a third where whoever started the process lowered the thresholds, as Dask does. These are the
# highest that glibc itself comes to; other allocators do not read them.
MEMORY_KEPT = {"MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(64 << 20)}
"""Environment of processes that calculate."""


def python_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as ``python -m`` does, which starts every process of ours.

    ``python -m`` would run files of the current folder that are named like modules, and so would an empty entry of
    ``PYTHONPATH``. The process searches for modules where this one does instead (`search_path`).

    Parameters
    ----------
    module : str
        Dotted name.
    arguments : str
        What it finds in ``sys.argv[1:]``.
    """
    flags = [*_ALONE, *(["-s"] if sys.flags.no_user_site else []), *(["-B"] if sys.dont_write_bytecode else [])]
    return [sys.executable, *flags, "-c", _BEGIN.format(paths=search_path(), module=module), *arguments]


class Child:
    """A process that runs a module, in a session of its own: Ctrl-C is for this process alone.

    Parameters
    ----------
    module : str
        Dotted name.
    arguments : str
        What it finds in ``sys.argv[1:]``.
    environment : mapping of str to str, optional
        Variables beside those of this process.
    streams : optional
        As for `subprocess.Popen`; standard input is the lifeline (`watch_lifeline`) unless it is given.

    Attributes
    ----------
    pid : int
    """

    def __init__(
        self, module: str, *arguments: str, environment: Mapping[str, str] | None = None, **streams: Any
    ) -> None:
        self._process = subprocess.Popen(
            python_command(module, *arguments),
            env=os.environ | dict(environment or {}),
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            **{"stdin": subprocess.PIPE} | streams,
        )
        self.pid = self._process.pid

    def wait(self, seconds: float) -> int | None:
        """Return the code that it ends with; None if it is running still after so many seconds."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self._process.returncode

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def end(self, patience: float = 0.0) -> None:
        """Cut its lifeline, and kill it with all processes of its session if it is running still after `patience` s."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        if self.wait(patience) is None:
            if os.name == "posix":
                with contextlib.suppress(ProcessLookupError, PermissionError):  # it has just ended
                    os.killpg(self.pid, signal.SIGKILL)
            self._process.kill()
            self._process.wait()


def watch_lifeline(end: Callable[[], object]) -> threading.Thread:
    """Have a child call `end` in a thread when who started it has ended, however that came, or lets go of it.

    Whatever else reads standard input finds it empty from here on.
    """
    lifeline = os.dup(0)
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)

    def watch() -> None:
        while os.read(lifeline, 1):
            pass
        end()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def search_path() -> list[str]:
    """Return where this process searches for modules, and last where fmuid is.

    Left out are relative entries, the current folder and that of the script: what Python itself puts before all others.
    """
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    around = {_real(Path()), *([_real(Path(script).parent)] if script else [])}
    kept = [each for each in sys.path if Path(each).is_absolute() and _real(Path(each)) not in around]
    return list(dict.fromkeys([*kept, str(Path(__file__).absolute().parents[2])]))


def _real(path: Path) -> str:
    try:
        return os.path.normcase(path.resolve())
    except (OSError, RuntimeError):  # the current folder is gone, or links go round in circles
        return str(path)
