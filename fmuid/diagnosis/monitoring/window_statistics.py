"""What the windows of a record say: the machine linearised once over many of them, and summed block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline.whitening import Whitening
from fmuid.diagnosis.change_detection.information_matrix import InformationMatrix
from fmuid.diagnosis.change_detection.onset_tracker import Blocks
from fmuid.diagnosis.linearisation import LinearizedMachine
from fmuid.diagnosis.monitoring.windows import Window

# A window is cut into so many blocks at most, each of so many samples at least: an onset is dated to a block.
MOST_BLOCKS, BLOCK_SAMPLES = 20, 20


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
        count = int(np.clip(samples // (BLOCK_SAMPLES * len(white)), 1, MOST_BLOCKS))
        edges = np.linspace(window.begin, window.end, count + 1)
        grams = np.zeros((count, whole.shape[2], whole.shape[2]))
        for (times, values), (low, high) in zip(white, inside, strict=True):
            cuts = low + np.searchsorted(times[low:high], edges[1:-1] - window.slack)
            for k, (first, last) in enumerate(pairwise([low, *cuts.tolist(), high])):
                rows = values[first:last]
                grams[k] += rows.T @ rows
        yield WindowSums(window, edges, grams, samples)
