"""Batches: the same rows whatever runs them and whatever ends them meanwhile, and one sentence for what is wrong."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import inspect
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest
from distributed import KilledWorker

from experiments.batches.campaign import command, family, left_over, rows
from fmuid.batches import batch as module
from fmuid.batches import cluster
from fmuid.batches import worker as workshop
from fmuid.batches.batch import Batch, BatchResult
from fmuid.batches.cluster import GroupSizes
from fmuid.batches.parcel import Bundle, Parcel, changes
from fmuid.batches.run_case import VOLATILE, CaseRunner
from fmuid.batches.worker import GroupResult, run_group, versions
from fmuid.cli import batch as cli_batch
from fmuid.errors import FmuidError, InputError
from fmuid.progress import BatchStep, Event
from fmuid.reports.console.progress import Display
from fmuid.studies.study import Study
from tests.support.coil_study import COIL, STUDY, coil_table, fmuid_
from tests.support.isolated import wait_until

pytestmark = pytest.mark.usefixtures("blank_figures")
DRAWS = 30
# Samples of a table whose identification takes long enough to be disturbed.
LONG, STEP = 6000, 1e-3
NOISE = "[batch]\nnoise = {{ draws = {draws}, std = 0.02, truth = {{ R = 4.0, L = 0.1 }} }}\n"
RECORDS = '[batch]\ntables = "records/*.csv"\nstarts = 2\n'


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

    def __init__(self, seed: int = 0, stop_after: int | None = None, error: BaseException | None = None) -> None:
        self.rng, self.stop_after, self.error = np.random.default_rng(seed), stop_after, error
        self.ran: list[int] = []

    def run(self, parcel: Parcel, cases: Any, record_of: Any) -> cluster.Results:
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
    def __call__(self, scheduler: str | None, workers: int | None) -> Iterator[Here]:
        assert scheduler is None
        assert workers is None
        yield self


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what puts a `Here` in place of the cluster."""
    for name in workshop.SINGLE_THREADED:
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr(module, "WRITE_SECONDS", 0.0)
    monkeypatch.setattr(module, "WRITE_SHARE", 0.0)

    def use(seed: int = 0, kind: type[Here] = Here, **words: Any) -> Here:
        found = kind(seed, **words)
        monkeypatch.setattr(module, "crew", found)
        return found

    return use


def run(folder: Path, output: str = "out", **words: Any) -> BatchResult:
    return Batch(folder / "study.toml", folder / output, isolated=False, **words).run()


@pytest.mark.parametrize("seed", [1, 2])
def test_rows_do_not_depend_on_groups(folder: Path, here: Any, seed: int) -> None:
    here(seed)
    found = run(folder)
    same(found.frame, expected(folder))
    assert (found.truth, found.units) == ({"R": 4.0, "L": 0.1}, {"R": "Ohm", "L": "H"})
    assert (found.total, found.interrupted, found.lost, found.given_noise) == (DRAWS, False, (), False)
    assert len(list((folder / "out" / "cases").iterdir())) == 1
    assert "<th scope=row>L</th>" in (found._repr_html_() or "")


def test_messages_name_the_users_own_files(fleet: Path, here: Any) -> None:
    here()
    found = run(fleet)
    same(found.frame, expected(fleet))
    failed = found.frame[found.frame["status"] == "failed"]
    assert failed["table"].tolist() == ["r2", "r2"]
    assert failed["message"].str.startswith(str(fleet / "records" / "r2.csv")).all()


@pytest.mark.parametrize("isolated", [False, True])
def test_messages_name_the_users_own_model(folder: Path, here: Any, isolated: bool) -> None:
    shutil.copy(COIL, folder / "mine.fmu")
    text = write(folder, "[batch]\nvalues = { L = [0.0, 0.1] }\n").joinpath("study.toml").read_text(encoding="utf-8")
    (folder / "study.toml").write_text(text.replace(COIL.as_posix(), "mine.fmu"), encoding="utf-8")
    here()
    found = Batch(folder / "study.toml", folder / "out", isolated=isolated).run().frame
    same(found, expected(folder))
    assert found["status"].tolist() == ["failed", "converged"]
    assert f"simulation of {folder / 'mine.fmu'} failed" in found["message"][0]


