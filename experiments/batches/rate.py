"""How fast a batch is: identifications of the induction machine from drawn noise, beside a plain loop in one process.

    python -m experiments.batches.rate [--cases 1600] [--no-isolation]

Prints cases a second of a plain loop over `CaseRunner`, and of ``fmuid batch`` with one worker and with two, start
included and left out, and the memory of all processes over time.
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import time
from pathlib import Path

import pandas as pd

from experiments.batches.scale import Run, loops, show_memory

STUDY = Path(__file__).with_name("monte_carlo.toml")
FOREVER = 1e6  # s


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=1600)
    parser.add_argument("--no-isolation", action="store_true")
    chosen = parser.parse_args()
    words = ["--set", f"batch.monte_carlo.realizations={chosen.cases}", "--no-report"]
    words += ["--no-isolation"] if chosen.no_isolation else []
    plain = 1e3 / loops(STUDY, 1)
    print(f"plain loop, FMU in-process: {plain:.1f} cases a second", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for workers in (1, 2):
            output, began = Path(name) / f"out{workers}", time.perf_counter()
            run = Run(STUDY, output, "--workers", str(workers), *words)
            run.wait(FOREVER, signal.SIGINT)
            took = time.perf_counter() - began
            ends = pd.read_parquet(output / "cases", columns=["finished"])["finished"].sort_values()
            first, last = len(ends) // 20, len(ends) - len(ends) // 20 - 1
            steady = (last - first) / (ends.iloc[last] - ends.iloc[first]).total_seconds()
            print(f"{workers} worker(s): {steady:.1f} cases a second, {chosen.cases / took:.1f} with start and summary")
            show_memory([run])


if __name__ == "__main__":
    main()
