"""One interface of an FMU tried in a process that it may crash: ``python -m fmuid.simulation.smoke_test``.

What became of it is in a file, written anew at each step, so that it can be read whatever happened to the process.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.data import Experiment
from fmuid.errors import FmuidError, SimulationError
from fmuid.models import FMU, Description, SolverConfiguration
from fmuid.processes import watch_lifeline
from fmuid.simulation.instance import Instance
from fmuid.simulation.instance_registry import is_repeated
from fmuid.simulation.simulator import Simulator

SAMPLES = 100  # sampling intervals of a smoke simulation, about
DURATION = 1.0  # of an FMU without a default experiment, s
OBSERVED = 200  # outputs that are looked at: what an FMU has beyond them is of the same kind


class Stage(StrEnum):
    """What a try was doing."""

    START = "start"
    INSTANTIATION = "instantiation"
    SIMULATION = "simulation"
    REPETITION = "repetition"
    END = "end"


@dataclass
class SmokeReport:
    """How far a try came.

    Attributes
    ----------
    doing : Stage
        What the process was doing last.
    instantiated, simulated, repeated : bool
        Whether that was done.
    differs : bool
        Whether the second simulation gave other outputs than the first.
    run : SolverConfiguration or None
    start, stop : float
        What was simulated, s.
    samples, outputs : int
        Samples in time and outputs of each.
    seconds : float
        How long a simulation took, s: the second one.
    error : str
        The error that ended it.
    warnings : list of str
        What the FMU, or fmuid, warned of.
    no_reset : list of str
        What was warned of where a reset does not bring the FMU back to its beginning.
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
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> SmokeReport:
        """Read it again; a process that did not come to write anything was starting."""
        if not path.is_file():
            return cls()
        found = json.loads(path.read_text(encoding="utf-8"))
        run = None if found["run"] is None else SolverConfiguration(**found["run"])
        return cls(**found | {"doing": Stage(found["doing"]), "run": run})


def default_times(description: Description, kind: str, share: float = 1.0) -> tuple[np.ndarray, float | None]:
    """Return the samples of a smoke simulation and the step between communications, both s.

    Parameters
    ----------
    description : Description
        Its default experiment is simulated, from the start time or 0 for `DURATION`.
    kind : str
        Co-simulation keeps to the step size of the default experiment, if there is one: some can take no other.
    share : float
        How much of the default experiment.

    Returns
    -------
    times : (K,) array
    step_size : float or None
    """
    given = description.default_experiment
    start = given.get("start", 0.0)
    stop = given.get("stop", start + DURATION)
    duration = share * (stop - start if stop > start else DURATION)
    step = given.get("step_size", 0.0) if kind == "co-simulation" else 0.0
    if not 0 < step <= duration:
        return np.linspace(start, start + duration, SAMPLES + 1), None
    interval = step * max(1, round(duration / step / SAMPLES))
    return start + interval * np.arange(max(1, int(duration / interval + 1e-9)) + 1), step


def attempt(path: Path, kind: str, share: float, target: Path) -> SmokeReport:
    """Instantiate an FMU, simulate it twice and write the report as it goes.

    Parameters
    ----------
    path : Path
        The FMU.
    kind : str
        The interface.
    share : float
        How much of the default experiment.
    target : Path
        The report's file.
    """
    report = SmokeReport()
    with _warnings(report):
        try:
            _run(report, FMU(path), kind, share, target)
        except SimulationError as error:
            said = f'; the FMU says: "{" / ".join(error.messages)}"' if error.messages else ""
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
    """Return the outputs that are looked at; an FMU without outputs is observed by its states."""
    numbers = [v.name for v in description.with_causality("output") if v.type in ("Real", "Integer", "Boolean")]
    local = [name for name in description.states if description.variables[name].causality == "local"]
    return (numbers or local)[:OBSERVED]


@contextmanager
def _warnings(report: SmokeReport) -> Iterator[None]:
    """Collect what is warned of, once each."""

    class Collect(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            whose = f"{record.args[0]}: " if isinstance(record.args, tuple) and record.args else ""
            text = record.getMessage().removeprefix(whose)  # there is only one FMU
            found = report.no_reset if getattr(record, "no_reset", False) else report.warnings
            if text not in found:
                found.append(text)

    logger, handler = logging.getLogger("fmuid"), Collect(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def main(arguments: Sequence[str]) -> None:
    """Make one attempt: FMU, interface, share of the default experiment, and the file of the report."""
    watch_lifeline(partial(os._exit, 1))
    path, kind, share, target = arguments
    attempt(Path(path), kind, float(share), Path(target))


if __name__ == "__main__":
    main(sys.argv[1:])
