"""Batches in processes of their own: scripts, kills, clusters."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest

from experiments.batches.campaign import command, family, left_over, rows
from fmuid import Batch, FmuidError, Study
from fmuid.apps.workbench.pages.batch import BatchPage
from fmuid.files import replacing
from fmuid.runs.batch import local_workers
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.runs.batch.worker import versions
from tests.support.coil_batches import DRAWS, NOISE, expected, plain, refused, same, worker, write
from tests.support.coil_study import fmuid_
from tests.support.isolated import wait_until
from tests.support.misbehaving import RELEASED, Mode, Where, lag, misbehaving_fmu
from tests.support.workbench import asked_for, bench_of

pytestmark = pytest.mark.usefixtures("blank_figures")
SAMPLES, STEP = 200, 0.1  # of the record of the cases that wait; s
QUARTER, CASES = 50, 200
GATED = """
[model]
fmu = "{fmu}"
fixed = {{ mode = {mode}, where = {where} }}
[[experiments]]
data = "first.csv"
inputs = ["u"]
outputs = ["x"]
interpolation = "zoh"
[parameters]
gain = {{ start = 1.0, min = 0.0 }}
T = {{ start = 1.0, min = 1e-3 }}
[batch]
sweep = {{ amount = [1.0, 2.0, 3.0, 4.0] }}
monte_carlo = {{ realizations = 50, std = 0.02, true_values = {{ gain = 2.0, T = 0.5 }} }}
"""


# --- on this machine ---------------------------------------------------------------------

SCRIPT = """
import fmuid
found = fmuid.Batch({study!r}, {output!r}, workers=2).run()
print(len(found.frame), found.interrupted)
"""


@pytest.mark.slow
def test_a_script_without_a_guard(folder: Path) -> None:
    """Workers that import the script again would begin the batch again; from standard input there is none to import."""
    script = SCRIPT.format(study=str(folder / "study.toml"), output=str(folder / "out"))
    done = subprocess.run([sys.executable, "-"], input=script, capture_output=True, text=True, timeout=600)
    assert (done.stdout, done.stderr) == (f"{DRAWS} False\n", "")
    same(pd.read_parquet(folder / "out" / "cases"), expected(folder))


def started(folder: Path, workers: int) -> subprocess.Popen[str]:
    line = command(folder / "study.toml", folder / "out", "--workers", str(workers), "--no-isolation")
    (folder / "scratch").mkdir(exist_ok=True)
    environment = os.environ | {"TMPDIR": str(folder / "scratch")}
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def wait_for_part(process: subprocess.Popen[str], folder: Path, known: int = 0) -> None:
    """Wait until a batch has written a part more."""
    until = time.monotonic() + 600
    while time.monotonic() < until and process.poll() is None:
        if len(list((folder / "out" / "cases").glob("part-*.parquet"))) > known:
            return
        time.sleep(0.02)
    raise AssertionError(process.communicate())


def release(gate: Path, quarter: str) -> None:
    with replacing(gate) as draft:
        draft.write_text(quarter)


def gated_study(folder: Path) -> None:
    """Write a study whose cases wait, a quarter of them each, until their quarter is released."""
    times = STEP * np.arange(SAMPLES, dtype=np.float64)
    u = np.sign(np.sin(3.0 * times))
    pd.DataFrame({"time": times, "u": u, "x": lag(times, u, 2.0, 0.5)}).to_csv(folder / "first.csv", index=False)
    words = {"fmu": misbehaving_fmu(folder).as_posix(), "mode": float(Mode.WAIT), "where": float(Where.INITIALIZATION)}
    (folder / "study.toml").write_text(GATED.format(**words), encoding="utf-8")


@pytest.mark.slow
def test_kills(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a worker and, at a drawn moment, of the driver; Ctrl-C, SIGTERM: no row lost or run again, no process left."""
    rng, gate = np.random.default_rng(5), folder / "released"
    monkeypatch.setenv(RELEASED, str(gate))
    gated_study(folder)
    release(gate, "1")
    process = started(folder, 2)
    wait_for_part(process, folder)
    workers = [each for each in family(process.pid) if "spawn_main" in " ".join(each.cmdline())]
    assert len(workers) == 2
    workers[0].kill()
    time.sleep(rng.uniform(0.0, 0.5))
    everybody = family(process.pid)
    process.kill()
    process.communicate()
    assert not left_over(everybody)
    assert not list((folder / "scratch").glob("fmuid-*"))
    kept = pd.read_parquet(folder / "out" / "cases")
    assert 0 < len(kept) <= QUARTER

    partial = [kept]
    for quarter, number in enumerate((signal.SIGINT, signal.SIGTERM), 2):
        release(gate, f"{quarter}")
        process = started(folder, 2)
        wait_for_part(process, folder, len(list((folder / "out" / "cases").glob("part-*.parquet"))))
        everybody = family(process.pid)
        process.send_signal(number)
        _, said = process.communicate(timeout=600)
        assert not left_over(everybody)
        assert not list((folder / "scratch").glob("fmuid-*"))
        assert process.returncode == 1
        partial.append(pd.read_parquet(folder / "out" / "cases"))
        assert len(partial[-2]) < len(partial[-1]) <= quarter * QUARTER
        answer, *others, last = said.splitlines()
        assert others == []
        assert answer.startswith("interrupted: saving the finished cases")
        assert last == f"interrupted: {len(partial[-1])} of {CASES} cases are finished; the same command resumes"

    release(gate, "4")
    process = started(folder, 1)
    _, said = process.communicate(timeout=600)
    assert (process.returncode, said) == (0, "")
    found = pd.read_parquet(folder / "out" / "cases")
    assert found["case"].tolist() == list(range(CASES))
    for before in partial:
        assert before.merge(found[["case", *VOLATILE]]).shape[0] == len(before)
    runner = CaseRunner(Study.read(folder / "study.toml"))
    for case in rng.choice(CASES, 20, replace=False).tolist():
        row = runner(case).row
        assert [row[str(name)] for name in plain(found)] == plain(found).loc[case].tolist()


