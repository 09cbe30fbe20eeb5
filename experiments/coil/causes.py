"""Turns, a sensor, or only what has always been so: what is named when the causes beside a fault are looked at too.

    python -m experiments.coil.causes

Run from the project's folder; it rewrites the table "causes" in README.md. The data are the closed form of the coil,
made without any FMU; each draw has a healthy record and a new one.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import fmuid
from experiments import pages
from experiments.coil import study
from fmuid.arrays import Floats

HERE = Path(__file__).parent
DRAWS, SEED, SETTLING = 50, 7, 50
DRIFT_R, DRIFT_L = 0.5, 0.0013  # Ω, H: standard deviations of what may change without being a fault


class Off(NamedTuple):
    """What a record has that the healthy coil has not; noise of an autoregression of order 1."""

    turns: float = 0.0  # Ω
    resistance: float = 0.0  # Ω
    inductance: float = 0.0  # H
    gain: float = 0.0
    offset: float = 0.0  # standard deviations of the noise
    delay: float = 0.0  # s
    colour: float = 0.0


class Case(NamedTuple):
    """A row of the table: in both records, only in the new one, and the cause that is right."""

    always: Off
    new: Off
    right: str


ALWAYS = Off(gain=0.02, offset=0.25, delay=2e-4)
CASES = {
    "nothing": Case(Off(), Off(), ""),
    "nothing, coloured noise (AR 0.8)": Case(Off(colour=0.8), Off(colour=0.8), ""),
    "warm, R + 1 Ω": Case(Off(), Off(resistance=1.0), ""),
    "sensor off in both records": Case(ALWAYS, ALWAYS, ""),
    "turns, ΔR = 1 Ω": Case(Off(), Off(turns=1.0), "fault dR"),
    "turns, ΔR = 1 Ω, warm": Case(Off(), Off(turns=1.0, resistance=1.0), "fault dR"),
    "turns, ΔR = 1 Ω, sensor off in both": Case(ALWAYS, ALWAYS._replace(turns=1.0), "fault dR"),
    "turns, ΔR = 0.2 Ω": Case(Off(), Off(turns=0.2), "fault dR"),
    "inductance + 10 %": Case(Off(), Off(inductance=0.01), "parameter L"),
    "sensor's gain − 20 %": Case(Off(), Off(gain=-0.2), "gain i"),
    "sensor's offset, half a std of the noise": Case(Off(), Off(offset=0.5), "offset i"),
    "sensor's delay, 1 ms": Case(Off(), Off(delay=1e-3), "delay i"),
}


def record(off: Off, rng: np.random.Generator) -> fmuid.Experiment:
    """Return a record of the coil with something off."""
    clean: Floats = study.current(
        study.R + off.resistance + off.turns, study.L + off.inductance + 2.0 * study.TAU * off.turns
    )
    std = math.sqrt(study.NOISE_VARIANCE)
    white = std * math.sqrt(1.0 - off.colour**2) * rng.standard_normal(study.SAMPLES + SETTLING)
    noise = lfilter([1.0], [1.0, -off.colour], white)[SETTLING:]
    late = clean - off.delay * np.gradient(clean, study.STEP)
    seen = (1.0 + off.gain) * late + off.offset * std + noise
    time = study.STEP * np.arange(study.SAMPLES)
    return study.experiment(pd.DataFrame({"time": time, "u": study.voltage(), "i": seen}))


def names(found: fmuid.Diagnosis) -> list[str]:
    """Return what a diagnosis names, the likeliest first."""
    explanations = found.evidence.explanations if found.evidence is not None else ()
    return [" + ".join(f"{each.kind.value} {each.variable}" for each in one.changes) for one in explanations]


def row(case: Case, key: int, count: int) -> dict[str, float | str]:
    """Return the rates of a case, in percent, and the first names most often given."""
    rng, tally = np.random.default_rng([SEED, key]), Counter[str]()
    called = among = alone = fault = 0
    coil, faulty = study.models()
    for _ in range(count):
        healthy = record(case.always, rng)
        known = fmuid.identify(
            fmuid.Problem(coil, healthy, {"R": fmuid.Parameter(3.0, min=0.0), "L": fmuid.Parameter(0.2, min=1e-4)})
        )
        inflate = {
            name: math.hypot(1.0, drift / float(known.std[known.names.index(name)]))
            for name, drift in (("R", DRIFT_R), ("L", DRIFT_L))
        }
        turns = fmuid.Fault(faulty, {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": known["L"] / known["R"]})
        baseline = fmuid.Baseline(known, inflate, records=[healthy])
        settings = fmuid.DiagnosisSettings(study.LEVEL)
        found = fmuid.diagnose(record(case.new, rng), baseline, {"turns": turns}, coil, settings)
        named = names(found)
        called += bool(named)
        among += case.right in named
        alone += named == [case.right]
        fault += found.kind == "fault"
        tally[named[0] if named else "nothing"] += 1
    return {
        "called": 100 * called / count,
        "among": 100 * among / count,
        "alone": 100 * alone / count,
        "fault": 100 * fault / count,
        "first": ", ".join(f"{name} {100 * times / count:.0f}" for name, times in tally.most_common(3)),
    }


def table(count: int = DRAWS) -> str:
    """Return the table of all cases."""
    lines = [
        "| in the new record | called (%) | the truth named | alone | a fault alone | named first, % |",
        "|---|---|---|---|---|---|",
    ]
    for key, (name, case) in enumerate(CASES.items()):
        found = row(case, key, count)
        truth = (f"{found['among']:.1f}", f"{found['alone']:.1f}") if case.right else ("", "")
        rates = f"{found['called']:.1f} | {truth[0]} | {truth[1]} | {found['fault']:.1f}"
        lines.append(f"| {name} | {rates} | {found['first']} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def main() -> None:
    """Rewrite the page's table."""
    pages.rewrite(HERE, {"causes": table()})


if __name__ == "__main__":
    main()
