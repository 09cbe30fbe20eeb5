"""Workers of this machine, kept by a process of their own.

It is ``python -m fmuid.runs.batch.local_workers ADDRESS COUNT FOLDER``. As workers are started there, the main module
of the batch need not be importable. Standard input is the lifeline: it ends with the batch, however that ends. Then
this process ends its workers and all that they have started, and removes the folder.

The folder is locked while a process uses it; the next batch removes it otherwise. The lock is of the open file
(``flock``) and inherited: it lasts until the last process that has it ends. A lock file appears under its name with the
lock already on it, so no folder in use is removed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from fmuid.errors import FmuidError
from fmuid.files import file_name
from fmuid.processes import MEMORY_KEPT, Child, watch_lifeline

try:
    import fcntl
except ImportError:  # of POSIX systems; Windows removes no folder that is in use, but leaves those of killed processes
    fcntl = None  # type: ignore[assignment]

PREFIX = "fmuid-batch-"
# A keeper that ends within so many seconds is started again at most so often in a row:
# a short lack of memory must end no batch.
SOON_SECONDS = 10.0
MOST_RESTARTS = 12
# Profiles and statistics that only Dask's dashboard shows are off or rare: they took a tenth of a processor.
CALM = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.disk": False,
    "distributed.admin.system-monitor.gil.enabled": False,
}


class LocalWorkers:
    """Process that keeps workers of this machine; restarted if it ends."""

    def __init__(self, address: str, count: int, folder: Path, locks: Sequence[int] = ()) -> None:
        self._address, self._count, self._folder, self._locks = address, count, folder, locks
        self._log = folder / "log.txt"
        self._starts = 0
        self._start()

    def _start(self) -> None:
        self._folder.mkdir(mode=0o700, exist_ok=True)
        self._starts, self._started = self._starts + 1, time.monotonic()
        with self._log.open("ab") as log:
            self._process = Child(
                "fmuid.runs.batch.local_workers",
                *(self._address, str(self._count), str(self._folder)),
                environment={"OMP_NUM_THREADS": "1", **MEMORY_KEPT},
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=self._locks,  # the folder is in use as long as this process or that one lives
            )

    def look(self) -> None:
        """Start the process again where something has ended it."""
        if self._process.running:
            return
        if time.monotonic() - self._started > SOON_SECONDS:
            self._starts = 0
        if self._starts > MOST_RESTARTS:
            said = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
            reason = next((line.strip() for line in reversed(said) if "Error: " in line), "no reason given")
            raise FmuidError(f"workers end at once: {reason}")
        self.close()
        self._start()

    def close(self) -> None:
        """End the process, the workers and all that they have started."""
        self._process.end(SOON_SECONDS)


@contextlib.contextmanager
def scratch_folder() -> Iterator[tuple[Path, list[int]]]:
    """Give a new private folder and its lock; remove unused ones first."""
    _sweep(Path(tempfile.gettempdir()))
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    except OSError as error:
        why = f"{tempfile.gettempdir()}: no folder for workers: {error.strerror}"
        raise FmuidError(f"{why}. Free disk space, or set TMPDIR to another folder.") from None
    with contextlib.ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        draft = folder / "draft"
        handle = _locked(draft, os.O_CREAT)
        if handle is not None:
            stack.callback(os.close, handle)
            draft.rename(folder / _lock_name())
        yield folder, [] if handle is None else [handle]


def _sweep(place: Path) -> None:
    """Remove the folders of this user that nobody has locked any more."""
    for folder in place.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # another batch was faster, or it is somebody else's
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
                continue
            handle = _locked(folder / _lock_name())
            if handle is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(handle)


def _locked(path: Path, flags: int = 0) -> int | None:
    """Return the descriptor of a locked file; None if locked or missing."""
    if fcntl is None:
        return None
    try:
        handle = os.open(path, os.O_RDWR | flags, 0o600)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _lock_name() -> str:
    """Return the name of this machine's lock: shared folders may lack locks."""
    return f"lock-{file_name(socket.gethostname())}"


def end(folder: Path) -> None:
    """End all processes below this one, remove the folder, end this process."""
    import psutil

    children = psutil.Process().children(recursive=True)
    for child in children:
        with contextlib.suppress(psutil.NoSuchProcess):  # it has ended by itself
            child.kill()
    psutil.wait_procs(children, timeout=5.0)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


async def keep(address: str, count: int, folder: Path) -> None:
    """Keep workers of one thread each connected to a scheduler; those that die are started again."""
    import dask
    from distributed import Nanny

    dask.config.set(CALM)  # which nannies hand on to their workers
    nannies = [
        Nanny(address, nthreads=1, local_directory=str(folder), dashboard=False)  # unnamed: names of the dead are taken
        for _ in range(count)
    ]
    await asyncio.gather(*nannies)
    ends = [asyncio.ensure_future(each.finished()) for each in nannies]  # type: ignore[no-untyped-call]
    await asyncio.wait(ends, return_when="FIRST_COMPLETED")


def main() -> None:
    """Watch the lifeline and keep the workers; ends with them."""
    address, count, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    over = threading.Event()

    def let_go() -> None:
        over.set()
        end(folder)

    watcher = watch_lifeline(let_go)
    try:
        asyncio.run(keep(address, count, folder))
    except Exception as error:
        print(f"{type(error).__name__}: {error}", flush=True)
    finally:
        if over.wait(1.0):  # the scheduler ended with the other process
            watcher.join()
        os._exit(1)  # a worker is gone for good; the batch starts another process


if __name__ == "__main__":
    main()
