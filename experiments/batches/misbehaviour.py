"""A batch in which one case in ten misbehaves in every way that native code can: it costs these cases and no others.

    python -m experiments.batches.misbehaviour [--cases 1000] [--every 10] [--workers 2] [--time-limit 2]

Identifies a first-order lag from noisy draws, with an FMU that crashes, hangs, ends its process, takes all memory,
leaks, prints, forks or returns what is no status, everywhere or in a band of parameter values that the search runs
into. What the rows should be is known from a run in-process of an FMU that returns fmi2Error in place of whatever is
worse. Ends with code 1 if a row differs by one bit in anything but how a failure is described.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.batches.campaign import family, left_over, rows
from fmuid.runs.batch.batch import Batch
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.studies.study import Study
from tests.support.misbehaving import Mode, Where, misbehaving_fmu

GAIN, T, NOISE, SAMPLES, STEP = 2.5, 0.6, 0.02, 100, 0.05
BAND = 3.0, 4.2  # gains on the way from the start to the truth
HARMLESS = (Mode.CLOSE, Mode.LEAK_ONCE, Mode.SPEAK, Mode.MUTTER, Mode.CHATTER, Mode.LATER, Mode.SPAWN)
WAYS = [mode for mode in Mode if mode not in (Mode.SOUND, Mode.SLOW, Mode.LEAK)]
PLACES = ((Where.STEP, False), (Where.STEP, True), (Where.INITIALIZATION, False), (Where.RESET, False))
"""Where the FMU misbehaves, and whether in the band only: one after the other when all ways have had their turn."""
EVERYWHERE = -1e300, 1e300

STUDY = """
[model]
fmu = "{fmu}"
[model.fixed]
amount = 1.0
at = 1.0
[[experiments]]
data = "table.csv"
inputs = ["u"]
outputs = ["x"]
interpolation = "zoh"
[parameters]
gain = {{ start = 8.0 }}
T = {{ start = 10.0, min = 1e-3 }}
[isolation]
time_limit = {time_limit}
memory_limit_mb = 400
[batch]
combine = "zip"
monte_carlo = {{ realizations = {draws}, std = {noise}, true_values = {{ gain = {gain}, T = {T}, mode = 0 }} }}
[batch.sweep]
"""
HELD = ("mode", "where", "bad_from", "bad_to")


def plan(cases: int, every: int, ways: Sequence[Mode] = WAYS) -> pd.DataFrame:
    """Return how each case misbehaves (the values held), and in `same_as` the mode with the same row in-process."""
    sound = [Mode.SOUND, Where.STEP, *EVERYWHERE, Mode.SOUND]
    found = pd.DataFrame([sound] * cases, columns=[*HELD, "same_as"], dtype=float)
    for turn, case in enumerate(range(every - 1, cases, every)):
        mode, (where, in_band) = ways[turn % len(ways)], PLACES[turn // len(ways) % len(PLACES)]
        harmless = mode in HARMLESS or where == Where.RESET or (mode == Mode.NOT_A_NUMBER and where != Where.STEP)
        same_as = Mode.SOUND if harmless else Mode.RETURN_ERROR
        found.loc[case] = [mode, where, *(BAND if in_band else EVERYWHERE), same_as]
    return found


def write_study(folder: Path, name: str, held: pd.DataFrame, time_limit: float) -> Path:
    """Write a study of so many draws with these values held, its FMU and its table; return its path."""
    times = STEP * np.arange(SAMPLES)
    pd.DataFrame({"time": times, "u": np.sign(np.sin(2.5 * times + 0.1))}).to_csv(folder / "table.csv", index=False)
    text = STUDY.format(
        fmu=misbehaving_fmu(folder).name, time_limit=time_limit, draws=len(held), noise=NOISE, gain=GAIN, T=T
    )
    text += "".join(f"{word} = {held[word].to_list()}\n" for word in HELD)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def in_peace(folder: Path, held: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of an FMU that returns fmi2Error in place of whatever is worse, run in this process."""
    run = CaseRunner(Study.read(write_study(folder, "peace.toml", held.assign(mode=held["same_as"]), 60.0)))
    found = pd.DataFrame([run(case).row for case in range(len(held))]).astype(dict(run.columns))
    return found.drop(columns=list(VOLATILE))


def differences(found: pd.DataFrame, right: pd.DataFrame, held: pd.DataFrame) -> str:
    """Return in words what differs beside the misbehaviour itself; nothing where there is nothing."""
    bad = held["mode"] != Mode.SOUND
    if not np.array_equal(found["set.mode"], held["mode"]):
        return "the modes are not those asked for"
    texts = {name: str for name in right if not pd.api.types.is_numeric_dtype(right[name])}
    one, other = (rows.drop(columns="set.mode").astype(texts) for rows in (found, right))
    worse = bad & (right["status"] == "failed")
    one.loc[worse, "message"] = other.loc[worse, "message"]
    try:
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    except AssertionError as error:
        cases = [case for case in found.index if not one.loc[[case]].equals(other.loc[[case]])]
        return f"cases {cases} differ: {error}"
    return ""


def show(found: pd.DataFrame) -> None:
    """Print what became of the cases of each way to misbehave."""
    bad = found[found["set.mode"] != Mode.SOUND]
    for _, some in bad.groupby(["set.where", "set.bad_from", "set.mode"]):
        where, low, mode = some[["set.where", "set.bad_from", "set.mode"]].to_numpy()[0]
        place = Where(int(where)).name.lower() + (" in a band" if low != EVERYWHERE[0] else "")
        counts = ", ".join(f"{n} {status}" for status, n in some["status"].value_counts().items())
        print(
            f"{Mode(int(mode)).name.lower():16} {place:15} {counts:13} {some['rejected'].sum():3} rejected "
            f"{some['elapsed_s'].max():5.1f} s  {some['message'].iloc[0].rpartition(': ')[2]}"
        )


def main() -> int:
    """Run the campaign and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--time-limit", type=float, default=2.0)
    chosen = parser.parse_args()
    held = plan(chosen.cases, chosen.every)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        right = in_peace(folder, held)
        print(f"in-process, fmi2Error in place of the worst: {time.monotonic() - began:.1f} s", flush=True)
        study, began = write_study(folder, "war.toml", held, chosen.time_limit), time.monotonic()
        Batch(study, folder / "war", workers=chosen.workers).run()
        print(f"isolated, {chosen.workers} workers: {time.monotonic() - began:.1f} s", flush=True)
        found, left = rows(folder / "war"), left_over(family(os.getpid())[1:])
        seconds = pd.read_parquet(folder / "war" / "cases").set_index("case")["elapsed_s"]
    show(found.assign(elapsed_s=seconds))
    wrong = differences(found, right, held)
    print(f"{(held['mode'] != 0).sum()} of {len(held)} cases misbehave: {wrong or 'every row is as it should be'}")
    print(f"processes left: {len(left)}")
    return int(bool(wrong or left))


if __name__ == "__main__":
    sys.exit(main())