def test_workers_that_cannot_begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho ImportError: no numpy >&2\necho more >&2\nexit 1\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr(local_workers, "MOST_RESTARTS", 3)
    monkeypatch.setattr(local_workers, "SOON_SECONDS", 600.0)
    host, until = local_workers.LocalWorkers("tcp://127.0.0.1:9", 1, tmp_path / "workers"), time.monotonic() + 600
    with pytest.raises(FmuidError, match=r"^workers end at once: ImportError: no numpy$"):
        while time.monotonic() < until:
            host.look()
            time.sleep(0.01)
    host.close()


def shops(folder: Path) -> list[Path]:
    """Return the folders that workers have for a batch."""
    return list(folder.glob("*/dask-scratch-space/worker-*/fmuid-*"))


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_sentence(folder: Path, scheduler: tuple[str, subprocess.Popen[bytes]]) -> None:
    """Whatever Dask and asyncio say of it; and the same command goes on without it."""
    address, process = scheduler
    write(folder, NOISE.format(draws=3000))
    words = [sys.executable, "-m", "fmuid", "batch", "study.toml", "-o", "out", "--no-report"]
    line = [*words, "--scheduler", address]
    pipes: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with worker(address, folder / "one"), subprocess.Popen(line, cwd=folder, **pipes) as batch:
        wait_until(lambda: list(folder.glob("out/cases/part-*")))
        process.kill()
        _, error = batch.communicate(timeout=120)
    assert batch.returncode == 1
    assert error.splitlines() == [
        f"error: connection to the scheduler at {address} lost. Finished cases are kept: start a scheduler, and repeat "
        "the command."
    ]
    kept = rows(folder / "out")
    assert 0 < len(kept) < 3000
    job = Batch(folder / "study.toml", folder / "out")
    assert set(job.pending.tolist()) == set(range(3000)) - set(kept["case"])


@pytest.mark.slow
def test_a_cluster(
    fleet: Path, scheduler: tuple[str, subprocess.Popen[bytes]], capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without workers, with other versions, and in peace."""
    address, _ = scheduler
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 2.0)
    words = (fleet / "study.toml", "-o", fleet / "out", "--scheduler", address)
    assert f"the scheduler at {address} has no workers" in refused(capsys, *words)
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 600.0)
    with worker(address, fleet / "one"), worker(address, fleet / "two", "--nworkers", "1"):
        with monkeypatch.context() as older:
            older.setattr(cluster, "versions", lambda: versions() | {"fmuid": "0.0.9"})
            said = refused(capsys, *words)
        assert f"the scheduler at {address}" in said
        assert f"runs fmuid {versions()['fmuid']}, this machine 0.0.9" in said
        assert fmuid_("batch", *words) == 0
        assert capsys.readouterr().err == ""
        same(pd.read_parquet(fleet / "out" / "cases"), expected(fleet))
        dashboard = json.loads((fleet / "out" / "batch.json").read_text())["dashboard"]
        with urlopen(dashboard, timeout=60.0) as answer:
            assert answer.status == 200
        BatchPage(doc := asked_for("out"), bench_of(fleet))
        assert f'href="{dashboard}"' in " ".join(text for text, _ in doc.template_variables["pieces"])

        wait_until(lambda: not shops(fleet))
