"""Numerics of better starts: the weak form against closed forms, and the noise that data show."""

import numpy as np
import pytest

import fmuid
from fmuid.estimation import WeakForm, second_difference_noise
from fmuid.estimation.starting_points import SETTINGS

WINDOW = SETTINGS.window
RNG = np.random.default_rng(0)
TIMES = np.cumsum(RNG.uniform(0.4, 1.6, 400) * 1e-2)


def windows(there: np.ndarray | None = None) -> WeakForm:
    return WeakForm(TIMES, np.ones((400, 1), dtype=bool) if there is None else there)


def test_the_weak_form_of_a_true_right_hand_side_vanishes() -> None:
    """x = sin 3t and f = 3 cos 3t: what is left are the trapezoids' errors, of second order in the step."""
    x, f = np.sin(3.0 * TIMES)[:, None], 3.0 * np.cos(3.0 * TIMES)[:, None]
    weak = windows()
    left = weak.residual(x, f[:-1], f[1:])
    wrong = weak.residual(x, 1.1 * f[:-1], 1.1 * f[1:])
    assert left.shape == weak.shape
    assert np.abs(left).max() < 0.01 * np.abs(wrong).max()


def test_the_noise_of_the_windows_is_what_it_says() -> None:
    weak, zero = windows(), np.zeros((399, 1))
    found = [weak.residual(RNG.standard_normal((400, 1)), zero, zero)[:, 0] for _ in range(400)]
    assert np.std(found, axis=0) == pytest.approx(weak.noise[:, 0], rel=0.2)


def test_windows_without_samples_do_not_count() -> None:
    there = np.ones((400, 1), dtype=bool)
    there[100:150] = False
    assert windows(there).shape[0] < windows().shape[0]
    for few in (TIMES[:WINDOW], TIMES[:2]):
        with pytest.raises(fmuid.InputError, match="no window has enough samples"):
            WeakForm(few, np.ones((few.size, 1), dtype=bool))


@pytest.mark.parametrize("count", [400, 396])  # the last window ends with the record or before
def test_windows_are_those_of_a_direct_count(count: int) -> None:
    there = np.random.default_rng(7).random((count, 2)) < [0.4, 0.5]
    there[-WINDOW:] = True
    times = (np.repeat(TIMES[::4], 4) + np.tile([0.0, 0.0, 0.0, 1e-3], 100))[:count]  # jumps
    times[60:75] = times[60]
    every = range(0, count - WINDOW, WINDOW // 2)
    firsts = [a for a in every if (there[a : a + WINDOW + 1].sum(axis=0) >= 3).all() and times[a + WINDOW] > times[a]]
    weak = WeakForm(times, there)
    assert weak.shape == (len(firsts), 2)
    # a step at each sample in turn is seen by the windows that have it inside
    still = np.zeros((count - 1, count))
    seen = np.abs(weak.residual(np.eye(count), still, still)) > 0.0
    for window, first in zip(seen, firsts, strict=True):
        assert set(np.flatnonzero(window)) <= set(range(first, first + WINDOW + 1))


def test_second_differences_show_the_noise() -> None:
    for std in (0.01, 0.3):
        values = np.sin(TIMES) + std * RNG.standard_normal(400)
        values[RNG.random(400) < 0.3] = np.nan
        values[200:] += 5.0  # one step
        assert second_difference_noise(TIMES, values) == pytest.approx(std, rel=0.2)
    assert second_difference_noise(TIMES, 3.0 * TIMES) == pytest.approx(0.0, abs=1e-14)
    assert np.isnan(second_difference_noise(TIMES[:4], TIMES[:4]))
    assert np.isnan(second_difference_noise(np.zeros(6), np.arange(6.0)))
