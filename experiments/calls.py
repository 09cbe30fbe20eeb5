"""False, missed and wrong calls, counted: many records of one machine, compared with healthy ones of their own.

A campaign simulates nothing twice: what a machine says of its coordinates is linearized once where the estimates of
many records come near each other (`Shared`), by the rule by which monitoring takes a linear model for good enough. Each
record has its own noise, its own model of it, its own healthy record and its own decision, all by `fmuid.diagnosis`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, cast

import numpy as np
import pandas as pd
from scipy import special
from scipy.signal import lfilter

import fmuid
from experiments import pages
from fmuid.array_types import Floats
from fmuid.diagnosis import Alarm, OnsetShape
from fmuid.diagnosis.baseline_comparator import learn_baseline
from fmuid.diagnosis.baseline_statistics import BaselineStatistics
from fmuid.diagnosis.cause_analysis import Examination, examine
from fmuid.diagnosis.cause_ranking import CauseSet
from fmuid.diagnosis.causes import CauseKind, ChangeParameterSet
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL

LEVEL, SEED = 0.01, 17
FALSE, FAULTY = 400, 200  # records of a case without and with a fault
# Samples in which colored noise becomes stationary, at least, and so many of its time constants.
SETTLING, CONSTANTS = 60, 4.0
# A point is near one where the machine is linearized: standard deviations away times relative change of a coordinate.
NEAR = 0.3


class Linearised(Protocol):
    """What can be linearized: a machine over a record."""

    experiment: fmuid.Experiment

    def linearize(self, point: Floats) -> tuple[Floats, Floats]:
        """Return the outputs (K, n_outputs) at a point (N,), and their derivatives (K, n_outputs, N)."""

    def in_axes(self, outputs: Floats, /) -> Floats:
        """Return outputs of the model behind those of sensors."""

    def sensed(self, slopes: Floats, /) -> Floats:
        """Return the slopes of sensors by those of the model."""


class Shared:
    """A machine that is linearized once for all records of one excitation."""

    def __init__(self, machine: Linearised, coordinates: ChangeParameterSet, noise: float) -> None:
        self.experiment, self._machine, self._noise = machine.experiment, machine, noise
        self.coordinates = coordinates
        self._anchors: list[tuple[Floats, Floats, Floats, Floats]] = []
        self._magnitude = coordinates.magnitude

    def over(self, experiment: fmuid.Experiment) -> LinearizedMachine:
        """Return the same over another record with the same inputs."""
        other = copy(self)
        other.experiment = experiment
        return cast(LinearizedMachine, other)  # all of it that an examination asks for

    def linearize(self, point: Floats) -> tuple[Floats, Floats]:
        """Return outputs and derivatives, to first order from the nearest point where they are known."""
        near = [(self._distance(point, each), k) for k, each in enumerate(self._anchors)]
        if not near or min(near)[0] > NEAR:
            outputs, columns = self._machine.linearize(point)
            flat = columns.reshape(-1, columns.shape[-1]) / self._noise
            self._anchors.append((point.copy(), outputs, columns, flat.T @ flat))
            return outputs, columns
        anchor, outputs, columns, _ = self._anchors[min(near)[1]]
        return outputs + columns @ (point - anchor), columns

    def outputs(self, point: Floats) -> Floats:
        """Return the outputs alone."""
        return self.linearize(point)[0]

    def in_axes(self, outputs: Floats) -> Floats:
        """Return outputs of the model behind those of sensors."""
        return self._machine.in_axes(outputs)

    def sensed(self, slopes: Floats) -> Floats:
        """Return the slopes of sensors by those of the model."""
        return self._machine.sensed(slopes)

    def _distance(self, point: Floats, anchor: tuple[Floats, Floats, Floats, Floats]) -> float:
        off = point - anchor[0]
        return float(np.max(np.abs(off) / self._magnitude)) * math.sqrt(max(0.0, float(off @ anchor[3] @ off)))


class Setting(NamedTuple):
    """What the records of a campaign have in common."""

    coordinates: ChangeParameterSet
    drift: Floats
    """Standard deviation of what may change without being a fault (N,)."""
    noise: float
    machine: Callable[[str, bool], Linearised]
    """Of a case, over its healthy or its new record without noise."""
    records: Callable[[str, np.random.Generator], tuple[fmuid.Experiment, fmuid.Experiment]]
    """A healthy and a new record of a case without noise, with the inputs of these."""
    truth: Callable[[str], dict[str, float]]
    """Causes that are new in a case, and their sizes; NaN of those that have none in the fitted models."""
    colour: Callable[[str], float]
    """The noise's correlation from sample to sample."""
    share: Callable[[str], float] = lambda _: 1.0
    """Which share of the noise's variance has it; the rest is white."""


