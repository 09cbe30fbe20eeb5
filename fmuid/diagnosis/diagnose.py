"""Diagnosis by fault models (1.63–1.68): is something wrong, what, how much, and how sure is that.

Each hypothesis is a model with nominal parameters, which the healthy machine's estimates hold like springs, and fault
parameters, which are free. It is fitted twice, without and with its fault, by the compound criterion (1.68) with the
noise of the healthy machine. By how much the criterion falls, D, decides (`fmuid.diagnosis.hypothesis_tests`); the
fault parameters say how large the fault is; information criteria say which of several faults it is; and a residual
that stays larger than the noise with all of them says that it is something else (docs/method.md section 7).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import special

from fmuid.blas import single_threaded
from fmuid.data import Experiment, Noise, Parameter
from fmuid.diagnosis.baseline.baseline import Baseline
from fmuid.diagnosis.baseline_comparator import compare
from fmuid.diagnosis.cause_results import ChangeEvidence
from fmuid.diagnosis.change_detection.cause_ranking import MODEL_ERROR
from fmuid.diagnosis.change_parameters import Causes
from fmuid.diagnosis.diagnosis_result import Diagnosis, ResidualVarianceTest
from fmuid.diagnosis.fault_fits import FitSolverCheck, fit_both
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.hypothesis import BaselineDeviation, FaultHypothesis, FaultSize
from fmuid.diagnosis.hypothesis_tests import (
    FALSE_ALARM_LEVEL,
    UNEXPLAINED_SHARE,
    NullDistribution,
    at_least_one,
    orthant_weights,
    rivals,
)
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, Marquardt, Result, TerminationReason, check_level
from fmuid.formatting import nearest, of_one_experiment
from fmuid.identification import (
    SAME_VARIANCE_RATIO,
    SIGNIFICANCE_LEVEL,
    PriorDataComparison,
    Problem,
    VarianceTest,
    compare_prior_and_data,
    identify,
)
from fmuid.models import FMU, System
from fmuid.progress import FaultStep, Progress
from fmuid.version import __version__


@dataclass(frozen=True)
class DiagnosisSettings:
    """How faults are looked for.

    Parameters
    ----------
    level : float
        Probability of an alarm where nothing is wrong, whatever the number of faults looked for.
    search : Marquardt
        Of the fits.
    sensitivity : "finite-difference", "forward" or "fmu"
        As for `fmuid.Problem`.
    accuracy : "refine", "report" or "off"
        What is done about the error of the simulation in each fit (`fmuid.identify`).
    causes : Causes
        What is looked at beside the faults where there are healthy records: sensors, supply, drift.
    model_error : float
        κ, how much of its effect a fault model has wrong along any other cause's signature, as a share.

    Raises
    ------
    InputError
        If the level is not between 0 and 1, there is no such sensitivity, or the models' error is negative.

    Examples
    --------
    >>> fmuid.DiagnosisSettings(level=0.001).level
    0.001
    """

    level: float = FALSE_ALARM_LEVEL
    search: Marquardt = field(default_factory=Marquardt)
    sensitivity: str = "finite-difference"
    accuracy: str = "refine"
    causes: Causes = field(default_factory=Causes)
    model_error: float = MODEL_ERROR

    def __post_init__(self) -> None:
        check_level(self.level, "a test")
        if not (math.isfinite(self.model_error) and self.model_error >= 0):
            raise InputError(f"model_error is a share of a fault's effect, 0 or more, not {self.model_error!r}")
        if self.sensitivity not in SENSITIVITIES:
            near = nearest(self.sensitivity, SENSITIVITIES)
            raise InputError(f"sensitivity {self.sensitivity!r} is not known{near}: give {' or '.join(SENSITIVITIES)}")


@single_threaded
def diagnose(
    experiments: Experiment | Sequence[Experiment],
    baseline: Baseline | Result | str | Path,
    hypotheses: Mapping[str, Fault],
    nominal_model: System | FMU | str | Path,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Look for faults in a record.

    Parameters
    ----------
    experiments : Experiment or sequence of Experiment
        The record, with the names of the nominal model.
    baseline : Baseline, Result or path
        The healthy machine; a result, or its ``result.json``, where there is nothing else to say of it.
    hypotheses : mapping of str to Fault
        What may be wrong.
    nominal_model : System, FMU or path
        The healthy machine.
    settings : DiagnosisSettings, optional
    progress : callable, optional
        Called with a `fmuid.progress.FaultStep` before each fit.

    Raises
    ------
    InputError
        If there is no hypothesis, the healthy result does not fit the model, or names do not fit together.
    SimulationError
        If the simulation fails at the healthy estimate.

    Examples
    --------
    >>> coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    >>> turns = fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})
    >>> fmuid.diagnose(test.experiment, fmuid.identify(coil.problem()), {"turns": turns}, coil.fmu)
    Diagnosis(fault: turns)
    """
    if not hypotheses:
        raise InputError("there is no fault to look for: give at least one fault model with its parameters")
    listed = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    work = _DiagnosisRunner(listed, Baseline.of(baseline), settings or DiagnosisSettings())
    models: list[str | None] = [None, *hypotheses]

    def tell(fault: str | None) -> None:
        if progress is not None:
            progress(FaultStep(share=models.index(fault) / len(models), fault=fault))

    tell(None)
    system = System.of(nominal_model)
    nominal = work.fit_nominal(system)
    found = []
    for name, fault in hypotheses.items():
        tell(name)
        try:
            found.append(work.fit_fault(name, fault, nominal))
        except InputError as error:
            raise InputError(f"fault {name!r}: {error}") from None
    return work.decided(nominal, found, work.beside(system, hypotheses) if work.baseline.beside else None)


