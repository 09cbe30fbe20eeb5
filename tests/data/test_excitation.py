"""Excitations against the closed forms of their autocorrelation, spectrum and peaks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid import InputError
from fmuid.data.signals import multisine, prbs, step_sequence


@pytest.mark.parametrize("order", [2, 5, 9])
@pytest.mark.parametrize("seed", [0, 3])
def test_prbs_is_a_maximum_length_sequence(order: int, seed: int) -> None:
    """Periodic autocorrelation: A² at no shift, -A²/N at all others; power N + 1 in every line but that at zero, 1."""
    count, amplitude = 2**order - 1, 2.5
    frame = prbs(count * 1e-3, 1e-3, amplitude, 1, order=order, seed=seed, offset=4.0)
    centred = (frame["u"] - 4.0).to_numpy()
    power = np.abs(np.fft.fft(centred / amplitude)) ** 2
    np.testing.assert_allclose(power, [1.0] + [count + 1.0] * (count - 1), rtol=1e-9)
    correlation = [np.mean(centred * np.roll(centred, shift)) for shift in range(count)]
    np.testing.assert_allclose(correlation, [amplitude**2] + [-(amplitude**2) / count] * (count - 1), atol=1e-12)


def test_prbs_order_and_seed() -> None:
    """By default the record is no longer than a period; a seed is a shift of the same sequence."""
    frame = prbs(0.4, 1e-3, 1.0, 10)  # 40 bits: order 6, 63 bits
    bits = (frame["u"].to_numpy()[::10] > 0).astype(int)
    whole = prbs(0.63, 1e-3, 1.0, 10, seed=5)["u"].to_numpy()[::10] > 0
    shifted = [np.roll(whole, k)[:40].astype(int).tolist() for k in range(63)]
    assert bits.tolist() in shifted
    assert not prbs(0.63, 1e-3, 1.0, 10, seed=1).equals(prbs(0.63, 1e-3, 1.0, 10, seed=2))
    pd.testing.assert_frame_equal(prbs(0.4, 1e-3, 1.0, 10), frame)
    again = prbs(0.6, 1e-3, 1.0, 1, order=4)["u"].to_numpy()
    np.testing.assert_array_equal(again[:300], again[15:315])  # a given order repeats itself


def test_multisine_has_equal_lines_in_its_band_and_none_outside() -> None:
    frame = multisine(2.0, 1e-3, 3.0, 5.0, 40.0, period=1.0, offset=-1.0)
    lines = np.abs(np.fft.rfft(frame["u"] + 1.0)) / 1000  # 0.5 Hz apart; amplitudes
    wanted = np.zeros(1001, bool)
    wanted[10:81:2] = True
    np.testing.assert_allclose(lines[~wanted], 0.0, atol=1e-12)
    np.testing.assert_allclose(lines[wanted], lines[10], rtol=1e-9)
    assert np.abs(frame["u"] + 1.0).max() == pytest.approx(3.0, rel=1e-12)
    np.testing.assert_allclose(frame["u"][:1000], frame["u"][1000:], atol=1e-11)


@pytest.mark.parametrize("count", [8, 31, 200])
def test_multisine_has_low_peaks(count: int) -> None:
    """Schroeder: crest factors near 1.7, whatever the number of lines; without phases they are sqrt(2 n)."""
    values = multisine(1.0, 1 / 4096, 1.0, 1.0, float(count))["u"].to_numpy()
    crest = 1.0 / np.sqrt(np.mean(values**2))
    assert np.sqrt(2) < crest < 1.85


def test_steps() -> None:
    frame = step_sequence(1.0, 0.1, [1.0, -1.0, 2.0], offset=10.0, column="w")
    assert frame["w"].tolist() == [11.0] * 3 + [9.0] * 3 + [12.0] * 4
    given = step_sequence(1.0, 0.1, [0.0, 1.0, 3.0], times=[0.0, 0.3, 0.45])["u"]
    assert given.tolist() == [0.0] * 3 + [1.0] * 2 + [3.0] * 5


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: prbs(0.0, 1e-3, 1.0, 5), "duration must be greater"),
        (lambda: prbs(1.0, -1e-3, 1.0, 5), "step must be greater than 0"),
        (lambda: prbs(1.0, 0.3, 1.0, 1), "duration 1 s is 3.33333 samples of 0.3 s"),
        (lambda: prbs(1e9, 1e-3, 1.0, 1), r"1e\+12 samples of 0.001 s"),
        (lambda: prbs(1.0, 1e-3, float("nan"), 5), "amplitude must be finite"),
        (lambda: prbs(1.0, 1e-3, 1.0, 0), "must be a whole number from 1 to 1000"),
        (lambda: prbs(1.0, 1e-3, 1.0, 5, order=1), "order must be a whole number from 2 to 32"),
        (lambda: prbs(1.0, 1e-3, 1.0, 5, seed=-1), "seed must be a whole number, 0 or more"),
        (lambda: prbs(1.0, 1e-3, 1.0, 5, column="time"), "column: 'time'"),
        (lambda: multisine(1.0, 1e-3, 1.0, 5.0, 500.0), "below half the sampling rate, 500 Hz"),
        (lambda: multisine(1.0, 1e-3, 1.0, 5.0, 4.0), "highest 4 Hz must be from lowest, 5 Hz"),
        (lambda: multisine(1.0, 1e-3, 1.0, 5.2, 5.8), "no multiple of 1/period = 1 Hz from 5.2 to 5.8 Hz"),
        (lambda: step_sequence(1.0, 0.1, []), "0 levels do not fit 10 samples"),
        (lambda: step_sequence(1.0, 0.1, [1.0, 2.0], times=[0.0]), "2 levels but 1 times"),
        (lambda: step_sequence(1.0, 0.1, [1.0, 2.0], times=[0.1, 0.2]), "times must begin with 0"),
        (lambda: step_sequence(1.0, 0.1, [True]), "a level must be a number"),
    ],
)
def test_refusals(call: Callable[[], Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        call()
