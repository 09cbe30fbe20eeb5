"""Problem of a case, and the true values for its simulated measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from fmuid.data import Experiment, JointPrior, time_name
from fmuid.errors import InputError
from fmuid.identification import Problem
from fmuid.simulation import AnySimulator, simulator_of
from fmuid.studies import BatchSettings, ExperimentSettings, Study, Value

Values = Mapping[str, Value]


def flat_names(study: Study) -> dict[str, str]:
    """Return all parameters with their variables, those per experiment one by one."""
    return {
        each.name_in(given.name, name): name for name, each in study.parameters.items() for given in study.experiments
    }


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
    known: dict[str, Value] = {name: each.start for name, each in study.parameters.items() if name not in free}
    known |= held
    parameters = {
        name: replace(study.parameters[name], start=starts[name]) if name in starts else study.parameters[name]
        for name in free
    }
    if like is not None:
        return like.measuring(experiments, parameters)
    joint = study.joint_prior
    if joint is not None:
        joint = _given(joint, {flat: float(known[name]) for flat, name in flat_names(study).items() if name in known})
    return Problem(
        study.system,
        experiments,
        parameters,
        noise=study.noise,
        values={**study.model.values, **known},
        joint_prior=joint,
        loss=study.estimation.loss,
        sensitivity=study.estimation.jacobian,
        choices={name: few for name, few in study.model.choices.items() if name not in known},
    )


def _given(prior: JointPrior, known: Mapping[str, float]) -> JointPrior | None:
    """Return the conditional normal distribution of unknown parameters (1.37)."""
    there = np.array([name in known for name in prior.names])
    if not there.any():
        return prior
    if there.all():
        return None
    left = ~there
    std = np.sqrt(np.diag(prior.covariance))
    correlation = prior.covariance / np.outer(std, std)
    gain = np.linalg.solve(correlation[np.ix_(there, there)], correlation[np.ix_(there, left)]).T
    away = (np.array([known[name] for name in prior.names if name in known]) - prior.mean[there]) / std[there]
    matrix = correlation[np.ix_(left, left)] - gain @ correlation[np.ix_(there, left)]
    return JointPrior(
        [name for name in prior.names if name not in known],
        prior.mean[left] + std[left] * (gain @ away),
        (matrix + matrix.T) / 2.0 * np.outer(std[left], std[left]),
    )


def truth_values(study: Study, held: Values) -> dict[str, Value]:
    """Return all true values: of ``true_values``, else held, else the start of the parameter."""
    drawn = study.batch.monte_carlo if study.batch is not None else None
    given = {} if drawn is None else drawn.true_values
    flat = flat_names(study)
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
    flat, names = flat_names(study), tuple(study.parameters)
    values = {**study.model.values, **{name: value for name, value in truth.items() if name not in flat}}
    found = []
    for given, experiment in zip(study.experiments, experiments, strict=True):
        theta = [float(truth[name if name in flat else f"{name}[{given.name}]"]) for name in names]
        found.append((simulator_of(study.system, experiment, names, values), theta))
    return found


def check_model(study: Study, settings: BatchSettings, subsets: Sequence[Sequence[str]], held: Values) -> None:
    """Check that model, study and batch fit together, without any table."""
    experiments = [_unmeasured(given, 2 + len(flat_names(study))) for given in study.experiments]
    problem_of(study, experiments, tuple(study.parameters), {}, {})  # what is wrong without the batch, as the study's
    try:
        for free in subsets:
            problem = problem_of(study, experiments, free, held, {})
            study.estimator.check(problem)
        if settings.monte_carlo is not None:
            truth_simulators(study, experiments, truth_values(study, held))
    except InputError as error:
        raise settings.error(f"{error}") from None


def _unmeasured(given: ExperimentSettings, rows: int) -> Experiment:
    """Return an experiment without data: inputs at rest, names of the outputs."""
    columns = dict.fromkeys([*given.inputs.values(), *([] if given.observed is None else given.columns)], 0.0)
    columns |= dict.fromkeys(given.supply_columns, 1.0)
    frame = pd.DataFrame({time_name(given.time): np.arange(rows, dtype=np.float64)} | columns)
    return given.model_copy(update={"warmup": 0.0}).experiment(frame, str(given.data), measured=False)
