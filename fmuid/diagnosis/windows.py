"""Records cut into windows: sums of each window, check of the warm-up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.data import Experiment, usual_step
from fmuid.diagnosis.alarms import RecordTime
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.information_matrix import InformationMatrix, Whitening
from fmuid.diagnosis.linearized_machine import LinearizedMachine, residual_and_columns
from fmuid.diagnosis.onset import SETTINGS as ONSET
from fmuid.diagnosis.onset import ChangeTransient
from fmuid.diagnosis.onset_tracker import Blocks
from fmuid.errors import InputError


@dataclass(frozen=True)
class WindowSettings:
    """Numbers of windows."""

    step_tolerance: float = 1e-3  # sampling intervals before a window for its first sample: times are rounded
    most_blocks: int = 20  # of a window: an onset is dated to a block
    block_samples: int = 20  # of a block, at least
    transient_share: float = 0.2  # noise deviations by which outputs may depend on the start after the transient
    most_compared: int = 8  # windows simulated from starts of their own


SETTINGS = WindowSettings()


@dataclass(frozen=True)
class WatchedRecord:
    """A record of a monitoring."""

    name: str
    begin: float  # s of the record
    clock: float  # the same, s of all data
    date: str = ""  # of time zero, if the data file has dates
    counts: float = 0.0  # begin of the samples that count, s of the record
    windows: int = 0  # examined so far
    grows: bool = False

    def moment(self, time: float) -> RecordTime:
        """Return a time of the record with its date."""
        date = (pd.Timestamp(self.date) + pd.Timedelta(seconds=time)).isoformat() if self.date else ""
        return RecordTime(self.name, time, date)


@dataclass(frozen=True)
class Window:
    """A window of a record."""

    number: int  # from 0 on
    lead: int  # first row of the simulation
    start: int  # first row
    stop: int  # row behind
    begin: float  # s
    end: float  # begin of the next window, s
    slack: float  # s by which samples before `begin` belong to it
    there: bool  # every output has a sample that counts


@dataclass(frozen=True)
class SkippedWindow:
    """A window in which some output has no sample that counts.

    Attributes
    ----------
    source : str
        Of the record.
    time : float
        Begin of the window, s.
    """

    source: str
    time: float


def split_windows(record: Experiment, window: float | None, transient: float, begun: WatchedRecord) -> list[Window]:
    """Return the whole windows (length `window`, s; None: the record) of a record from `begun` on."""
    times = record.times
    step = usual_step(times)
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
        said = f"{times[-1] - times[0]:g} s are shorter than a window of {window:g} s"
        raise InputError(f"{record.source}: {said}. Give shorter windows, or longer data.")
    edges = begun.begin + window * np.arange(begun.windows, begun.windows + count + 1)
    borders = np.searchsorted(times, edges - slack)
    leads = np.searchsorted(times, edges - transient - slack)
    rows = zip(leads.tolist(), borders.tolist(), borders[1:].tolist(), strict=False)
    return [made(begun.windows + k, lead, start, stop) for k, (lead, start, stop) in enumerate(rows)]


def part_of(whole: Experiment, windows: Sequence[Window], transient: float) -> Experiment:
    """Return successive windows of a record, with the warm-up before them."""
    times, lead = whole.times, windows[0].lead
    from_begin = lead == windows[0].start
    left = max(whole.warmup, transient) if from_begin else float(times[windows[0].start] - times[lead])
    # with all columns: a fault may have inputs that the healthy machine has not
    return replace(whole, frame=whole.frame.iloc[lead : windows[-1].stop], warmup=left)


@dataclass(frozen=True, eq=False)
class WindowSums:
    """Sums of one window."""

    window: Window
    edges: Floats  # (B + 1,), of its blocks, s of the record
    grams: Floats  # (B, N + 1, N + 1), of the whitened residual at zero and the N columns, by block
    samples: int

    def blocks(self, shift: float) -> Blocks:
        """Return its blocks in s of all data, later by `shift`."""
        return Blocks(self.edges + shift, self.grams[:, 1:, 1:], self.grams[:, 1:, 0])

    @cached_property
    def whole(self) -> InformationMatrix:
        """Information of the window on all coordinates."""
        gram = self.grams.sum(axis=0)
        return InformationMatrix(gram[1:, 1:], gram[1:, 0], float(gram[0, 0]))

    def quieter(self, factor: float) -> WindowSums:
        """Return the sums beside noise with a variance larger by a factor."""
        return replace(self, grams=self.grams / factor)


def summed(
    machine: LinearizedMachine, windows: Sequence[Window], point: Floats, healthy: Floats, whitening: Whitening
) -> Iterator[WindowSums]:
    """Yield the sums of windows, linearized at a point (N,)."""
    part, whole = machine.experiment, residual_and_columns(machine, point)
    begins, white = np.array([each.begin - each.slack for each in windows]), list[tuple[Floats, Floats]]()
    for _, kept, values in whitening.of_outputs(part, whole, begins):
        values[:, 0] += values[:, 1:] @ (point - healthy)
        white.append((part.times[kept], values))
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
    """Return the build-up of changes, and its coordinates (N,)."""
    compared = windows[: SETTINGS.most_compared + 1]
    whole = part_of(record, compared, transient)
    early, columns = made.machine(whole).linearize(point)
    std = np.array([made.healthy.whitening.std(name) for name in record.output_names])
    left, late = [], []
    for each in compared[1:]:
        part = part_of(record, [each], transient)
        rows = slice(each.lead - compared[0].lead, each.stop - compared[0].lead)
        outputs, started = made.machine(part).linearize(point)
        late.append(((started - columns[rows]) / std[:, None]) ** 2)
        off = np.abs(outputs - early[rows]) / std
        left.append(np.sum(off**2, axis=1))
        most = off[part.counted].max(initial=0.0)
        if most > SETTINGS.transient_share:
            shift = f"the initial state still shifts outputs by {most:.2g} × noise level"
            said = f"warm-up of {transient:g} s too short: {shift}"
            raise InputError(f"{record.source}: {said}. Give a longer warm-up, and longer windows.")
    length, slow = min(each.size for each in left), made.coordinates.slow
    states, seen = np.mean([each[:length] for each in left], axis=0), columns / std[:, None]

    def built(slow: Flags) -> ChangeTransient:
        return ChangeTransient.of(states, seen[:, :, slow].reshape(len(seen), -1), step)

    step = usual_step(whole.times)
    first = 1 + round(built(slow).lasts / step)
    differs = np.mean([each[:first].sum(axis=(0, 1)) for each in late], axis=0)
    # a column that never depends on the start shows at once
    slow = slow & (differs > ONSET.over**2 * first * np.mean(np.sum(seen**2, axis=1), axis=0))
    return built(slow), slow
