"""Trial of one FMI interface in a separate process: ``python -m fmuid.simulation.smoke_test``.

A file has its report, written anew at each stage: it survives any end of the process.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.codec import as_json, from_json
from fmuid.data import Experiment
from fmuid.errors import FmuidError, SimulationError, warnings_to
from fmuid.models import FMU, Description, SolverConfiguration
from fmuid.processes import watch_lifeline
from fmuid.simulation.instance import Instance
from fmuid.simulation.instance_registry import is_repeated
from fmuid.simulation.simulator import Simulator


class Stage(StrEnum):
    """Stages of a trial."""

    START = "start"
    INSTANTIATION = "instantiation"
    SIMULATION = "simulation"
    REPETITION = "repetition"
    END = "end"


@dataclass
class SmokeReport:
    """Progress of a trial; `seconds` is the second simulation's duration.

    `differs`: the second simulation gave other outputs. `no_reset`: warnings that a reset does not work.
    """

    doing: Stage = Stage.START
    instantiated: bool = False
    simulated: bool = False
    repeated: bool = False
    differs: bool = False
    run: SolverConfiguration | None = None
    start: float = 0.0
    stop: float = 0.0
    samples: int = 0
    outputs: int = 0
    seconds: float = 0.0
    error: str = ""
    warnings: list[str] = field(default_factory=list)
    no_reset: list[str] = field(default_factory=list)

    def write(self, path: Path) -> None:
        """Write it to a file."""
        path.write_text(json.dumps(as_json(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> SmokeReport:
        """Return a written report; without a file the process was starting."""
        return from_json(cls, json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else cls()


def default_times(description: Description, kind: str, share: float = 1.0) -> tuple[np.ndarray, float | None]:
    """Return samples (K,) of a trial and its communication step, s.

    The `share` of the default experiment is simulated, else 1 s. Co-Simulation keeps its step size if given.
    """
    given = description.default_experiment
    start = given.get("start", 0.0)
    stop = given.get("stop", start + 1.0)
    duration = share * (stop - start if stop > start else 1.0)
    step = given.get("step_size", 0.0) if kind == "co-simulation" else 0.0
    intervals = 100  # about
    if not 0 < step <= duration:
        return np.linspace(start, start + duration, intervals + 1), None
    interval = step * max(1, round(duration / step / intervals))
    return start + interval * np.arange(max(1, int(duration / interval + 1e-9)) + 1), step


def attempt(path: Path, kind: str, share: float, target: Path) -> SmokeReport:
    """Instantiate an FMU and simulate it twice; write the report to `target`."""
    report = SmokeReport()
    with warnings_to(partial(_note, report)):
        try:
            _run(report, FMU(path), kind, share, target)
        except SimulationError as error:
            said = f'; FMU: "{" / ".join(error.messages)}"' if error.messages else ""
            report.error = f"failed at t = {error.time:.6g} s: {error.call}{said}"
        except FmuidError as error:
            report.error = str(error)
    report.write(target)
    return report


def _run(report: SmokeReport, fmu: FMU, kind: str, share: float, target: Path) -> None:
    def begin(doing: Stage) -> None:
        report.doing = doing
        report.write(target)

    begin(Stage.INSTANTIATION)
    if not fmu.description.interfaces[kind].once_per_process:
        instance = Instance(fmu, kind, "fmuid")
        report.instantiated = True
        begin(Stage.END)
        instance.close()
    times, step_size = default_times(fmu.description, kind, share)
    names = observed(fmu.description)
    frame = pd.DataFrame({"time": times})
    experiment = Experiment(frame, outputs=names, measured=False, source="the default experiment")
    report.start, report.stop, report.samples, report.outputs = times[0], times[-1], len(times), len(names)
    begin(Stage.SIMULATION)
    simulator = Simulator(fmu, experiment, interface=kind, step_size=step_size)
    first = simulator([])
    report.run = simulator.system.components[""].how_run(stiff="" in simulator.stiff)
    report.instantiated = report.simulated = True
    begin(Stage.REPETITION)
    began = time.perf_counter()
    second = simulator([])
    report.seconds, report.repeated = time.perf_counter() - began, True
    report.differs = not is_repeated(second, first)
    begin(Stage.END)
    simulator.close()


def observed(description: Description) -> list[str]:
    """Return the observed outputs, else the states: the first 200."""
    numbers = [v.name for v in description.with_causality("output") if v.type in ("Real", "Integer", "Boolean")]
    local = [name for name in description.states if description.variables[name].causality == "local"]
    return (numbers or local)[:200]


def _note(report: SmokeReport, record: logging.LogRecord) -> None:
    """Note a warning once."""
    whose = f"{record.args[0]}: " if isinstance(record.args, tuple) and record.args else ""
    text = record.getMessage().removeprefix(whose)  # there is only one FMU
    found = report.no_reset if getattr(record, "no_reset", False) else report.warnings
    if text not in found:
        found.append(text)


def main(arguments: Sequence[str]) -> None:
    """Make one trial: FMU, interface, share of the default experiment, report file."""
    watch_lifeline(partial(os._exit, 1))
    path, kind, share, target = arguments
    attempt(Path(path), kind, float(share), Path(target))


if __name__ == "__main__":
    main(sys.argv[1:])
