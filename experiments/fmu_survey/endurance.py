"""Many simulations of one FMU in one process: whether it fails, leaks, or remembers what it should not.

    python -m experiments.fmu_survey.endurance FMU PARAMETER [--kind model-exchange] [--simulations 20000]

The parameter takes 20 values in turn, and every simulation must give what the first one at that value gave. Prints the
resident memory of the process (Linux) and the largest difference at intervals.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid

VALUES = 20
LINES = 10


def resident() -> float:
    """Return the resident memory of this process, MB."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return int(text.partition("VmRSS:")[2].split()[0]) / 1024


def main() -> None:
    """Parse the command line, simulate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("fmu", type=Path)
    parser.add_argument("parameter")
    parser.add_argument("--kind", default="co-simulation", choices=["co-simulation", "model-exchange"])
    parser.add_argument("--simulations", type=int, default=20_000)
    parser.add_argument("--samples", type=int, default=50)
    chosen = parser.parse_args()
    fmu = fmuid.FMU(chosen.fmu)
    variables = fmu.description.variables.values()
    outputs = [v.name for v in variables if v.type == "Real" and (v.causality == "output" or v.is_state)]
    frame = pd.DataFrame({"time": np.linspace(0, 1, chosen.samples), **dict.fromkeys(outputs, 0.0)})
    simulator = fmuid.Simulator(
        fmu, fmuid.Experiment(frame, outputs=outputs), parameters=[chosen.parameter], interface=chosen.kind
    )
    start = float(fmu.description.variables[chosen.parameter].start or 1.0)
    thetas = start * np.linspace(0.9, 1.1, VALUES)[:, np.newaxis]
    first = [simulator(theta) for theta in thetas]
    print(
        "| simulations | resident memory, MB | largest difference from the first | simulations/s |\n|---|---|---|---|"
    )
    difference, begun, every = 0.0, time.perf_counter(), max(chosen.simulations // LINES, 1)
    print(f"| {VALUES} | {resident():.1f} | | |", flush=True)
    for i in range(VALUES, chosen.simulations):
        k = i % VALUES
        difference = max(difference, float(np.abs(simulator(thetas[k]) - first[k]).max()))
        if (i + 1) % every == 0:
            rate = (i + 1 - VALUES) / (time.perf_counter() - begun)
            print(f"| {i + 1} | {resident():.1f} | {difference:.0e} | {rate:.0f} |", flush=True)


if __name__ == "__main__":
    main()