class _DiagnosisRunner:
    """What all hypotheses share: the record, the common mode, the noise."""

    def __init__(self, experiments: list[Experiment], baseline: Baseline, settings: DiagnosisSettings) -> None:
        self.baseline, self.experiments, self.common, self.held = (
            baseline,
            experiments,
            baseline.common,
            baseline.values,
        )
        self.settings, self.level = settings, settings.level
        outputs = tuple(dict.fromkeys(name for each in experiments for name in each.output_names))
        self.freedom, self.variance = baseline.freedom, baseline.variance(outputs)
        self.refinement = baseline.refinement

    def fit_nominal(self, model: System) -> tuple[Result, PriorDataComparison]:
        """Fit the healthy machine."""
        problem = self._problem(model, self.experiments, self.common, self.variance, self.held)
        problem.simulate_by(self.refinement)  # that of the healthy record, whose estimates are the prior
        # a fault that is not in the model leaves a residual: no reason to search elsewhere
        result = identify(problem, self.settings.search, accuracy=self.settings.accuracy, remedies=False)
        return result, compare_prior_and_data(problem, result)

    def fit_fault(self, name: str, fault: Fault, nominal: tuple[Result, PriorDataComparison]) -> FaultHypothesis:
        """Fit a fault model without and with its fault."""
        names = fault.names
        everywhere = {*self.common, *(n for each in self.experiments for n in (*each.input_names, *each.output_names))}
        for given in names:
            if given not in everywhere:
                raise InputError(f"names has {given!r}, which is no parameter, input or output of the healthy machine")
        system = System.of(fault.model)
        experiments = [fault.renamed(each) for each in self.experiments]
        common = {names.get(each, each): parameter for each, parameter in self.common.items()}
        fault.check_beside(common)
        variance = {names.get(each, each): value for each, value in self.variance.items()}
        without = self._problem(system, experiments, common, variance, {**fault.values, **fault.zero})
        problem = self._problem(system, experiments, common | fault.searched, variance, fault.values)
        healthy, best = fit_both(
            without,
            problem,
            _started(without, nominal[0], names),
            lambda healthy: _starts(problem, healthy, fault),
            self.settings.search,
            self.settings.accuracy,
        )
        reading, freedom = compare_prior_and_data(problem, best), _freedom(best, fault, self.freedom)
        return _hypothesis(name, fault, system, (healthy, best), nominal[0].criterion, reading, freedom)

    def beside(self, system: System, faults: Mapping[str, Fault]) -> ChangeEvidence:
        """Say what is new beside the healthy records."""
        how = self.settings
        return compare(self.experiments, self.baseline, faults, system, how.causes, self.level, how.model_error)

    def _problem(
        self,
        system: System,
        experiments: list[Experiment],
        parameters: Mapping[str, Parameter],
        variance: Mapping[str, float],
        values: Mapping[str, float | int | bool | str],
    ) -> Problem:
        return Problem(
            system, experiments, parameters, noise=Noise(variance), values=values, sensitivity=self.settings.sensitivity
        )

    def decided(
        self,
        nominal: tuple[Result, PriorDataComparison],
        found: Sequence[FaultHypothesis],
        evidence: ChangeEvidence | None,
    ) -> Diagnosis:
        """Compare the hypotheses and say what it is; with healthy records by the evidence of all causes."""
        adjusted = at_least_one([each.probability for each in found])
        share = self.level / len(found)
        thresholds = [each.reference.threshold(share) for each in found]
        called = [
            i
            for i, (each, p) in enumerate(zip(found, adjusted, strict=True))
            if p <= self.level and each.ended and each.determined
        ]
        # all with one and the same scale: that of the residual of the best model
        scale = min(each.colour for each in found) ** 2
        samples = int(sum(each.counted.sum() for each in self.experiments))
        information = [each.active * math.log(samples) - each.statistic * each.colour**2 / scale for each in found]
        best = [called[i] for i in rivals([information[i] for i in called])] if called else []
        result = nominal[0]
        return Diagnosis(
            level=self.level,
            hypotheses=tuple(
                each.judged(p, threshold, bic)
                for each, p, threshold, bic in zip(found, adjusted, thresholds, information, strict=True)
            ),
            called=tuple(found[i].name for i in called),
            named=tuple(found[i].name for i in best) if evidence is None else evidence.faults,
            unexplained=self._unexplained(nominal[1].variances, found[best[0]].variances if best else None)
            if evidence is None
            else self._owed(evidence),
            samples=samples,
            noise_variance=self.variance,
            nominal={
                n: (v, s) for n, v, s in zip(result.names, result.values.tolist(), result.std.tolist(), strict=True)
            },
            ended=_ended(result),
            strain=found[best[0]].strain if best else _strain(nominal[1]),
            version=__version__,
            result=result,
            checked=FitSolverCheck.of(result),
            evidence=evidence,
        )

    def _unexplained(
        self, without: Sequence[VarianceTest], with_: Sequence[VarianceTest] | None
    ) -> ResidualVarianceTest:
        """Test whether the residual is larger than the noise; the last test is that of all outputs together."""
        test = (without if with_ is None else with_)[-1]
        return self._larger(test.ratio, without[-1].ratio, round(test.degrees_of_freedom), alarm=with_ is not None)

    def _owed(self, evidence: ChangeEvidence) -> ResidualVarianceTest:
        """Say whether what the residual owes to the inputs has changed from the healthy records on."""
        p = evidence.remainder.probability
        return ResidualVarianceTest(evidence.ratio, p, p < UNEXPLAINED_SHARE * self.level, evidence.explained)

    def _larger(self, ratio: float, before: float, samples: int, *, alarm: bool) -> ResidualVarianceTest:
        # both variances are estimates: their ratio is F
        exact = math.isinf(self.freedom)
        tail = special.chdtrc(samples, samples * ratio) if exact else special.fdtrc(samples, self.freedom, ratio)
        larger = ratio > SAME_VARIANCE_RATIO and float(tail) < UNEXPLAINED_SHARE * self.level
        explained = (before - ratio) / (before - 1.0) if alarm and before > 1.0 else 0.0
        return ResidualVarianceTest(ratio, float(tail), bool(larger), float(np.clip(explained, 0.0, 1.0)))


