"""Make the tables of healthy, warm and faulty machines: noise on the currents of `machine.run`.

    python -m experiments.machine_faults.make_tables [FOLDER]

writes one table a case, 0.5 MB each, to a folder (default ``tables`` beside this script). Columns: ``time`` (s);
``ua``, ``ub``, ``uc`` (V); ``w`` (electrical speed, rad/s), ``theta`` (electrical rotor angle, rad); ``ia``, ``ib``
(A). The draws of study.py are in Park axes linked to the rotor, with noise on these.
"""

from __future__ import annotations

import sys
from functools import cache
from math import sqrt
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import max_len_seq

from experiments.machine_faults.machine import SPEED, SPEED_STEP, Condition, run
from fmuid.data.signals import inverse_park

SAMPLES, SAMPLE_TIME = 4500, 7e-4  # the method's own
SUBSTEPS = 20  # Runge-Kutta steps of a sample: within 1e-6 A of four times as many
BIT = 145  # samples, 0.1 s
NOISE_VARIANCE = 0.0462  # A², on each of the two currents

PHASES = ["ua", "ub", "uc"]
WARM = 1.3
SHORTED, BROKEN = (1, 2, 5, 10, 20), (1, 2, 3)
CASES = {
    "healthy": Condition(),
    "warm": Condition(warmth=WARM),
    **{f"stator_{'abc'[phase]}{turns}": Condition(turns=turns, phase=phase) for turns in SHORTED for phase in range(3)},
    "warm_stator_b10": Condition(turns=10, phase=1, warmth=WARM),
    **{f"bars_{bars}": Condition(bars=bars) for bars in BROKEN},
    "warm_bars_1": Condition(bars=1, warmth=WARM),
}
"""Name of a case to what the machine is like."""


@cache
def simulate(condition: Condition) -> pd.DataFrame:
    """Return what noise-free sensors would show of a machine, with the columns of the tables."""
    bits = 2.0 * max_len_seq(5)[0] - 1.0
    bits[0] = 0.0  # while the flux builds up the speed stays at 750 rpm
    references = np.asarray(SPEED + SPEED_STEP * bits[np.arange(SAMPLES) // BIT % bits.size], dtype=np.float64)
    found = run(condition, references, SAMPLE_TIME, SUBSTEPS)
    frame = pd.DataFrame(found, columns=["uds", "uqs", "w", "theta", "ids", "iqs"])
    frame.insert(0, "time", SAMPLE_TIME * np.arange(SAMPLES))
    return frame


def add_noise(frame: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return a table with white Gaussian noise on its two currents."""
    noise = rng.normal(scale=sqrt(NOISE_VARIANCE), size=(len(frame), 2))
    return frame.assign(ids=frame["ids"] + noise[:, 0], iqs=frame["iqs"] + noise[:, 1])


def table(case: str, seed: int = 0) -> pd.DataFrame:
    """Return the table of a case; each case and seed has noise of its own."""
    return add_noise(simulate(CASES[case]), np.random.default_rng([seed, list(CASES).index(case)]))


def sensor_table(case: str, seed: int = 0) -> pd.DataFrame:
    """Return what a drive records of a case: voltages of the phases, and two noisy current sensors."""
    frame = inverse_park(
        inverse_park(simulate(CASES[case]), ["uds", "uqs"], PHASES), ["ids", "iqs"], ["ia", "ib", "ic"]
    )
    rng = np.random.default_rng([seed, list(CASES).index(case), 2])
    frame[["ia", "ib"]] += rng.normal(scale=sqrt(NOISE_VARIANCE), size=(len(frame), 2))
    return frame[["time", *PHASES, "w", "theta", "ia", "ib"]]


def main() -> None:
    """Write all tables."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("tables")
    folder.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        sensor_table(case).to_csv(folder / f"{case}.csv", index=False, float_format="%.9g", lineterminator="\n")
    print(f"{len(CASES)} tables in {folder}")


if __name__ == "__main__":
    main()
