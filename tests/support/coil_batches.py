"""Batches of the coil over small fleets of records."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
import psutil

from experiments.batches.campaign import family
from fmuid import Batch, Study
from fmuid.runs import BatchResult
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.runs.batch.study_package import StudyPackage
from fmuid.runs.batch.worker import run_group
from tests.support.coil_study import STUDY, fmuid_

DRAWS = 30
NOISE = "[batch]\nmonte_carlo = {{ realizations = {draws}, std = 0.02, true_values = {{ R = 4.0, L = 0.1 }} }}\n"
RECORDS = '[batch]\ndata = "records/*.csv"\nstarting_points = 2\n'


def write(folder: Path, batch: str, **replaced: str) -> Path:
    text = STUDY + batch
    for old, new in replaced.items():
        text = text.replace(f"{old} = {{ start = 6.0", f"{old} = {{ start = {new}")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder


def plain(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(columns=list(VOLATILE))


def same(found: pd.DataFrame, other: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(plain(found), plain(other), check_exact=True)


def expected(folder: Path) -> pd.DataFrame:
    """Return what the cases give one after the other in this process."""
    runner = CaseRunner(Study.read(folder / "study.toml"))
    frame = pd.DataFrame([runner(case).row for case in range(len(runner.cases))])
    return frame.astype({"finished": "datetime64[us, UTC]"})


# --- without a cluster -------------------------------------------------------------------


class Here:
    """Stands for a cluster: runs groups in this process, of drawn sizes and in a drawn order."""

    threads = 1
    dashboard = "http://127.0.0.1:8787/status"

    def __init__(self, seed: int = 0, stop_after: int | None = None, error: BaseException | None = None) -> None:
        self.rng, self.stop_after, self.error = np.random.default_rng(seed), stop_after, error
        self.ran: list[int] = []

    def run(self, parcel: StudyPackage, cases: Any, record_of: Any) -> cluster.Results:
        edges = np.sort(self.rng.choice(np.arange(1, len(cases)), min(6, len(cases) - 1), replace=False))
        groups = np.split(cases, edges)
        for k in self.rng.permutation(len(groups)):
            yield None
            group = groups[k].tolist()
            records = {name: content for case in group for name, content in record_of(case).items()}
            if self.stop_after is not None and len(self.ran) + len(group) > self.stop_after:
                raise self.error or KeyboardInterrupt
            self.ran += group
            yield run_group(parcel, group, records)

    @contextlib.contextmanager
    def __call__(self, scheduler: str | None, workers: int | None) -> Iterator[Self]:
        assert scheduler is None
        assert workers is None
        yield self


def run(folder: Path, output: str = "out", *, resume: bool = True, **words: Any) -> BatchResult:
    return Batch(folder / "study.toml", folder / output, isolated=False, **words).run(resume=resume)


# --- wrong input -------------------------------------------------------------------------


def refused(capsys: Any, *arguments: str | Path) -> str:
    assert fmuid_("batch", *arguments) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    return str(error)


# --- on a cluster ------------------------------------------------------------------------


def _json(path: Path) -> dict[str, Any]:
    """Return what a file says, nothing before it is written to its end."""
    try:
        found: dict[str, Any] = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return {}
    return found


@contextlib.contextmanager
def worker(address: str, place: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a worker in an empty folder of its own."""
    place.mkdir()
    line = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", *words]
    environment = os.environ | {"TMPDIR": str(place)}
    output = (place / "log.txt").open("wb")
    with output, subprocess.Popen(line, cwd=place, stdout=output, stderr=output, env=environment) as process:
        try:
            yield process
        finally:
            for each in family(process.pid):
                with contextlib.suppress(psutil.NoSuchProcess):
                    each.kill()
