"""A folder as a batch that is under way leaves it."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd


def batch(folder: Path, done: int) -> None:
    """Write a batch of five cases as far as it has come."""
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    manifest = {"fmuid": "0", "study": {"title": "Fleet"}, "files": {}, "cases": 5, "truth": {"R": 4.0}}
    (folder / "batch.json").write_text(json.dumps(manifest))
    rows = {
        "case": np.arange(done),
        "status": ["failed" if k == 1 else "converged" for k in range(done)],
        "draw": np.arange(done),
        "value.R": [4.0 + 0.01 * k for k in range(done)],
        "std.R": np.full(done, 0.1),
        "cost": np.ones(done),
        "accuracy": [None if k == 1 else "checked" for k in range(done)],
        "message": ["hit <b>a wall" if k == 1 else "converged" for k in range(done)],
    }
    write_part(folder, done, pd.DataFrame(rows))


def write_part(folder: Path, first: int, frame: pd.DataFrame) -> None:
    """Write rows under the name that a part has: its first case and the digest of its content."""
    content = frame.to_parquet()
    (folder / f"cases/part-{first:09d}-{hashlib.sha256(content).hexdigest()[:12]}.parquet").write_bytes(content)
