"""Diagnosis by fault models (1.63–1.68): an examination, and a fit of the named fault without healthy data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from annotated_types import Ge, Gt, Lt
from scipy import special

from fmuid.blas import single_threaded
from fmuid.data import Experiment, Noise
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.cause_analysis import Examination, examine
from fmuid.diagnosis.cause_ranking import SETTINGS as CAUSE_RANKING
from fmuid.diagnosis.cause_results import ChangeEvidence, EstimatedChange, Explanation
from fmuid.diagnosis.causes import CauseKind, Causes
from fmuid.diagnosis.change_detection import detectable
from fmuid.diagnosis.diagnosis_result import BaselineDeviation, Diagnosis
from fmuid.diagnosis.faults import VARIANT, Fault, checked_faults, with_variants
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.rule import FALSE_ALARM_LEVEL, MISS_PROBABILITY, MODEL_ERROR
from fmuid.diagnosis.unexplained_residual import VarianceRatio
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, Marquardt, Result, check_level
from fmuid.events import FaultStep, Progress
from fmuid.formatting import nearest
from fmuid.identification import SIGNIFICANCE_LEVEL, Problem, identify
from fmuid.models import FMU, System
from fmuid.version import __version__

# A model that without its fault differs by more than this from the healthy one, in sums of squares over the noise, has
# another healthy machine in it; differences of the simulations alone are smaller.
SAME_CRITERION = 1.0


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings of a diagnosis.

    Raises
    ------
    InputError
        If a setting is out of range.

    Examples
    --------
    >>> fmuid.diagnosis.DiagnosisSettings(level=0.001).level
    0.001
    """

    level: Annotated[float, Gt(0), Lt(1)] = FALSE_ALARM_LEVEL
    """probability of a false alarm, whatever the number of faults"""
    search: Marquardt = field(default_factory=Marquardt)
    """of the fit of the named fault"""
    sensitivity: str = "finite-difference"
    """Jacobian of that fit: "finite-difference", "forward" or "fmu", as for `fmuid.Problem`"""
    solver_check: str = "refine"
    """solver check of that fit: "refine", "report" or "off", as for `fmuid.identify`"""
    causes: Causes = field(default_factory=Causes)
    """beside the faults, where there are healthy data"""
    model_error: Annotated[float, Ge(0)] = MODEL_ERROR
    """κ: error of a fault model along other signatures, as a share of its effect"""

    def __post_init__(self) -> None:
        check_level(self.level, "a test")
        if not (math.isfinite(self.model_error) and self.model_error >= 0):
            raise InputError(f"model_error must be a fraction of 0 or more, not {self.model_error!r}")
        if self.sensitivity not in SENSITIVITIES:
            near = nearest(self.sensitivity, SENSITIVITIES)
            raise InputError(f"unknown sensitivity {self.sensitivity!r}{near}. Choose {' or '.join(SENSITIVITIES)}.")


