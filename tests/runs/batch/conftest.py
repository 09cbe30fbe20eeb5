"""Fixtures of these tests."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fmuid.runs.batch import batch as module
from tests.support.coil_batches import DRAWS, NOISE, RECORDS, Here, _json, write
from tests.support.coil_cases import R, record
from tests.support.coil_study import coil_table
from tests.support.isolated import wait_until


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    write(tmp_path, NOISE.format(draws=DRAWS))
    return tmp_path


@pytest.fixture
def fleet(folder: Path) -> Path:
    """A study of records, one of which is no table."""
    (folder / "records").mkdir()
    for k in range(4):
        coil_table(folder / "records" / f"r{k}.csv", 0.0, seed=k)
    (folder / "records" / "r2.csv").write_text("time,u\n0,nothing\n")
    return write(folder, RECORDS)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what puts a `Here` in place of the cluster."""
    monkeypatch.setattr(module, "WRITE_SECONDS", 0.0)
    monkeypatch.setattr(module, "WRITE_SHARE", 0.0)

    def use(seed: int = 0, kind: type[Here] = Here, **words: Any) -> Here:
        found = kind(seed, **words)
        monkeypatch.setattr(module, "crew", found)
        return found

    return use


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler in a process of its own, without workers."""
    place, line = tmp_path / "scheduler", [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    place.mkdir()
    line += ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    line += ["--scheduler-file", str(place / "file.json")]
    with subprocess.Popen(line, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        wait_until(lambda: _json(place / "file.json"))
        yield _json(place / "file.json")["address"], process
        process.kill()


@pytest.fixture
def case_folder(tmp_path: Path) -> Path:
    """Return a folder with the study's own table and three records."""
    record(0).to_csv(tmp_path / "table.csv", index=False)
    (tmp_path / "records").mkdir()
    for k in (1, 2, 10):
        record(k, R + 0.1 * k).to_csv(tmp_path / "records" / f"run{k}.csv", index=False)
    return tmp_path