def noise(rng: np.random.Generator, shape: tuple[int, int], std: float, colour: float, share: float = 1.0) -> Floats:
    """Return noise (n, outputs) of an autoregression of order 1, or white noise with a share of it."""
    settling = max(SETTLING, math.ceil(-CONSTANTS / math.log(colour))) if colour else SETTLING
    white = std * math.sqrt(1.0 - colour**2) * rng.standard_normal((shape[0] + settling, shape[1]))
    colored = np.asarray(lfilter([1.0], [1.0, -colour], white, axis=0)[settling:])
    if share == 1.0:
        return colored
    return np.asarray(math.sqrt(share) * colored + math.sqrt(1.0 - share) * std * rng.standard_normal(shape))


def noisy(
    clean: fmuid.Experiment, rng: np.random.Generator, std: float, colour: float, share: float = 1.0
) -> fmuid.Experiment:
    """Return a record with noise on its outputs."""
    seen = clean.output_values + noise(rng, clean.output_values.shape, std, colour, share)
    frame = clean.frame.copy()
    frame[list(clean.output_names)] = seen
    return fmuid.Experiment(frame, clean.inputs, clean.outputs, interpolation=clean.interpolation)


class Campaign:
    """Records of some cases, examined one after the other; a file keeps what is done."""

    def __init__(self, setting: Setting, file: Path) -> None:
        self.setting, self.file = setting, file
        self._shared: dict[tuple[str, int], Shared] = {}

    def run(self, cases: Iterable[str], keys: Mapping[str, int], counts: Mapping[str, int]) -> pd.DataFrame:
        """Examine what is missing of some cases and return all rows."""
        for case in cases:
            row = partial(self.row, case, keys[case])
            pages.continued(self.file, ("case", case), "record", range(counts[case]), row)
            self._shared.clear()
        return pd.read_csv(self.file, keep_default_na=False)

    def row(self, case: str, key: int, record: int) -> dict[str, str | float]:
        """Return what is said of one record of a case."""
        rng = np.random.default_rng([SEED, key, record])
        return {"case": case, "record": record, **self._said(case, self.examined(case, rng))}

    def examined(self, case: str, rng: np.random.Generator) -> Examination:
        """Return the examination of a fresh record of a case beside a fresh healthy one."""
        setting = self.setting
        colour, share = setting.colour(case), setting.share(case)
        healthy, new = (
            self._of(case, at).over(noisy(clean, rng, setting.noise, colour, share))
            for at, clean in enumerate(setting.records(case, rng))
        )
        known = BaselineStatistics.of(
            learn_baseline([healthy], setting.coordinates), setting.coordinates, setting.drift
        )
        return examine([new], known, setting.coordinates, LEVEL)

    def _of(self, case: str, new: int) -> Shared:
        if (case, new) not in self._shared:
            setting = self.setting
            self._shared[case, new] = Shared(setting.machine(case, bool(new)), setting.coordinates, setting.noise)
        return self._shared[case, new]

    def _said(self, case: str, found: Examination) -> dict[str, str | float]:
        naming, truth = found.naming, self.setting.truth(case)
        right = next((each for each in naming.named if set(each.names) == set(truth)), None)
        kinds = {each.name: each.kind for each in found.coordinates.each}
        faults = [kinds[name] is CauseKind.FAULT for each in naming.named for name in each.names]
        return {
            "alarm": int(naming.alarm),
            "else": int(found.evidence.remainder.probability < UNEXPLAINED_RESIDUAL.structure_share * LEVEL),
            "remainder": found.evidence.remainder.probability,
            "named": " or ".join(" + ".join(each.names) for each in naming.named),
            "fault": int(bool(faults) and all(faults)),
            "D": max(each.statistic for each in found.evidence.suspects),
            "off": " ".join(f"{each:.4g}" for each in _off(right, truth)) if right is not None else "",
        }


