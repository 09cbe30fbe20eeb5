"""Onsets from running sums against least squares over all samples, and how often the stated set holds the truth."""

from __future__ import annotations

import numpy as np
import pytest

from fmuid.diagnosis.evidence.causes import Cause
from fmuid.diagnosis.evidence.information import Known
from fmuid.diagnosis.evidence.onset import RunningSums, Shape, dated, largest_by_chance

LENGTH, BLOCKS = 20, 40
CAUSE = Cause("step", (1,), 2.0)
KNOWN = Known(np.array([0.2, -0.1, 0.0]), np.diag([0.5, 1e-4, 0.3]) + 1e-3)


def record(seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.standard_normal((LENGTH * BLOCKS + 7, 3)), random.standard_normal(LENGTH * BLOCKS + 7)


def explained(jacobian: np.ndarray, residual: np.ndarray, extra: np.ndarray) -> tuple[float, float]:
    """Return D and the size of an extra column, beside coordinates with a prior, by least squares over the samples."""
    root = np.linalg.cholesky(np.linalg.inv(KNOWN.covariance)).T
    top, bottom = np.hstack([jacobian, extra[:, None]]), np.hstack([root, np.zeros((3, 1))])
    data = np.concatenate([residual, root @ KNOWN.mean])
    with_it = np.vstack([top, bottom])
    found, rest = np.linalg.lstsq(with_it, data)[:2]
    return float(np.linalg.lstsq(with_it[:, :3], data)[1][0] - rest[0]), float(found[3])


@pytest.mark.parametrize("shape", Shape)
@pytest.mark.parametrize("at", [0, 13, 29])
def test_an_onset_is_a_column_of_least_squares(shape: Shape, at: int) -> None:
    jacobian, residual = record(1)
    end = 30
    sums = RunningSums.of(jacobian, residual, LENGTH)
    found = sums.onsets(KNOWN, CAUSE, end, shape)
    block = np.repeat(np.arange(BLOCKS), LENGTH)[: end * LENGTH]
    # a ramp rises from block to block: the middle of each stands for its samples
    extra = jacobian[: end * LENGTH, 1] * (block >= at)
    if shape is Shape.RAMP:
        extra = extra * (block + 0.5 - at)
        exact = (block + 0.5 - at) ** 2
        assert (exact[block >= at] > 0).all()
    statistic, size = explained(jacobian[: end * LENGTH], residual[: end * LENGTH], extra)
    assert found.statistics[at] == pytest.approx(statistic, rel=1e-7)
    assert found.sizes[at, 0] == pytest.approx(size, rel=1e-7)
    few = sums.onsets(KNOWN, CAUSE, end, shape, at=[at])
    assert few.statistics == pytest.approx(found.statistics[[at]])


def test_a_cause_of_one_sign() -> None:
    jacobian, residual = record(2)
    sums = RunningSums.of(jacobian, residual - 3.0 * jacobian[:, 1], LENGTH)
    assert sums.onsets(KNOWN, CAUSE, BLOCKS).statistics.max() > 1000
    assert sums.onsets(KNOWN, Cause("up", (1,), 2.0, 1), BLOCKS).statistics.max() < 50


def test_what_is_between_two_blocks() -> None:
    jacobian, residual = record(3)
    part = RunningSums.of(jacobian, residual, LENGTH).between(4, 9)
    rows = slice(4 * LENGTH, 9 * LENGTH)
    assert part.matrix == pytest.approx(jacobian[rows].T @ jacobian[rows])
    assert part.score == pytest.approx(jacobian[rows].T @ residual[rows])


def test_the_set_holds_the_onset_and_the_shape_is_told() -> None:
    """200 records with a step of known begin: the 95 % set holds it, the size is near, and no ramp is likelier."""
    random = np.random.default_rng(4)
    spread = np.linalg.cholesky(KNOWN.covariance)
    held, sizes, shapes = [], [], []
    for _ in range(200):
        jacobian = random.standard_normal((LENGTH * BLOCKS, 3))
        begin = int(random.integers(5 * LENGTH, 35 * LENGTH))
        truth = KNOWN.mean + spread @ random.standard_normal(3)
        truth_in_time = np.tile(truth, (len(jacobian), 1))
        truth_in_time[begin:, 1] += 0.6
        residual = np.einsum("ij,ij->i", jacobian, truth_in_time) + random.standard_normal(len(jacobian))
        sums = RunningSums.of(jacobian, residual, LENGTH)
        step, ramp = (sums.onsets(KNOWN, CAUSE, BLOCKS, shape) for shape in Shape)
        when = dated(step)
        held.append((when.blocks[0] - 1) * LENGTH <= begin <= (when.blocks[1] + 1) * LENGTH)
        sizes.append((when.size[0] - 0.6) / np.sqrt(when.covariance[0, 0]))
        shapes.append(when.log_evidence > dated(ramp, blocks=20).log_evidence)
    assert np.mean(held) >= 0.93
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(1.0, abs=0.2)
    assert np.mean(shapes) >= 0.8  # steps near an end look like ramps


def test_chance_of_the_largest_statistic() -> None:
    """The law drawn from the information alone is that of records drawn sample by sample."""
    random = np.random.default_rng(5)
    jacobian = random.standard_normal((LENGTH * BLOCKS, 3))
    rows = jacobian.reshape(BLOCKS, LENGTH, 3)
    causes, ends = (CAUSE, Cause("plane", (0, 2), 1.0)), (20, 40)
    drawn = largest_by_chance(np.einsum("bij,bik->bjk", rows, rows), KNOWN, causes, ends, draws=200)
    spread = np.linalg.cholesky(KNOWN.covariance)
    real = []
    for _ in range(200):
        truth = KNOWN.mean + spread @ random.standard_normal(3)
        sums = RunningSums.of(jacobian, jacobian @ truth + random.standard_normal(len(jacobian)), LENGTH)
        real.append(max(sums.onsets(KNOWN, c, end).statistics.max() for end in ends for c in causes))
    assert np.quantile(drawn, [0.5, 0.9]) == pytest.approx(np.quantile(real, [0.5, 0.9]), rel=0.1)
