"""Coils with one error each, by equations of their own in steps of 1/16 sample, and what the tool says of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import fmuid
from fmuid.array_types import Floats
from fmuid.estimation import Verdict
from fmuid.identification import Assessment, ErrorKind, assess, find_model_errors, judge, refit
from fmuid.identification.data_defects import without_clipped
from tests.support.paths import FMUS

COIL, R, L, STEP = FMUS / "Coil" / "Coil.fmu", 4.0, 0.1, 0.002
SUBSTEPS = 16
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
class Scene:
    """An error: its current (draws, count) from voltages, and kinds that name it; none: a doubt.

    Attributes
    ----------
    current : callable
    kinds : frozenset of ErrorKind
    """

    current: Callable[[Floats], Floats]
    kinds: frozenset[ErrorKind] = frozenset()


def read(found: Floats, late: float = 0.0) -> Floats:
    """Return samples (draws, count) of a fine record, read some samples late."""
    places = np.arange(found.shape[-1] // SUBSTEPS) * SUBSTEPS - round(late * SUBSTEPS)
    return np.where(places >= 0, found[..., np.maximum(places, 0)], 0.0)


def _of(rate: Rate, **how: bool) -> Callable[[Floats], Floats]:
    return lambda u: read(integrated(u, rate, **how)[0])


def _dead(share: float) -> Scene:
    def current(u: Floats) -> Floats:
        size = share * np.sqrt(np.mean(u**2))
        return read(integrated(u, lambda _, x, v: (v - size * np.tanh(x / 0.02) - R * x) / L)[0])

    return Scene(current, frozenset({ErrorKind.DEAD_TIME}))


def _saturated(share: float) -> Scene:
    def current(u: Floats) -> Floats:
        top = np.abs(read(integrated(u, plain)[0])).max()
        return read(integrated(u, lambda _, x, v: (v - R * x) / (L * (1.0 - share * (x / top) ** 2)))[0])

    return Scene(current, frozenset({ErrorKind.SATURATION}))


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
    level = np.mean(read(integrated(u, plain)[0]) ** 2)
    return read(
        integrated(
            u,
            lambda _, x, v: np.stack([(v - R * (1.0 + x[1]) * x[0]) / L, 0.1 * x[0] ** 2 / level - 0.5 * x[1]]),
            states=2,
        )[0]
    )


def _hysteretic(u: Floats) -> Floats:
    """A sensor with play of 3 % of the amplitude."""
    i = read(integrated(u, plain)[0])
    play, found = 0.03 * np.abs(i).max(), np.zeros_like(i)
    for k in range(1, i.shape[1]):
        found[:, k] = np.clip(found[:, k - 1], i[:, k] - play, i[:, k] + play)
    return found


def _cubic(u: Floats) -> Floats:
    i = read(integrated(u, plain)[0])
    return np.asarray(i - 0.05 * i**3 / np.abs(i).max() ** 2)


def _lost(u: Floats) -> Floats:
    """Two samples of the current are lost in the middle."""
    i = read(integrated(u, plain)[0])
    half = i.shape[1] // 2
    return np.hstack([i[:, :half], i[:, half + 2 :], i[:, -2:]])


DELAYS = frozenset({ErrorKind.DELAY, ErrorKind.INPUT_DELAY})
SCENES = {
    "honest": Scene(_of(plain)),
    "late 0.5": Scene(lambda u: read(integrated(u, plain)[0], 0.5), DELAYS),
    "late 1": Scene(lambda u: read(integrated(u, plain)[0], 1.0), DELAYS),
    "offset": Scene(
        lambda u: read(integrated(u, plain)[0]) + 0.05, frozenset({ErrorKind.OFFSET, ErrorKind.INPUT_OFFSET})
    ),
    "gain 3 %": Scene(lambda u: 1.03 * read(integrated(u, plain)[0])),
    "linear": Scene(_of(plain, linear=True), frozenset({ErrorKind.INTERPOLATION})),
    "drift": Scene(_drifting, frozenset({ErrorKind.DRIFT, ErrorKind.STEP})),
    "fixed": Scene(_of(plain), frozenset({ErrorKind.FIXED})),
    "dead 2 %": _dead(0.02),
    "dead 10 %": _dead(0.1),
    "saturation 5 %": _saturated(0.05),
    "saturation 15 %": _saturated(0.15),
    "uneven": Scene(_of(plain)),
    "hum": Scene(_of(plain)),
    # not on the list
    "eddy currents": Scene(_eddy),
    "sensor lag": Scene(_lagging),
    "heating": Scene(_heating),
    "play": Scene(_hysteretic),
    "cubic sensor": Scene(_cubic),
    "lost samples": Scene(_lost),
}


@dataclass(frozen=True, eq=False)
class Found:
    """What the tool says of a record.

    Attributes
    ----------
    verdict : Verdict
    names : tuple of frozenset of ErrorKind
        Kinds of each error found and its alternatives.
    values, std : (N,) arrays
        Of R and L.
    before : (N,) array
        Estimates without freed errors.
    """

    verdict: Verdict
    names: tuple[frozenset[ErrorKind], ...]
    values: Floats
    std: Floats
    before: Floats


@cache
def records(scene: str, count: int, color: float, draws: int) -> tuple[Floats, Floats]:
    """Return voltages and noisy currents (draws, count), with 1/30 of the current's variance."""
    rng = np.random.default_rng([30, count, draws])
    u = voltages(rng, draws, count)
    sound, current = read(integrated(u, plain)[0]), SCENES[scene].current(u)
    level = np.sqrt(np.mean(sound**2) / 30)
    noise = lfilter([np.sqrt(1.0 - color**2)], [1.0, -color], rng.standard_normal((draws, count + 100)))[:, 100:]
    if scene == "uneven":
        noise = noise * np.abs(sound) / np.sqrt(np.mean(sound**2))
    if scene == "hum":
        noise = noise + np.cos(2.0 * np.pi * 50.0 * STEP * np.arange(count) + 1.0)
    return u, current + level * noise


def found_of(scene: str, u: Floats, i: Floats, delay_std: float = 0.29) -> Found:
    """Identify, test, refit and judge as `fmuid.run` does."""
    frame = pd.DataFrame({"time": STEP * np.arange(len(u)), "u": u, "i": i})
    given = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.03, min=1e-4)}
    fixed = {"L": 1.3 * L} if scene == "fixed" else {}
    parameters = {name: each for name, each in given.items() if name not in fixed}
    experiment = fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")
    problem = fmuid.Problem(COIL, experiment, parameters, values=fixed, noise=fmuid.Noise(delay_std=delay_std))
    result = fmuid.identify(problem)
    before = result.values
    cut = without_clipped(problem, result)
    if cut is not None:
        problem = cut[0]
        result = fmuid.identify(problem)
    tested = problem.as_in(result)
    errors = find_model_errors(tested, result)
    again = refit(tested, result, errors) if errors is not None and errors.errors else None
    base, own = (tested, result) if again is None else (again.problem, again.result)
    errors = errors if again is None else again.found
    checks = assess(base, own, earlier=Assessment(model_errors=errors))
    checks = replace(checks, data_defects=(*(() if cut is None else cut[1]), *checks.data_defects))
    named = () if errors is None else tuple(each.kinds for each in (*errors.freed, *errors.errors))
    size = len(parameters)
    return Found(judge(own, checks), named, own.values[:size], own.std[:size], before)
