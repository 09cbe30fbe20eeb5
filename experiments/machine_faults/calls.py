"""False, missed and wrong calls of a machine with two phase-current sensors: shorted turns, bars, sensors, supply.

    python -m experiments.machine_faults.calls

Run from the project's folder; it rewrites calls.csv and the tables "false" and "calls" in README.md, and goes on where
it was interrupted. The records are those of machine.py, in phases; the voltages are those asked for, of which a supply
may make a little more or less in each phase. What is compared with them are the fault models in fmus/, behind the map
of phase signals.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

import fmuid
from experiments import calls, pages
from experiments.machine_faults import models
from experiments.machine_faults.machine import BARS, TRUTH, TURNS, Condition
from experiments.machine_faults.make_tables import WARM, simulate
from fmuid.data import Angle, Observation
from fmuid.data.signals import T23, inverse_park
from fmuid.diagnosis import Causes
from fmuid.diagnosis.causes import ChangeParameterSet, SignalScale, coordinates_of
from fmuid.diagnosis.linearized_machine import LinearizedMachine

HERE = Path(__file__).parent
STD = 0.175  # A, on each of the two phase currents: as much as on ids and iqs in make_tables.py
SUPPLY, SENSORS = ("ua", "ub", "uc"), ("ia", "ib")
OBSERVATION = Observation(
    Angle(column="theta"), dict.fromkeys(("ids", "iqs"), SENSORS), dict.fromkeys(("uds", "uqs"), SUPPLY)
)
DRIFT = {"Rs": 1.5, "Rr": 0.6, "Lm": 0.004, "Lf": 0.0008}  # standard deviations: temperature 15 %, inductances 1 %


class Off(NamedTuple):
    """What is new in a record, or always there: the machine, its sensors a and b, its supply a, b and c."""

    machine: Condition = Condition()
    gain: tuple[float, float] = (0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)  # standard deviations of the noise
    delay: tuple[float, float] = (0.0, 0.0)  # s
    supply: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Case(NamedTuple):
    """A row of the table."""

    new: Off
    always: Off = Off()
    colour: float = 0.0

    @property
    def right(self) -> dict[str, float]:
        """The causes that are new, and their sizes."""
        new, old, found = self.new, self.always, {}
        if new.machine.turns:
            found[f"stator.fault.eta_{'abc'[new.machine.phase]}"] = new.machine.turns / TURNS
        if new.machine.bars:
            found["rotor.eta0"] = 3 * new.machine.bars / BARS
        for kind, scale in (("gain", 1.0), ("offset", STD), ("delay", 1.0), ("supply", 1.0)):
            names = SUPPLY if kind == "supply" else SENSORS
            for name, value, before in zip(names, getattr(new, kind), getattr(old, kind), strict=True):
                if value != before:
                    found[f"{'input gain' if kind == 'supply' else kind}({name})"] = scale * (value - before)
        return found


def _turns(turns: int, phase: str, **more: float) -> Condition:
    return Condition(turns=turns, phase="abc".index(phase), **more)  # type: ignore[arg-type]


ALWAYS = Off(gain=(0.02, -0.01), offset=(0.3, -0.2), delay=(5e-5, 0.0), supply=(0.005, -0.01, 0.0))


def _always(machine: Condition) -> Off:
    return Off(machine, ALWAYS.gain, ALWAYS.offset, ALWAYS.delay, ALWAYS.supply)


CASES = {
    "white noise": Case(Off()),
    "AR 0.4": Case(Off(), colour=0.4),
    "AR 0.8": Case(Off(), colour=0.8),
    "warm, resistances + 30 %": Case(Off(Condition(warmth=WARM))),
    "cold, resistances − 20 %": Case(Off(Condition(warmth=0.8))),
    "sensors and supply off in both": Case(ALWAYS, ALWAYS),
    "1 turn of a": Case(Off(_turns(1, "a"))),
    "2 turns of a": Case(Off(_turns(2, "a"))),
    "5 turns of a, warm": Case(Off(_turns(5, "a", warmth=WARM))),
    "5 turns of b, AR 0.8": Case(Off(_turns(5, "b")), colour=0.8),
    "5 turns of c, sensors and supply off in both": Case(_always(_turns(5, "c")), ALWAYS),
    "10 turns of a": Case(Off(_turns(10, "a"))),
    "20 turns of b": Case(Off(_turns(20, "b"))),
    "40 turns of c": Case(Off(_turns(40, "c"))),
    "1 broken bar": Case(Off(Condition(bars=1))),
    "sensor a, gain + 3 %": Case(Off(gain=(0.03, 0.0))),
    "sensor b, gain − 3 %": Case(Off(gain=(0.0, -0.03))),
    "sensor a, delay 0.1 ms": Case(Off(delay=(1e-4, 0.0))),
    "sensor a, offset half a std": Case(Off(offset=(0.5, 0.0))),
    "supply b − 1 %": Case(Off(supply=(0.0, -0.01, 0.0))),
    "10 turns of a and 1 broken bar": Case(Off(_turns(10, "a", bars=1))),
    "10 turns of a and sensor b, gain + 3 %": Case(Off(_turns(10, "a"), gain=(0.0, 0.03))),
    "2 turns of a and sensor b, offset half a std": Case(Off(_turns(2, "a"), offset=(0.0, 0.5))),
    "sensor a, gain + 3 %, and sensor b, offset half a std": Case(Off(gain=(0.03, 0.0), offset=(0.0, 0.5))),
    "1 broken bar and sensor a, gain + 3 %": Case(Off(Condition(bars=1), gain=(0.03, 0.0))),
}
KEYS = {name: k for k, name in enumerate(CASES)}


@cache
def clean(off: Off) -> fmuid.Experiment:
    """Return a record in phases without noise."""
    frame = simulate(off.machine)
    frame = inverse_park(inverse_park(frame, ["uds", "uqs"], SUPPLY), ["ids", "iqs"], [*SENSORS, "ic"])
    # the inverter is asked for voltages without a common part, of which each phase makes its own share
    gains = T23 @ np.diag(1.0 + np.array(off.supply)) @ T23.T
    frame[list(SUPPLY)] = frame[list(SUPPLY)].to_numpy() @ T23.T @ np.linalg.inv(gains).T @ T23
    time = frame["time"].to_numpy()
    for k, name in enumerate(SENSORS):
        late = CubicSpline(time, frame[name])(time - off.delay[k])
        frame[name] = (1.0 + off.gain[k]) * late + off.offset[k] * STD
    return fmuid.Experiment(frame, ["w"], observation=OBSERVATION)


def without(given: ChangeParameterSet, name: str) -> ChangeParameterSet:
    """Return coordinates without one: the speed is known here."""
    kept = [i for i, each in enumerate(given.each) if each.name != name]
    causes = [each for each in given.causes if each.name != name]
    moved = [replace(each, columns=tuple(kept.index(i) for i in each.columns)) for each in causes]
    return ChangeParameterSet(tuple(given.each[i] for i in kept), tuple(moved), given.healthy[kept], given.faults)


@cache
def setting() -> calls.Setting:
    """Return what all records have in common."""
    nominal = {name: fmuid.Parameter(value) for name, value in TRUTH.items()}
    faults = dict(models.faults())
    ratios = {name: fmuid.Parameter(0.0, min=0.0, nominal=0.01) for name in models.RATIOS}
    faults["stator"] = fmuid.Fault(models.stator(), ratios, faults["stator"].variable_map, inputs={"theta": "theta"})
    sound, noise = clean(Off()), dict.fromkeys(SENSORS, STD)
    lines = Causes(joint=None, dead_time=None)  # of later studies
    coordinates = without(
        coordinates_of(models.healthy_machine(), nominal, faults, sound, SignalScale(noise), lines), "input gain(w)"
    )
    machine = LinearizedMachine(models.healthy_machine(), {}, coordinates, sound)
    drift = np.zeros(len(coordinates.each))
    for name, std in DRIFT.items():
        drift[[each.name for each in coordinates.each].index(name)] = std

    def phases(case: str, new: bool) -> LinearizedMachine:
        return machine.over(clean(CASES[case].new if new else CASES[case].always))

    def records(case: str, _: np.random.Generator) -> tuple[fmuid.Experiment, fmuid.Experiment]:
        return clean(CASES[case].always), clean(CASES[case].new)

    return calls.Setting(
        coordinates, drift, STD, phases, records, lambda case: CASES[case].right, lambda case: CASES[case].colour
    )


def tables(found: pd.DataFrame) -> dict[str, str]:
    """Return the tables of the page."""
    faulty = {name: tuple(case.right) for name, case in CASES.items() if case.right}
    return {
        "false": calls.false_table(found, [name for name in CASES if name not in faulty]),
        "calls": calls.named_table(found, faulty),
    }


def main() -> None:
    """Examine the records and rewrite the page's tables."""
    counts = {name: calls.FAULTY if case.right else calls.FALSE for name, case in CASES.items()}
    pages.rewrite(HERE, tables(calls.Campaign(setting(), HERE / "calls.csv").run(CASES, KEYS, counts)))


if __name__ == "__main__":
    main()