# --- one hypothesis ---------------------------------------------------------------------


def _started(problem: Problem, nominal: Result, names: Mapping[str, str]) -> np.ndarray:
    """Return the nominal estimate as a start of another model (N,)."""
    own = {_renamed(name, names): value for name, value in zip(nominal.names, nominal.values.tolist(), strict=True)}
    return np.array([own[name] for name in problem.parameters.names])


def _renamed(name: str, names: Mapping[str, str]) -> str:
    """Return the other model's name of a parameter, also of one that is there once an experiment."""
    variable, bracket, experiment = name.rpartition("[") if of_one_experiment(name) else (name, "", "")
    return names.get(variable, variable) + bracket + experiment


def _starts(problem: Problem, healthy: Result, fault: Fault) -> list[np.ndarray]:
    """Return the starts of the search (N,): the common mode as it fits without the fault."""
    common = dict(zip(healthy.names, healthy.values.tolist(), strict=True))
    return [np.array([(common | own)[name] for name in problem.parameters.names]) for own in fault.starts()]


def _ended(result: Result) -> bool:
    """Whether a search has ended where nothing more is to be gained, whatever it determines."""
    return result.converged or result.outcome in (TerminationReason.UNDETERMINED, TerminationReason.RUNAWAY)


def _colour(result: Result, fault: Fault) -> float:
    """Return by how much the residual's colour widens the scatter of the fault parameters, at most."""
    return math.sqrt(result.test_scale(list(fault.parameters)))