def test_logs(folder: Path, here: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    told = CaseRunner.__call__

    def talking(runner: CaseRunner, index: int) -> Any:
        outcome = told(runner, index)
        return type(outcome)(outcome.row, "hello\n" * (100_000 if index == 3 else 1) if index in (3, 5) else "")

    monkeypatch.setattr(CaseRunner, "__call__", talking)
    here()
    run(folder)
    logs = {path.name: path.read_text() for path in (folder / "out" / "logs").iterdir()}
    assert set(logs) == {"case-000003.txt", "case-000005.txt"}
    assert logs["case-000005.txt"] == "hello\n"
    assert 60_000 < len(logs["case-000003.txt"]) <= 64 * 1024


def test_interrupted_and_gone_on_with(folder: Path, here: Any) -> None:
    first = here(3, stop_after=12)
    found = run(folder)
    assert found.interrupted
    assert sorted(found.frame["case"]) == sorted(first.ran)
    assert 0 < len(first.ran) < DRAWS
    second = here(4)
    job = Batch(folder / "study.toml", folder / "out", isolated=False)
    assert set(job.pending.tolist()) == set(range(DRAWS)) - set(first.ran)
    events: list[Event] = []
    again = job.run(events.append)
    steps = [event for event in events if isinstance(event, BatchStep)]
    assert sorted(first.ran + second.ran) == list(range(DRAWS))  # none lost, none run twice
    same(again.frame, expected(folder))
    kept = again.frame[again.frame["case"].isin(first.ran)].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, found.frame)
    assert (steps[0].done, steps[0].failed, steps[-1].done, steps[-1].total) == (len(first.ran), 0, DRAWS, DRAWS)
    third = here(5)
    same(run(folder).frame, again.frame)
    assert not third.ran


def test_failed_cases_are_finished(fleet: Path, here: Any) -> None:
    here()
    run(fleet)
    again = here()
    run(fleet)
    assert not again.ran


def test_where_nothing_is_finished_nothing_is_refused(folder: Path, here: Any) -> None:
    here(stop_after=0)
    nothing = run(folder)
    assert nothing.frame.empty
    assert (nothing._repr_html_() or "").startswith(f"<p><b>0 of {DRAWS} cases")
    write(folder, NOISE.format(draws=10))
    here()
    same(run(folder).frame, expected(folder))


def test_begin_anew(folder: Path, here: Any) -> None:
    here()
    run(folder)
    write(folder, NOISE.format(draws=10))
    again = here()
    found = run(folder, resume=False)
    assert sorted(again.ran) == list(range(10))
    same(found.frame, expected(folder))


def test_a_damaged_part_is_run_again(folder: Path, here: Any) -> None:
    here(3, stop_after=12)
    run(folder)
    part = sorted((folder / "out" / "cases").iterdir())[0]
    part.write_bytes(part.read_bytes()[:-20])
    here()
    found = run(folder)
    assert found.lost == (part,)
    same(found.frame, expected(folder))


