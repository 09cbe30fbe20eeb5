"""Machines with one error each, in their windings by equations of their own (`winding_machine`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

import fmuid
from fmuid.array_types import Floats
from fmuid.identification import ErrorKind
from tests.support.paths import FMUS
from tests.support.verdicts import Flaw, Found, Plant, found_in
from tests.support.winding_machine import MACHINE, STEP, STEPS, Condition, currents, excitation, fine_times, to_axes

MODEL = FMUS / "InductionMachine" / "InductionMachine.fmu"
COUNT, DRAWS, NOISE = 3000, 100, 0.1
DELAY = ErrorKind.DELAY, ErrorKind.INPUT_DELAY


@dataclass(frozen=True)
class Scene(Flaw):
    """An error of the machine, of the sensors, or of a fixed parameter.

    Sensors make currents (K, 2) of times and currents at all steps of the integration.
    """

    machine: Mapping[str, Any] = field(default_factory=dict)
    sensed: Callable[[Floats, Floats], Floats] = field(default=lambda _, axes: axes[::STEPS])
    fixed: Mapping[str, float] = field(default_factory=dict)


def _late(samples: float) -> Scene:
    def sensed(times: Floats, axes: Floats) -> Floats:
        return np.asarray(CubicSpline(times, axes)(np.maximum(times[::STEPS] - samples * STEP, 0.0)))

    return Scene(DELAY, samples, sensed=sensed)


MAIN = ErrorKind.STATE_DEPENDENCE, ErrorKind.SATURATION
SCENES = {
    "honest": Scene(),
    "late 0.5": _late(0.5),
    "late 1": _late(1.0),
    "offset": Scene((ErrorKind.OFFSET,), 0.1, sensed=lambda _, axes: axes[::STEPS] + np.array([0.1, 0.0])),
    "gain 3 %": Scene((ErrorKind.GAIN,), 0.03, sensed=lambda _, axes: axes[::STEPS] * [1.03, 1.0]),
    "dead 1.5 V": Scene((ErrorKind.DEAD_TIME,), math.inf, machine={"dead_time": 1.5}),
    "dead 7 V": Scene((ErrorKind.DEAD_TIME,), math.inf, machine={"dead_time": 7.0}),
    "saturation 5 %": Scene(MAIN, 0.05, has_truth=False, machine={"saturation": 0.05}),
    "saturation 15 %": Scene(MAIN, math.inf, has_truth=False, machine={"saturation": 0.15}),
    "fixed": Scene((ErrorKind.FIXED,), 1.0 / 1.3 - 1.0, fixed={"Rr": 1.3 * MACHINE["Rr"]}),
}


@cache
def _lines(name: str) -> tuple[list[tuple[Floats, ...]], Floats]:
    """Return drives, and fine currents of their lines."""
    drives = [excitation(COUNT, 5000 + k) for k in range(DRAWS)]
    return [*drives], currents(drives, [Condition(**SCENES[name].machine)] * DRAWS, fine=True)


@cache
def _found(name: str, color: float) -> list[Found]:
    scene, rng, found = SCENES[name], np.random.default_rng(77), list[Found]()
    for (times, speed, angle, volts), lines in zip(*_lines(name), strict=True):
        drawn = rng.standard_normal((COUNT + 100, 2))
        noise = lfilter([np.sqrt(1.0 - color**2)], [1.0, -color], drawn, axis=0)[100:]
        fine = fine_times(COUNT)
        turned = angle[0] + cumulative_trapezoid(np.interp(fine, times, speed), fine, initial=0)
        axes = scene.sensed(fine, to_axes(lines, turned)) + NOISE * noise
        columns = {"uds": volts[:, 0], "uqs": volts[:, 1], "w": speed, "ids": axes[:, 0], "iqs": axes[:, 1]}
        frame = pd.DataFrame({"time": times, **columns})
        experiment = fmuid.Experiment(frame, ["uds", "uqs", "w"], ["ids", "iqs"])
        free = {each: fmuid.Parameter(1.2 * value, min=0.0) for each, value in MACHINE.items()}
        parameters = {each: given for each, given in free.items() if each not in scene.fixed}
        noisy = fmuid.Noise(delay_std=0.29)
        found.append(found_in(fmuid.Problem(MODEL, experiment, parameters, values=scene.fixed, noise=noisy)))
    return found


def machines() -> Plant:
    """Return machines over records of 3000 samples."""
    return Plant(SCENES, MACHINE, _found, DRAWS)
