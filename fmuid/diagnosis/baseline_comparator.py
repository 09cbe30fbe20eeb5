"""A baseline ready to be compared with records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline, BaselineSource, MachineDigest, StoredBaseline, digest_of_record
from fmuid.diagnosis.baseline_statistics import BaselineStatistics, own_point, shown_by
from fmuid.diagnosis.cause_analysis import error_of
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import Causes, ChangeParameterSet, SignalScale, coordinates_of
from fmuid.diagnosis.faults import Fault, with_variants
from fmuid.diagnosis.information_matrix import ChangePrior, Whitening
from fmuid.diagnosis.linearized_machine import LinearizedMachine, residual_of
from fmuid.errors import InputError
from fmuid.estimation import output_noise
from fmuid.formatting import nearest
from fmuid.models import System


@dataclass(frozen=True, eq=False)
class BaselineComparator:
    """A healthy machine, ready to be compared with records."""

    system: System
    baseline: Baseline
    coordinates: ChangeParameterSet
    healthy: BaselineStatistics
    shown: StoredBaseline | None = None

    @classmethod
    def of(
        cls,
        system: System,
        baseline: Baseline,
        faults: Mapping[str, Fault],
        causes: Causes | None,
        experiments: Sequence[Experiment],
        *,
        fewer: bool = False,
    ) -> BaselineComparator:
        """Return the comparator of a baseline and new experiments; with `fewer` its file may have more causes."""
        first = (*baseline.records, *experiments)[0]
        _check(first, [*baseline.records[1:], *experiments], baseline)
        for name, fault in faults.items():
            try:
                for detail in fault.nuisance.keys() - System.of(fault.model).connectors.keys():
                    System.of(fault.model).variable(detail, "nuisance variable")
                fault.check_beside(baseline.common, [*first.input_names, *first.of_model.output_names])
            except InputError as error:
                raise InputError(f"fault {name!r}: {error}") from None
        variance = baseline.variance(first.output_names)
        scale = {name: math.sqrt(value) for name, value in variance.items()}
        alone = Causes(None, None, None, None, None, None, None)
        lines = None if baseline.records or baseline.shown is None else baseline.shown.lines
        sizes = SignalScale(scale, lines)
        coordinates = coordinates_of(system, baseline.common, faults, first, sizes, causes or alone)
        known, drift = _of_result(baseline, coordinates)
        noise = Whitening({name: baseline.noise(name, value) for name, value in variance.items()})
        learned = all(name in baseline.result.fit.output_noise for name in variance)
        basis = BaselineSource.RESULT if learned else BaselineSource.WHITE_RESULT
        made = cls(system, baseline, coordinates, BaselineStatistics(known, noise, drift, basis=basis))
        if not baseline.beside:
            return made
        basis, shown = made._shown(variance, fewer=fewer)
        return replace(made, healthy=BaselineStatistics.of(shown, coordinates, drift, basis), shown=shown)

    def _shown(self, variance: Mapping[str, float], *, fewer: bool) -> tuple[BaselineSource, StoredBaseline]:
        """Return source and sums of healthy records, from the file if fitting."""
        baseline, coordinates = self.baseline, self.coordinates
        given, known, basis = baseline.noise_variance, baseline.shown, BaselineSource.RECORDS
        asked = MachineDigest.of(self.system, baseline, coordinates)
        if known is not None and known.subject is not None:
            unlike = known.subject.unlike(asked, fewer=fewer)
            if unlike is None:
                return BaselineSource.FILE, known.subject.among(known, asked)
            if not baseline.records:
                remedy = "Identify the healthy study again, or list its data in healthy_data."
                raise InputError(f"{known.path}: made with {unlike.value} than in this study. {remedy}")
            basis = unlike
        elif known is not None and known.path is not None:
            basis = BaselineSource.DAMAGED
        records = [self.machine(each) for each in baseline.records]
        learned = learn_baseline(records, coordinates, None if given is None else variance)
        return basis, replace(learned, subject=asked)

    def model_error(self, stated: float, level: float) -> float:
        """Return κ: the largest of the known faults' data, or without them the stated one."""
        if not self.baseline.trials:
            return stated
        causes, found = self.coordinates.by_name, []
        for name, records in self.baseline.trials.items():
            if name not in causes:
                raise InputError(f"known_fault_data.{name}: unknown cause{nearest(name, causes)}")
            for each in records:
                shown = error_of(self.machine(each), self.healthy, self.coordinates, name, level)
                if math.isnan(shown):
                    remedy = "Use data with a larger fault, or remove it."
                    raise InputError(f"{each.source}: no change by {name} found. {remedy}")
                found.append(shown)
        return max(found)

    def machine(self, experiment: Experiment) -> LinearizedMachine:
        """Return the machine over a record."""
        baseline = self.baseline
        return LinearizedMachine(self.system, baseline.values, self.coordinates, experiment, baseline.refinement)