@pytest.mark.slow
def test_full_disk(folder: Path, here: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    calls, fsync = [], os.fsync

    def full(handle: int) -> None:
        calls.append(handle)
        if len(calls) > 6:  # manifest, folder, and two parts
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    first = here(3)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--in-process") == 1
    out, error = capsys.readouterr()
    assert error.startswith(f"error: {folder / 'out'} cannot be written to: No space left on device; the cases")
    assert error.count("\n") == 1
    second = here(4)
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--in-process") == 0
    assert len(first.ran) + len(second.ran) >= DRAWS
    assert len(second.ran) < DRAWS
    same(pd.read_parquet(folder / "out" / "cases"), expected(folder))
    out, error = capsys.readouterr()
    assert error == ""
    assert "30 cases: 30 converged" in " ".join(out.split())
    told = json.loads((folder / "out" / "summary.json").read_text())
    digests = [hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in ("study.toml", "first.csv")]
    assert [told["study"]["digest"], told["tables"]["first.csv"]] == digests
    assert told["date"].startswith("20")


def test_a_lost_scheduler_keeps_what_there_is(folder: Path, here: Any, capsys: Any) -> None:
    lost = here(3, stop_after=12, error=FmuidError("the scheduler was lost"))
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--in-process") == 1
    assert "error: the scheduler was lost" in capsys.readouterr().err
    assert sorted(pd.read_parquet(folder / "out" / "cases")["case"]) == sorted(lost.ran)


def test_ctrl_c_on_the_command_line(folder: Path, here: Any, capsys: Any) -> None:
    ran = here(3, stop_after=12).ran
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--in-process") == 1
    out, error = capsys.readouterr()
    assert error.endswith(f"interrupted: {len(ran)} of {DRAWS} cases are finished; the same command goes on\n")
    assert "summary.csv" in out


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f: write(f, NOISE.format(draws=DRAWS), R="7.0"), "parameters.R.start was 6.0"),
        (lambda f: write(f, NOISE.format(draws=31)), "batch.noise.draws was 30"),
        (lambda f: write(f, NOISE.format(draws=DRAWS) + "seed = 3\n"), "batch.seed was not given"),
        (lambda f: coil_table(f / "first.csv", 0.0, seed=9), "first.csv has another content"),
    ],
)
def test_another_batch_is_refused(folder: Path, here: Any, change: Any, told: str) -> None:
    here(3, stop_after=12)
    run(folder)
    change(folder)
    with pytest.raises(InputError) as raised:
        run(folder)
    said = str(raised.value)
    assert said.startswith(f"{folder / 'out'} has the cases of another batch ({told}")
    assert said.endswith("choose another folder with --output, or have the earlier cases removed with --no-resume")


def test_what_no_row_depends_on_may_change(folder: Path, here: Any) -> None:
    here(3, stop_after=12)
    run(folder)
    text = (folder / "study.toml").read_text().replace('"Coil"', '"Another title"')
    (folder / "study.toml").write_text(text)
    here()
    assert len(run(folder).frame) == DRAWS


def test_changed_records_are_named(fleet: Path, here: Any) -> None:
    here()
    run(fleet)
    (fleet / "records" / "r1.csv").unlink()
    coil_table(fleet / "records" / "r9.csv", 0.0, seed=9)
    coil_table(fleet / "records" / "r3.csv", 0.0, seed=8)
    with pytest.raises(InputError) as raised:
        run(fleet)
    for told in ("records/r3.csv has another content", "r9.csv is new", "r1.csv is no longer part of it"):
        assert told in str(raised.value)


def test_another_version_is_refused(folder: Path) -> None:
    bundle = Bundle(Study.read(folder / "study.toml"), isolated=False, versions={})
    told = bundle.manifest()
    assert changes(json.loads(json.dumps(told)), told) == []
    assert changes(told | {"fmuid": "0.0.9"}, told) == [f"it was run by fmuid 0.0.9, this is {told['fmuid']}"]


def test_a_record_that_changes_meanwhile(fleet: Path) -> None:
    bundle = Bundle(Study.read(fleet / "study.toml"), isolated=False, versions={})
    path = fleet / "records" / "r1.csv"
    assert list(bundle.record(path).values()) == [path.read_bytes()]
    coil_table(path, 0.0, seed=9)
    with pytest.raises(InputError, match=r"r1.csv has changed while the batch ran"):
        bundle.record(path)
    path.unlink()
    with pytest.raises(InputError, match=r"r1.csv has changed while the batch ran"):
        bundle.record(path)


def test_records_do_not_travel_with_the_study(fleet: Path) -> None:
    parcel = Bundle(Study.read(fleet / "study.toml"), isolated=False, versions={}).parcel
    assert sorted(Path(name).name for name in parcel.files) == ["Coil.fmu", "first.csv"]


def test_sizes_of_groups() -> None:
    sizes = GroupSizes()
    assert sizes.next(10_000, 2) == 1
    seen = []
    for _ in range(20):
        count = sizes.next(10_000, 2)
        seen.append(count)
        sizes.learn(count, 0.04 * count + (2.0 if len(seen) == 1 else 0.0))
    assert seen[:4] == [1, 1, 2, 4]  # the first took long, and its worker is warm now
    assert seen[-1] == 37  # 1.5 s
    assert sizes.next(40, 2) == 10
    assert sizes.next(3, 2) == 1
    sizes.learn(37, 370.0)
    assert sizes.next(10_000, 2) == 1


