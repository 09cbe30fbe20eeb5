"""Problem of a case, and the true values for its simulated measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.data import Experiment, time_name
from fmuid.identification import Problem
from fmuid.simulation import AnySimulator, simulator_of
from fmuid.studies import BatchSettings, ExperimentSettings, Study, Value

Values = Mapping[str, Value]


def problem_of(
    study: Study,
    experiments: Sequence[Experiment],
    free: Sequence[str],
    held: Values,
    starts: Mapping[str, float],
    like: Problem | None = None,
) -> Problem:
    """Return the problem of a case; all cases share the study's model.

    Parameters that are not `free` are held at the study's starts; `held` and `starts` replace values of the study.
    `like` is a problem with the same inputs, free parameters and held values, whose simulators serve again.
    """
    known = {name: each.start for name, each in study.parameters.items() if name not in free} | dict(held)
    if like is not None:
        return like.measuring(experiments, study.free_parameters(known, starts))
    return study.problem(experiments, known, starts)


def truth_values(study: Study, held: Values) -> dict[str, Value]:
    """Return all true values: of ``true_values``, else held, else the start of the parameter."""
    drawn = study.batch.monte_carlo if study.batch is not None else None
    given = {} if drawn is None else drawn.true_values
    flat = study.flat_names
    found: dict[str, Value] = {
        full: given.get(full, given.get(name, held.get(name, study.parameters[name].start)))
        for full, name in flat.items()
    }
    rest = {**held, **given}
    return found | {name: value for name, value in rest.items() if name not in flat and name not in study.parameters}


def truth_simulators(
    study: Study, experiments: Sequence[Experiment], truth: Values
) -> list[tuple[AnySimulator, list[float]]]:
    """Return a simulator of the truth for each experiment, and its parameters."""
    flat, names = study.flat_names, tuple(study.parameters)
    values = {**study.model.values, **{name: value for name, value in truth.items() if name not in flat}}
    found = []
    for given, experiment in zip(study.experiments, experiments, strict=True):
        theta = [float(truth[name if name in flat else f"{name}[{given.name}]"]) for name in names]
        found.append((simulator_of(study.system, experiment, names, values), theta))
    return found


def check_model(study: Study, settings: BatchSettings, subsets: Sequence[Sequence[str]], held: Values) -> None:
    """Check that model, study and batch fit together, without any table."""
    experiments = [_unmeasured(given, 2 + len(study.flat_names)) for given in study.experiments]
    problem_of(study, experiments, tuple(study.parameters), {}, {})  # what is wrong without the batch, as the study's
    with settings.place.located():
        for free in subsets:
            problem = problem_of(study, experiments, free, held, {})
            study.estimator.check(problem)
        if settings.monte_carlo is not None:
            truth_simulators(study, experiments, truth_values(study, held))


def _unmeasured(given: ExperimentSettings, rows: int) -> Experiment:
    """Return an experiment without data: inputs at rest, names of the outputs."""
    columns = dict.fromkeys([*given.inputs.values(), *([] if given.observed is None else given.columns)], 0.0)
    columns |= dict.fromkeys(given.supply_columns, 1.0)
    frame = pd.DataFrame({time_name(given.time): np.arange(rows, dtype=np.float64)} | columns)
    return given.model_copy(update={"warmup": 0.0}).experiment(frame, str(given.data), measured=False)
