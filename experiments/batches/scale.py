"""What a large batch costs beside its identifications: a million cases of a small model, or as many as the time allows.

    python -m experiments.batches.scale [--cases 1000000] [--minutes 10] [--workers 2] [--rows 1000000]

The model is a coil: 50 samples, two parameters, a draw of the noise a case. The batch runs as a command, which is
killed (SIGKILL) after a third of the time and given again, and ended (SIGTERM) after the rest of the time if it has not
ended by itself. Printed are

- CPU time a case of plain loops over `CaseRunner`, as many at a time as there are workers, for processors that share
  their caches are slower together; and of each kind of process of the batch, start left out;
- how long after the second command the first new case was finished;
- the resident memory of the driver, and of all others, over time;
- time and memory of the summary of so many rows: those that were run, again and again under new numbers.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq

from experiments.batches.campaign import command, family, left_over, write_study
from fmuid.processes import MEMORY_KEPT
from fmuid.runs.batch.batch import Batch
from fmuid.runs.batch.dataset import PART_ROWS

SAMPLES, LOOP_SECONDS, EVERY, LINES = 50, 20.0, 1.0, 12
# Of a run, in which processes start and code is loaded.
WARM = 0.2
# Looks at a run, one a second, that its costs are found from at least.
LEAST_SAMPLES = 5
KINDS = ("driver", "keeper", "workers", "servers", "hosts")

LOOP = """
import json, time
from pathlib import Path
from fmuid.runs.batch.case import CaseRunner
from fmuid.studies.study import Study
runner = CaseRunner(Study.read(Path({study!r}), isolated=False))
runner(0)
began, computed, cases = time.perf_counter(), time.process_time(), 0
while time.perf_counter() - began < {seconds}:
    cases += 1
    runner(cases % len(runner.cases))
print(json.dumps(1e3 * (time.process_time() - computed) / cases))
"""
SUMMARY = """
import json, resource, sys, time
from pathlib import Path
from fmuid.runs.batch.batch import Batch
from fmuid.runs.batch.dataset import Dataset
from fmuid.runs.batch.summary import summarize
job = Batch({study!r}, {output!r}, max_cases=10**9)
job.dataset.count = {rows}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began = time.perf_counter()
frame = job.dataset.read()
found = summarize(frame)
took = time.perf_counter() - began
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps([found.cases, took, before / 1e3, after / 1e3]))
"""


def loops(study: Path, count: int, seconds: float = LOOP_SECONDS) -> float:
    """Return the CPU time a case, ms, of plain loops in so many processes at a time, their environment a worker's."""
    script, environment = LOOP.format(study=str(study), seconds=seconds), dict(os.environ)
    environment |= {"OMP_NUM_THREADS": "1", **MEMORY_KEPT}
    line = [sys.executable, "-c", script]
    found = [subprocess.Popen(line, env=environment, stdout=subprocess.PIPE) for _ in range(count)]
    return float(np.mean([json.loads(each.communicate()[0]) for each in found]))


def kind_of(process: psutil.Process, driver: int) -> str:
    """Return what a process of a batch is: the one that was started, or by its command line."""
    line = " ".join(process.cmdline()) + " "
    if process.pid == driver:
        return "driver"
    if "fmuid.runs.batch.local_workers" in line:
        return "keeper"
    if "spawn_main" in line:
        return "workers"
    above = process.parent()
    served = above is not None and "fmuid.processes.server" in " ".join(above.cmdline())
    return "hosts" if served else "servers"


@dataclass
class Sample:
    """What the processes of a batch had at one moment: CPU time (s) and memory (MB) by process, and its kind."""

    when: float
    computed: dict[int, float] = field(default_factory=dict)
    memory: dict[int, float] = field(default_factory=dict)
    kinds: dict[int, str] = field(default_factory=dict)


class Run:
    """A batch that runs, and what is seen of it every second."""

    def __init__(self, study: Path, output: Path, *words: str) -> None:
        self.began = time.time()
        self.process = subprocess.Popen(command(study, output, *words), stdout=subprocess.DEVNULL)
        self.samples: list[Sample] = []
        self._over = threading.Event()
        self._watcher = threading.Thread(target=self._watch)
        self._watcher.start()

    def _watch(self) -> None:
        kinds: dict[int, str] = {}
        while not self._over.wait(EVERY):
            sample = Sample(time.time())
            for each in family(self.process.pid):
                with contextlib.suppress(psutil.Error):
                    kinds[each.pid] = kinds.get(each.pid) or kind_of(each, self.process.pid)
                    times = each.cpu_times()
                    sample.computed[each.pid] = times.user + times.system
                    sample.memory[each.pid] = each.memory_info().rss / 1e6
                    sample.kinds[each.pid] = kinds[each.pid]
            self.samples.append(sample)

    def wait(self, seconds: float, then: int) -> bool:
        """Wait for the end so long, and then send a signal; return whether it ended by itself."""
        try:
            self.process.wait(seconds)
            alone = True
        except subprocess.TimeoutExpired:
            alone = False
            processes = family(self.process.pid)
            self.process.send_signal(then)
            self.process.wait()
            left = left_over(processes, 30.0)
            if left:
                raise SystemExit(f"processes are left: {left}") from None
        self._over.set()
        self._watcher.join()
        return alone

    def steady(self, finished: pd.Series[pd.Timestamp]) -> tuple[int, dict[str, float], float]:
        """Return cases, CPU time (s) by kind, and the time that passed (s), start and end left out."""
        when = finished.astype("int64") / 1e6
        begun = when[when > self.began].min()
        usable = [each for each in self.samples if each.when > begun and "hosts" in each.kinds.values()]
        if len(usable) < LEAST_SAMPLES:
            passed = self.samples[-1].when - self.began if self.samples else 0.0
            raise SystemExit(
                f"too few seconds with cases in {passed:.0f} s of a run, start included: give more --minutes, or wait "
                "until the machine has less to do"
            )
        first, last = usable[int(WARM * len(usable))], usable[-2]  # in the last one some may have ended
        computed = dict.fromkeys(KINDS, 0.0)
        for pid in set(first.computed) & set(last.computed):
            computed[last.kinds[pid]] += last.computed[pid] - first.computed[pid]
        return int(when.between(first.when, last.when).sum()), computed, last.when - first.when


