"""New records beside healthy ones: the baseline of a machine, its sensors and its supply, and what is new."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from fmuid.arrays import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.coordinates import OPEN, Causes, Coordinates, coordinates_of
from fmuid.diagnosis.examination import examine, healthy_of
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.findings import Evidence
from fmuid.diagnosis.linearisation import Machine
from fmuid.diagnosis.whitening import Whitening
from fmuid.errors import InputError
from fmuid.models import System
from fmuid.simulation import Refinement


def compare(
    experiments: Sequence[Experiment],
    baseline: Baseline,
    faults: Mapping[str, Fault],
    system: System,
    refinement: Refinement,
    causes: Causes,
    level: float,
    model_error: float,
) -> Evidence:
    """Say what is new in records beside the healthy ones of the baseline.

    Parameters
    ----------
    experiments : sequence of Experiment
    baseline : Baseline
        With its records.
    faults : mapping of str to Fault
    system : System
        The healthy machine.
    refinement : Refinement
        How fine the simulations are.
    causes : Causes
        Beside the faults.
    level, model_error : float
        As for `fmuid.diagnosis.examination.examine`.

    Raises
    ------
    InputError
        If the records have other inputs or outputs than the first one, or parameters are one per experiment.
    SimulationError
        If the healthy machine cannot be simulated.
    """
    first = baseline.records[0]
    _check(first, [*baseline.records[1:], *experiments], baseline)
    variance = baseline.variance(first.output_names)
    noise = {name: math.sqrt(value) for name, value in variance.items()}
    coordinates = coordinates_of(system, baseline.common, faults, first, noise, causes)

    def machine(experiment: Experiment) -> Machine:
        return Machine(system, baseline.values, baseline.common, faults, coordinates, experiment, refinement)

    records = [machine(record) for record in baseline.records]
    whitening = _whitening(records, coordinates, variance if baseline.noise_variance is not None else None)
    healthy = healthy_of(records, whitening, coordinates, _drift(baseline, coordinates))
    return Evidence.of(
        examine([machine(each) for each in experiments], healthy, coordinates, level, model_error), faults
    )


def _check(first: Experiment, others: Sequence[Experiment], baseline: Baseline) -> None:
    for each in others:
        for role in ("input", "output"):
            own, wanted = set(getattr(each, f"{role}_names")), set(getattr(first, f"{role}_names"))
            if own != wanted:
                raise InputError(
                    f"{each.source} has the {role}s {', '.join(sorted(own)) or 'none'}, and the healthy record "
                    f"{first.source} {', '.join(sorted(wanted)) or 'none'}: they must be the same"
                )
    for name, parameter in baseline.common.items():
        if parameter.per_experiment:
            raise InputError(
                f"the parameter {name!r} is one per experiment, which does not go with healthy records: "
                "diagnose each experiment by itself"
            )


def _whitening(
    records: Sequence[Machine], coordinates: Coordinates, variances: Mapping[str, float] | None
) -> Whitening:
    """Return the noise of the healthy records, by what is left of them beside all coordinates of sound machines."""
    residuals = []
    for record in records:
        outputs, columns = record.linearise(coordinates.healthy)
        experiment = record.experiment
        rest = np.where(experiment.counted, experiment.output_values - outputs, 0.0)
        flat = columns[experiment.counted] * coordinates.normal
        # what a sound machine may have, held by springs of its width in units of the residual itself
        scale = max(float(np.std(rest[experiment.counted])), np.finfo(float).tiny)
        stacked = np.vstack([flat / scale, np.eye(flat.shape[1])])
        target = np.concatenate([rest[experiment.counted] / scale, np.zeros(flat.shape[1])])
        taken = columns @ (np.linalg.lstsq(stacked, target, rcond=None)[0] * coordinates.normal)
        residuals.append((experiment, np.where(experiment.counted, rest - taken, 0.0)))
    return Whitening.of(residuals, variances)


def _drift(baseline: Baseline, coordinates: Coordinates) -> Floats:
    """Return what the healthy parameters may have changed by without being a fault (N,): what `inflate` adds."""
    drift = np.zeros(len(coordinates.each))
    known = dict(zip(baseline.result.names, baseline.result.std.tolist(), strict=True))
    for i, (name, parameter) in enumerate(baseline.common.items()):
        if parameter.prior is None:
            drift[i] = OPEN * (parameter.nominal or abs(parameter.start) or 1.0)
        else:
            drift[i] = math.sqrt(max(0.0, parameter.prior.std**2 - known[name] ** 2))
    return drift
