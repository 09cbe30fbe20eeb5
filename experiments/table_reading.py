"""Processor time of `fmuid.read_data` relative to `pandas.read_csv` with the right arguments, in turn, best of seven.

python experiments/table_reading.py [ROWS]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import fmuid

DIGITS = "%.8g"
TURNS = 7


def write_tables(folder: Path, rows: int) -> dict[str, dict[str, Any]]:
    """Write tables; return pandas' arguments by file."""
    rng = np.random.default_rng(1)
    frame = pd.DataFrame({"time": 1e-4 * np.arange(rows), **{name: rng.standard_normal(rows) for name in "uiw"}})
    gaps = frame.assign(w=frame["w"].where(np.arange(rows) % 1000 > 0))
    dates = pd.Timestamp("2026-01-01") + pd.to_timedelta(frame["time"], unit="s")
    iso, german = "%Y-%m-%dT%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f"

    def write(name: str, table: pd.DataFrame, **how: Any) -> None:
        table.to_csv(folder / name, index=False, float_format=DIGITS, **how)

    write("plain.csv", frame)
    write("german.csv", frame, sep=";", decimal=",")
    write("tabs.txt", frame, sep="\t")
    write("spaces.txt", frame, sep=" ")
    write("words.txt", gaps, sep=" ", na_rep="NaN")
    write("gaps.csv", gaps)
    write("overload.csv", gaps, na_rep="OL")
    write("utf16.csv", frame, encoding="utf-16")
    write("iso.csv", frame.assign(time=dates.dt.strftime(iso)))
    write("dates.csv", frame.assign(time=dates.dt.strftime(german)))
    return {
        "plain.csv": {},
        "german.csv": {"sep": ";", "decimal": ","},
        "tabs.txt": {"sep": "\t"},
        "spaces.txt": {"sep": r"\s+"},
        "words.txt": {"sep": r"\s+"},
        "gaps.csv": {},
        "overload.csv": {"na_values": ["OL"]},
        "utf16.csv": {"encoding": "utf-16"},
        "iso.csv": {"parse_dates": ["time"]},
        "dates.csv": {"parse_dates": ["time"], "date_format": german},
    }


def seconds(call: Callable[[], object]) -> float:
    """Return the processor time of a call, s."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def main() -> None:
    """Print the times and their ratio for each table."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    with tempfile.TemporaryDirectory() as name:
        for file, how in write_tables(Path(name), rows).items():
            path = Path(name) / file
            each = [
                (seconds(lambda: pd.read_csv(path, **how)), seconds(lambda: fmuid.read_data(path)))  # noqa: B023
                for _ in range(TURNS)
            ]
            pandas, own = (min(times) for times in zip(*each, strict=True))
            print(f"{file:14} pandas {pandas:.2f} s   fmuid {own:.2f} s   ratio {own / pandas:.2f}", flush=True)


if __name__ == "__main__":
    main()
