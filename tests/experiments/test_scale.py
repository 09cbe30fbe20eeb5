"""A batch of a thousand cases whose processes are killed: no row is lost or run again, its summary is pandas' own."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.batches.campaign import command, family, left_over, write_study
from experiments.batches.scale import SAMPLES, repeat_rows
from fmuid.runs.batch.batch import Batch

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="it has no SIGKILL"),
]
CASES = 1000


def test_a_thousand_cases(tmp_path: Path) -> None:
    study, output = write_study(tmp_path, CASES, SAMPLES), tmp_path / "out"
    process = subprocess.Popen(command(study, output, "--workers", "2"), stdout=subprocess.DEVNULL)
    until = time.monotonic() + 600
    # a fast machine may be done by then: batches that are certainly not are killed in tests/runs/batch/test_kills.py
    while len(list(output.glob("cases/part-*"))) < 2 and process.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.05)
    everybody = family(process.pid)
    process.kill()
    process.wait()
    assert not left_over(everybody, 60.0)
    kept = pd.read_parquet(output / "cases")
    assert 0 < len(kept) <= CASES

    done = subprocess.run(command(study, output, "--workers", "2"), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    found = pd.read_parquet(output / "cases")
    assert found["case"].tolist() == found["draw"].tolist() == list(range(CASES))
    both = kept.merge(found, on=["case", "finished", "worker", "value.R", "value.L"])
    assert len(both) == len(kept)  # what was finished is as it was

    summary = pd.read_csv(output / "summary.csv").set_index("parameter")
    converged = found[found["status"] == "converged"]
    assert len(converged) > 0.99 * CASES
    for name in ("R", "L"):
        values, stds = converged[f"value.{name}"], converged[f"std.{name}"]
        assert summary.loc[name, "cases"] == len(values)
        assert summary.loc[name, "mean"] == pytest.approx(values.mean(), rel=1e-12)
        assert summary.loc[name, "median"] == pytest.approx(values.median(), rel=1e-12)
        assert summary.loc[name, "spread"] == pytest.approx(values.std(), rel=1e-9)
        assert summary.loc[name, "stated_std"] == pytest.approx(np.sqrt((stds**2).mean()), rel=1e-12)

    repeat_rows(output, tmp_path / "many", 250_000)
    job = Batch(study, tmp_path / "many", max_cases=CASES)
    job.dataset.count = 250_000
    assert job.dataset.finished().all()
    assert [path.stat().st_size > 0 for path in job.dataset.parts()] == [True] * 3
