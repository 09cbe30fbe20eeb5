"""Design of the test: the smallest fault that an excitation shows, and which excitation shows the smallest.

From the sensitivities of the healthy machine follows, before anything is measured, the information on each cause beside
all that may change and beside the errors of the healthy record (`fmuid.diagnosis.change_detection`). A fault f makes D
noncentral χ² with noncentrality (f/σ_f)²; for one parameter of either sign it is found with probability 1 − β at
f = (z_{1−α/2} + z_{1−β}) σ_f, and with z_{1−α} where it has one sign only (S. M. Kay, "Fundamentals of Statistical
Signal Processing, volume II: Detection Theory", 1998, chapter 6). With several causes α is what the smallest of their
probabilities falls below by chance. The angle between two signatures says from which size on they can be told apart.
"""

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
from fmuid.diagnosis.cause_ranking import MODEL_ERROR, angle, distinguishable_size
from fmuid.diagnosis.causes import Cause, CauseKind, Causes
from fmuid.diagnosis.change_detection import FALSE_ALARM_LEVEL, MinPDistribution, detectable
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.information_matrix import (
    ChangePrior,
    InformationMatrix,
    ScoreStatistics,
    is_determined,
)
from fmuid.errors import InputError
from fmuid.estimation import Result, check_level
from fmuid.models import FMU, System

# Of no alarm where there is a fault of the size, unless said otherwise: the size is found nineteen times of twenty.
MISS_PROBABILITY = 0.05
# An endless healthy record is so many times as long as the new one.
FOREVER = 1e4


@dataclass(frozen=True)
class MinimumDetectableFault:
    """The smallest size of a fault that is found.

    Attributes
    ----------
    fault, name : str
        The hypothesis, and its parameter.
    value : float
        Found with the probability asked for; infinite where the excitation does not determine the fault.
    std : float
        Of its estimate.
    unit : str
        "" without.
    share : float
        Of the variance, what the healthy record's errors make: a longer test does not lower it.
    rival : str
        The other cause whose signature is nearest, "" without.
    rival_angle : float
        Between the two signatures, rad; NaN without.
    apart : float
        The size from which on every other cause is excluded, 20 : 1 in 90 % of records; infinite where it never is.
    """

    fault: str
    name: str
    value: float
    std: float
    unit: str
    share: float
    rival: str = ""
    rival_angle: float = math.nan
    apart: float = math.nan


