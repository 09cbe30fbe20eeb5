"""A process that keeps local workers running: ``python -m fmuid.runs.batch.local_workers ADDRESS COUNT FOLDER``.

Workers are started from here and not from the process that runs the batch, whose main module need then not be one that
can be imported again. Standard input is the lifeline: when it ends, which it does also when the other process is
killed, this one ends its workers and all that they have started, and removes the folder.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
import threading
from pathlib import Path

from fmuid.processes import watch_lifeline

CALM = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.disk": False,
    "distributed.admin.system-monitor.gil.enabled": False,
}
"""What Dask leaves out here, or does less often: profiles and statistics, which only its dashboard shows, and 50 looks
a second at how late its loops are, 10 at the memory of workers, whose FMUs are not in it.

They took a tenth of a processor beside two workers, whether there was anything to do or not.
"""


def end(folder: Path) -> None:
    """End all processes below this one, remove the folder, end this process."""
    import psutil

    children = psutil.Process().children(recursive=True)
    for child in children:
        try:
            child.kill()
        except psutil.NoSuchProcess:  # it has ended by itself
            continue
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
        os._exit(1)  # a worker is gone for good; whoever sees this process's end starts another


if __name__ == "__main__":
    main()
