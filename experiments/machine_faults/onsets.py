"""Since when: monitoring of a machine in which turns are shorted while it is watched.

    python -m experiments.machine_faults.onsets [DRAWS]

Run from the project's folder; it rewrites onsets.csv and the table "onsets" in README.md, and goes on where it was
interrupted. Records of 9 s in windows of 0.56 s, in the rotor's axes, noise as in make_tables.py; the machine is that
of machine.py, the speed changes at random. What was identified of a healthy record has other errors in each draw.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid
from experiments import calls, pages
from experiments.machine_faults import models
from experiments.machine_faults.machine import SPEED, SPEED_STEP, TURNS, Condition, run
from experiments.machine_faults.make_tables import BIT, SAMPLE_TIME, SUBSTEPS, add_noise
from fmuid.diagnosis import OnsetShape

HERE = Path(__file__).parent
FILE = HERE / "onsets.csv"
DRAWS, SEED, SHORTED = 50, 41, (2, 5, 10)
SAMPLES, BEGIN = 12_800, (3.5, 5.5)  # s, between which the short circuit comes
RULE = fmuid.Rule(window=0.56, transient=0.42, level=0.01)
BLOCK = RULE.window / 20  # type: ignore[operator]


def record(turns: int, phase: int, begin: int, rng: np.random.Generator, samples: int = SAMPLES) -> fmuid.Experiment:
    """Return a record in which turns of a phase are shorted from a sample on."""
    bits = np.append(0.0, rng.choice([-1.0, 1.0], samples // BIT))
    references = SPEED + SPEED_STEP * bits[np.arange(samples) // BIT]
    shorted = (begin, Condition(turns=turns, phase=phase))
    found = run(Condition(phase=phase), references, SAMPLE_TIME, SUBSTEPS, shorted if turns else None)
    frame = pd.DataFrame(found, columns=["uds", "uqs", "w", "theta", "ids", "iqs"])
    frame.insert(0, "time", SAMPLE_TIME * np.arange(samples))
    return fmuid.Experiment(add_noise(frame, rng), models.INPUTS, models.OUTPUTS, warmup=RULE.transient, name="new")


@cache
def healthy() -> fmuid.Result:
    """Return an identification of a healthy record."""
    searched = {name: fmuid.Parameter(value) for name, value in models.NOMINAL.items()}
    sound = record(0, 0, 0, np.random.default_rng(SEED))
    return fmuid.identify(fmuid.Problem(models.healthy_machine(), sound, searched, noise=fmuid.Noise(delay_std=0.0)))


def watched(new: fmuid.Experiment, rng: np.random.Generator) -> fmuid.Monitor:
    """Return the monitoring of a record."""
    first = healthy()
    known = replace(
        first,
        estimates=replace(first.estimates, values=first.values + first.std * rng.standard_normal(first.values.size)),
    )
    baseline = fmuid.Baseline(known, models.INFLATION)
    monitor = fmuid.Monitor(baseline, models.faults(), models.healthy_machine(), RULE)
    monitor.add(new)
    return monitor


def drawn(turns: int, draw: int) -> dict[str, float | str]:
    """Return what monitoring says of a fresh record."""
    rng, phase = np.random.default_rng([SEED, turns, draw]), draw % 3
    begin = int(rng.integers(round(BEGIN[0] / SAMPLE_TIME), round(BEGIN[1] / SAMPLE_TIME)))
    monitor = watched(record(turns, phase, begin, rng), rng)
    label = f"stator.fault.eta_{'abc'[phase]}"

    def right(alarm: fmuid.diagnosis.Alarm) -> bool:
        return alarm.explanations[0].changes[0].label == label

    named = calls.onset(monitor, begin * SAMPLE_TIME, OnsetShape.STEP, turns / TURNS, right)
    return {"turns": turns, "draw": draw, "alarm": int(bool(named)), **named}


def table(found: pd.DataFrame) -> str:
    """Return the table of all cases, as Markdown; rates with their 95 % intervals."""
    heads = ["turns", "draws", "alarm (%)", "phase right (%)", "after (s)", "D", "onset off by (s)"]
    heads += ["within 2 blocks (%)", "set holds it (%)", "its width (s)", "shape right (%)", "rms of error / std"]
    rows = []
    for turns, part in found.groupby("turns"):
        cells = [str(turns), str(len(part)), calls.rate(part["alarm"] == 1)]
        part = part[part["alarm"] == 1]
        cells += [calls.rate(part["right"] == 1), f"{part['late'].median():.2f}", f"{part['D'].median():.0f}"]
        cells += [f"{part['off'].median():.3f}", calls.rate(part["off"] <= 2 * BLOCK + 1e-9)]
        rows.append(cells + calls.dated(part))
    return pages.table(heads, rows)


def main() -> None:
    """Watch the records that are missing, and rewrite the page's table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS
    for turns in SHORTED:
        pages.continued(FILE, ("turns", turns), "draw", range(count), partial(drawn, turns))
    pages.rewrite(HERE, {"onsets": table(pd.read_csv(FILE))})


if __name__ == "__main__":
    main()
