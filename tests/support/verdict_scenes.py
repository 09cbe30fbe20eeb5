"""Coils with one error each, by equations of their own in steps of 1/16 sample."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import fmuid
from fmuid.array_types import Floats
from fmuid.identification import ErrorKind
from tests.support.paths import FMUS
from tests.support.verdicts import Flaw, Found, Plant, found_in

COIL, R, L, STEP = FMUS / "Coil" / "Coil.fmu", 4.0, 0.1, 0.002
SUBSTEPS = 16
RMS = 12.0 * math.sqrt(2.0 / 3.0)  # of the voltage
Rate = Callable[[float, Floats, Floats], Floats]


def voltages(rng: np.random.Generator, draws: int, count: int) -> Floats:
    """Return held voltages (draws, count): three levels, 15 samples each."""
    return 12.0 * np.repeat(rng.choice([-1.0, 0.0, 1.0], (draws, count // 15 + 2)), 15, axis=1)[:, :count]


def integrated(u: Floats, rate: Rate, *, states: int = 1, linear: bool = False) -> Floats:
    """Return the states (states, draws, 16 count) by Runge and Kutta; the voltage is held, or linear."""
    h, x = STEP / SUBSTEPS, np.zeros((states, len(u)))
    found = np.empty((states, len(u), u.shape[1] * SUBSTEPS))
    rise = np.diff(u, axis=1, append=u[:, -1:]) / SUBSTEPS if linear else np.zeros_like(u)
    for k in range(u.shape[1] * SUBSTEPS):
        found[:, :, k], t, n = x, k * h, k // SUBSTEPS
        a, c = (u[:, n] + rise[:, n] * (k % SUBSTEPS + part) for part in (0.0, 1.0))
        b = 0.5 * (a + c)
        k1 = rate(t, x, a)
        k2 = rate(t + h / 2, x + h / 2 * k1, b)
        k3 = rate(t + h / 2, x + h / 2 * k2, b)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, x + h * k3, c))
    return found


def plain(_: float, x: Floats, u: Floats) -> Floats:
    return (u - R * x) / L


@dataclass(frozen=True)
class Scene(Flaw):
    """An error with its current (draws, count) from voltages."""

    current: Callable[[Floats], Floats] = field(kw_only=True)


def read(found: Floats, late: float = 0.0) -> Floats:
    """Return samples (draws, count) of a fine record, read some samples late."""
    places = np.arange(found.shape[-1] // SUBSTEPS) * SUBSTEPS - round(late * SUBSTEPS)
    return np.where(places >= 0, found[..., np.maximum(places, 0)], 0.0)


def _sound(u: Floats, late: float = 0.0) -> Floats:
    return read(integrated(u, plain)[0], late)


def _late(samples: float) -> Scene:
    return Scene((ErrorKind.DELAY, ErrorKind.INPUT_DELAY), samples, current=lambda u: _sound(u, samples))


def _dead(share: float) -> Scene:
    size = share * RMS

    def current(u: Floats) -> Floats:
        return read(integrated(u, lambda _, x, v: (v - size * np.tanh(x / 0.02) - R * x) / L)[0])

    return Scene((ErrorKind.DEAD_TIME,), size, current=current)


def _saturated(share: float) -> Scene:
    def current(u: Floats) -> Floats:
        top = np.abs(_sound(u)).max()
        return read(integrated(u, lambda _, x, v: (v - R * x) / (L * (1.0 - share * (x / top) ** 2)))[0])

    return Scene((ErrorKind.SATURATION,), has_truth=False, current=current)


def _drifting(u: Floats) -> Floats:
    span = STEP * u.shape[1]
    return read(integrated(u, lambda t, x, v: (v - R * (1.0 + 0.1 * (t / span - 0.5)) * x) / L)[0])


def _eddy(u: Floats) -> Floats:
    """A resistor of 20 R beside the inductance."""
    current = integrated(u, lambda _, x, v: (v - R * x) / (1.0 + 1.0 / 20.0) / L)[0]
    fine = np.repeat(u, SUBSTEPS, axis=1)
    return read((current + fine / (20.0 * R)) / (1.0 + 1.0 / 20.0))


def _lagging(u: Floats) -> Floats:
    """A sensor with a lag of a sample."""
    return read(integrated(u, lambda _, x, v: np.stack([(v - R * x[0]) / L, (x[0] - x[1]) / STEP]), states=2)[1])


def _heating(u: Floats) -> Floats:
    """R rises with the energy, by 20 % at the end of a record of 1000 samples."""
    level = np.mean(_sound(u) ** 2)
    return read(
        integrated(
            u,
            lambda _, x, v: np.stack([(v - R * (1.0 + x[1]) * x[0]) / L, 0.1 * x[0] ** 2 / level - 0.5 * x[1]]),
            states=2,
        )[0]
    )


def _hysteretic(u: Floats) -> Floats:
    """A sensor with play of 3 % of the amplitude."""
    i = _sound(u)
    play, found = 0.03 * np.abs(i).max(), np.zeros_like(i)
    for k in range(1, i.shape[1]):
        found[:, k] = np.clip(found[:, k - 1], i[:, k] - play, i[:, k] + play)
    return found


def _cubic(u: Floats) -> Floats:
    i = _sound(u)
    return np.asarray(i - 0.05 * i**3 / np.abs(i).max() ** 2)


def _lost(u: Floats) -> Floats:
    """Two samples of the current are lost in the middle."""
    i = _sound(u)
    half = i.shape[1] // 2
    return np.hstack([i[:, :half], i[:, half + 2 :], i[:, -2:]])


SCENES = {
    # sound; the standard deviations allow for uneven noise and hum
    "honest": Scene(current=_sound),
    "uneven": Scene(current=_sound),
    "hum": Scene(current=_sound),
    # tested
    "late 0.5": _late(0.5),
    "late 1": _late(1.0),
    "sensor lag": Scene((ErrorKind.LAG,), 1.0, current=_lagging),
    "offset": Scene((ErrorKind.OFFSET, ErrorKind.INPUT_OFFSET), 0.05, current=lambda u: _sound(u) + 0.05),
    "gain 3 %": Scene((ErrorKind.GAIN, ErrorKind.INPUT_GAIN), 0.03, current=lambda u: 1.03 * _sound(u)),
    # held outputs of linear inputs come half a sample early
    "linear": Scene(
        (ErrorKind.INTERPOLATION, ErrorKind.ADVANCE), 1.0, current=lambda u: read(integrated(u, plain, linear=True)[0])
    ),
    "drift": Scene((ErrorKind.DRIFT, ErrorKind.STEP), 0.1, current=_drifting),
    "fixed": Scene((ErrorKind.FIXED,), 1.0 / 1.3 - 1.0, current=_sound),
    "dead 2 %": _dead(0.02),
    "dead 10 %": _dead(0.1),
    "play": Scene((ErrorKind.HYSTERESIS,), current=_hysteretic),
    "cubic sensor": Scene((ErrorKind.NONLINEARITY,), 0.05, current=_cubic),
    "saturation 5 %": _saturated(0.05),
    "saturation 15 %": _saturated(0.15),
    "heating": Scene((ErrorKind.DRIFT, ErrorKind.STEP, ErrorKind.STATE_DEPENDENCE), has_truth=False, current=_heating),
    # not tested: a doubt by names of several causes
    "eddy currents": Scene((ErrorKind.ADVANCE, ErrorKind.INPUT_ADVANCE), has_truth=False, current=_eddy),
    "lost samples": Scene((ErrorKind.CLOCK,), has_truth=False, current=_lost),
}


@cache
def records(scene: str, count: int, color: float, draws: int) -> tuple[Floats, Floats]:
    """Return voltages and noisy currents (draws, count), with 1/30 of the current's variance."""
    rng = np.random.default_rng([30, count, draws])
    u = voltages(rng, draws, count)
    sound, current = _sound(u), SCENES[scene].current(u)
    level = np.sqrt(np.mean(sound**2) / 30)
    noise = lfilter([np.sqrt(1.0 - color**2)], [1.0, -color], rng.standard_normal((draws, count + 100)))[:, 100:]
    if scene == "uneven":
        noise = noise * np.abs(sound) / np.sqrt(np.mean(sound**2))
    if scene == "hum":
        noise = noise + np.cos(2.0 * np.pi * 50.0 * STEP * np.arange(count) + 1.0)
    return u, current + level * noise


def found_of(scene: str, u: Floats, i: Floats, delay_std: float = 0.29) -> Found:
    """Return what the tool says of a record."""
    frame = pd.DataFrame({"time": STEP * np.arange(len(u)), "u": u, "i": i})
    given = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.03, min=1e-4)}
    fixed = {"L": 1.3 * L} if scene == "fixed" else {}
    parameters = {name: each for name, each in given.items() if name not in fixed}
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")
    return found_in(fmuid.Problem(COIL, experiment, parameters, values=fixed, noise=fmuid.Noise(delay_std=delay_std)))


@cache
def _found(count: int, name: str, color: float) -> list[Found]:
    return [found_of(name, *each) for each in zip(*records(name, count, color, 200), strict=True)]


def coils(count: int) -> Plant:
    """Return coils over records of some samples."""
    return Plant(SCENES, {"R": R, "L": L}, partial(_found, count))
