"""Design of the test: the smallest fault that an excitation shows, and which excitation shows the smallest.

From the sensitivities of the healthy model follows the covariance (1.47) of the fault parameters beside the common
mode before anything is measured. A fault f makes D noncentral χ² with noncentrality (f/σ_f)²; for one parameter of
either sign it is found with probability 1 − β at f = (z_{1−α/2} + z_{1−β}) σ_f, and with z_{1−α} where it has one
sign only (S. M. Kay, "Fundamentals of Statistical Signal Processing, volume II: Detection Theory", 1998, chapter 6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special

from fmuid.arrays import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.decision import FALSE_ALARM_LEVEL
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.monitoring.belief import Belief
from fmuid.diagnosis.monitoring.window_fit import Extended
from fmuid.errors import InputError
from fmuid.estimation import Result, check_level

# Of no alarm where there is a fault of the size, unless said otherwise: the size is found nineteen times of twenty.
MISS_PROBABILITY = 0.05


@dataclass(frozen=True)
class Detectable:
    """The smallest size of a fault that is found.

    Attributes
    ----------
    name : str
        The fault parameter.
    value : float
        Found with the probability asked for; with bounds and several parameters an upper limit, infinite where the
        excitation does not determine the fault.
    std : float
        Of its estimate in D: the other parameters of the fault are taken to be zero.
    unit : str
        "" without.
    share : float
        Of the variance, what the healthy record's errors make: a longer test does not lower it.
    """

    name: str
    value: float
    std: float
    unit: str
    share: float


class Design:
    """A fault, a healthy machine and the rates asked for: what is the smallest fault that an excitation shows.

    Parameters
    ----------
    fault : Fault
    baseline : Baseline, Result or path
        As for `fmuid.diagnose`.
    false_alarm : float
        Probability of a significant result without a fault.
    miss : float
        Probability of none with it, below one half.

    Raises
    ------
    InputError
        If a rate is out of its range or the healthy result does not fit the model.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> fault = fmuid.Fault(fmuid.datasets.faulty_coil().fmu, {"dR": fmuid.Parameter(0.0, nominal=1.0)})
    >>> design = fmuid.Design(fault, fmuid.identify(coil.problem()))
    >>> long = fmuid.trial(fmuid.prbs(2.0, 1e-3, 12.0, bit=8), ["u"], ["i"])
    >>> short = fmuid.trial(fmuid.steps(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
    >>> design.rank({"short": short, "long": long})["excitation"].tolist()
    ['long', 'short']
    """

    def __init__(
        self,
        fault: Fault,
        baseline: Baseline | Result | str | Path,
        *,
        false_alarm: float = FALSE_ALARM_LEVEL,
        miss: float = MISS_PROBABILITY,
    ) -> None:
        check_level(false_alarm, "a test")
        if not 0 < miss < 0.5:
            raise InputError(f"the rate of misses must be above 0 and below 0.5, not {miss!r}")
        healthy = Baseline.of(baseline)
        self.model = Extended(
            "the fault", fault, healthy.common, healthy.variances, healthy.freedom, healthy.refinement
        )
        self.false_alarm, self.miss = false_alarm, miss

    def detectable(self, excitation: Experiment) -> tuple[Detectable, ...]:
        """Return the smallest detectable value of each size.

        Parameters
        ----------
        excitation : Experiment
            A record, or an excitation that is still to be applied (`trial`), with the healthy machine's names.

        Raises
        ------
        InputError
            If the excitation does not have the model's inputs.
        SimulationError
            If the simulation of the healthy machine fails.
        """
        model = self.model
        simulator = model.simulator(model.fault.renamed(excitation))
        _, slopes = model.linearise(simulator, model.prior.mean)
        scatter = slopes.T @ slopes
        information = model.prior.information + scatter
        sizes = [(name, model.system.unit(name) or "") for name in model.fault.sizes]
        if not model.determined(information):
            return tuple(Detectable(name, math.inf, math.inf, unit, math.nan) for name, unit in sizes)
        whole = model.covariance(Belief(model.prior.mean, information, scatter))
        inverse = np.linalg.inv(information)
        by_prior = (inverse @ model.prior.information @ inverse)[model.first :, model.first :]
        own = whole[model.first :, model.first :]
        need = self._need(own)
        precision = np.linalg.inv(own)
        place = {name: i for i, name in enumerate(model.fault.parameters)}
        found = []
        for name, unit in sizes:
            pair = [place[name]] + ([place[model.fault.located[name]]] if name in model.fault.located else [])
            # a fault that an angle locates: the direction that shows least
            std = float(np.linalg.eigvalsh(precision[np.ix_(pair, pair)])[0]) ** -0.5
            share = float(by_prior[pair[0], pair[0]] / own[pair[0], pair[0]])
            found.append(Detectable(name, need * std, std, unit, share))
        return tuple(found)

    def _need(self, covariance: Floats) -> float:
        """Return how many standard deviations a fault must have."""
        reference = self.model.reference(covariance, self.model.freedom)
        threshold = reference.threshold(self.false_alarm)
        if len(reference.weights) == 1:
            return math.sqrt(float(special.chndtrinc(threshold, reference.free, self.miss)))
        # D is at least the square of any one component
        return math.sqrt(threshold) - float(special.ndtri(self.miss))

    def rank(self, candidates: Mapping[str, Experiment]) -> pd.DataFrame:
        """Compare excitations: one row each, the best first.

        Returns
        -------
        pandas.DataFrame
            ``excitation``, ``duration`` (s), for each size its smallest detectable value and ``.std``, and ``worst``:
            the largest of these values over the magnitudes (nominal) of the parameters, by which they are ordered.

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
                worst = max(worst, each.value / (self.model.fault.parameters[each.name].nominal or 1.0))
            rows.append(row | {"worst": worst})
        return pd.DataFrame(rows).sort_values("worst", kind="stable", ignore_index=True)


def trial(
    frame: pd.DataFrame,
    inputs: Sequence[str] | Mapping[str, str],
    outputs: Sequence[str] | Mapping[str, str],
    *,
    time: str = "time",
    interpolation: str | Mapping[str, str] = "hold",
    discard: float = 0.0,
    name: str = "trial",
) -> Experiment:
    """Return an experiment that has not been made yet, from its excitation (`fmuid.data.excitation`).

    Parameters
    ----------
    frame : pandas.DataFrame
        The time, s, and the inputs.
    inputs, outputs, time, interpolation, discard, name
        As for `fmuid.Experiment`; every output counts at every time after `discard`.

    Examples
    --------
    >>> fmuid.trial(fmuid.steps(0.2, 1e-3, [0.0, 12.0]), ["u"], ["i"])
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
