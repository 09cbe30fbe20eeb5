"""New records beside healthy ones: the baseline of a machine, its sensors and its supply, and what is new."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline, BaselineSource, MachineDigest, StoredBaseline
from fmuid.diagnosis.cause_analysis import BaselineStatistics, error_of, healthy_of, shown_by
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import Causes, ChangeParameterSet, coordinates_of
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.information_matrix import ChangePrior
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.prewhitening import Whitening, whitening_of
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import System

NOTHING_BESIDE = Causes(None, None, None, None, None)


@dataclass(frozen=True, eq=False)
class BaselineComparator:
    """A healthy machine, as records are compared with it.

    Attributes
    ----------
    system : System
        The healthy machine.
    baseline : Baseline
    faults : mapping of str to Fault
    coordinates : ChangeParameterSet
    healthy : BaselineStatistics
    basis : BaselineSource
        Where the healthy machine is from.
    shown : StoredBaseline or None
        What the healthy records showed.
    """

    system: System
    baseline: Baseline
    faults: Mapping[str, Fault]
    coordinates: ChangeParameterSet
    healthy: BaselineStatistics
    basis: BaselineSource = BaselineSource.RECORDS
    shown: StoredBaseline | None = None

    @classmethod
    def of(
        cls,
        system: System,
        baseline: Baseline,
        faults: Mapping[str, Fault],
        causes: Causes,
        experiments: Sequence[Experiment],
        *,
        planned: bool = False,
        fewer: bool = False,
    ) -> BaselineComparator:
        """Return that of a baseline with its records; without them, of its result alone and with the faults as causes.

        Parameters
        ----------
        system : System
            The healthy machine.
        baseline : Baseline
        faults : mapping of str to Fault
        causes : Causes
            Beside the faults, where there are healthy records.
        experiments : sequence of Experiment
            To be compared.
        planned : bool
            Whether there will be a healthy record, and all causes are looked at.
        fewer : bool
            Whether what was kept beside more causes serves, too: not for what the residual owes to the inputs.

        Raises
        ------
        InputError
            If the records have other inputs or outputs than the first one, parameters are one per experiment, or there
            are no healthy records and what others showed is of another machine.
        SimulationError
            If the healthy machine cannot be simulated.
        """
        first = (*baseline.records, *experiments)[0]
        _check(first, [*baseline.records[1:], *experiments], baseline)
        for name, fault in faults.items():
            try:
                fault.check_beside(baseline.common, [*first.input_names, *first.output_names])
            except InputError as error:
                raise InputError(f"fault {name!r}: {error}") from None
        variance = baseline.variance(first.output_names)
        noise = {name: math.sqrt(value) for name, value in variance.items()}
        beside = causes if baseline.beside or planned else NOTHING_BESIDE
        coordinates = coordinates_of(system, baseline.common, faults, first, noise, beside)
        drift = _drift(baseline, coordinates)
        if not baseline.beside:
            healthy = BaselineStatistics(_by_result(baseline, coordinates), Whitening.white(variance), drift)
            return cls(system, baseline, faults, coordinates, healthy, BaselineSource.RESULT)
        basis, shown = _shown(system, baseline, faults, coordinates, variance, fewer=fewer)
        return cls(system, baseline, faults, coordinates, healthy_of(shown, coordinates, drift), basis, shown)

    def model_error(self, stated: float, level: float) -> float:
        """Return κ: the largest that the trials of the baseline show, or without them what is stated.

        Raises
        ------
        InputError
            If the trials are of no cause that there is, or show nothing new.
        """
        if not self.baseline.trials:
            return stated
        causes, found = {cause.name: cause for cause in self.coordinates.causes}, []
        for name, records in self.baseline.trials.items():
            if name not in causes:
                raise InputError(f"trials have {name!r}, which is no cause{nearest(name, causes)}")
            for each in records:
                shown = error_of(self.machine(each), self.healthy, self.coordinates, causes[name], level)
                if math.isnan(shown):
                    raise InputError(
                        f"the trial {each.source} shows nothing of {name}: take a larger one, or leave it out"
                    )
                found.append(shown)
        return max(found)

    def machine(self, experiment: Experiment) -> LinearizedMachine:
        """Return the machine over a record."""
        return _machine(self.system, self.baseline, self.faults, self.coordinates, experiment)


@single_threaded
def compute_stored_baseline(
    baseline: Baseline, faults: Mapping[str, Fault], system: System, causes: Causes
) -> StoredBaseline:
    """Return what the records of a baseline show of the healthy machine and of all causes.

    Raises
    ------
    InputError, SimulationError
        As `BaselineComparator.of`.
    """
    shown = BaselineComparator.of(system, baseline, faults, causes, []).shown
    assert shown is not None  # there are records
    return shown


def _shown(
    system: System,
    baseline: Baseline,
    faults: Mapping[str, Fault],
    coordinates: ChangeParameterSet,
    variance: Mapping[str, float],
    *,
    fewer: bool,
) -> tuple[BaselineSource, StoredBaseline]:
    """Return what healthy records showed, of the file where that fits, and where it is from."""
    given, known, basis = baseline.noise_variance, baseline.shown, BaselineSource.RECORDS
    how = system, baseline.values, baseline.refinement
    asked = MachineDigest.of(how, faults, coordinates, given, baseline.records)
    if known is not None and known.subject is not None:
        unlike = known.subject.unlike(asked, fewer=fewer)
        if unlike is None:
            return BaselineSource.FILE, known.subject.among(known, asked)
        if not baseline.records:
            raise InputError(
                f"{known.path} is of {unlike.value} than this study: identify the healthy study again with these, or "
                "name its tables as records"
            )
        basis = unlike
    elif known is not None and known.path is not None:
        basis = BaselineSource.DAMAGED
    records = [_machine(system, baseline, faults, coordinates, each) for each in baseline.records]
    whitening = whitening_of(records, coordinates.healthy, coordinates.normal, None if given is None else variance)
    return basis, replace(shown_by(records, whitening, coordinates), subject=asked)


def _machine(
    system: System,
    baseline: Baseline,
    faults: Mapping[str, Fault],
    coordinates: ChangeParameterSet,
    experiment: Experiment,
) -> LinearizedMachine:
    return LinearizedMachine(
        system, baseline.values, baseline.common, faults, coordinates, experiment, baseline.refinement
    )


def _by_result(baseline: Baseline, coordinates: ChangeParameterSet) -> ChangePrior:
    """Return what the healthy result alone says: its estimates, and no fault."""
    std = np.zeros(len(coordinates.each))
    known = dict(zip(baseline.result.names, baseline.result.std.tolist(), strict=True))
    for i, name in enumerate(baseline.common):
        std[i] = known.get(name, 0.0)
    return ChangePrior(np.zeros(std.size), np.diag(std**2))


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
                f"the parameter {name!r} is one per experiment, which does not go with a diagnosis: "
                "diagnose each experiment by itself, with a parameter of its own"
            )


def _drift(baseline: Baseline, coordinates: ChangeParameterSet) -> Floats:
    """Return what the healthy parameters may have changed by without being a fault (N,): what `inflate` adds."""
    drift = np.zeros(len(coordinates.each))
    known = dict(zip(baseline.result.names, baseline.result.std.tolist(), strict=True))
    for i, (name, parameter) in enumerate(baseline.common.items()):
        if parameter.prior is None or name not in known:
            drift[i] = CAUSES.open * (parameter.nominal or abs(parameter.start) or 1.0)
        else:
            drift[i] = math.sqrt(max(0.0, parameter.prior.std**2 - known[name] ** 2))
    return drift
