"""What the campaigns here share: a study of many quick cases, its batch as a command, two datasets compared."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import psutil

from fmuid.runs.batch.case import VOLATILE

FMUS = Path(__file__).parents[2] / "fmus"
R, L, STEP, SAMPLES, NOISE = 4.0, 0.1, 1e-3, 300, 0.02
HELD = 15  # samples, after each change of the voltage

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "{table}"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
[parameters]
R = {{ start = 6.0, min = 0.0 }}
L = {{ start = 0.05, min = 1e-3 }}
"""
DRAWS = "monte_carlo = {{ realizations = {draws}, std = 0.02, true_values = {{ R = 4.0, L = 0.1 }} }}\n"
FLEET = 'tables = "records/*.csv"\nstarts = {starts}\n'


def coil_current(voltage: npt.NDArray[np.float64], start: float = 0.0) -> npt.NDArray[np.float64]:
    """Return the current of the coil for a held voltage: exact, sample by sample."""
    decay = np.exp(-R / L * STEP)
    current = np.full(voltage.size, start)
    for k in range(voltage.size - 1):
        current[k + 1] = decay * current[k] + (1 - decay) / R * voltage[k]
    return current


def write_table(path: Path, seed: int, samples: int = SAMPLES, start: float = 0.0, noise: float = NOISE) -> None:
    """Write a record of a coil: what a held voltage of random signs drives, and noise."""
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.choice([-1.0, 1.0], -(-samples // HELD)), HELD)[:samples]
    current = coil_current(voltage, start) + noise * rng.normal(size=samples)
    pd.DataFrame({"time": STEP * np.arange(samples), "u": voltage, "i": current}).to_csv(path, index=False)


def write_study(folder: Path, draws: int, samples: int = SAMPLES) -> Path:
    """Write a study of the coil with so many draws of noise, and return its path."""
    return _write(folder, DRAWS.format(draws=draws), samples)


def write_fleet(folder: Path, records: int, starts: int) -> Path:
    """Write a study of so many records of the coil, each from so many starts, and return its path."""
    (folder / "records").mkdir(parents=True, exist_ok=True)
    for k in range(records):
        write_table(folder / "records" / f"record{k:04d}.csv", seed=k)
    return _write(folder, FLEET.format(starts=starts))


def _write(folder: Path, batch: str, samples: int = SAMPLES) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "table.csv", seed=1, samples=samples)
    path = folder / "study.toml"
    text = STUDY.format(fmu=(FMUS / "Coil" / "Coil.fmu").as_posix(), table="table.csv")
    path.write_text(f"{text}[noise]\ndelay_std = 0.0\n[batch]\n{batch}", encoding="utf-8")
    return path


def command(study: Path, output: Path, *words: str) -> list[str]:
    """Return the command line of a batch."""
    return [sys.executable, "-m", "fmuid", "batch", str(study), "--output", str(output), *words]


def rows(output: Path) -> pd.DataFrame:
    """Return the finished rows in a batch's folder, without what differs from run to run."""
    found = pd.read_parquet(output / "cases").drop_duplicates("case").sort_values("case", ignore_index=True)
    return found.drop(columns=list(VOLATILE))


def differences(one: Path, other: Path) -> str:
    """Return in words whether two datasets are the same bit for bit."""
    try:
        pd.testing.assert_frame_equal(rows(one), rows(other), check_exact=True)
    except AssertionError as error:
        return f"DIFFERENT: {error}"
    return f"the same bit for bit, {len(rows(one))} cases"


def family(process: int) -> list[psutil.Process]:
    """Return a process and all below it."""
    with contextlib.suppress(psutil.NoSuchProcess):
        top = psutil.Process(process)
        return [top, *top.children(recursive=True)]
    return []


def left_over(processes: Sequence[psutil.Process], patience: float = 600.0) -> list[psutil.Process]:
    """Return which processes are still there after some time, s."""
    until = time.monotonic() + patience
    while time.monotonic() < until:
        there = [each for each in processes if _runs(each)]
        if not there:
            return []
        time.sleep(0.1)
    return there


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:  # it ended between the two questions
        return False
