"""A record cut into windows: what each says, and whether the simulation before it is long enough.

The machine is linearised once over many of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.information_matrix import InformationMatrix
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.onset import SETTINGS as ONSET
from fmuid.diagnosis.onset import ChangeTransient
from fmuid.diagnosis.onset_tracker import Blocks
from fmuid.diagnosis.prewhitening import Whitening
from fmuid.errors import InputError


@dataclass(frozen=True)
class WindowSettings:
    """Numbers of windows.

    Attributes
    ----------
    step_tolerance : float
        A window begins with the sample that is nearest, to this share of a sampling interval: times are rounded
        decimals.
    most_blocks : int
        An onset is dated to a block of a window: it has so many at most.
    block_samples : int
        Of a block, at least.
    transient_share : float
        Simulations from an early and from a late start agree after the transient to this share of the noise's
        deviation.
    most_compared : int
        Windows that have a start of their own.
    """

    step_tolerance: float = 1e-3
    most_blocks: int = 20
    block_samples: int = 20
    transient_share: float = 0.2
    most_compared: int = 8


SETTINGS = WindowSettings()


@dataclass(frozen=True)
class GrowingRecord:
    """A record that is cut piece by piece, as it grows.

    Attributes
    ----------
    begin : float
        Of its time, s.
    counts : float
        From when on samples count, s.
    windows : int
        Which it was cut into so far.
    grows : bool
        Whether more of it may come.
    """

    begin: float
    counts: float
    windows: int = 0
    grows: bool = False


@dataclass(frozen=True)
class Window:
    """A window of a record.

    Attributes
    ----------
    number : int
        From 0 on.
    lead, start, stop : int
        Rows where the simulation, the window and what follows it begins.
    begin, end : float
        s; `end` is where the next window begins.
    slack : float
        By which samples may lie before `begin` and belong to it, s: times are rounded decimals.
    there : bool
        Whether every output has a sample that counts.
    """

    number: int
    lead: int
    start: int
    stop: int
    begin: float
    end: float
    slack: float
    there: bool


@dataclass(frozen=True)
class SkippedWindow:
    """A window of a record in which no sample of some output counts.

    Attributes
    ----------
    source : str
        Of the record.
    time : float
        Where the window begins, s.
    """

    source: str
    time: float


def split_windows(record: Experiment, window: float | None, transient: float, begun: GrowingRecord) -> list[Window]:
    """Return the windows of a record, or the next ones of a piece of it.

    What is left at the end of the record and shorter than a window is in none.

    Parameters
    ----------
    record : Experiment
    window : float or None
        Their length, s; None for the whole record.
    transient : float
        What is simulated before them, s.
    begun : GrowingRecord

    Raises
    ------
    InputError
        If the record is shorter than a window.
    """
    times = record.times
    step = float(np.median(np.diff(times)))
    slack, last = SETTINGS.step_tolerance * step, float(times[-1]) + step
    counted = record.counted & (times >= begun.counts)[:, None]
    before = np.vstack([np.zeros(counted.shape[1]), np.cumsum(counted, axis=0)])

    def made(number: int, lead: int, start: int, stop: int) -> Window:
        there = bool((before[stop] > before[start]).all()) and stop - lead > 1
        end = float(times[stop]) if stop < times.size else last
        return Window(number, lead, start, stop, float(times[start]), end, slack, there)

    if window is None:
        return [made(0, 0, 0, times.size)]
    count = math.floor((last - begun.begin + slack) / window) - begun.windows
    if count <= 0 and (begun.grows or begun.windows):
        return []
    if count <= 0:
        raise InputError(
            f"{record.source} lasts {times[-1] - times[0]:g} s, which is shorter than a window of {window:g} s: "
            "make the windows shorter, or the record longer"
        )
    edges = begun.begin + window * np.arange(begun.windows, begun.windows + count + 1)
    borders = np.searchsorted(times, edges - slack)
    leads = np.searchsorted(times, edges - transient - slack)
    rows = zip(leads.tolist(), borders.tolist(), borders[1:].tolist(), strict=False)
    return [made(begun.windows + k, lead, start, stop) for k, (lead, start, stop) in enumerate(rows)]


def part_of(whole: Experiment, windows: Sequence[Window], transient: float) -> Experiment:
    """Return successive windows of a record with what is simulated before them, which does not count."""
    times, lead = whole.times, windows[0].lead
    from_begin = lead == windows[0].start
    left = max(whole.discard, transient) if from_begin else float(times[windows[0].start] - times[lead])
    # with all columns: a fault may have inputs that the healthy machine has not
    return replace(whole, frame=whole.frame.iloc[lead : windows[-1].stop], discard=left)


@dataclass(frozen=True, eq=False)
class WindowSums:
    """What one window says.

    Attributes
    ----------
    window : Window
    edges : (B + 1,) array
        Of its blocks, s of the record.
    grams : (B, N + 1, N + 1) array
        Of the whitened residual at zero, then the N columns, block by block.
    samples : int
    """

    window: Window
    edges: Floats
    grams: Floats
    samples: int

    def blocks(self, shift: float) -> Blocks:
        """Return its blocks by the clock of all records, which is later by `shift`."""
        return Blocks(self.edges + shift, self.grams[:, 1:, 1:], self.grams[:, 1:, 0])

    @cached_property
    def _gram(self) -> Floats:
        return np.asarray(self.grams.sum(axis=0))

    @cached_property
    def whole(self) -> InformationMatrix:
        """What the window says of all coordinates."""
        return InformationMatrix(self._gram[1:, 1:], self._gram[1:, 0])

    def squares(self, at: Floats) -> float:
        """Return the sum of squares of what is left at some coordinates (N,)."""
        along = np.concatenate([[1.0], -at])
        return max(0.0, float(along @ self._gram @ along))


def summed(
    machine: LinearizedMachine,
    part: Experiment,
    windows: Sequence[Window],
    point: Floats,
    healthy: Floats,
    whitening: Whitening,
) -> Iterator[WindowSums]:
    """Yield what windows say, linearised at a point (N,) and relative to the healthy coordinates (N,).

    Parameters
    ----------
    machine : LinearizedMachine
        Over `part`.
    part : Experiment
        The windows and what is simulated before them.
    windows : sequence of Window
    point, healthy : (N,) array
    whitening : Whitening

    Raises
    ------
    SimulationError
        If a simulation fails.
    """
    outputs, columns = machine.linearise(point)
    residual = np.where(part.counted, part.output_values - outputs, 0.0) + columns @ (point - healthy)
    whole = np.concatenate([residual[:, :, None], columns], axis=2)
    white = [(part.times[rows], values) for rows, values in whitening.of_outputs(part, whole)]
    for window in windows:
        span = np.array([window.begin, window.end]) - window.slack
        inside = [np.searchsorted(times, span) for times, _ in white]
        samples = int(sum(high - low for low, high in inside))
        count = int(np.clip(samples // (SETTINGS.block_samples * len(white)), 1, SETTINGS.most_blocks))
        edges = np.linspace(window.begin, window.end, count + 1)
        grams = np.zeros((count, whole.shape[2], whole.shape[2]))
        for (times, values), (low, high) in zip(white, inside, strict=True):
            cuts = low + np.searchsorted(times[low:high], edges[1:-1] - window.slack)
            for k, (first, last) in enumerate(pairwise([low, *cuts.tolist(), high])):
                rows = values[first:last]
                grams[k] += rows.T @ rows
        yield WindowSums(window, edges, grams, samples)


def build_up_of(
    made: BaselineComparator, record: Experiment, windows: Sequence[Window], transient: float, point: Floats
) -> tuple[ChangeTransient, Flags]:
    """Return how a change builds up in the outputs, by what is left of other starts before some windows, and of what.

    A change whose column is the same from the start on needs no state: it shows at once.

    Parameters
    ----------
    made : BaselineComparator
    record : Experiment
    windows : sequence of Window
        Two or more, one after the other.
    transient : float
        What is simulated before each, s.
    point : (N,) array
        Where the machine is simulated.

    Returns
    -------
    build_up : ChangeTransient
    slow : (N,) array of bool
        Whose changes build up.

    Raises
    ------
    InputError
        If the transient lasts longer.
    SimulationError
        If a simulation fails.
    """
    compared = windows[: SETTINGS.most_compared + 1]
    whole = part_of(record, compared, transient)
    early, columns = made.machine(whole).linearise(point)
    std = np.array([made.healthy.whitening.std(name) for name in record.output_names])
    left, late = [], []
    for each in compared[1:]:
        part = part_of(record, [each], transient)
        rows = slice(each.lead - compared[0].lead, each.stop - compared[0].lead)
        outputs, started = made.machine(part).linearise(point)
        late.append(((started - columns[rows]) / std[:, None]) ** 2)
        off = np.abs(outputs - early[rows]) / std
        left.append(np.sum(off**2, axis=1))
        most = off[part.counted].max(initial=0.0)
        if most > SETTINGS.transient_share:
            raise InputError(
                f"{record.source}: the transient lasts longer than {transient:g} s: what a simulation "
                f"starts from still shows then, by {most:.2g} standard deviations of the noise; "
                "give a longer transient, and windows longer than that"
            )
    length = min(each.size for each in left)
    step, slow = float(np.median(np.diff(whole.times))), made.coordinates.slow
    states, seen = np.mean([each[:length] for each in left], axis=0), columns / std[:, None]

    def built() -> ChangeTransient:
        return ChangeTransient.of(states, seen[:, :, slow].reshape(len(seen), -1), step)

    first = 1 + round(built().lasts / step)
    differs = np.mean([each[:first].sum(axis=(0, 1)) for each in late], axis=0)
    slow = slow & (differs > ONSET.over**2 * first * np.mean(np.sum(seen**2, axis=1), axis=0))
    return built(), slow