def learn_baseline(
    records: Sequence[LinearizedMachine], coordinates: ChangeParameterSet, variances: Mapping[str, float] | None = None
) -> StoredBaseline:
    """Return the sums of healthy records, each linearized at its own estimate."""
    healthy = [coordinates.healthy] * len(records)
    whitening = whitening_of(records, healthy, coordinates.normal, variances)
    points = [own_point(each, whitening, coordinates) for each in records]  # what is nonlinear is no noise
    return shown_by(records, whitening_of(records, points, coordinates.normal, variances), coordinates)


@single_threaded
def compute_stored_baseline(
    baseline: Baseline, faults: Mapping[str, Fault], system: System, causes: Causes
) -> StoredBaseline:
    """Return the sums of a baseline's records for all causes.

    Raises
    ------
    InputError
        If records, models and faults do not fit together.
    SimulationError
        If the healthy machine cannot be simulated.
    """
    shown = BaselineComparator.of(system, baseline, with_variants(faults), causes, []).shown
    assert shown is not None  # there are records
    return shown


@single_threaded
def extend_stored_baseline(
    baseline: Baseline, faults: Mapping[str, Fault], system: System, causes: Causes, records: Sequence[Experiment]
) -> StoredBaseline:
    """Return the sums of a baseline with more healthy records; without file those of all records.

    Raises
    ------
    InputError
        If records, models and faults do not fit together, or a record counts already.
    SimulationError
        If the healthy machine cannot be simulated.
    """
    known = baseline.shown
    if known is None:
        whole = replace(baseline, records=[*baseline.records, *records])
        return compute_stored_baseline(whole, faults, system, causes)
    made = BaselineComparator.of(system, replace(baseline, records=()), with_variants(faults), causes, records)
    assert made.shown is not None and made.shown.subject is not None  # the file serves
    digests = [digest_of_record(each) for each in records]
    for digest, each in zip(digests, records, strict=True):
        if digest in made.shown.subject.records:
            raise InputError(f"{each.source}: in the baseline {known.path} already. Remove it from the list.")
    new = shown_by([made.machine(each) for each in records], made.shown.whitening, made.coordinates)
    return made.shown.extended(new, digests)


def _check(first: Experiment, others: Sequence[Experiment], baseline: Baseline) -> None:
    for each in others:
        for role in ("input", "output"):
            own, wanted = (sorted(set(getattr(one, f"{role}_names"))) for one in (each, first))
            if own != wanted:
                mine, theirs = (", ".join(names) or "none" for names in (own, wanted))
                said = f"{role}s {mine} differ from those of {first.source}: {theirs}"
                raise InputError(f"{each.source}: {said}. Use the same {role}s.")
    for record in baseline.records:
        # planned outputs count without a value
        there = np.any(record.counted & ~np.isnan(record.output_values), axis=0)
        for name in np.array(record.output_names)[~there].tolist():
            raise InputError(f"{record.source}: no sample of {name!r}. Remove it from the healthy data.")
    for name, parameter in baseline.common.items():
        if parameter.per_experiment:
            remedy = "Diagnose each experiment alone, without per_experiment."
            raise InputError(f"the parameter {name!r} is one per experiment. {remedy}")


def _of_result(baseline: Baseline, coordinates: ChangeParameterSet) -> tuple[ChangePrior, Floats]:
    """Return the healthy result's prior, and σ of sound changes (N,)."""
    std, drift = np.zeros(len(coordinates.each)), np.zeros(len(coordinates.each))
    std[coordinates.details] = coordinates.normal[coordinates.details]
    known = dict(zip(baseline.result.names, baseline.result.std.tolist(), strict=True))
    for i, (name, parameter) in enumerate(baseline.common.items()):
        std[i] = known.get(name, 0.0)
        if parameter.prior is None or name not in known:
            drift[i] = CAUSES.open * (parameter.nominal or abs(parameter.start) or 1.0)
        else:
            drift[i] = math.sqrt(max(0.0, parameter.prior.std**2 - known[name] ** 2))
    return ChangePrior(np.zeros(std.size), np.diag(std**2)), drift


def whitening_of(
    records: Sequence[LinearizedMachine],
    points: Sequence[Floats],
    width: Floats,
    variances: Mapping[str, float] | None = None,
) -> Whitening:
    """Return the noise of records beside coordinates that may be off; given variances stay."""
    residuals = []
    for record, point in zip(records, points, strict=True):
        experiment, (outputs, columns) = record.experiment, record.linearize(point)
        rest, there = residual_of(experiment, outputs), experiment.counted
        # held by springs of its width in units of the residual itself
        scale = max(float(np.std(rest[there])), np.finfo(float).tiny)
        stacked = np.vstack([columns[there] * width / scale, np.eye(width.size)])
        target = np.concatenate([rest[there] / scale, np.zeros(width.size)])
        taken = columns @ (np.linalg.lstsq(stacked, target, rcond=None)[0] * width)
        residuals.append((experiment, np.where(there, rest - taken, 0.0)))
    return Whitening(output_noise(residuals, variances))