@single_threaded
def diagnose(
    experiments: Experiment | Sequence[Experiment],
    baseline: Baseline | Result | str | Path,
    faults: Mapping[str, Fault],
    model: System | FMU | str | Path,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Look for faults in a record.

    Parameters
    ----------
    experiments : Experiment or sequence of Experiment
        With the names of the healthy model.
    baseline : Baseline, Result or path
        The healthy machine; also a result alone, or its ``result.json``.
    faults : mapping of str to Fault
    model : System, FMU or path
        The healthy machine.
    settings : DiagnosisSettings, optional
    progress : callable, optional
        Called with a `fmuid.events.FaultStep` before the examination and before the fit.

    Raises
    ------
    InputError
        If there is no fault, the healthy result does not fit the model, or names do not fit together.
    SimulationError
        If the simulation fails at the healthy estimate.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> fmuid.diagnose(test.experiment, fmuid.identify(coil.problem()), {"turns": turns}, coil.fmu)
    Diagnosis(fault: turns)
    """
    faults, known = checked_faults(faults), Baseline.of(baseline)
    listed = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    how, tell = settings or DiagnosisSettings(), progress or (lambda _: None)
    tell(FaultStep(share=0.0, fault=None))
    causes = how.causes if known.beside else None
    made = BaselineComparator.of(System.of(model), known, with_variants(faults), causes, listed)
    kappa = made.model_error(how.model_error, how.level)
    machines = [made.machine(each) for each in listed]
    found = examine(machines, made.healthy, made.coordinates, how.level, kappa)
    evidence, fitted = found.evidence, None
    if evidence.basis.alone and evidence.explanations:
        best = evidence.explanations[0]
        if len(best.faults) == 1:
            tell(FaultStep(share=0.5, fault=best.faults[0]))
            fitted = _fitted(made, found, best, listed, how)
            refined = tuple(_refined(each, faults[each.fault], fitted, kappa) for each in best.changes)
            explanations = (Explanation(refined, best.odds), *evidence.explanations[1:])
            evidence = replace(evidence, explanations=explanations)
    points = made.healthy.points
    values = (made.coordinates.healthy + found.estimate.mean).tolist()
    stds = np.sqrt(np.maximum(np.diag(found.estimate.covariance), 0.0)).tolist()
    return Diagnosis(
        level=how.level,
        evidence=evidence,
        unexplained=_unexplained(evidence, found, known.freedom),
        nominal=dict(zip(known.common, zip(values, stds, strict=True), strict=False)),
        noise_variance=known.variance(listed[0].output_names),
        deviation=_deviation(found) if evidence.basis.alone else None,
        version=__version__,
        accuracy=None if fitted is None else fitted.accuracy,
        fitted=() if fitted is None else fitted.names,
        result=fitted,
        residuals=_residuals(listed[0], found) if evidence.explanations else None,
        mismatched=_mismatched(machines, made),
        coverage=None if points is None else points.coverage(listed),
        detectable=_detectable(found),
    )


def _detectable(found: Examination) -> dict[str, float]:
    """Return the size of each fault that such a record shows; of its details the worst."""
    sizes: dict[str, float] = {}
    for cause in found.at.causes:
        of = found.coordinates.each[cause.columns[0]]
        if of.kind is CauseKind.FAULT:
            size = detectable(found.at.news, cause, found.limit, MISS_PROBABILITY)
            sizes[of.name] = max(size, sizes.get(of.name, 0.0))
    return sizes


def _mismatched(machines: Sequence[LinearizedMachine], made: BaselineComparator) -> tuple[str, ...]:
    """Return the faults whose models differ from the healthy machine at zero."""
    squares = dict.fromkeys(made.coordinates.faults, 0.0)
    for machine in machines:
        std = [made.healthy.whitening.std(output) for output in machine.experiment.output_names]
        for name, apart in machine.apart_at_zero().items():
            squares[name] += float(np.sum((apart / std)[machine.experiment.counted] ** 2))
    apart_at = (name.partition(VARIANT)[0] for name, value in squares.items() if value > SAME_CRITERION)
    return tuple(dict.fromkeys(apart_at))


def _unexplained(evidence: ChangeEvidence, found: Examination, freedom: float) -> VarianceRatio:
    """Test the residual: its variance, or beside healthy data its structure."""
    if not evidence.basis.alone:
        return VarianceRatio(evidence.ratio, evidence.remainder.probability)
    noise = found.at.whitening
    share = sum(map(noise.independent_share, noise.models)) / len(noise.models)
    return VarianceRatio.of(evidence.ratio, share * evidence.samples, share * freedom)


def _deviation(found: Examination) -> BaselineDeviation | None:
    """Return the nominal parameter farthest outside its prior, beside the named causes."""
    news, at = found.at.news, found.coordinates.of(CauseKind.PARAMETER)
    score, information = news.score[at], np.diag(news.information)[at]
    for named in found.naming.named[:1]:
        shared = news.information[np.ix_(at, named.columns)]
        score = score - shared @ named.fit.sizes
        information = information - np.sum(shared * np.linalg.solve(news.part(named.columns)[0], shared.T).T, axis=1)
    statistics = np.where(information > 0, score**2 / np.where(information > 0, information, 1.0), 0.0)
    i = int(np.argmax(statistics))
    if len(at) * special.chdtrc(1, statistics[i]) >= SIGNIFICANCE_LEVEL:
        return None
    return BaselineDeviation(found.coordinates.each[at[i]].variable, math.sqrt(statistics[i]))


def _residuals(experiment: Experiment, found: Examination) -> pd.DataFrame:
    columns = {"time": experiment.times}
    for kind, values in zip(("healthy", "fault"), found.residuals, strict=True):
        shown = np.where(experiment.counted, values, math.nan)
        columns |= {f"{kind}.{name}": own for name, own in zip(experiment.output_names, shown.T, strict=True)}
    return pd.DataFrame(columns)


# --- the fit of the fault that is named


def _fitted(
    made: BaselineComparator,
    found: Examination,
    best: Explanation,
    experiments: Sequence[Experiment],
    how: DiagnosisSettings,
) -> Result:
    """Fit the named sizes, others zero, with healthy estimates as prior."""
    fault, baseline = made.coordinates.faults[best.faults[0]], made.baseline
    named = {each.variable: each.value for each in best.changes}
    named |= {each.angle: each.angle_value for each in best.changes if each.angle}
    sizes = {name: each for name, each in fault.searched.items() if name in named}
    searched = fault.own_names(baseline.common) | sizes
    nominal = made.coordinates.healthy + found.estimate.mean
    start = [*nominal[: len(baseline.common)], *(named[name] for name in sizes)]
    variance = baseline.variance(experiments[0].output_names)
    problem = Problem(
        System.of(fault.model),
        [fault.renamed(each) for each in experiments],
        searched,
        noise=Noise(fault.own_names(variance), delay_std=0.0),  # the delay of both records is the same
        values={**fault.values, **{name: value for name, value in fault.zero.items() if name not in named}},
        sensitivity=how.sensitivity,
    )
    problem = problem.finer(baseline.refinement)  # that of the healthy record, whose estimates are the prior
    low, high = np.array([(each.min, each.max) for each in searched.values()]).T
    begin = np.clip(start, low, high)
    return identify(problem, how.search, start=begin, solver_check=how.solver_check, restart=False)


def _refined(change: EstimatedChange, fault: Fault, fitted: Result, kappa: float) -> EstimatedChange:
    """Return a change with the fitted size and the model's error; unchanged if the fit failed."""
    std = float(fitted.std[fitted.names.index(change.variable)])
    if not (fitted.converged and math.isfinite(std)):
        return change
    value = fitted[change.variable]
    change = replace(change, value=value, std=math.hypot(std, CAUSE_RANKING.own_share * kappa * value))
    if not change.angle:
        return change
    off = float(fitted.std[fitted.names.index(change.angle)])
    turned = fitted[change.angle] % fault.angle_of[change.angle].period
    return replace(change, angle_value=turned, angle_std=off)
