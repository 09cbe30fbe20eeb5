"""A coil of its own equations: monitored under noise of four kinds, and at operating points of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil

STEP, R, L, STD = 1e-3, 4.0, 0.1, 0.0224  # s, Ω, H; A: a thirtieth of the current's power
WINDOW, WINDOWS = 0.25, 40
FAULTS = {"turns": fmuid.Fault(coil.models()[1], {"dR": fmuid.Parameter(0.0, nominal=1.0)}, values={"tau": L / R})}
KINDS = ("white", "AR 0.6", "t3", "hum", "mixture")


def noise(kind: str, rng: np.random.Generator, count: int) -> np.ndarray:
    """Return noise of variance 1."""
    parts: dict[str, Callable[[], np.ndarray]] = {
        "white": lambda: rng.standard_normal(count),
        "AR 0.6": lambda: lfilter([0.8], [1.0, -0.6], rng.standard_normal(count + 300))[300:],
        "t3": lambda: rng.standard_t(3, count) / math.sqrt(3.0),
        "hum": lambda: np.cos(2 * math.pi * 50 * STEP * np.arange(count) + rng.uniform(0, 2 * math.pi)),
    }
    if kind == "hum":
        return np.asarray(0.7 * parts["white"]() + parts["hum"]())
    if kind == "mixture":
        return 0.5 * parts["AR 0.6"]() + 0.5 * parts["t3"]() + 0.7 * parts["hum"]()
    return parts[kind]()


def record(rng: np.random.Generator, kind: str, count: int, fault: np.ndarray | float = 0.0) -> fmuid.Experiment:
    """Return a record of the coil with ΔR = fault (count,) and ΔL = 2 τ ΔR, sample by sample in closed form."""
    voltage = np.repeat(rng.choice([-1.0, 1.0], count // coil.BIT + 1), coil.BIT)[:count]
    resistance = R + np.broadcast_to(fault, count)
    decay = np.exp(-resistance / (L + 2.0 * L / R * (resistance - R)) * STEP)
    drive, current = (1.0 - decay) / resistance * voltage, np.zeros(count)
    for k in range(count - 1):
        current[k + 1] = decay[k] * current[k] + drive[k]
    frame = pd.DataFrame({"time": STEP * np.arange(count), "u": voltage, "i": current + STD * noise(kind, rng, count)})
    return fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh", name=str(count))


def baseline(records: Sequence[fmuid.Experiment]) -> fmuid.Baseline:
    """Return the baseline of healthy records, identified from the first."""
    parameters = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-4)}
    result = fmuid.identify(fmuid.Problem(coil.models()[0], records[0], parameters))
    return fmuid.Baseline(result, {"R": 10.0}, records=records)


def monitor(rng: np.random.Generator, kind: str, *, with_records: bool) -> fmuid.Monitor:
    """Return a monitor of a fresh healthy record of 3 s."""
    healthy = record(rng, kind, 3000)
    known = baseline([healthy])
    known = known if with_records else replace(known, records=())
    return fmuid.Monitor(known, FAULTS, coil.models()[0], fmuid.Rule(window=WINDOW, transient=0.2))


SAMPLES = round(WINDOW * WINDOWS / STEP) + 200


def operated(rng: np.random.Generator, **off: float) -> fmuid.Experiment:
    """Return a record of 1.2 s of a coil with saturation and an inverter drop, by Runge-Kutta steps of 0.25 ms."""
    amplitude, bit, count = rng.uniform(0.7, 1.3), int(rng.integers(12, 20)), 1200
    resistance, turns = R * rng.uniform(0.95, 1.1), off.get("turns", 0.0)
    voltage = amplitude * (np.repeat(rng.choice([-1.0, 1.0], count // bit + 1), bit)[:count] + rng.uniform(-0.3, 0.3))
    current, step, x = np.zeros(count), STEP / 4, 0.0

    def rate(i: float, u: float) -> float:
        own = (L + 2.0 * L / R * turns) * (1.0 - off.get("saturation", 0.0) * min(i * i / 0.16, 1.5))
        return (u - off.get("dead", 0.0) * math.tanh(i / 0.02) - (resistance + turns) * i) / own

    for k, u in enumerate(voltage[:-1].tolist()):
        for _ in range(4):
            a = rate(x, u)
            b = rate(x + step * a / 2, u)
            c = rate(x + step * b / 2, u)
            x += step * (a + 2 * b + 2 * c + rate(x + step * c, u)) / 6
        current[k + 1] = x
    times = STEP * np.arange(count)
    seen = (1.0 + off.get("gain", 0.0)) * np.interp(times - off.get("delay", 0.0), times, current)
    seen = seen + off.get("offset", 0.0) + 0.01 * rng.standard_normal(count)
    frame = pd.DataFrame({"time": times, "u": voltage, "i": seen})
    return fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh", name=str(rng.integers(1 << 40)))
