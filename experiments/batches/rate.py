"""How fast a batch is: identifications of the induction machine from drawn noise, beside a plain loop in one process.

    python -m experiments.batches.rate [--cases 10000] [--seconds 2] [--no-isolation]

The study is that of experiments/induction_machine (4500 samples, four parameters). Prints cases a second of a plain
loop over `CaseRunner`, and of ``fmuid batch`` with one worker and with two, start included and left out, and the memory
that all processes of a batch have together, over time.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pandas as pd
import psutil

from experiments.batches.campaign import FMUS, command, family

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "{table}"
inputs = ["uds", "uqs", "w"]
outputs = ["ids", "iqs"]
[parameters]
Rs = {{ start = 14.7, min = 0.0 }}
Rr = {{ start = 1.9, min = 0.0 }}
Lm = {{ start = 0.654, min = 1e-3 }}
Lf = {{ start = 0.0381, min = 1e-4 }}
[batch]
monte_carlo = {{ realizations = {draws}, std = 0.2, true_values = {{ Rs = 9.81, Rr = 3.83, Lm = 0.436, Lf = 0.0762 }} }}
"""
LOOP_CASES = 200
LINES = 10


def write_study(folder: Path, draws: int) -> Path:
    """Write the study and return its path."""
    table = FMUS.parent / "experiments" / "induction_machine" / "table.csv"
    fmu = FMUS / "InductionMachine" / "InductionMachine.fmu"
    path = folder / "study.toml"
    path.write_text(STUDY.format(fmu=fmu.as_posix(), table=table.as_posix(), draws=draws), encoding="utf-8")
    return path


LOOP = """
import time
from pathlib import Path
from fmuid.runs.batch.case import CaseRunner
from fmuid.studies.study import Study
runner = CaseRunner(Study.read(Path({study!r}), isolated={isolated}))
runner(0)
began = time.perf_counter()
for case in range(1, {cases} + 1):
    runner(case)
print({cases} / (time.perf_counter() - began))
"""


def loop(study: Path, cases: int, *, isolated: bool) -> float:
    """Return the cases a second of a plain loop in one process, whose linear algebra has one thread as in workers."""
    script = LOOP.format(study=str(study), cases=cases, isolated=isolated)
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def memory(process: int) -> tuple[float, float]:
    """Return the memory of the first process of a batch, and of all below it together, MB.

    Pages that several processes share count for each of them in part where the system tells (Linux).
    """
    found = []
    for each in family(process):
        with contextlib.suppress(psutil.Error):
            used = each.memory_full_info()
            found.append(getattr(used, "pss", used.rss))
    return (found[0] / 1e6, sum(found[1:]) / 1e6) if found else (0.0, 0.0)


def batch(study: Path, output: Path, workers: int, every: float, *words: str) -> tuple[float, list[tuple[float, ...]]]:
    """Run a batch; return how long it took, s, and the memory (time, driver, all others) over time."""
    began, samples = time.perf_counter(), list[tuple[float, ...]]()
    process = subprocess.Popen(command(study, output, "--workers", str(workers), *words), stdout=subprocess.DEVNULL)
    over = threading.Event()

    def look() -> None:
        while not over.wait(every):
            samples.append((time.perf_counter() - began, *memory(process.pid)))

    watcher = threading.Thread(target=look)
    watcher.start()
    code = process.wait()
    over.set()
    watcher.join()
    if code:
        raise SystemExit(f"the batch ended with code {code}")
    return time.perf_counter() - began, samples


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=2.0, help="between two looks at the memory")
    parser.add_argument("--no-isolation", action="store_true")
    chosen = parser.parse_args()
    words = ["--no-isolation"] if chosen.no_isolation else []
    with tempfile.TemporaryDirectory() as name:
        study = write_study(Path(name), chosen.cases)
        plain = loop(study, min(LOOP_CASES, chosen.cases - 1), isolated=not chosen.no_isolation)
        print(f"plain loop: {plain:.1f} cases a second", flush=True)
        for workers in (1, 2):
            output = Path(name) / f"out{workers}"
            took, samples = batch(study, output, workers, chosen.seconds, *words)
            ends = pd.read_parquet(output / "cases", columns=["finished"])["finished"].sort_values()
            first, last = len(ends) // 20, len(ends) - len(ends) // 20 - 1
            steady = (last - first) / (ends.iloc[last] - ends.iloc[first]).total_seconds()
            share = steady / plain / workers
            print(f"{workers} worker(s): {steady:.1f} cases a second, each {share:.2f} of the plain loop;", end=" ")
            print(f"{chosen.cases / took:.1f} with start and summary, {took:.0f} s")
            print("| time, s | driver, MB | workers and FMUs, MB |\n|---|---|---|")
            for line in samples[:: max(1, len(samples) // LINES)]:
                print("| {:.0f} | {:.0f} | {:.0f} |".format(*line))


if __name__ == "__main__":
    main()
