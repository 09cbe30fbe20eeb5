"""Make table.csv: a 1.1 kW induction machine under vector control, measured with noise.

    python experiments/induction_machine/make_table.py

Five coupled FMUs are the drive: speed controller, current controller, inverter, the machine in *phase quantities*
(1.58) and its shaft with the load. The Park model that is identified from the table is not among them.

- Before t = 0 the DC machine turns the unexcited induction machine at 750 rpm. At t = 0 it becomes a generator on a
  resistor (torque proportional to speed) and the control starts: all currents and fluxes start at zero. While the flux
  builds up, for the first bit of the sequence, the speed stays at 750 rpm.
- The FMUs exchange their values every 50 us, a fourteenth of the sampling interval, and hold them in between. Inverter
  and shaft say what the machine has to see on average over the step that begins: voltages turned, and a speed moved on,
  by half a step. What is recorded are instantaneous values; for the voltages those of the inverter in the axes linked
  to the rotor, where they follow the control with a time constant of 2 ms. They are so smooth that the straight lines
  between samples are nearly what the machine saw: from the table without noise the four parameters come back within
  0.05 of the standard deviations that they have with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import pi, sqrt
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import max_len_seq

import fmuid
from fmuid.data.signals import inverse_park

Array = npt.NDArray[np.floating]

FMUS = Path(__file__).parents[2] / "fmus"

TRUTH = {"Rs": 9.8, "Rr": 3.8, "Lm": 0.436, "Lf": 0.0762}
"""Resistances in ohm and inductances in henry, near the chapter's estimates."""

SAMPLES = 4500
SAMPLE_TIME = 7e-4  # s
SUBSTEPS = 14  # communication steps of one sample: 50 us, the period of the inverter's modulation
NOISE_VARIANCE = 0.0462  # A², on each of the two currents
SEED = 0

POLE_PAIRS = 2
LOAD = 0.05  # N m s, torque of the generator over the mechanical speed: 3.9 N m at 750 rpm
RPM = 2 * pi / 60  # rad/s
SPEED, SPEED_STEP = 750 * RPM, 90 * RPM  # rad/s, mechanical
BIT = 145  # samples of one bit of the PRBS, 0.1 s: 31 bits fill the table

COMPONENTS = {
    "speed": "SpeedController",
    "current": "CurrentController",
    "inverter": "Inverter",
    "machine": "ThreePhaseInductionMachine",
    "shaft": "MechanicalLoad",
}
CONNECTIONS = (
    ("speed.torque", "current.torque"),
    ("current.uds", "inverter.uds_wanted"),
    ("current.uqs", "inverter.uqs_wanted"),
    *((f"inverter.u{phase}", f"machine.u{phase}") for phase in "abc"),
    ("machine.torque", "shaft.torque"),
    # what is measured
    ("shaft.speed", "speed.speed"),
    *((f"machine.i{phase}", f"current.i{phase}") for phase in "abc"),
    *(("machine.theta", f"{each}.theta") for each in ("current", "inverter")),
    *(("shaft.w", f"{each}.w") for each in ("current", "inverter", "machine")),
)
VALUES = {
    **{f"machine.{name}": value for name, value in TRUTH.items()},
    "machine.p": POLE_PAIRS,
    "current.p": POLE_PAIRS,
    "shaft.p": POLE_PAIRS,
    "shaft.f": LOAD,
    "shaft.speed_start": SPEED,
    "speed.halfway_start": SPEED,
    "speed.smooth_start": SPEED,
    "speed.integral_start": LOAD * SPEED,  # the operator knows the load
    "inverter.period": SAMPLE_TIME / SUBSTEPS,
    "shaft.period": SAMPLE_TIME / SUBSTEPS,
}
RECORDED = {
    "uds": "inverter.uds",
    "uqs": "inverter.uqs",
    "speed": "shaft.speed",
    "ids": "machine.ids",
    "iqs": "machine.iqs",
    "ia": "machine.ia",
    "ib": "machine.ib",
    "ic": "machine.ic",
    "theta": "machine.theta",
}


@cache
def drive() -> fmuid.System:
    """Return the drive, its FMUs loaded once."""
    fmus = {name: FMUS / model / f"{model}.fmu" for name, model in COMPONENTS.items()}
    return fmuid.System(components=fmus, connections=CONNECTIONS)


def speed_reference(samples: int) -> Array:
    """Return 750 rpm for a bit, then plus or minus 90 rpm, 30 bits of a maximum-length sequence, rad/s (samples,)."""
    bits = 2.0 * max_len_seq(5)[0] - 1.0
    bits[0] = 0.0
    wanted: Array = SPEED + SPEED_STEP * bits[np.arange(samples) // BIT % bits.size]
    return wanted


def record(times: Array, reference: Array, columns: Mapping[str, str]) -> pd.DataFrame:
    """Return what the drive does under a speed reference that is held from sample to sample."""
    frame = pd.DataFrame({"time": times, "reference": reference, **dict.fromkeys(columns, 0.0)})
    outputs = {variable: column for column, variable in columns.items()}
    experiment = fmuid.Experiment(frame, {"speed.reference": "reference"}, outputs, interpolation="zoh")
    step = SAMPLE_TIME / SUBSTEPS
    found = fmuid.Simulator(drive(), experiment, values=VALUES, step_size=step)([])
    return pd.DataFrame({"time": times, **dict(zip(columns, found.T, strict=True))})


def simulate(samples: int = SAMPLES) -> pd.DataFrame:
    """Return what noise-free sensors would show.

    Columns: ``time`` (s); ``uds``, ``uqs``, ``ids``, ``iqs`` (V and A, Park axes linked to the rotor); ``w``
    (electrical speed, rad/s); ``ua`` to ``uc``, ``ia`` to ``ic`` (phases); ``theta`` (electrical rotor angle, rad).
    """
    frame = record(np.arange(samples) * SAMPLE_TIME, speed_reference(samples), RECORDED)
    frame["w"] = POLE_PAIRS * frame["speed"]
    frame = inverse_park(frame, ["uds", "uqs"], ["ua", "ub", "uc"])
    return frame[["time", "uds", "uqs", "w", "ids", "iqs", "ua", "ub", "uc", "ia", "ib", "ic", "theta"]]


def add_noise(frame: pd.DataFrame, variance: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return the columns of table.csv, with white Gaussian noise of a variance (A²) on the two currents."""
    table = frame[["time", "uds", "uqs", "w", "ids", "iqs"]].copy()
    table[["ids", "iqs"]] += rng.normal(scale=sqrt(variance), size=(len(table), 2))
    return table


def main() -> None:
    """Rewrite table.csv beside this script."""
    table = add_noise(simulate(), NOISE_VARIANCE, np.random.default_rng(SEED))
    table.to_csv(Path(__file__).with_name("table.csv"), index=False, float_format="%.9g", lineterminator="\n")


if __name__ == "__main__":
    main()