def repeat_rows(source: Path, target: Path, rows: int) -> None:
    """Write a dataset of so many rows, those of another one again and again under new numbers."""
    (target / "cases").mkdir(parents=True)
    table = pa.concat_tables([pq.read_table(path) for path in sorted(source.glob("cases/part-*.parquet"))])
    for first in range(0, rows, PART_ROWS):
        numbers = np.arange(first, min(rows, first + PART_ROWS))
        part = table.take(pa.array(numbers % table.num_rows))
        for name in ("case", "draw"):
            part = part.set_column(part.schema.get_field_index(name), name, pa.array(numbers))
        sink = pa.BufferOutputStream()
        pq.write_table(part, sink, compression="zstd")
        digest = hashlib.sha256(sink.getvalue()).hexdigest()[:12]
        (target / "cases" / f"part-{first:09d}-{digest}.parquet").write_bytes(sink.getvalue())


def show_costs(plain: float, runs: list[Run], finished: pd.Series[pd.Timestamp]) -> float:
    """Print CPU time a case; return the cases a second."""
    counts, computed, passed = zip(*(run.steady(finished) for run in runs), strict=True)
    total = {kind: 1e3 * sum(each[kind] for each in computed) / sum(counts) for kind in KINDS}
    rate = sum(counts) / sum(passed)
    print(f"plain loop: {plain:.2f} ms of CPU time a case; the batch: {sum(total.values()):.2f}, of which")
    print("; ".join(f"{kind} {each:.3f}" for kind, each in total.items()), end=" ")
    beside = sum(each for kind, each in total.items() if kind != "hosts")
    print(f"-> {beside:.3f} ms a case beside the processes that run the cases ({sum(counts)} cases)")
    print(f"{rate:.0f} cases a second in {sum(passed):.0f} s")
    return float(rate)


def show_memory(runs: list[Run]) -> None:
    """Print the resident memory over time."""
    print("| run | time, s | driver, MB | all others, MB |\n|---|---|---|---|")
    for number, run in enumerate(runs, start=1):
        for each in run.samples[:: max(1, len(run.samples) // LINES)]:
            driver = sum(size for pid, size in each.memory.items() if each.kinds[pid] == "driver")
            others = sum(each.memory.values()) - driver
            print(f"| {number} | {each.when - run.began:.0f} | {driver:.0f} | {others:.0f} |")


def show_summary(study: Path, output: Path, rows: int, folder: Path) -> None:
    """Print time and memory of the summary of so many rows."""
    repeat_rows(output, folder / "many", rows)
    script = SUMMARY.format(study=str(study), output=str(folder / "many"), rows=rows)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    cases, took, before, after = json.loads(done.stdout)
    print(f"summary of {cases} rows: {took:.1f} s, {after:.0f} MB at most ({before:.0f} before)")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rows", type=int, default=1_000_000)
    chosen = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study, output = write_study(folder, chosen.cases, SAMPLES), folder / "out"
        plain = [loops(study, chosen.workers)]
        words = ["--workers", str(chosen.workers), "--max-cases", str(chosen.cases)]
        runs = [Run(study, output, *words)]
        if not runs[0].wait(20.0 * chosen.minutes, signal.SIGKILL):
            runs.append(Run(study, output, *words))
            runs[1].wait(40.0 * chosen.minutes, signal.SIGTERM)
        plain.append(loops(study, chosen.workers))
        finished = Batch(study, output, max_cases=chosen.cases).dataset.read()["finished"]
        rate = show_costs(sum(plain) / 2, runs, finished)
        all_take = f"at this rate all take {chosen.cases / rate / 3600:.2f} h"
        print(f"{len(finished)} of {chosen.cases} cases were run; {all_take}")
        if len(runs) > 1:
            again = finished[finished.astype("int64") / 1e6 > runs[1].began].min()
            print(f"the first new case was finished {again.timestamp() - runs[1].began:.1f} s after the second command")
        show_memory(runs)
        Batch(study, output, max_cases=chosen.cases).dataset.compact()
        disk = sum(path.stat().st_size for path in output.glob("cases/*"))
        print(f"on the disk: {disk / len(finished):.0f} bytes a case")
        show_summary(study, output, chosen.rows, folder)
        print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
