"""Onsets, added window by window, against least squares over all samples; coverage of the confidence set."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from fmuid.diagnosis import OnsetShape
from fmuid.diagnosis import onset_tracker as watching
from fmuid.diagnosis.cause_ranking import log_bayes_factor
from fmuid.diagnosis.causes import Cause
from fmuid.diagnosis.change_detection import log_chance, log_limit
from fmuid.diagnosis.information_matrix import ChangePrior
from fmuid.diagnosis.onset import ChangeTransient, estimate_onset
from fmuid.diagnosis.onset_tracker import Blocks, OnsetTracker, TrackerSettings

LENGTH, BLOCKS, WINDOWS = 20, 5, 8
SAMPLES = LENGTH * BLOCKS * WINDOWS
CAUSE = Cause("step", (1,), 2.0)
KNOWN = ChangePrior(np.array([0.2, -0.1, 0.0]), np.diag([0.5, 1e-4, 0.3]) + 1e-3)
DRIFT = np.array([0.0, 0.0, 0.4])


def watched(jacobian: np.ndarray, residual: np.ndarray, begun: OnsetTracker | None = None) -> OnsetTracker:
    """Return a watch that has seen all windows; a block lasts a second."""
    found = begun or OnsetTracker(KNOWN, np.diag(DRIFT**2))
    rows = jacobian.reshape(-1, BLOCKS, LENGTH, jacobian.shape[1])
    rest = residual.reshape(-1, BLOCKS, LENGTH)
    for k, (own, left) in enumerate(zip(rows, rest, strict=True)):
        edges = np.arange(BLOCKS + 1.0) + BLOCKS * k
        found.add(Blocks(edges, np.einsum("bij,bik->bjk", own, own), np.einsum("bij,bi->bj", own, left)))
    return found


def explained(
    jacobian: np.ndarray, residual: np.ndarray, extra: np.ndarray, drifted: np.ndarray
) -> tuple[float, float]:
    """Return D and the size of an extra column by least squares over the samples.

    Beside coordinates with their prior, one that drifts by itself in each window, and that may have drifted for good,
    from the begin on and as `drifted` says.
    """
    known = KNOWN.drifting(DRIFT)
    root = np.linalg.cholesky(np.linalg.inv(known.covariance)).T
    window = np.kron(np.eye(WINDOWS), np.ones((LENGTH * BLOCKS, 1))) * jacobian[:, [2]]
    beside = np.hstack([jacobian, window, drifted[:, None]])
    springs = np.zeros((3 + WINDOWS + 1, 3 + WINDOWS + 1))
    springs[:3, :3] = root
    springs[3:, 3:] = np.eye(WINDOWS + 1) / DRIFT[2]
    data = np.concatenate([residual, root @ KNOWN.mean, np.zeros(WINDOWS + 1)])
    without = np.vstack([beside, springs])
    with_it = np.column_stack([without, np.concatenate([extra, np.zeros(len(springs))])])
    found, rest = np.linalg.lstsq(with_it, data)[:2]
    return float(np.linalg.lstsq(without, data)[1][0] - rest[0]), float(found[-1])


@pytest.mark.parametrize("shape", OnsetShape)
@pytest.mark.parametrize("at", [0, 13, 29])
def test_an_onset_is_a_column_of_least_squares(shape: OnsetShape, at: int) -> None:
    random = np.random.default_rng(1)
    jacobian, residual = random.standard_normal((SAMPLES, 3)), random.standard_normal(SAMPLES)
    (found,) = watched(jacobian, residual).onsets([CAUSE], shape)
    block = np.repeat(np.arange(BLOCKS * WINDOWS), LENGTH)
    course, total = (block >= at) * 1.0, 1.0
    if shape is OnsetShape.RAMP:  # it rises from block to block: the middle of each stands for its samples
        course, total = course * (block + 0.5 - at), float(BLOCKS * WINDOWS)
    statistic, size = explained(jacobian, residual, jacobian[:, 1] * course, jacobian[:, 2] * course / total)
    assert found.clock[at] == at
    assert found.statistics[at] == pytest.approx(statistic, rel=1e-6)
    assert found.sizes[at, 0] == pytest.approx(size, rel=1e-6)


def test_correlated_drift_is_that_of_other_coordinates() -> None:
    """Beside a cause, coordinates turned by 30° have the same D and a drift with correlation."""
    random, angle = np.random.default_rng(3), np.pi / 6.0
    jacobian, residual = random.standard_normal((SAMPLES, 3)), random.standard_normal(SAMPLES)
    turn = np.eye(3)
    turn[np.ix_([0, 2], [0, 2])] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    known = ChangePrior(turn @ KNOWN.mean, turn @ KNOWN.covariance @ turn.T)
    other = watched(jacobian @ turn.T, residual, OnsetTracker(known, turn @ np.diag(DRIFT**2) @ turn.T))
    for shape in OnsetShape:
        (plain,), (found,) = (each.onsets([CAUSE], shape) for each in (watched(jacobian, residual), other))
        assert found.statistics == pytest.approx(plain.statistics, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("sign", [0, 1])
def test_evidence_of_an_onset_is_that_of_its_statistics(sign: int) -> None:
    """In closed form, of sizes with a normal or half-normal prior."""
    random, cause = np.random.default_rng(2), Cause("step", (1,), 0.5, sign)
    jacobian, residual = random.standard_normal((SAMPLES, 3)), random.standard_normal(SAMPLES)
    found = watched(jacobian, residual)
    (onsets,) = found.onsets([cause], OnsetShape.STEP)
    expected = [log_bayes_factor(found.news(clock), [cause]) for clock in onsets.clock]
    assert onsets.log_evidence(1.0) == pytest.approx(expected)


def test_old_onsets_thin_out_and_those_of_an_alarm_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "SETTINGS", TrackerSettings(fine=2, most=8))
    found, plain = OnsetTracker(KNOWN, np.diag(DRIFT**2)), (np.tile(np.eye(3), (BLOCKS, 1, 1)), np.ones((BLOCKS, 3)))
    for k in range(100):
        found.add(Blocks(np.arange(BLOCKS + 1.0) + BLOCKS * k, *plain))
        if k == 30:
            found.pinned = (147.0, 148.0)
    clock = found.onsets([CAUSE], OnsetShape.STEP)[0].clock
    assert clock[0] == 0.0
    assert {147.0, 148.0, 490.0, 491.0, 499.0} <= set(clock.tolist())
    assert len(clock) <= 9 + 2 * BLOCKS + 2


@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.campaign)]
)
def test_confidence_set_and_shape_over_draws(draws: int) -> None:
    """Records with a step of known begin: the 95 % set contains it, and no ramp is likelier."""
    random, spread = np.random.default_rng(4), np.linalg.cholesky(KNOWN.covariance)
    held, shapes = 0, 0
    for _ in range(draws):
        jacobian = random.standard_normal((SAMPLES, 3))
        begin = int(random.integers(5 * LENGTH, 35 * LENGTH))
        course = np.tile(KNOWN.mean + spread @ random.standard_normal(3), (SAMPLES, 1))
        course[begin:, 1] += 0.6
        residual = np.einsum("ij,ij->i", jacobian, course) + random.standard_normal(SAMPLES)
        found = watched(jacobian, residual, OnsetTracker(KNOWN, np.zeros((3, 3))))
        when = estimate_onset([found.onsets([CAUSE], shape)[0] for shape in OnsetShape], found.end)
        held += when.between[0] <= begin / LENGTH <= when.between[1]
        shapes += when.shape is OnsetShape.STEP
    assert held / draws >= 0.92
    assert shapes / draws >= 0.8  # steps near an end look like ramps


def lagged(values: np.ndarray, constant: float) -> np.ndarray:
    """Return the response of a lag of the first order."""
    decay = np.exp(-1.0 / constant)
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], values))


LAG = 3.0 * LENGTH  # its time constant, samples


@pytest.mark.parametrize("constant", [False, True], ids=["white", "constant"])
def test_how_a_change_builds_up(constant: bool) -> None:
    """Of a lag of the first order: 1 − exp(−2t/τ) under white excitation, 1 − exp(−t/τ) under constant excitation."""
    driven = np.ones(20_000) if constant else np.random.default_rng(7).standard_normal(20_000)
    left = np.exp(-2.0 * np.arange(1000) / LAG)
    found = ChangeTransient.of(left, lagged(driven, LAG)[1000:, None], 0.1)
    rate = (1.0 if constant else 2.0) / (0.1 * LAG)
    lags = np.array([0.0, 0.5, 1.0, 4.0]) * 0.1 * LAG
    expected = (lags[1:] - lags[:-1] + np.diff(np.exp(-rate * lags)) / rate) / np.diff(lags)
    assert found.shares(np.zeros(1), lags)[0] == pytest.approx(expected, abs=0.04)
    assert found.shares(np.array([-100.0]), lags) == pytest.approx(1.0)
    assert ChangeTransient.of(np.zeros(50), np.ones((100, 2)), 0.1).lasts == 0.0  # without a state


@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.campaign)]
)
def test_confidence_set_of_a_machine_with_memory_over_draws(draws: int) -> None:
    """A gain before a lag of three blocks changes, for trackers with its build-up and without."""
    random, lead = np.random.default_rng(8), 2000
    held, near, widths = np.zeros((2, draws), bool), np.zeros((2, draws), bool), np.zeros((2, draws))
    for i in range(draws):
        driven, begin = random.standard_normal(SAMPLES + lead), int(random.integers(10, 30))
        course = np.arange(SAMPLES + lead) >= lead + LENGTH * begin
        column, moved = (lagged(each, LAG)[lead:, None] for each in (driven, driven * course))
        jacobian = np.hstack([random.standard_normal((SAMPLES, 1)), column / column.std()])
        residual = 0.6 * moved[:, 0] / column.std() + random.standard_normal(SAMPLES)
        known = ChangeTransient.of(np.exp(-2.0 * np.arange(400) / LAG), jacobian[:, 1:], 1.0 / LENGTH)
        for k, build_up in enumerate((known, ChangeTransient())):
            begun = OnsetTracker(ChangePrior(np.zeros(2), np.diag([0.5, 1e-4])), np.zeros((2, 2)))
            found = watched(jacobian, residual, begun.building_up(build_up, np.array([False, True])))
            when = estimate_onset([found.onsets([CAUSE], shape)[0] for shape in OnsetShape], found.end)
            low, high = when.between
            held[k, i], near[k, i] = low - 1e-9 <= begin <= high + 1e-9, abs(when.clock - begin) <= 2
            widths[k, i] = high - low
    assert held[0].mean() >= 0.95 > held[1].mean()
    assert near[0].mean() > near[1].mean() + 0.05
    assert np.median(widths[0]) <= np.median(widths[1]) + 1.0


CAUSES = (Cause("either", (0,), 1.0), Cause("up", (0,), 1.0, 1), Cause("plane", (0, 1), 1.0))


@pytest.mark.parametrize("cause", CAUSES, ids=[each.name for each in CAUSES])
@pytest.mark.parametrize("windows", [1, 30])
def test_level_over_all_onsets_and_windows(cause: Cause, windows: int) -> None:
    """Random walks that are tested after each window from each onset on."""
    level, draws, d = 0.1, 2000, len(cause.columns)
    steps = np.random.default_rng(6).standard_normal((draws, windows, d))
    walk = np.concatenate([np.zeros((draws, 1, d)), steps.cumsum(axis=1)], axis=1)
    alarmed = np.zeros(draws, dtype=bool)
    for now in range(1, windows + 1):
        off = (walk[:, [now]] - walk[:, :now]) / np.sqrt(now - np.arange(now))[None, :, None]
        statistic = np.where((off[:, :, 0] > 0) | (not cause.sign), np.sum(off**2, axis=2), 0.0)
        alarmed |= (log_chance(statistic, cause) < log_limit(level / windows, [cause], now)).any(axis=1)
    assert alarmed.mean() == pytest.approx(level, abs=0.03)
