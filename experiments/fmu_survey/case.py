"""One FMU, one interface, one integrator: simulated by fmuid and compared, in a process of its own.

    python -m experiments.fmu_survey.case FMU co-simulation own
    python -m experiments.fmu_survey.case FMU model-exchange rk45 [TOLERANCE]

prints one JSON line for each comparison: {"against", "error", "variable", "events"}, or {"failed", "why"}, or
{"stage"} before each stage, so that a crash tells where it happened.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import fmuid
from experiments.fmu_survey import plain
from experiments.fmu_survey.equations import KNOWN
from fmuid.array_types import Floats
from fmuid.models.description import Variable

TOLERANCE, TIGHT = 1e-8, 1e-11
"""What is asked of rk45 and cvode, and what is asked where that does not suffice."""
MOST_STEPS = 1000
MOST_VARIABLES = 40
DEFAULT_STOP = 2.0  # s, where the FMU declares none
LONGER = 5.0  # s, instead of the second that tools write where nobody chose
AROUND_EVENTS = 1e-6  # share of the duration on both sides of an event where values are not compared
STIFF = ("Roberts",)
SHORTER = {"Stair": {"co-simulation": 8.9, "model-exchange": 8.9}, "Roberts": {"co-simulation": 0.1}}
"""Where to stop, s: Stair ends the simulation itself after 9 s, the co-simulation of Roberts steps 1 µs at a time."""
EXACT = 2.0**53
"""Whole numbers above this are not exact in a table of floating-point numbers: left out."""


@dataclass(frozen=True)
class Task:
    """What is simulated: times (K,), input columns (K,) by variable, what is compared, a table if there is one."""

    fmu: fmuid.FMU
    times: Floats
    inputs: dict[str, Floats]
    names: list[str]
    table: pd.DataFrame | None

    @classmethod
    def of(cls, path: Path, kind: str) -> Task:
        """Choose by ``<model>_ref.csv`` (``_out``) and ``<model>_in.csv`` beside the FMU, or by what it declares."""
        fmu = fmuid.FMU(path)
        tables = [path.with_name(path.stem + ending) for ending in ("_ref.csv", "_out.csv")]
        table = next((pd.read_csv(t).drop_duplicates("time") for t in tables if t.exists()), None)
        variables = fmu.description.variables
        if table is None:
            times = _times(fmu, SHORTER.get(path.stem, {}).get(kind))
            names = [v.name for v in variables.values() if v.causality == "output" or v.is_state]
        else:
            times = table["time"].to_numpy(np.float64)
            names = [name for name, c in _expanded(table, variables).items() if max(map(abs, c)) <= EXACT]
            times = times[times <= SHORTER.get(path.stem, {}).get(kind, np.inf)]
        names = [name for name in names if _comparable(variables[name])][:MOST_VARIABLES]
        given = path.with_name(path.stem + "_in.csv")
        inputs = {} if table is not None else _invent_inputs(times, variables)
        if given.exists():
            inputs = _read_inputs(given, times, variables)
        return cls(fmu, times, inputs, names, table)

    def simulate(self, kind: str, integrator: str, tolerance: float) -> Floats:
        """Simulate with fmuid (co-simulation: the integrator is the FMU's own); returns (K, n)."""
        frame = pd.DataFrame({"time": self.times, **self.inputs, **{f"y {n}": 0.0 for n in self.names}})
        experiment = fmuid.Experiment(
            frame,
            inputs=list(self.inputs),
            outputs={name: f"y {name}" for name in self.names},
            interpolation="zoh" if kind == "co-simulation" else "linear",
        )
        choice: dict[str, Any] = {"interface": kind}
        if kind == "model-exchange":
            choice |= {"integrator": integrator, "tolerance": tolerance}
        return fmuid.Simulator(self.fmu, experiment, **choice)([])

    def references(self, kind: str) -> Iterator[tuple[str, list[str], Floats, list[float]]]:
        """Yield (what it is, variables, (K, n) array, event times) of all references there are, the FMU's own last."""
        own = self._plain(kind)
        events = own.events
        known = KNOWN.get(self.fmu.path.stem) or KNOWN.get(self.fmu.name)
        if known and not self.inputs and (kind == "model-exchange" or not self._of_euler):
            solution = known(self.start, self.times)
            names = [name for name in solution.values if name in self.names]
            events = events or solution.events
            yield "equations", names, np.array([solution.values[name] for name in names]).T, events
        if self.table is not None and (kind == "co-simulation" or not self._of_euler):
            columns = _expanded(self.table, self.fmu.description.variables)
            names = [name for name in self.names if name in columns]
            rows = len(self.times)
            yield "table", names, np.array([columns[name][:rows] for name in names], np.float64).T, events
        yield "plain loop" if kind == "co-simulation" else "scipy on the FMU", self.names, *own

    def _plain(self, kind: str) -> plain.Reference:
        if kind == "co-simulation":
            return plain.co_simulation(self.fmu, self.times, self.inputs, self.names)
        stiff = self.fmu.path.stem in STIFF
        try:
            return plain.model_exchange(self.fmu, self.times, self.inputs, self.names, stiff=stiff)
        except plain.TooManyEvaluationsError:
            return plain.model_exchange(self.fmu, self.times, self.inputs, self.names, stiff=True)

    @property
    def _of_euler(self) -> bool:
        """Whether the tables and the co-simulation of this model are explicit Euler's: the Reference FMUs."""
        return "Reference" in self.fmu.description.generation_tool or not self.fmu.description.generation_tool

    def start(self, *names: str) -> float:
        """Return the start value of the first of these variables that has one."""
        values = (self.fmu.description.variables[n].start for n in names if n in self.fmu.description.variables)
        return float(next(value for value in values if value is not None))


def compare(
    task: Task, simulated: Floats, names: Sequence[str], reference: Floats, events: Sequence[float]
) -> dict[str, Any]:
    """Return the largest deviation of a variable relative to its range, and which variable and when."""
    kept = np.ones(len(task.times), bool)
    margin = AROUND_EVENTS * float(task.times[-1] - task.times[0])
    for event in events:
        kept &= np.abs(task.times - event) > margin
    columns = [task.names.index(name) for name in names]
    ours, theirs = simulated[kept][:, columns], reference[kept]
    there = ~np.isnan(theirs)
    theirs, ours = np.where(there, theirs, 0.0), np.where(there, ours, 0.0)
    spread = np.ptp(theirs, axis=0)
    scale = np.where(spread > 1e-9 * np.abs(theirs).max(axis=0), spread, np.maximum(np.abs(theirs).max(axis=0), 1e-12))
    relative = np.abs(ours - theirs) / scale
    worst = np.unravel_index(np.argmax(relative), relative.shape)
    return {
        "error": float(relative[worst]),
        "variable": names[int(worst[1])],
        "time": float(task.times[kept][worst[0]]),
        "ours": float(ours[worst]),
        "theirs": float(theirs[worst]),
        "events": len(events),
        "samples": int(kept.sum()),
    }


def _times(fmu: fmuid.FMU, shorter: float | None) -> Floats:
    declared = fmu.description.default_experiment
    start = declared.get("start", 0.0)
    stop = declared.get("stop", start + DEFAULT_STOP)
    duration = shorter or (LONGER if stop - start == 1.0 else max(stop - start, 0.0) or DEFAULT_STOP)
    step = duration / 500 if shorter else declared.get("step_size", duration / 500)
    steps = int(np.clip(round(duration / step), 2, MOST_STEPS))
    return np.asarray(start + step * np.arange(steps + 1))


def _comparable(variable: Variable) -> bool:
    return variable.type in ("Real", "Integer", "Boolean") and variable.causality in ("output", "local")


def _expanded(table: pd.DataFrame, variables: Mapping[str, Variable]) -> dict[str, list[float]]:
    """Return the columns of a reference table as numbers, those of arrays (numbers in a row) by their elements."""
    columns: dict[str, list[float]] = {}
    for name in table.columns:
        arrays = [v.array for v in variables.values() if v.array and v.name.partition("[")[0] == name]
        if arrays:
            rows = [[float(x) for x in str(cell).split()] for cell in table[name]]
            columns |= {element: [row[i] for row in rows] for i, element in enumerate(arrays[0])}
        elif name in variables and _comparable(variables[name]):
            columns[name] = [float(x) for x in table[name].replace({"false": 0, "true": 1})]
    return columns


def _invent_inputs(times: Floats, variables: Mapping[str, Variable]) -> dict[str, Floats]:
    """Return a sine around its start value for every continuous input."""
    share = (times - times[0]) / (times[-1] - times[0])
    inputs = {}
    continuous = {
        (v.reference, v.array and v.name): v for v in variables.values() if v.causality == "input" and v.continuous
    }
    for i, variable in enumerate(continuous.values()):  # one of several names of a variable
        start = float(variable.start or 0.0)
        column = start + 0.1 * max(abs(start), 1.0) * np.sin(2 * np.pi * (1 + i) * share)
        inputs[variable.name] = np.clip(
            column,
            -np.inf if variable.min is None else variable.min,
            np.inf if variable.max is None else variable.max,
        )
    return inputs


def _read_inputs(path: Path, times: Floats, variables: Mapping[str, Variable]) -> dict[str, Floats]:
    """Return the inputs of a table at the samples: continuous ones linear, others held."""
    table = pd.read_csv(path)
    own = table["time"].to_numpy(np.float64)
    inputs = {}
    for name in table.columns.drop("time"):
        column = table[name].to_numpy(np.float64)
        if name not in variables or np.abs(column).max() > EXACT:
            continue
        held = column[np.clip(np.searchsorted(own, times + 1e-9, side="right") - 1, 0, None)]
        inputs[name] = np.interp(times, own, column) if variables[name].continuous else held
    return inputs


def main(path: str, kind: str, integrator: str, tolerance: str = str(TOLERANCE)) -> None:
    """Run one case and print its lines; integrator "none" leaves fmuid out and tries only the references."""

    def say(**what: object) -> None:
        print(json.dumps(what), flush=True)

    say(stage="fmuid")
    task = Task.of(Path(path), kind)
    if not task.names:
        say(failed="fmuid", why="no output, no state: nothing to compare")
        return
    simulated = None
    try:
        if integrator != "none":
            simulated = task.simulate(kind, integrator, float(tolerance))
    except fmuid.FmuidError as error:
        say(failed="fmuid", why=str(error))
    say(stage="reference")
    try:
        for against, names, reference, events in task.references(kind):
            if simulated is None:
                say(against=against, reference="stands")
            else:
                say(against=against, **compare(task, simulated, names, reference, events))
    except Exception as error:  # whatever an FMU's wrapper raises
        say(failed="reference", why=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
