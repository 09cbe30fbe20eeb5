"""Workers of this machine, kept by a process of their own.

It is ``python -m fmuid.runs.batch.local_workers ADDRESS COUNT FOLDER``. As workers are started there, the main module
of the batch need not be importable. Standard input is the lifeline: it ends with the batch, however that ends. Then
this process ends its workers and all that they have started, and removes the folder.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

from fmuid.errors import FmuidError
from fmuid.processes import MEMORY_KEPT, Child, watch_lifeline

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

    def __init__(self, address: str, count: int, folder: Path) -> None:
        self._address, self._count, self._folder = address, count, folder
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