class Design:
    """Faults, a healthy machine and the rates asked for: what is the smallest fault that an excitation shows.

    Parameters
    ----------
    faults : mapping of str to Fault
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    model : System, FMU or path
        The healthy machine.
    causes : Causes, optional
        Beside the faults, where the baseline has records or `healthy` is asked for.
    false_alarm : float
        Probability of an alarm where nothing is new.
    miss : float
        Probability of none with a fault, below one half.
    model_error : float
        κ, as for `fmuid.DiagnosisSettings`.

    Raises
    ------
    InputError
        If there is no fault, a rate is out of its range or the healthy result does not fit the model.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> fault = fmuid.Fault(fmuid.datasets.faulty_coil().fmu, {"dR": fmuid.Parameter(0.0, nominal=1.0)})
    >>> design = fmuid.Design({"turns": fault}, fmuid.identify(coil.problem()), coil.fmu)
    >>> long = fmuid.planned_experiment(fmuid.prbs(2.0, 1e-3, 12.0, bit=8), ["u"], ["i"])
    >>> short = fmuid.planned_experiment(fmuid.step_sequence(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
    >>> design.rank({"short": short, "long": long})["excitation"].tolist()
    ['long', 'short']
    """

    def __init__(
        self,
        faults: Mapping[str, Fault],
        baseline: Baseline | Result | str | Path,
        model: System | FMU | str | Path,
        causes: Causes | None = None,
        *,
        false_alarm: float = FALSE_ALARM_LEVEL,
        miss: float = MISS_PROBABILITY,
        model_error: float = MODEL_ERROR,
    ) -> None:
        check_level(false_alarm, "a test")
        if not 0 < miss < 0.5:
            raise InputError(f"the rate of misses must be above 0 and below 0.5, not {miss!r}")
        if not faults:
            raise InputError("there is no fault to look for: give at least one fault model with its parameters")
        self.faults, self.baseline, self.system = dict(faults), Baseline.of(baseline), System.of(model)
        self.causes, self.model_error = causes or Causes(), model_error
        self.false_alarm, self.miss = false_alarm, miss

    @single_threaded
    def detectable(self, excitation: Experiment, healthy: float | None = None) -> tuple[MinimumDetectableFault, ...]:
        """Return the smallest detectable value of each size.

        Parameters
        ----------
        excitation : Experiment
            A record, or an excitation that is still to be applied (`trial`), with the healthy machine's names.
        healthy : float, optional
            The healthy record is so many times as long as this one, with the same excitation, and all causes are
            looked at; infinite: nothing of the healthy machine is uncertain but what drifts. Default: what the
            baseline has.

        Raises
        ------
        InputError
            If the excitation does not have the model's inputs.
        SimulationError
            If the simulation of the healthy machine fails.
        """
        planned = healthy is not None
        made = BaselineComparator.of(
            self.system, self.baseline, self.faults, self.causes, [excitation], planned=planned, fewer=True
        )
        _, columns = made.machine(excitation).linearise(made.coordinates.healthy)
        white = made.healthy.whitening(excitation, columns)
        said = InformationMatrix.of(white, np.zeros(len(white)))
        known = made.healthy.known
        if healthy is not None:
            longer = min(healthy, FOREVER)
            known = ChangePrior.after(
                InformationMatrix(longer * said.matrix, longer * said.score), made.coordinates.normal
            )
        sharp = ScoreStatistics.of(
            said, ChangePrior(0.0 * known.mean, 0.0 * known.covariance).drifting(made.healthy.drift)
        )
        news = ScoreStatistics.of(said, known.drifting(made.healthy.drift))
        causes, kappa = made.coordinates.causes, made.model_error(self.model_error, self.false_alarm)
        limit = self.false_alarm if len(causes) == 1 else MinPDistribution.of(news, causes).limit(self.false_alarm)
        found = []
        for cause in causes:
            of = made.coordinates.each[cause.columns[0]]
            if of.kind is CauseKind.FAULT:
                size = self._size(news, sharp, said, cause, causes, limit, kappa)
                found.append(MinimumDetectableFault(of.fault, of.variable, size[0], size[1], of.unit, *size[2:]))
        return tuple(found)

    def _size(
        self,
        news: ScoreStatistics,
        sharp: ScoreStatistics,
        said: InformationMatrix,
        cause: Cause,
        causes: Sequence[Cause],
        limit: float,
        kappa: float,
    ) -> tuple[float, float, float, str, float, float]:
        """Return value, std, share, rival, its angle and the size that is told apart, of one fault."""
        least = [float(np.linalg.eigvalsh(each.part(cause.columns)[0])[0]) for each in (news, sharp)]
        if not is_determined(news, said, cause.columns):
            return math.inf, math.inf, math.nan, "", math.nan, math.inf
        value, std = detectable(news, cause, limit, self.miss), least[0] ** -0.5
        share = 1.0 - least[0] / least[1]
        others = [each for each in causes if each is not cause and is_determined(news, said, each.columns)]
        if not others:
            return value, std, share, "", math.nan, value
        angles = [angle(news, cause, other) for other in others]
        near = int(np.argmin(angles))
        apart = max(distinguishable_size(news, cause, other, kappa) for other in others)
        return value, std, share, others[near].name, angles[near], max(apart, value)

    def cost(self, excitation: Experiment, healthy: Sequence[float] = (1.0, 3.0, 10.0, 100.0)) -> pd.DataFrame:
        """Return what a healthy record of some length costs: the detectable sizes against those of an endless one.

        Parameters
        ----------
        excitation : Experiment
        healthy : sequence of float
            Lengths of the healthy record, in lengths of the new one.

        Returns
        -------
        pandas.DataFrame
            ``healthy``, and for each size its smallest detectable value and ``.times`` that with an endless one.
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
            ``excitation``, ``duration`` (s), for each size its smallest detectable value, ``.std``, the cause whose
            signature is nearest (``.rival``) with its ``.angle`` (°), the size from which on it is told from all others
            (``.apart``), and ``worst``: the largest of the detectable values over the magnitudes (nominal) of the
            parameters, by which they are ordered.

        Raises
        ------
        InputError
            If there are no candidates, or one does not have the model's inputs.
        SimulationError
            If the simulation of the healthy machine fails.
        """
        if not candidates:
            raise InputError("there is no excitation to compare: give at least one")
        rows = []
        for name, excitation in candidates.items():
            row: dict[str, object] = {
                "excitation": name,
                "duration": float(excitation.times[-1] - excitation.times[0]),
            }
            worst = 0.0
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
    time: str = "time",
    interpolation: str | Mapping[str, str] = "zoh",
    discard: float = 0.0,
    name: str = "trial",
) -> Experiment:
    """Return an experiment that has not been made yet, from its excitation (`fmuid.data.signals`).

    Parameters
    ----------
    frame : pandas.DataFrame
        The time, s, and the inputs.
    inputs, outputs, time, interpolation, discard, name
        As for `fmuid.Experiment`; every output counts at every time after `discard`.

    Examples
    --------
    >>> fmuid.planned_experiment(fmuid.step_sequence(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
    Experiment('trial', 200 samples, 0 to 0.199 s, u → i)
    """
    return Experiment(
        frame,
        inputs,
        outputs,
        time=time,
        interpolation=interpolation,
        discard=discard,
        measured=False,
        name=name,
        source=name,
    )