def test_a_case_that_ends_its_workers_is_given_up(folder: Path, here: Any) -> None:
    class Deadly(Here):
        def run(self, parcel: Parcel, cases: Any, record_of: Any) -> cluster.Results:
            yield GroupResult(given_up=(7,))
            yield from super().run(parcel, cases[cases != 7], record_of)

    here(kind=Deadly)
    frame = run(folder).frame
    assert (frame["status"] == "failed").tolist() == [case == 7 for case in range(DRAWS)]
    assert "ended the process of its worker" in frame["message"][7]
    assert np.isnan(frame["value.R"][7])
    assert frame["draw"][7] == 7


class Dying:
    """Stands for a client whose workers die of one case, be it alone or in a group."""

    status = "running"

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
    crew: Any = cluster.Crew(Dying(), "tcp://here:1", None)
    found = [each for each in crew.run(None, np.arange(12), lambda _: {}) if each is not None]
    assert sorted(row["case"] for each in found for row in each.rows) == [case for case in range(12) if case != 5]
    assert [each.given_up for each in found if each.given_up] == [(5,)]


# --- wrong input -------------------------------------------------------------------------


def refused(capsys: Any, *arguments: str | Path) -> str:
    assert fmuid_("batch", *arguments) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    return str(error)


def test_too_many_cases(folder: Path, capsys: Any) -> None:
    said = refused(capsys, folder / "study.toml", "-o", folder / "out", "--max-cases", "29")
    assert "spans 30 cases, and --max-cases allows 29" in said
    assert not (folder / "out").exists()


def test_no_batch(folder: Path, capsys: Any) -> None:
    said = refused(capsys, write(folder, "") / "study.toml", "-o", folder / "out")
    assert "study.toml has no [batch]: give it" in said


def test_empty_pattern(folder: Path, capsys: Any) -> None:
    write(folder, '[batch]\ntables = "nothing/*.csv"\n')
    assert '"nothing/*.csv" matches no file' in refused(capsys, folder / "study.toml", "-o", folder / "out")


def test_rows_of_nobody(folder: Path, here: Any, capsys: Any) -> None:
    here()
    run(folder)
    (folder / "out" / "batch.json").unlink()
    assert "has cases and no batch.json" in refused(capsys, folder / "study.toml", "-o", folder / "out")
    for spoilt, told in (
        ("[]", "batch.json cannot be read (no table)"),
        ('{"fmuid": "0.1.0", "stu', "batch.json cannot be read (Unterminated string"),
        ("[" * 100_000, "batch.json cannot be read ("),
        ('{"fmuid": "0.0.9", "study": [], "files": ["a"]}', "it was run by fmuid 0.0.9, this is "),
    ):
        (folder / "out" / "batch.json").write_text(spoilt)
        said = refused(capsys, folder / "study.toml", "-o", folder / "out")
        assert told in said and "--no-resume" in said and "--output" in said


def test_output_is_a_file(folder: Path, capsys: Any) -> None:
    said = refused(capsys, folder / "study.toml", "-o", folder / "first.csv")
    assert "first.csv cannot be written to" in said


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--workers", "0"], "--workers must be a whole number above 0, not 0"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], "keep one"),
        (["--scheduler", "tcp://127.0.0.1:9"], "there is no Dask scheduler at tcp://127.0.0.1:9"),
        (["--scheduler", "nonsense"], "there is no Dask scheduler at nonsense"),
    ],
)
def test_wrong_cluster(folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.5)
    assert told in refused(capsys, folder / "study.toml", "-o", folder / "out", *words)


