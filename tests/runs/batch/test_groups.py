"""Cases in groups over workers, of which some end: processes, scripts, kills, clusters."""

import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest
from distributed import KilledWorker

from experiments.batches.campaign import command, family, left_over, rows
from fmuid import Batch, FmuidError, Study
from fmuid.apps.workbench.pages.batch import BatchPage
from fmuid.files import replacing
from fmuid.runs.batch import local_workers
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.runs.batch.study_package import StudyPackage
from fmuid.runs.batch.worker import GroupResult, IsolatedCases, run_group, versions
from tests.support.coil_batches import DRAWS, NOISE, Here, expected, plain, refused, run, same, worker, write
from tests.support.coil_cases import bits
from tests.support.coil_study import fmuid_
from tests.support.isolated import wait_until
from tests.support.misbehaving import RELEASED, Mode, Where, lag, misbehaving_fmu
from tests.support.workbench import asked_for, bench_of

pytestmark = pytest.mark.usefixtures("blank_figures")


def test_the_inside_of_dask_is_quiet() -> None:
    """Also by loggers that have levels of their own."""
    names = ("distributed", "distributed.client", "distributed.core", "tornado.application")
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    with cluster._quiet():
        assert not any(logger.isEnabledFor(logging.CRITICAL) for logger in loggers)
    assert [logger.level for logger in loggers] == before


def test_a_case_that_ends_its_workers_is_given_up(folder: Path, here: Any) -> None:
    class Deadly(Here):
        def run(self, parcel: StudyPackage, cases: Any, record_of: Any) -> cluster.Results:
            yield GroupResult(given_up=(7,))
            yield from super().run(parcel, cases[cases != 7], record_of)

    here(kind=Deadly)
    frame = run(folder).frame
    assert (frame["status"] == "failed").tolist() == [case == 7 for case in range(DRAWS)]
    assert "worker process ended repeatedly" in frame["message"][7]
    assert np.isnan(frame["value.R"][7])
    assert frame["draw"][7] == 7


class Dying:
    """Stands for a client whose workers die of one case, be it alone or in a group."""

    status, dashboard_link = "running", None

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"total_threads": 1}

    def submit(self, function: Any, *arguments: Any, **_: bool) -> Any:
        class Ended:
            def exception(self) -> Exception | None:
                if function is run_group and 5 in arguments[1]:
                    return KilledWorker("group", None, 3)  # type: ignore[arg-type]
                return None

            def result(self) -> GroupResult:
                return GroupResult([{"case": case} for case in arguments[1]], {}, 0.01)

            def add_done_callback(self, put: Any) -> None:
                put(self)

        return Ended()


def test_a_group_whose_workers_die_is_taken_apart() -> None:
    crew: Any = cluster.WorkerPool(Dying(), "tcp://here:1", None)
    found = [each for each in crew.run(None, np.arange(12), lambda _: {}) if each is not None]
    assert sorted(row["case"] for each in found for row in each.rows) == [case for case in range(12) if case != 5]
    assert [each.given_up for each in found if each.given_up] == [(5,)]


def test_workers_have_a_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with cluster._scratch_folder() as folder:
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o777 == 0o700
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(FmuidError, match=r"missing: no folder for workers: No such file.*TMPDIR"):
        cluster._scratch_folder().__enter__()


needs_fork = pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork")


def study_of(folder: Path, modes: list[int], **other: Any) -> Study:
    times = 0.1 * np.arange(20.0)
    rng = np.random.default_rng(5)
    pd.DataFrame({"time": times, "u": 1.0, "x": 1.0 - np.exp(-times) + 0.01 * rng.normal(size=20)}).to_csv(
        folder / "table.csv", index=False
    )
    data: dict[str, Any] = {
        "model": {"fmu": str(misbehaving_fmu(folder))},
        "experiments": [{"data": "table.csv", "inputs": ["u"], "outputs": ["x"]}],
        "parameters": {"gain": {"start": 1.2, "min": 0.5, "max": 2.0}},
        "estimation": {"solver_check": "off"},  # which only the first of like cases would simulate, and print, more for
        "batch": {"sweep": {"mode": [float(mode) for mode in modes]}},
    }
    data |= other
    return Study.of(data, folder / "study.toml")


@needs_fork
def test_cases_that_spoil_the_connection_cost_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    modes: list[int] = [Mode.SOUND, Mode.FORGE, Mode.STOP_PARENT, Mode.SOUND]
    found = IsolatedCases(study_of(tmp_path, modes)).run(range(4))
    assert [outcome.row["status"] == "failed" for outcome in found] == [False, True, False, False]
    assert "corrupted the connection" in str(found[1].row["message"])
    assert len({found[i].row["value.gain"] for i in (0, 2, 3)}) == 1


@needs_fork
@pytest.mark.slow
def test_a_first_draw_that_ends_the_process_costs_the_others_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A case asks nothing of another one, whoever runs it."""
    fmu = str(misbehaving_fmu(tmp_path))
    batch = {"monte_carlo": {"realizations": 10, "std": 0.01, "true_values": {"gain": 1.0, "mode": 0.0}}}

    def draws(mode: Mode, low: float = 5.0, high: float = 6.0) -> Study:
        values = {"mode": float(mode), "where": float(Where.STEP), "bad_from": low, "bad_to": high}
        return study_of(tmp_path, [], model={"fmu": fmu, "fixed": values}, batch=batch)

    gain = float(str(CaseRunner(draws(Mode.SOUND))(0).row["value.gain"]))
    cases = IsolatedCases(draws(Mode.SEGFAULT, gain - 1e-4, gain + 1e-4))
    plain = CaseRunner(draws(Mode.RETURN_ERROR, gain - 1e-4, gain + 1e-4))
    begun: list[Any] = []
    begin = cases._begin

    def counted(host: Any) -> None:
        begun.append(host)
        begin(host)

    monkeypatch.setattr(cases, "_begin", counted)
    found = [cases.run([k])[0] for k in (1, 2, 3)]
    assert len(begun) == 1
    assert [bits(outcome.row) for outcome in found] == [bits(plain(k).row) for k in (1, 2, 3)]
    assert {outcome.row["status"] for outcome in found} == {"converged"}


SAMPLES, STEP = 200, 0.1  # of the record of the cases that wait; s
QUARTER, CASES = 50, 200
GATED = """
model = {{ fmu = "{fmu}", fixed = {{ mode = {mode}, where = {where} }} }}
experiments = [{{ data = "first.csv", inputs = ["u"], outputs = ["x"], interpolation = "zoh" }}]
parameters = {{ gain = {{ start = 1.0, min = 0.0 }}, T = {{ start = 1.0, min = 1e-3 }} }}
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
