"""A batch whose workers and driver are killed at random moments: nothing is lost, nothing differs, nothing stays.

    python -m experiments.batches.kills [--kills 20] [--cases 4000] [--seed 1]

Runs a batch of the coil once in peace and once with so many ``kill -9``: of a worker, of the process that keeps the
workers, of the process of an FMU, of the whole batch, whose command is then given again. Ends with code 1 if the two
datasets differ, a finished case was run again, or a process is left.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import psutil

from experiments.batches.campaign import command, differences, family, left_over, write_study

WORKERS = 2
KINDS = ("worker", "keeper", "FMU", "batch")
SHARES = (0.4, 0.1, 0.2, 0.3)


def victim(batch: int, kind: str, rng: np.random.Generator) -> psutil.Process | None:
    """Return a process of one kind below a batch, if there is one now."""
    processes = family(batch)
    marks = {
        "worker": "spawn_main",
        "keeper": "fmuid.runs.batch.local_workers",
        "FMU": "fmuid.processes.server ",
    }
    found = []
    for each in processes[1:]:
        with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
            line = " ".join(each.cmdline()) + " "
            if kind in marks and marks[kind] in line:
                found.append(each)
    if kind == "batch":
        return processes[0] if processes else None
    return found[int(rng.integers(len(found)))] if found else None


class Campaign:
    """One disturbed batch."""

    def __init__(self, study: Path, output: Path, seed: int) -> None:
        self.study, self.output, self.rng = study, output, np.random.default_rng(seed)
        self.scratch = output.with_name("scratch")
        self.scratch.mkdir()
        self.killed: dict[str, int] = dict.fromkeys(KINDS, 0)
        self.stayed = self.repeated = 0
        self.finished = pd.DataFrame()
        self.start()

    def start(self) -> None:
        """Give the command."""
        words = command(self.study, self.output, "--workers", str(WORKERS))
        environment = os.environ | {"TMPDIR": str(self.scratch)}
        self.process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment)

    def kill(self) -> None:
        """Kill one process after a random time."""
        time.sleep(self.rng.uniform(0.5, 4.0))
        kind, chosen = str(self.rng.choice(KINDS, p=SHARES)), None
        while chosen is None:
            time.sleep(0.05)  # there may be none of the kind yet
            if self.process.poll() is not None:
                return
            chosen = victim(self.process.pid, kind, self.rng)
        processes = family(self.process.pid)
        with contextlib.suppress(psutil.NoSuchProcess):
            chosen.kill()
            self.killed[kind] += 1
        if kind == "batch":
            self.process.wait()
            self.stayed += len(left_over(processes))
            self.compare()
            self.start()

    def compare(self) -> None:
        """See that the rows that were finished before are still those."""
        now = pd.read_parquet(self.output / "cases") if (self.output / "batch.json").exists() else pd.DataFrame()
        if len(self.finished):
            same = self.finished[["case", "finished", "worker"]].merge(now[["case", "finished", "worker"]])
            self.repeated += len(self.finished) - len(same)
        self.finished = now

    def end(self) -> str:
        """Wait for the batch and return what it said that was wrong."""
        _, said = self.process.communicate()
        self.compare()
        return said.decode()


def main() -> int:
    """Run the campaign and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--cases", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = write_study(folder, chosen.cases)
        began = time.monotonic()
        subprocess.run(command(study, folder / "peace", "--workers", str(WORKERS)), check=True, capture_output=True)
        print(f"undisturbed: {time.monotonic() - began:.0f} s", flush=True)
        began, campaign = time.monotonic(), Campaign(study, folder / "war", chosen.seed)
        while sum(campaign.killed.values()) < chosen.kills and campaign.process.poll() is None:
            campaign.kill()
        said = campaign.end()
        took, code = time.monotonic() - began, campaign.process.returncode
        print(f"disturbed: {took:.0f} s, killed: {campaign.killed}; exit {code}")
        print(said, end="")
        if code:
            return 1
        found = differences(folder / "peace", folder / "war")
        print(f"datasets: {found}")
        print(f"finished cases run again: {campaign.repeated}; processes left: {campaign.stayed}", end="")
        print(f"; temporary folders left: {len(list(campaign.scratch.glob('fmuid-*')))}")
        wrong = not found.startswith("the same") or campaign.repeated or campaign.stayed
        return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