def test_differences_of_versions() -> None:
    mine = {"python": "3.11.7.final.0", "fmuid": "0.1.0", "dask": "2026.8.0", "distributed": "2026.8.0"}
    mine |= {"numpy": "2.4.6", "pandas": "3.1.1"}
    for name, other, told in (
        ("python", "3.11.9.final.0", None),
        ("python", "3.12.1.final.0", "runs python 3.12.1, and here it is 3.11.7: install the same on both sides"),
        ("fmuid", "0.1.1", "runs fmuid 0.1.1, and here it is 0.1.0: install the same on both sides"),
        ("fmuid", None, "has no fmuid: install fmuid 0.1.0 there"),
        (
            "distributed",
            "2026.7.0",
            "runs distributed 2026.7.0, and here it is 2026.8.0: install the same on both sides",
        ),
        ("numpy", "2.9.0", None),
        ("numpy", "1.26.4", "runs numpy 1.26.4, and here it is 2.4.6: install the same on both sides"),
        ("pandas", "2.2.0", "runs pandas 2.2.0, and here it is 3.1.1: install the same on both sides"),
    ):
        assert workshop.difference(mine, mine | {name: other}) == told


class Unlike:
    """Stands for a client of a cluster on which one side runs something else."""

    def __init__(self, scheduler: dict[str, str | None], worker: dict[str, str | None]) -> None:
        here = versions()
        self.found = {
            "scheduler": {"packages": here | scheduler},
            "workers": {"tcp://a:1": {"packages": here}, "tcp://b:2": {"packages": here | worker}},
        }

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"n_workers": 2}

    def get_versions(self, packages: list[str]) -> dict[str, Any]:
        assert packages == ["fmuid"]
        return self.found


