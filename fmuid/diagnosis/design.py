"""Design of a test: minimum detectable fault sizes of excitations (docs/method/design.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.cause_ranking import distinguishable_size, nearest_cause
from fmuid.diagnosis.causes import CauseKind
from fmuid.diagnosis.change_detection import MinPDistribution, detectable
from fmuid.diagnosis.diagnose import DiagnosisSettings
from fmuid.diagnosis.faults import Fault, checked_faults
from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics, is_determined
from fmuid.diagnosis.rule import MISS_PROBABILITY
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.models import FMU, System


@dataclass(frozen=True)
class MinimumDetectableFault:
    """Minimum detectable size of a fault."""

    fault: str
    name: str  # of its parameter
    value: float  # infinite where the excitation does not determine the fault
    std: float  # of its estimate
    unit: str
    share: float  # of the variance, by the errors of the healthy record: a longer test does not lower it
    rival: str  # other cause with the nearest signature, "" without
    rival_angle: float  # between the two signatures, rad
    apart: float  # size from which every other cause is excluded, 20 : 1 in 90 % of records


class Design:
    """Minimum detectable faults of excitations, for a healthy machine and error rates.

    Parameters
    ----------
    faults : mapping of str to Fault
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    model : System, FMU or path
        The healthy machine.
    settings : DiagnosisSettings, optional
        Level, causes and fault-model error of the later diagnosis.
    miss : float
        Probability of no alarm with a fault, below one half.

    Raises
    ------
    InputError
        If there is no fault, a rate is out of its range or the healthy result does not fit the model.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> fault = fmuid.Fault(fmuid.datasets.faulty_coil().fmu, {"dR": fmuid.Parameter(0.0, nominal=1.0)})
    >>> design = fmuid.Design({"turns": fault}, fmuid.identify(coil.problem()), coil.fmu)
    >>> long = fmuid.diagnosis.planned_experiment(fmuid.signals.prbs(2.0, 1e-3, 12.0, bit=8), ["u"], ["i"])
    >>> short = fmuid.diagnosis.planned_experiment(fmuid.signals.step_sequence(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
    >>> design.rank({"short": short, "long": long})["excitation"].tolist()
    ['long', 'short']
    """

    def __init__(
        self,
        faults: Mapping[str, Fault],
        baseline: Baseline | Result | str | Path,
        model: System | FMU | str | Path,
        settings: DiagnosisSettings | None = None,
        *,
        miss: float = MISS_PROBABILITY,
    ) -> None:
        if not 0 < miss < 0.5:
            raise InputError(f"the missed-alarm rate must be between 0 and 0.5, not {miss!r}")
        self.faults, self.baseline, self.system = checked_faults(faults), Baseline.of(baseline), System.of(model)
        self.settings, self.miss = settings or DiagnosisSettings(), miss

    @single_threaded
    def detectable(self, excitation: Experiment, healthy: float | None = None) -> tuple[MinimumDetectableFault, ...]:
        """Return the smallest detectable value of each size.

        Parameters
        ----------
        excitation : Experiment
            An experiment or a `planned_experiment`.
        healthy : float, optional
            Length of a planned healthy experiment with the same excitation, in lengths of this one; infinite: only
            drift is uncertain. Default: the baseline's data.

        Raises
        ------
        InputError
            If the excitation does not have the model's inputs.
        SimulationError
            If the simulation of the healthy machine fails.
        """
        causes = self.settings.causes if healthy is not None or self.baseline.beside else None
        made = BaselineComparator.of(self.system, self.baseline, self.faults, causes, [excitation], fewer=True)
        _, columns = made.machine(excitation).linearize(made.coordinates.healthy)
        planned = np.concatenate([np.zeros((*columns.shape[:2], 1)), columns], axis=2)
        white = made.healthy.whitening(excitation, planned)[:, 1:]
        said = InformationMatrix.of(white, np.zeros(len(white)))
        known, drift = made.healthy.known, made.healthy.drift
        if healthy is not None:
            longer = min(healthy, 1e4)  # endless
            record = InformationMatrix(longer * said.matrix, longer * said.score)
            known = ChangePrior.after(record, made.coordinates.normal)
        sharp = ScoreStatistics.of(said, ChangePrior(0.0 * known.mean, 0.0 * known.covariance).drifting(drift))
        news = ScoreStatistics.of(said, known.drifting(drift))
        if healthy is None and made.healthy.population is not None:  # errors of the model between operating points
            news = made.healthy.population.judged(news)
        every, level = made.coordinates.causes, self.settings.level
        kappa = made.model_error(self.settings.model_error, level)
        limit = level if len(every) == 1 else MinPDistribution.of(news, every).limit(level)
        determined = [cause for cause in every if is_determined(news, said, cause.columns)]
        found = []
        for cause in every:
            of = made.coordinates.each[cause.columns[0]]
            if of.kind is not CauseKind.FAULT:
                continue
            if cause not in determined:
                unknown = math.inf, math.inf, of.unit, math.nan, "", math.nan, math.inf
                found.append(MinimumDetectableFault(of.fault, of.variable, *unknown))
                continue
            least = [float(np.linalg.eigvalsh(each.part(cause.columns)[0])[0]) for each in (news, sharp)]
            value, share = detectable(news, cause, limit, self.miss), 1.0 - least[0] / least[1]
            others = [other for other in determined if other is not cause]
            rival, near = nearest_cause(news, cause, others)
            apart = max([value, *(distinguishable_size(news, cause, other, kappa) for other in others)])
            size = value, least[0] ** -0.5, of.unit, share, rival, near, apart
            found.append(MinimumDetectableFault(of.fault, of.variable, *size))
        return tuple(found)

    def cost(self, excitation: Experiment, healthy: Sequence[float] = (1.0, 3.0, 10.0, 100.0)) -> pd.DataFrame:
        """Compare detectable sizes by the length of the healthy experiment.

        Parameters
        ----------
        excitation : Experiment
        healthy : sequence of float
            Lengths of the healthy experiment, in lengths of this one.

        Returns
        -------
        pandas.DataFrame
            ``healthy``, and for each size its smallest detectable value and ``.times``, the ratio.
        """
        endless = self.detectable(excitation, math.inf)
        rows = []
        for length in healthy:
            row = {"healthy": length}
            for each, best in zip(self.detectable(excitation, length), endless, strict=True):
                name = f"{each.fault}.{each.name}"
                row |= {name: each.value, f"{name}.times": each.value / best.value}
            rows.append(row)
        return pd.DataFrame(rows)

    def rank(self, candidates: Mapping[str, Experiment]) -> pd.DataFrame:
        """Compare excitations: one row each, the best first.

        Returns
        -------
        pandas.DataFrame
            ``excitation``, ``duration`` (s), for each size its smallest detectable value, ``.std``, the nearest other
            cause (``.rival``), its ``.angle`` (°), the size that excludes all others (``.apart``), and ``worst``: the
            largest detectable value over the parameter's magnitude.

        Raises
        ------
        InputError
            If there are no candidates, or one does not have the model's inputs.
        SimulationError
            If the simulation of the healthy machine fails.
        """
        if not candidates:
            raise InputError("no excitation given. Give at least one.")
        rows = []
        for name, excitation in candidates.items():
            duration, worst = float(excitation.times[-1] - excitation.times[0]), 0.0
            row: dict[str, object] = {"excitation": name, "duration": duration}
            for each in self.detectable(excitation):
                row |= {each.name: each.value, f"{each.name}.std": each.std}
                if each.rival:
                    row |= {f"{each.name}.rival": each.rival, f"{each.name}.angle": math.degrees(each.rival_angle)}
                    row[f"{each.name}.apart"] = each.apart
                worst = max(worst, each.value / (self.faults[each.fault].parameters[each.name].nominal or 1.0))
            rows.append(row | {"worst": worst})
        return pd.DataFrame(rows).sort_values("worst", kind="stable", ignore_index=True)


@single_threaded
def planned_experiment(
    frame: pd.DataFrame,
    inputs: Sequence[str] | Mapping[str, str],
    outputs: Sequence[str] | Mapping[str, str],
    *,
    interpolation: str | Mapping[str, str] = "zoh",
    warmup: float = 0.0,
    name: str = "trial",
) -> Experiment:
    """Return an experiment without measured outputs, of an excitation (`fmuid.data.signals`).

    Parameters
    ----------
    frame : pandas.DataFrame
        ``time`` (s) and the inputs.
    inputs, outputs, interpolation, warmup, name
        As for `fmuid.Experiment`.

    Examples
    --------
    >>> fmuid.diagnosis.planned_experiment(fmuid.signals.step_sequence(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
    Experiment('trial', 200 samples, 0 to 0.199 s, u → i)
    """
    how = {"interpolation": interpolation, "warmup": warmup, "measured": False, "name": name, "source": name}
    return Experiment(frame, inputs, outputs, **how)  # type: ignore[arg-type]
