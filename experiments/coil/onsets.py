"""Since when, how large, and how often for nothing: monitoring of a coil that loses turns while it is watched.

    python -m experiments.coil.onsets [DRAWS]

Run from the project's folder; it rewrites onsets.csv and the table "onsets" in README.md, and goes on where it was
interrupted. Records of 12 s in windows of 0.5 s, each with a healthy record of its own; the data are the closed form of
the coil, made without any FMU. R may drift by 0.5 Ω.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import fmuid
from experiments import calls, pages
from experiments.coil import study
from experiments.coil.calls import DRIFT, SOUND, Off, sensor
from fmuid.diagnosis import OnsetShape

HERE = Path(__file__).parent
FILE = HERE / "onsets.csv"
DRAWS, SEED = 100, 23  # the seed is none by which anything was chosen
SECONDS, WINDOW, TRANSIENT, BLOCK = 12, 0.5, 0.2, 0.025
DRIFT_R = DRIFT["R"]
LARGE = 100.0  # D from which on an onset is to be dated within two blocks


class Case(NamedTuple):
    """ΔR at the onset (Ω), its rise (Ω/s), whether the healthy record has the causes beside the fault.

    `drawn`: the sensor is off in both records and R drifts, as much as the monitoring is told.
    """

    size: float
    rise: float = 0.0
    beside: bool = False
    drawn: bool = False


CASES = {
    "step of 0.3 Ω": Case(0.3),
    "step of 1 Ω": Case(1.0),
    "step of 0.15 Ω": Case(0.15),
    "ramp of 0.1 Ω/s": Case(0.0, 0.1),
    "nothing": Case(0.0),
    "step of 1 Ω, all causes": Case(1.0, beside=True),
    "nothing, all causes": Case(0.0, beside=True),
    "step of 1 Ω, all causes, sensor and drifts drawn": Case(1.0, beside=True, drawn=True),
}


def record(
    case: Case,
    begin: float,
    rng: np.random.Generator,
    name: str,
    seconds: int = SECONDS,
    *,
    sensor: Off = SOUND,
    drift: tuple[float, float] = (0.0, 0.0),
) -> fmuid.Experiment:
    """Return a record whose coil loses turns from a time on, in steps of 25 ms.

    R drifts by the first part of `drift` (Ω) in all of the record, and from that time on by the second besides.
    """
    samples, block = round(seconds / study.STEP), round(BLOCK / study.STEP)
    voltage = np.repeat(rng.choice([-1.0, 1.0], samples // study.BIT + 1), study.BIT)[:samples]

    def coil(since: float) -> tuple[float, float]:
        fault, drifted = (case.size + case.rise * since, sum(drift)) if since >= 0 else (0.0, drift[0])
        return study.R + fault + drifted, study.L + 2 * study.TAU * fault

    coils = (coil(first * study.STEP - begin) for first in range(0, samples, block))
    current = study.piecewise(voltage, coils, block)
    seen = sensor.seen(current) + math.sqrt(study.NOISE_VARIANCE) * rng.standard_normal(samples)
    frame = pd.DataFrame({"time": study.STEP * np.arange(samples), "u": voltage, "i": seen})
    return fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh", warmup=TRANSIENT, name=name)


@cache
def parameters() -> tuple[fmuid.Result, fmuid.System, fmuid.System]:
    """Return an identification of a healthy record, and the models."""
    searched = {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-4)}
    healthy = record(Case(0.0), math.inf, np.random.default_rng(SEED), "healthy")
    return fmuid.identify(
        fmuid.Problem(study.models()[0], healthy, searched, noise=fmuid.Noise(delay_std=0.0))
    ), *study.models()


def drawn(name: str, draw: int) -> dict[str, float | str]:
    """Return what monitoring says of a fresh record of a case beside a fresh healthy one."""
    case, rng = CASES[name], np.random.default_rng([SEED, list(CASES).index(name), draw])
    first, coil, faulty = parameters()
    seen_by = sensor(rng) if case.drawn else SOUND
    healthy = [record(Case(0.0), math.inf, rng, "healthy", sensor=seen_by)] if case.beside else []
    # what an identification of it would give: the truth with the errors that it states
    known = replace(
        first,
        estimates=replace(first.estimates, values=np.array([study.R, study.L]) + first.std * rng.standard_normal(2)),
    )
    inflate = {"R": math.hypot(1.0, DRIFT_R / float(known.std[known.names.index("R")]))}
    turns = fmuid.Fault(faulty, {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": known["L"] / known["R"]})
    baseline = fmuid.Baseline(known, inflate, records=healthy)
    monitor = fmuid.Monitor(baseline, {"turns": turns}, coil, fmuid.Rule(WINDOW, TRANSIENT, study.LEVEL))
    begin = float(rng.uniform(4.0, 7.0) // BLOCK * BLOCK)
    always, since = (DRIFT_R * rng.standard_normal(2)).tolist() if case.drawn else (0.0, 0.0)
    monitor.add(record(case, begin, rng, "new", sensor=seen_by, drift=(always, since)))
    found: dict[str, float | str] = {"case": name, "draw": draw, "alarm": int(bool(monitor.alarms))}
    if not (case.size or case.rise):
        return found
    shape, size = (OnsetShape.RAMP, math.nan) if case.rise else (OnsetShape.STEP, case.size)
    return found | calls.onset(monitor, begin, shape, size, lambda alarm: "turns" in alarm.fault.split(" or "))


def table(found: pd.DataFrame) -> str:
    """Return the table of all cases, as Markdown; rates with their 95 % intervals."""
    heads = ["", "draws", "alarm (%)", "after (s)", "onset off by (s)", "D > 100: within 2 blocks (%)",
             "set holds it (%)", "its width (s)", "shape right (%)", "rms of error / std"]  # fmt: skip
    rows = []
    for name, case in CASES.items():
        part = found[found["case"] == name]
        cells = [name, str(len(part)), calls.rate(part["alarm"] == 1)]
        if case.size or case.rise:
            dated = part[part["alarm"] == 1].dropna(subset=["off"])
            cells += [f"{dated['late'].median():.2f}", f"{dated['off'].median():.3f}"]
            cells += [calls.rate(dated[dated["D"] > LARGE]["off"] <= 2 * BLOCK + 1e-9)]
            cells += calls.dated(dated)
        rows.append(cells)
    return pages.table(heads, rows)


def main() -> None:
    """Watch the records that are missing, and rewrite the page's table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS
    for name in CASES:
        pages.continued(FILE, ("case", name), "draw", range(count), partial(drawn, name))
    pages.rewrite(HERE, {"onsets": table(pd.read_csv(FILE))})


if __name__ == "__main__":
    main()