def test_a_cluster_that_is_not_alike() -> None:
    cluster._check(Unlike({}, {}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the worker tcp://b:2 has no fmuid: install fmuid .* there$"):
        cluster._check(Unlike({}, {"fmuid": None}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the scheduler at tcp://s:8786 runs dask 2020.1.0, and here it is"):
        cluster._check(Unlike({"dask": "2020.1.0"}, {}), "tcp://s:8786")


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ((0, 0, 0.0, math.inf, 0), "0 of 100 cases, waiting for workers"),
        ((0, 0, 0.0, math.inf, 2), "0 of 100 cases"),
        ((40, 3, 0.5, 119.2, 2), "40 of 100 cases, 3 failed, 0.5 a second, 0:02:00 left"),
        ((100, 3, 0.5, 0.0, 2), "100 of 100 cases, 3 failed"),
    ],
)
def test_progress(
    step: tuple[int, int, float, float, int], told: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    done, failed, rate, left, threads = step
    event = BatchStep(done=done, total=100, failed=failed, rate=rate, left=left, threads=threads)
    assert event.share == done / 100
    monkeypatch.setattr(Display, "EVERY", 3600.0)
    with Display() as display:
        display(event)
        assert capsys.readouterr().out == ""  # lines are seldom
    monkeypatch.setattr(Display, "EVERY", 0.0)
    with Display() as display:
        display(event)
    assert capsys.readouterr().out == f"{told}\n"


def test_the_command_refuses_what_the_class_refuses() -> None:
    assert inspect.signature(cli_batch.batch).parameters["max_cases"].default == module.MAX_CASES


def test_a_worker_that_computes_in_threads(folder: Path, here: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    here()
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    with pytest.raises(InputError, match=r"start it with OPENBLAS_NUM_THREADS=1 in its environment"):
        run(folder)


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
    line = command(folder / "study.toml", folder / "out", "--workers", str(workers), "--in-process")
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


@pytest.mark.slow
def test_kills(folder: Path) -> None:
    """Of a worker and, at a drawn moment, of the driver; Ctrl-C, SIGTERM: no row lost or run again, no process left."""
    draws, rng = 200, np.random.default_rng(5)
    times = STEP * np.arange(LONG)
    pd.DataFrame({"time": times, "u": np.sign(np.sin(300 * times))}).to_csv(folder / "first.csv", index=False)
    write(folder, NOISE.format(draws=draws))
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
    assert 0 < len(kept) < draws

    partial = [kept]
    for number in (signal.SIGINT, signal.SIGTERM):
        process = started(folder, 2)
        wait_for_part(process, folder, len(list((folder / "out" / "cases").glob("part-*.parquet"))))
        everybody = family(process.pid)
        process.send_signal(number)
        _, said = process.communicate(timeout=600)
        assert not left_over(everybody)
        assert not list((folder / "scratch").glob("fmuid-*"))
        assert process.returncode == 1
        partial.append(pd.read_parquet(folder / "out" / "cases"))
        assert len(partial[-2]) < len(partial[-1]) < draws
        answer, last = said.splitlines()
        assert answer.startswith("interrupted: saving the finished cases, then ending the workers")
        assert last == f"interrupted: {len(partial[-1])} of {draws} cases are finished; the same command goes on"

    process = started(folder, 1)
    _, said = process.communicate(timeout=600)
    assert (process.returncode, said) == (0, "")
    found = pd.read_parquet(folder / "out" / "cases")
    assert found["case"].tolist() == list(range(draws))
    for before in partial:
        assert before.merge(found[["case", *VOLATILE]]).shape[0] == len(before)
    runner = CaseRunner(Study.read(folder / "study.toml"))
    for case in rng.choice(draws, 20, replace=False).tolist():
        row = runner(case).row
        assert [row[str(name)] for name in plain(found)] == plain(found).loc[case].tolist()


def test_workers_that_cannot_begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho ImportError: no numpy >&2\necho more >&2\nexit 1\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr(cluster, "MOST_RESTARTS", 3)
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 600.0)
    host, until = cluster._LocalWorkers("tcp://127.0.0.1:9", 1, tmp_path / "workers"), time.monotonic() + 600
    with pytest.raises(FmuidError, match=r"^the workers end as soon as they begin: ImportError: no numpy$"):
        while time.monotonic() < until:
            host.look()
            time.sleep(0.01)
    host.close()


# --- on a cluster ------------------------------------------------------------------------


def _json(path: Path) -> dict[str, Any]:
    """Return what a file says, nothing before it is written to its end."""
    try:
        found: dict[str, Any] = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return {}
    return found


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler in a process of its own, without workers."""
    place, line = tmp_path / "scheduler", [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    place.mkdir()
    line += ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    line += ["--scheduler-file", str(place / "file.json")]
    with subprocess.Popen(line, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        wait_until(lambda: _json(place / "file.json"))
        yield _json(place / "file.json")["address"], process
        process.kill()


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


def shops(folder: Path) -> list[Path]:
    """Return the folders that workers have for a batch."""
    return list(folder.glob("*/dask-scratch-space/worker-*/fmuid-*"))


@pytest.mark.slow
def test_a_cluster(
    fleet: Path, scheduler: tuple[str, subprocess.Popen[bytes]], capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without workers, with other versions, in peace, and lost meanwhile."""
    address, process = scheduler
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 2.0)
    words = (fleet / "study.toml", "-o", fleet / "out", "--scheduler", address)
    assert f"the scheduler at {address} has no workers" in refused(capsys, *words)
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 600.0)
    with worker(address, fleet / "one"), worker(address, fleet / "two", "--nworkers", "1"):
        with monkeypatch.context() as older:
            older.setattr(cluster, "versions", lambda: versions() | {"fmuid": "0.0.9"})
            said = refused(capsys, *words)
        assert f"the scheduler at {address}" in said
        assert f"runs fmuid {versions()['fmuid']}, and here it is 0.0.9" in said
        assert fmuid_("batch", *words) == 0
        assert capsys.readouterr().err == ""
        same(pd.read_parquet(fleet / "out" / "cases"), expected(fleet))

        wait_until(lambda: not shops(fleet))

        write(fleet, NOISE.format(draws=3000))

        def kill(step: Event) -> None:
            if step.share:
                assert {each.stat().st_mode & 0o777 for each in shops(fleet)} == {0o700}
                process.kill()

        job = Batch(fleet / "study.toml", fleet / "lost", scheduler=address)
        with pytest.raises(
            FmuidError, match=f"the scheduler at {address} was lost: the cases finished so far are kept"
        ):
            job.run(kill)
    kept = rows(fleet / "lost")
    assert 0 < len(kept) < 3000
    assert set(job.pending.tolist()) == set(range(3000)) - set(kept["case"])
