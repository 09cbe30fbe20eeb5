"""How exactly fmuid finds state events: bouncing balls and pendulums with dry friction, whose event times are known.

    python -m experiments.fmu_survey.event_times FMU...

An event is where a height or a speed goes through zero (or the floor). Just before each event of the known solution
(`experiments.fmu_survey.equations`), the deviation of that variable over its slope is the error of the event's time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid
from experiments.fmu_survey.case import Task
from experiments.fmu_survey.equations import KNOWN
from experiments.fmu_survey.survey import tool_of

CROSSING = ("h", "mass_s", "mass.v")
BEFORE = 1e-4  # s
INTEGRATORS = ("rk45", "cvode")
TOLERANCES = (1e-6, 1e-8, 1e-10)


def errors(path: Path, integrator: str, tolerance: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the errors of the event times, s."""
    task = Task.of(path, "model-exchange")
    solve = KNOWN.get(path.stem) or KNOWN[task.fmu.name]
    events = np.array(solve(task.start, task.times).events)
    events = events[(events > task.times[0] + 10 * BEFORE) & (events < task.times[-1])]
    times = np.unique(np.concatenate([[task.times[0]], events - 2 * BEFORE, events - BEFORE]))
    known = solve(task.start, times)
    name = next(name for name in CROSSING if name in known.values)
    experiment = fmuid.Experiment(pd.DataFrame({"time": times, name: 0.0}), outputs=[name])
    simulator = fmuid.Simulator(
        task.fmu, experiment, interface="model-exchange", integrator=integrator, tolerance=tolerance
    )
    ours, theirs = simulator([])[:, 0], known.values[name]
    last = np.searchsorted(times, events - BEFORE)
    slope = (theirs[last] - theirs[last - 1]) / (times[last] - times[last - 1])
    return np.asarray(np.abs((ours[last] - theirs[last]) / slope))


def main() -> None:
    """Print a table for the FMUs of the command line."""
    print("| FMU | tool | events | integrator | " + " | ".join(f"tolerance {t:.0e}" for t in TOLERANCES) + " |")
    print("|---|---|---|---|" + "---|" * len(TOLERANCES))
    for path in map(Path, sys.argv[1:]):
        tool = tool_of(fmuid.FMU(path))
        for integrator in INTEGRATORS:
            found = [errors(path, integrator, tolerance) for tolerance in TOLERANCES]
            shown = " | ".join(f"{each.max():.0e} s" for each in found)
            print(f"| {path.stem} | {tool} | {found[0].size} | {integrator} | {shown} |", flush=True)


if __name__ == "__main__":
    main()