def _freedom(result: Result, fault: Fault, freedom: float) -> float:
    """Return the degrees of freedom of a test: what the noise variances leave, and their colour, scatter alike."""
    inverse = 1.0 / freedom + 1.0 / result.test_freedom(list(fault.parameters))
    return 1.0 / inverse if inverse > 0.0 else math.inf


def _hypothesis(
    name: str,
    fault: Fault,
    system: System,
    fits: tuple[Result, Result],
    nominal_criterion: float,
    reading: PriorDataComparison,
    freedom: float,
) -> FaultHypothesis:
    without, best = fits
    colour = _colour(best, fault)
    statistic = max(without.criterion - best.criterion, 0.0) / colour**2
    reference = _reference(fault, best, freedom)
    probability = reference.probability(statistic)
    sizes = tuple(_size(each, fault, best, system.unit(each) or "", freedom, probability) for each in fault.sizes)
    off_bound = [each for each in sizes if each.value != 0.0 or each.name not in fault.constrained]
    return FaultHypothesis(
        name=name,
        sizes=sizes,
        common={
            n: (v, s)
            for n, v, s in zip(best.names, best.values.tolist(), best.std.tolist(), strict=True)
            if n not in fault.parameters
        },
        statistic=statistic,
        reference=reference,
        probability=probability,
        colour=colour,
        active=max(1, len(off_bound) + sum(each.name in fault.located for each in off_bound)),
        criterion=best.criterion,
        ended=_ended(best) and _ended(without),
        undetermined=best.undetermined if any(not math.isfinite(each.std) for each in sizes) else (),
        prior_determined=best.prior_determined,
        mismatch=without.criterion - nominal_criterion,
        outcome=best.outcome,
        strain=_strain(reading),
        variances=reading.variances,
        result=best,
        checked=FitSolverCheck.of(best),
    )


def _reference(fault: Fault, result: Result, freedom: float) -> NullDistribution:
    """Return the distribution of D without fault; directions that nothing determines are no part of it."""
    constrained = [result.names.index(name) for name in fault.constrained]
    kept = [i for i in constrained if math.isfinite(result.std[i])]
    free = len(fault.sizes) - len(constrained) + len(fault.located)
    try:
        weights = orthant_weights(result.covariance[np.ix_(kept, kept)])
    except InputError:  # all but the same parameter several times: χ² of all of them is an upper limit
        weights = (*(0.0,) * len(kept), 1.0)
    return NullDistribution(free, weights, freedom)


def _size(name: str, fault: Fault, result: Result, unit: str, freedom: float, probability: float) -> FaultSize:
    """Return a size with the probability that it is as far from zero by chance; an only one has that of D."""
    value, std = result[name], float(result.std[result.names.index(name)])
    if len(fault.sizes) > 1:
        ratio = (value / std) ** 2 if 0.0 < std < math.inf else 0.0
        alone = (
            NullDistribution(0, (0.5, 0.5), freedom)
            if name in fault.constrained
            else NullDistribution(1, freedom=freedom)
        )
        probability = (NullDistribution(2, freedom=freedom) if name in fault.located else alone).probability(ratio)
    low, high = fault.parameters[name].min, fault.parameters[name].max
    located = fault.located.get(name)
    angle = fault.angle(located) if located else None
    if located is None or angle is None:
        return FaultSize(name, value, std, unit, probability, low, high)
    at = result[located] % angle.period
    std_there = float(result.std[result.names.index(located)])
    return FaultSize(name, value, std, unit, probability, low, high, located, at, std_there, angle.period)


def _strain(reading: PriorDataComparison) -> BaselineDeviation | None:
    """Return the nominal parameter that has left what was foreseen, the one that has most."""
    agreement = reading.agreement
    if agreement is None or agreement.probability >= SIGNIFICANCE_LEVEL:
        return None
    conflict = np.abs(np.nan_to_num(reading.conflict))
    i = int(np.argmax(conflict))
    return BaselineDeviation(reading.names[i], float(conflict[i])) if conflict[i] else None
