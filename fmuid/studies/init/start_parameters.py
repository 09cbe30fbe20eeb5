"""Parameters that are start values: by name and by effect."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.errors import InputError, SimulationError
from fmuid.models import Description, System, Variable
from fmuid.simulation import Simulator

_START = re.compile(r"([._](start|init|initial|0)|(?<=[a-z\d])(Start|Init)|(?<=[A-Za-z])0)$|^(start|init|initial)_")


def is_start(variable: Variable, description: Description) -> bool:
    """Return whether a parameter names itself a start value."""
    if variable.causality != "parameter":
        return variable.is_state or variable.name in description.states
    if not _START.search(variable.name):
        return "initial" in variable.description.casefold().split()
    return not variable.name.endswith("0") or _origin(variable.name, description) is not None


def started(variable: Variable, description: Description) -> str | None:
    """Return the variable that a parameter is the start of, by name."""
    return _origin(variable.name, description) if _START.search(variable.name) else None


def _origin(name: str, description: Description) -> str | None:
    """Return the variable of ``ids_start``, ``ids0`` or ``mass_v0``; ``v0`` may be that of ``mass.v``."""
    said = _plain(_START.sub("", name))
    for v in description.variables.values():
        if v.variability == "continuous" and _plain(v.name) == said:
            return v.name
    ends = [state for state in description.states if _plain(state.rpartition(".")[2]) == said]
    return ends[0] if len(ends) == 1 and "." not in name else None


def _plain(name: str) -> str:
    return re.sub(r"[._]", "", name.casefold())


def starts_of(
    system: System, experiment: Experiment, description: Description, names: Sequence[str], thetas: Floats
) -> list[int]:
    """Return the start values among `names`; doubtful ones must move an initial value."""
    by_name = [k for k, name in enumerate(names) if is_start(description.variables[name], description)]
    doubtful = {k: started(description.variables[names[k]], description) for k in by_name if names[k].endswith("0")}
    origins = {k: origin for k, origin in doubtful.items() if origin is not None}
    if not origins:
        return by_name
    outputs = list(dict.fromkeys(origins.values()))
    first = _first_samples(system, experiment, names, outputs, thetas[[0, *(k + 1 for k in origins)]])
    moved = {
        k: first is None or first[row, outputs.index(origin)] != first[0, outputs.index(origin)]
        for row, (k, origin) in enumerate(origins.items(), start=1)
    }
    return [k for k in by_name if moved.get(k, True)]


def direct_effects(system: System, experiment: Experiment) -> Floats:
    """Return the first-sample effect of each input's largest value (n_outputs,); 0 if it fails."""
    moves = np.diag(np.abs(experiment.input_values).max(axis=0, initial=0.0))
    outputs, at = experiment.output_names, np.zeros((1, 0))
    effects, base = np.zeros(len(outputs)), _first_samples(system, experiment, (), outputs, at)
    if base is None:
        return effects
    for move in moves[moves.any(axis=1)]:
        moved = _first_samples(system, experiment, (), outputs, at, move)
        if moved is not None:
            effects += np.abs(moved[0] - base[0])
    return effects


def _first_samples(
    system: System,
    experiment: Experiment,
    names: Sequence[str],
    outputs: Sequence[str],
    thetas: Floats,
    move: Floats | None = None,
) -> Floats | None:
    """Return initial values (N, K) with inputs moved; None if the simulation fails."""
    columns = {name: f"input {k}" for k, name in enumerate(experiment.input_names)}
    first = experiment.input_values[0] + (0.0 if move is None else move)
    inputs: Mapping[str, float] = dict(zip(columns.values(), first.tolist(), strict=True))
    units = {name: unit for name, unit in experiment.units.items() if name in columns}
    times = experiment.times[0] + np.array([0.0, np.ptp(experiment.times) / experiment.times.size])
    frame = pd.DataFrame({"time": times, **inputs})
    try:
        short = Experiment(frame, columns, list(outputs), units=units, values=experiment.values, measured=False)
        found = Simulator(system, short, names).many(thetas)
    except (InputError, SimulationError):
        return None
    return None if any(error is not None for error in found.errors) else np.asarray(found.outputs[:, 0])
