"""Since when, how large, and how often for nothing: monitoring of a coil that loses turns while it is watched.

    python -m experiments.coil.onsets [DRAWS]

Run from the project's folder; it rewrites the table "onsets" in README.md. Records of 12 s in windows of 0.5 s, each
with a healthy record of its own; the data are the closed form of the coil, made without any FMU. R may drift by 0.5 Ω.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import fmuid
from experiments import pages
from experiments.coil import study
from fmuid.diagnosis import Shape

HERE = Path(__file__).parent
DRAWS, SEED = 100, 11
SECONDS, WINDOW, TRANSIENT, BLOCK = 12, 0.5, 0.2, 0.025
DRIFT_R = 0.5


class Case(NamedTuple):
    """ΔR at the onset (Ω), its rise (Ω/s), and whether the healthy record has the causes beside the fault."""

    size: float
    rise: float = 0.0
    beside: bool = False


CASES = {
    "nothing": Case(0.0),
    "nothing, all causes": Case(0.0, beside=True),
    "step of 0.15 Ω": Case(0.15),
    "step of 0.3 Ω": Case(0.3),
    "step of 1 Ω": Case(1.0),
    "step of 1 Ω, all causes": Case(1.0, beside=True),
    "ramp of 0.1 Ω/s": Case(0.0, 0.1),
}


def record(case: Case, begin: float, rng: np.random.Generator, name: str, seconds: int = SECONDS) -> fmuid.Experiment:
    """Return a record whose coil loses turns from a time on, in steps of 25 ms."""
    samples, block = round(seconds / study.STEP), round(BLOCK / study.STEP)
    voltage = np.repeat(rng.choice([-1.0, 1.0], samples // study.BIT + 1), study.BIT)[:samples]
    current, state = np.empty(samples), 0.0
    for first in range(0, samples, block):
        since = first * study.STEP - begin
        fault = case.size + case.rise * since if since >= 0 else 0.0
        resistance, inductance = study.R + fault, study.L + 2 * study.TAU * fault
        decay = math.exp(-resistance / inductance * study.STEP)
        part = slice(first, first + block)
        driven = lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage[part])
        current[part] = driven + state * decay ** np.arange(block)
        state = current[part][-1] * decay + (1.0 - decay) / resistance * voltage[part][-1]
    current += math.sqrt(study.NOISE_VARIANCE) * rng.standard_normal(samples)
    frame = pd.DataFrame({"time": study.STEP * np.arange(samples), "u": voltage, "i": current})
    return fmuid.Experiment(frame, ["u"], ["i"], interpolation="hold", discard=TRANSIENT, name=name)


def row(case: Case, key: int, count: int) -> str:
    """Return the cells of a case."""
    rng = np.random.default_rng([SEED, key])
    coil, faulty = study.models()
    found, right, late, off, held, width, shape, scaled = 0, 0, [], [], [], [], [], []
    parameters = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-4)}
    first = fmuid.identify(fmuid.Problem(coil, record(Case(0.0), math.inf, rng, "healthy"), parameters))
    truth = np.array([study.R, study.L])
    for _ in range(count):
        healthy = record(Case(0.0), math.inf, rng, "healthy")
        # what an identification of it would give: the truth with the errors that it states
        known = replace(first, values=truth + first.std * rng.standard_normal(2))
        inflate = {"R": math.hypot(1.0, DRIFT_R / float(known.std[known.names.index("R")]))}
        turns = fmuid.Fault(faulty, {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": known["L"] / known["R"]})
        baseline = fmuid.Baseline(known, inflate, records=[healthy] if case.beside else [])
        monitor = fmuid.Monitor(baseline, {"turns": turns}, coil, fmuid.Rule(WINDOW, TRANSIENT, study.LEVEL))
        begin = float(rng.uniform(4.0, 7.0) // BLOCK * BLOCK)
        monitor.add(record(case, begin, rng, "new"))
        alarms = [each for each in monitor.alarms if each.onset is not None]
        found += bool(monitor.alarms)
        if not alarms or not (case.size or case.rise):
            continue
        alarm, onset = alarms[-1], alarms[-1].onset
        assert onset is not None  # those without are left out
        right += "turns" in alarm.fault.split(" or ")
        late.append(alarms[0].time - begin)
        off.append(abs(onset.likely.time - begin))
        held.append(onset.first.time - 1e-9 <= begin <= onset.last.time + 1e-9)
        width.append(onset.last.time - onset.first.time)
        shape.append(onset.shape is (Shape.RAMP if case.rise else Shape.STEP))
        change = alarm.explanations[0].changes[0] if alarm.explanations else None
        if change is not None and change.fault and not case.rise:
            scaled.append((change.value - case.size) / change.std)
    cells = [f"{100 * found / count:.1f}"]
    if off:
        cells += [f"{100 * right / len(off):.0f}", f"{np.median(late):.2f}", f"{np.median(off):.3f}"]
        cells += [f"{100 * np.mean(np.array(off) <= 2 * BLOCK + 1e-9):.0f}", f"{100 * np.mean(held):.0f}"]
        cells += [f"{np.median(width):.2f}", f"{100 * np.mean(shape):.0f}"]
        cells.append(f"{math.sqrt(float(np.mean(np.square(scaled)))):.2f}" if scaled else "")
    return " | ".join(cells + [""] * (9 - len(cells)))


def table(count: int) -> str:
    """Return the table of all cases."""
    lines = [
        f"| {count} draws each | alarm (%) | turns among the named (%) | after (s) | onset off by (s) "
        "| within 2 blocks (%) | set holds it (%) | its width (s) | shape right (%) | rms of error / std |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for key, (name, case) in enumerate(CASES.items()):
        lines.append(f"| {name} | {row(case, key, count)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def main() -> None:
    """Rewrite the page's table."""
    pages.rewrite(HERE, {"onsets": table(int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS)})


if __name__ == "__main__":
    main()
