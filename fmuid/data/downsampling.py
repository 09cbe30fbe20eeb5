"""Series thinned to what a picture can show: lines by least and greatest, dots evenly."""

from __future__ import annotations

import math

import numpy as np

from fmuid.array_types import Floats, Indices


def extremes(columns: Floats, count: int) -> Indices:
    """Return which rows draw the same lines: the least and greatest of every column in every stretch, in order.

    Parameters
    ----------
    columns : (K, m) array
        Lines over the same abscissa; NaN where one has a gap.
    count : int
        About how many rows are wanted; fewer rows than these are all kept.
    """
    samples, lines = columns.shape
    if samples <= count:
        return np.arange(samples)
    size = math.ceil(samples / max(1, count // (2 * lines)))
    whole = samples // size * size
    blocks = columns[:whole].reshape(-1, size, lines)
    first = np.arange(0, whole, size)[:, None]
    found = [*(first + each for each in _ends(blocks)), *(whole + each for each in _ends(columns[None, whole:]))]
    return np.unique(np.concatenate([[0, samples - 1], *(each.ravel() for each in found)]))


def _ends(blocks: Floats) -> tuple[Indices, ...]:
    """Return where the least and the greatest of each block (n, size, m) are, (n, m) each; nothing of empty blocks."""
    if not blocks.shape[1]:
        return ()
    missing = np.isnan(blocks)
    return np.where(missing, np.inf, blocks).argmin(axis=1), np.where(missing, -np.inf, blocks).argmax(axis=1)


def evenly(samples: int, count: int) -> Indices:
    """Return which of so many rows to draw as dots, at most `count`, in equal distances, the first and last among them.

    The least and greatest of every stretch would show the envelope of the noise instead of the cloud.
    """
    return np.unique(np.linspace(0, samples - 1, min(samples, count)).round().astype(np.intp))
