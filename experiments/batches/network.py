"""A batch on a cluster whose workers share neither network address nor files with the one who gives the command.

    sudo python -m experiments.batches.network [--records 40] [--starts 5]

Scheduler and two workers stand in network namespaces of their own, joined by a bridge (Linux, needs root); each worker
has an empty working folder, a cache of its own, and an empty folder mounted over the one that has the study and over
the FMUs. The dataset must be the one that this machine's own workers give. Ends with code 1 if it is not.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from experiments.batches.campaign import FMUS, command, differences, family, write_fleet

BRIDGE, NET = "fmuid-br", "10.97.0"
NAMES = ("scheduler", "one", "two")
PORT = 8786


def ip(words: str, *, check: bool = True) -> None:
    """Run a command of iproute2."""
    subprocess.run(["ip", *words.split()], check=check, capture_output=True)


@contextlib.contextmanager
def namespaces() -> Iterator[None]:
    """Make the namespaces, each with an address of its own, and a bridge that joins them."""
    ip(f"link add {BRIDGE} type bridge")
    try:
        ip(f"addr add {NET}.254/24 dev {BRIDGE}")
        ip(f"link set {BRIDGE} up")
        for k, name in enumerate(NAMES):
            ip(f"netns add fmuid-{name}")
            ip(f"link add fmuid{k} type veth peer name inside netns fmuid-{name}")
            ip(f"link set fmuid{k} master {BRIDGE} up")
            ip(f"-n fmuid-{name} addr add {NET}.{k + 1}/24 dev inside")
            ip(f"-n fmuid-{name} link set inside up")
            ip(f"-n fmuid-{name} link set lo up")
        yield
    finally:
        for name in NAMES:
            ip(f"netns del fmuid-{name}", check=False)
        ip(f"link del {BRIDGE}", check=False)


@contextlib.contextmanager
def inside(name: str, place: Path, hidden: Sequence[Path], *words: str) -> Iterator[None]:
    """Run a Dask command in a namespace and an empty folder, with nothing to see in the hidden ones."""
    place.mkdir()
    mounts = " && ".join([*(f"mount -t tmpfs none {path}" for path in hidden), 'exec "$@"'])
    line = ["ip", "netns", "exec", f"fmuid-{name}", "sh", "-c", mounts, "sh", sys.executable, "-m", *words]
    environment = os.environ | {"TMPDIR": str(place), "XDG_CACHE_HOME": str(place / "cache")}
    with (place / "log.txt").open("wb") as log:
        process = subprocess.Popen(line, cwd=place, env=environment, stdout=log, stderr=log)
        try:
            yield
        finally:
            for each in family(process.pid):
                each.kill()
            process.wait()


def main() -> int:
    """Run the same batch here and there, and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--starts", type=int, default=5)
    chosen = parser.parse_args()
    if sys.platform != "linux" or os.geteuid() != 0:
        print("left out: network namespaces need Linux and root")
        return 0
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        study = write_fleet(folder / "study", chosen.records, chosen.starts)
        subprocess.run(command(study, folder / "here"), check=True, capture_output=True)
        stack.enter_context(namespaces())
        address, hidden = f"tcp://{NET}.1:{PORT}", [folder / "study", FMUS]
        words = ("--host", f"{NET}.1", "--port", str(PORT), "--no-dashboard")
        stack.enter_context(inside("scheduler", folder / "s", hidden, "distributed.cli.dask_scheduler", *words))
        for each in NAMES[1:]:
            line = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard")
            stack.enter_context(inside(each, folder / each, hidden, *line))
        time.sleep(5.0)
        began = time.monotonic()
        done = subprocess.run(command(study, folder / "there", "--scheduler", address), capture_output=True, text=True)
        print(f"exit {done.returncode} after {time.monotonic() - began:.0f} s {done.stderr}")
        if done.returncode:
            return 1
        found = differences(folder / "here", folder / "there")
        told = json.loads((folder / "there" / "batch.json").read_text(encoding="utf-8"))
        print(f"datasets: {found}, {len(told['files'])} files that no worker could see")
        return int(not found.startswith("the same"))


if __name__ == "__main__":
    sys.exit(main())