def _off(named: CauseSet, truth: Mapping[str, float]) -> Iterator[float]:
    """Yield by how many standard deviations sizes are off; a vector of the plane is judged by its length."""
    first = 0
    for cause in named.causes:
        at = slice(first, first + len(cause.columns))
        size, covariance = named.fit.sizes[at], named.fit.covariance[at, at]
        along = size / np.linalg.norm(size) if len(size) > 1 else np.ones(1)
        yield float((along @ size - truth[cause.name]) / np.sqrt(along @ covariance @ along))
        first = at.stop


def onset(
    monitor: fmuid.Monitor, begin: float, shape: OnsetShape, size: float, right: Callable[[Alarm], bool]
) -> dict[str, float]:
    """Return the last dated alarm of a monitoring beside the truth: time (s), shape and size; empty without one."""
    alarms = [each for each in monitor.alarms if each.onset is not None]
    if not alarms:
        return {}
    alarm, found = alarms[-1], alarms[-1].onset
    assert found is not None  # those without are left out
    change = alarm.explanations[0].changes[0]
    return {
        "D": float(monitor.table["statistic"].iloc[-1]),
        "right": int(right(alarm)),
        "late": alarms[0].time - begin,
        "off": abs(found.likely.time - begin),
        "held": int(found.first.time - 1e-9 <= begin <= found.last.time + 1e-9),
        "width": found.last.time - found.first.time,
        "shape": int(found.shape is shape),
        "scaled": (change.value - size) / change.std if change.fault else math.nan,
    }


# --- tables


def dated(part: pd.DataFrame) -> list[str]:
    """Return the cells of onsets: rate of sets that hold it, their width, rate of shapes, error of the size."""
    error = math.sqrt(float((part["scaled"] ** 2).mean()))
    cells = [rate(part["held"] == 1), f"{part['width'].median():.2f}", rate(part["shape"] == 1)]
    return [*cells, f"{error:.2f}" if math.isfinite(error) else ""]


def interval(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate by Clopper and Pearson, in percent."""
    low = float(special.betaincinv(count, total - count + 1, 0.025)) if count else 0.0
    high = float(special.betaincinv(count + 1, total - count, 0.975)) if count < total else 1.0
    return 100.0 * low, 100.0 * high


def rate(flags: Sequence[bool] | pd.Series) -> str:
    """Return a rate in percent, with its interval unless it is 0 or 100."""
    count, total = int(np.sum(np.asarray(flags, dtype=bool))), len(flags)
    if count in (0, total):
        return "" if not total else "100" if count else "0"
    low, high = interval(count, total)
    return f"{100.0 * count / total:.1f} ({low:.1f}–{high:.1f})"


def false_table(found: pd.DataFrame, cases: Sequence[str]) -> str:
    """Return the rates of false calls of cases in which nothing is new, as Markdown."""
    parts = {case: found[found["case"] == case] for case in cases}
    rows = [(case, rate(part["alarm"]), rate(part["else"])) for case, part in parts.items() if len(part)]
    return pages.table(["nothing new", "false calls (%)", "“something else” (%)"], rows)


def named_table(found: pd.DataFrame, cases: Mapping[str, Sequence[str]]) -> str:
    """Return what is named in cases with the causes that are right, as Markdown."""
    rows = []
    for case, right in cases.items():
        part, truth = found[found["case"] == case], set(right)
        if part.empty:
            continue
        sets = [[set(one.split(" + ")) for one in str(each).split(" or ")] if each else [] for each in part["named"]]
        off = [float(z) for each in part["off"] for z in str(each).split()]
        cells = [case, rate(part["alarm"]), rate([truth in each[:1] for each in sets])]
        cells.append(rate([each == [truth] for each in sets]))
        cells.append(rate([abs(z) <= float(special.ndtri(0.975)) for z in off if math.isfinite(z)]))
        firsts = pd.Series([str(each).split(" or ")[0] or "nothing" for each in part["named"]]).value_counts()
        shares = {
            name: 100 * count / len(part)
            for name, count in firsts.head(3).items()
            if {*str(name).split(" + ")} != truth
        }
        cells.append(", ".join(f"{name} {share:.0f}" for name, share in shares.items() if share >= 1.0))
        rows.append(cells)
    return pages.table(["new", "called", "named first", "alone", "interval holds", "another first, %"], rows)
