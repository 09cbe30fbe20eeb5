"""Turns, a sensor, or only what has always been so: false, missed and wrong calls of a coil, counted.

    python -m experiments.coil.calls

Run from the project's folder; it rewrites calls.csv, unlisted.csv and the tables "false", "calls" and "unlisted" in
README.md, and goes on where it was interrupted. The data are the closed form of the coil, made without any FMU; each
draw has a healthy record and a new one.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import fmuid
from experiments import calls, pages
from experiments.coil import study
from fmuid.array_types import Floats
from fmuid.diagnosis import Causes
from fmuid.diagnosis.causes import SignalScale, coordinates_of
from fmuid.diagnosis.linearized_machine import LinearizedMachine

HERE = Path(__file__).parent
DRIFT = {"R": 0.5, "L": 0.0013}  # Ω, H: standard deviations of what may change without being a fault
STD = math.sqrt(study.NOISE_VARIANCE)


class Off(NamedTuple):
    """What a record has that the healthy coil has not."""

    turns: float = 0.0  # Ω
    resistance: float = 0.0  # Ω
    inductance: float = 0.0  # H
    beside: float = 0.0  # 1/Ω, a resistance in parallel
    gain: float = 0.0
    offset: float = 0.0  # standard deviations of the noise
    delay: float = 0.0  # s

    def seen(self, current: Floats) -> Floats:
        """Return what the sensor shows of a current."""
        late = current - self.delay * np.gradient(current, study.STEP)
        return np.asarray((1.0 + self.gain) * late + self.offset * STD)


class Case(NamedTuple):
    """A row of the table: in both records, in the new one, the causes that are right, the noise's colour.

    `drawn`: beside it, whatever may always be so and what may drift, drawn as it is stated. `slow`: the share of the
    noise that has this colour.
    """

    always: Off
    new: Off
    right: tuple[str, ...] = ()
    colour: float = 0.0
    drawn: bool = False
    slow: float = 1.0


SOUND, ALWAYS = Off(), Off(gain=0.02, offset=0.25, delay=2e-4)
TURNS, L, GAIN, OFFSET, DELAY = "turns.dR", "L", "gain(i)", "offset(i)", "delay(i)"
CASES = {
    "white noise": Case(SOUND, SOUND),
    "AR 0.4": Case(SOUND, SOUND, colour=0.4),
    "AR 0.8": Case(SOUND, SOUND, colour=0.8),
    "warm, R + 1 Ω": Case(SOUND, Off(resistance=1.0)),
    "cold, R − 1 Ω": Case(SOUND, Off(resistance=-1.0)),
    "sensor off in both": Case(ALWAYS, ALWAYS),
    "turns, ΔR = 0.2 Ω": Case(SOUND, Off(turns=0.2), (TURNS,)),
    "turns, ΔR = 1 Ω": Case(SOUND, Off(turns=1.0), (TURNS,)),
    "turns, ΔR = 1 Ω, warm": Case(SOUND, Off(turns=1.0, resistance=1.0), (TURNS,)),
    "turns, ΔR = 1 Ω, AR 0.8": Case(SOUND, Off(turns=1.0), (TURNS,), 0.8),
    "turns, ΔR = 1 Ω, sensor off in both": Case(ALWAYS, ALWAYS._replace(turns=1.0), (TURNS,)),
    "inductance + 10 %": Case(SOUND, Off(inductance=0.01), (L,)),
    "resistance of 100 Ω in parallel": Case(SOUND, Off(beside=0.01), ("something else",)),
    "sensor's gain + 3 %": Case(SOUND, Off(gain=0.03), (GAIN,)),
    "sensor's gain − 20 %": Case(SOUND, Off(gain=-0.2), (GAIN,)),
    "sensor's offset, half a std of the noise": Case(SOUND, Off(offset=0.5), (OFFSET,)),
    "sensor's delay, 1 ms": Case(SOUND, Off(delay=1e-3), (DELAY,)),
    "turns, ΔR = 1 Ω, and offset": Case(SOUND, Off(turns=1.0, offset=0.5), (TURNS, OFFSET)),
    "offset and delay, 1 ms": Case(SOUND, Off(offset=0.5, delay=1e-3), (OFFSET, DELAY)),
    "sensor and drifts drawn": Case(SOUND, SOUND, drawn=True),
    "turns, ΔR = 1 Ω, sensor and drifts drawn": Case(SOUND, Off(turns=1.0), (TURNS,), drawn=True),
    "white noise, 8 % of it AR 0.98": Case(SOUND, SOUND, colour=0.98, slow=0.08),
    "white noise, 3 % of it AR 0.98": Case(SOUND, SOUND, colour=0.98, slow=0.03),
    "turns, ΔR = 1 Ω, white noise, 8 % of it AR 0.98": Case(SOUND, Off(turns=1.0), (TURNS,), 0.98, slow=0.08),
}
KEYS = {name: k for k, name in enumerate(CASES)}
# Seen where turns are the only cause that is looked for.
UNLISTED = (
    "white noise",
    "AR 0.4",
    "AR 0.8",
    "resistance of 100 Ω in parallel",
    "sensor's gain + 3 %",
    "sensor's offset, half a std of the noise",
    "sensor's delay, 1 ms",
)
ALONE = Causes(None, None, None, None, None)


def clean(off: Off) -> fmuid.Experiment:
    """Return a record of the coil with something off, without noise."""
    current = study.current(
        study.R + off.resistance + off.turns, study.L + off.inductance + 2.0 * study.TAU * off.turns
    )
    current = current + off.beside * study.voltage()
    frame = {"time": study.STEP * np.arange(study.SAMPLES), "u": study.voltage(), "i": off.seen(current)}
    return study.experiment(pd.DataFrame(frame))


def sensor(rng: np.random.Generator) -> Off:
    """Return a sensor that is off by as much as `Causes` expects."""
    gain, offset, delay = rng.standard_normal(3).tolist()
    return Off(gain=0.03 * gain, offset=0.5 * offset, delay=0.2 * study.STEP * delay)


def records(name: str, rng: np.random.Generator) -> tuple[fmuid.Experiment, fmuid.Experiment]:
    """Return a healthy and a new record of a case without noise."""
    case = CASES[name]
    if not case.drawn:
        return clean(case.always), clean(case.new)
    always = sensor(rng)
    resistance, inductance = rng.standard_normal(2).tolist()
    new = always._replace(turns=case.new.turns, resistance=DRIFT["R"] * resistance, inductance=DRIFT["L"] * inductance)
    return clean(always), clean(new)


def truth(case: str) -> dict[str, float]:
    """Return the causes that are new in a case and their sizes."""
    off = CASES[case].new
    gain = 1.0 + CASES[case].always.gain
    sizes = {TURNS: off.turns, L: off.inductance, GAIN: off.gain, OFFSET: off.offset * STD, DELAY: off.delay}
    return {name: sizes.get(name, math.nan) / (gain if name == OFFSET else 1.0) for name in CASES[case].right}


@cache
def setting(beside: Causes | None = None) -> calls.Setting:
    """Return what all records have in common: turns as a cause, and those beside it."""
    coil, faulty = study.models()
    nominal = {name: fmuid.Parameter(value, min=0.0) for name, value in (("R", study.R), ("L", study.L))}
    turns = fmuid.Fault(faulty, {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": study.TAU})
    sound = clean(SOUND)
    coordinates = coordinates_of(coil, nominal, {"turns": turns}, sound, SignalScale({"i": STD}), beside or Causes())
    drift = np.zeros(len(coordinates.each))
    for name, std in DRIFT.items():
        drift[[each.name for each in coordinates.each].index(name)] = std

    def machine(case: str, new: bool) -> LinearizedMachine:
        record = clean(CASES[case].new if new else CASES[case].always)
        return LinearizedMachine(coil, {}, coordinates, record)

    return calls.Setting(
        coordinates, drift, STD, machine, records, truth, lambda case: CASES[case].colour, lambda case: CASES[case].slow
    )


def tables(found: pd.DataFrame) -> dict[str, str]:
    """Return the tables of the page."""
    sound = [name for name, case in CASES.items() if not case.right]
    return {
        "false": calls.false_table(found, sound),
        "calls": calls.named_table(found, {name: case.right for name, case in CASES.items() if case.right}),
    }


def unlisted(found: pd.DataFrame) -> dict[str, str]:
    """Return the page's table of what is called where turns are the only cause that is looked for."""
    parts = {case: found[found["case"] == case] for case in UNLISTED}
    rows = [(case, calls.rate(part["alarm"]), calls.rate(part["else"])) for case, part in parts.items()]
    return {"unlisted": pages.table(["new", "turns called (%)", "“something else” (%)"], rows)}


def main() -> None:
    """Examine the records and rewrite the page's tables."""
    counts = {name: calls.FAULTY if case.right else calls.FALSE for name, case in CASES.items()}
    pages.rewrite(HERE, tables(calls.Campaign(setting(), HERE / "calls.csv").run(CASES, KEYS, counts)))
    alone = calls.Campaign(setting(ALONE), HERE / "unlisted.csv")
    pages.rewrite(HERE, unlisted(alone.run(UNLISTED, KEYS, counts)))


if __name__ == "__main__":
    main()
