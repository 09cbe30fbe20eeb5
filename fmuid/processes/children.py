"""Child processes: same modules as this process, and the same end."""

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
"""Whether this platform can fork processes and pass files to them (Linux, macOS)."""

# -E: no PYTHONPATH, PYTHONHOME; -P: no current or script folder. Child processes of
# `multiprocessing` (Dask's workers) get the same.
_ALONE = ("-E", "-P")
# Its own search path comes last.
_BEGIN = (
    "import sys; sys.path[:] = dict.fromkeys([*{paths!r}, *sys.path]); "
    "from runpy import run_module; run_module({module!r}, run_name='__main__', alter_sys=True)"
)

# glibc returns memory and maps it again: a twelfth of the time of an identification, a third with Dask's thresholds.
# These are the highest values of glibc itself.
MEMORY_KEPT = {"MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(64 << 20)}
"""Environment variables of processes that calculate."""


def python_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as ``python -m``; it runs no file of the current folder (`search_path`)."""
    flags = [*_ALONE, *(["-s"] if sys.flags.no_user_site else []), *(["-B"] if sys.dont_write_bytecode else [])]
    return [sys.executable, *flags, "-c", _BEGIN.format(paths=search_path(), module=module), *arguments]


class Child:
    """Process that runs a module in its own session, without Ctrl-C.

    `environment` is added to that of this process. `streams` are those of `subprocess.Popen`; standard input is the
    lifeline (`watch_lifeline`) by default.
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
        """Return the exit code; None if it runs longer than this."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self._process.returncode

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def end(self, patience: float = 0.0) -> None:
        """Cut its lifeline, and kill its session after `patience` s."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        if self.wait(patience) is None:
            if os.name == "posix":
                with contextlib.suppress(ProcessLookupError, PermissionError):  # it just ended
                    os.killpg(self.pid, signal.SIGKILL)
            self._process.kill()
            self._process.wait()


def watch_lifeline(end: Callable[[], object]) -> threading.Thread:
    """Call `end` in a thread when the parent ends or lets go; standard input is empty from now on."""
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
    """Return the module search path without current and script folder; fmuid's folder is before another fmuid."""
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    around = {_real(Path()), *([_real(Path(script).parent)] if script else [])}
    kept = [each for each in sys.path if Path(each).is_absolute() and _real(Path(each)) not in around]
    others = (k for k, each in enumerate(kept) if Path(each, "fmuid").is_dir())
    at = next(others, len(kept))
    return list(dict.fromkeys([*kept[:at], str(Path(__file__).absolute().parents[2]), *kept[at:]]))


def _real(path: Path) -> str:
    try:
        return os.path.normcase(path.resolve())
    except (OSError, RuntimeError):  # the current folder is gone, or links are circular
        return str(path)
