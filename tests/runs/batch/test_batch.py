"""Batches: the same rows however they are run, ended early or resumed; refusals of another batch."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fmuid import Batch, FmuidError, InputError, Study
from fmuid.events import BatchStep, Event
from fmuid.reports.render.console import Screen, showing
from fmuid.reports.render.progress import Display
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.case import CaseRunner
from fmuid.runs.batch.study_package import BatchStudy, changes
from fmuid.runs.batch.worker import difference, versions
from tests.support.coil_batches import DRAWS, NOISE, expected, refused, run, same, write
from tests.support.coil_study import COIL, coil_table, fmuid_
from tests.support.quick import first

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.mark.slow
def test_rows_do_not_depend_on_groups(folder: Path, here: Any) -> None:
    here(1)
    found = run(folder)
    same(found.frame, expected(folder))
    assert (found.truth, found.units) == ({"R": 4.0, "L": 0.1}, {"R": "Ohm", "L": "H"})
    assert (found.total, found.interrupted, found.lost, found.given_noise) == (DRAWS, False, (), False)
    assert len(list((folder / "out" / "cases").iterdir())) == 1
    assert "<th scope=row>L</th>" in (found._repr_html_() or "")
    again = Batch(folder / "study.toml", folder / "out")
    assert repr(again) == f"Batch({DRAWS} cases over draw, {str(folder / 'out')!r})"
    assert f"<b>{DRAWS} of {DRAWS} cases done</b>" in (again._repr_html_() or "")


@pytest.mark.parametrize("isolated", first(1, [False, True]))
def test_messages_name_the_users_own_model(folder: Path, here: Any, isolated: bool) -> None:
    shutil.copy(COIL, folder / "mine.fmu")
    text = write(folder, "[batch]\nsweep = { L = [0.0, 0.1] }\n").joinpath("study.toml").read_text(encoding="utf-8")
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
    write(folder, NOISE.format(draws=8))
    here()
    run(folder)
    logs = {path.name: path.read_text() for path in (folder / "out" / "logs").iterdir()}
    assert set(logs) == {"case-000003.txt", "case-000005.txt"}
    assert logs["case-000005.txt"] == "hello\n"
    assert 60_000 < len(logs["case-000003.txt"]) <= 64 * 1024


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ((0, 0, 0.0, math.inf, 0), "0 of 100 cases, waiting for workers"),
        ((0, 0, 0.0, math.inf, 2), "0 of 100 cases"),
        ((40, 3, 0.5, 119.2, 2), "40 of 100 cases, 3 failed, 0.5 a second, 0:02:00 left"),
        ((100, 3, 0.5, 0.0, 2), "100 of 100 cases, 3 failed"),
    ],
)
def test_progress(step: tuple[int, int, float, float, int], told: str, monkeypatch: Any, capsys: Any) -> None:
    done, failed, rate, left, threads = step
    event = BatchStep(done=done, total=100, failed=failed, rate=rate, left=left, threads=threads)
    assert event.share == done / 100
    for every, shown in ((3600.0, ""), (0.0, f"{told}\n")):  # lines are seldom
        monkeypatch.setattr(Display, "EVERY", every)
        with showing(Screen(verbose=True)), Display() as display:
            display(event)
            assert capsys.readouterr().err == shown


def command(folder: Path) -> int:
    return fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--no-isolation", "--no-report")


@pytest.mark.slow
def test_an_interruption(folder: Path, here: Any) -> None:
    first = here(3, stop_after=12)
    found = run(folder)
    assert found.interrupted
    assert 0 < len(first.ran) < DRAWS
    assert sorted(found.frame["case"]) == sorted(first.ran)
    second, events = here(4), list[Event]()
    job = Batch(folder / "study.toml", folder / "out", isolated=False)
    assert set(job.pending.tolist()) == set(range(DRAWS)) - set(first.ran)
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
    (fleet / "records" / "r1.csv").unlink()
    coil_table(fleet / "records" / "r9.csv", 0.0, seed=9)
    coil_table(fleet / "records" / "r3.csv", 0.0, seed=8)
    with pytest.raises(InputError) as raised:
        run(fleet)
    for told in ("records/r3.csv has changed", "r9.csv is new", "r1.csv was removed"):
        assert told in str(raised.value)


def test_where_nothing_is_finished_nothing_is_refused(folder: Path, here: Any) -> None:
    here(stop_after=0)
    nothing = run(folder)
    assert nothing.frame.empty
    assert (nothing._repr_html_() or "").startswith(f"<p><b>0 of {DRAWS} cases")
    write(folder, NOISE.format(draws=3))
    here()
    same(run(folder).frame, expected(folder))


@pytest.mark.slow
def test_changes_that_are_allowed(folder: Path, here: Any) -> None:
    """A damaged part, another title, and beginning again."""
    here(3, stop_after=12)
    run(folder)
    part = sorted((folder / "out" / "cases").iterdir())[0]
    part.write_bytes(part.read_bytes()[:-20])
    (folder / "study.toml").write_text((folder / "study.toml").read_text().replace('"Coil"', '"Another title"'))
    here()
    found = run(folder)
    assert found.lost == (part,)
    same(found.frame, expected(folder))
    write(folder, NOISE.format(draws=10))
    again = here()
    found = run(folder, resume=False)
    assert sorted(again.ran) == list(range(10))
    same(found.frame, expected(folder))


def test_another_batch(folder: Path, here: Any) -> None:
    small = NOISE.format(draws=2)
    write(folder, small)
    here(3)
    run(folder)
    changes: dict[str, Callable[[], object]] = {
        "parameters.R.start was 6.0": lambda: write(folder, small, R="7.0"),
        "batch.monte_carlo.realizations was 2": lambda: write(folder, NOISE.format(draws=6)),
        "batch.seed was not given": lambda: write(folder, small + "seed = 3\n"),
        "first.csv has changed": lambda: coil_table(folder / "first.csv", 0.0, seed=9),
    }
    for told, change in changes.items():
        change()
        with pytest.raises(InputError, match=r"cases of another batch.*--no-resume") as raised:
            run(folder)
        assert told in str(raised.value)


@pytest.mark.parametrize("error", [FmuidError("the scheduler was lost"), None], ids=["lost", "Ctrl-C"])
def test_finished_cases_are_kept(folder: Path, here: Any, capsys: Any, error: FmuidError | None) -> None:
    write(folder, NOISE.format(draws=10))
    ran = here(3, stop_after=6, error=error).ran
    assert command(folder) == 1
    out, said = capsys.readouterr()
    assert sorted(pd.read_parquet(folder / "out" / "cases")["case"]) == sorted(ran)
    interrupted = f"interrupted: {len(ran)} of 10 cases are finished"
    assert ("error: the scheduler was lost" if error else interrupted) in said
    assert ("summary.csv" in out) == (error is None)


def test_manifest_and_package(fleet: Path) -> None:
    bundle = BatchStudy(Study.read(fleet / "study.toml"), isolated=False, versions={})
    told = bundle.manifest()
    assert changes(json.loads(json.dumps(told)), told) == []
    assert changes(told | {"fmuid": "0.0.9"}, told) == [f"made by fmuid 0.0.9, this is {told['fmuid']}"]
    assert sorted(Path(name).name for name in bundle.parcel.files) == ["Coil.fmu", "first.csv"]
    path = fleet / "records" / "r1.csv"
    assert list(bundle.record(path).values()) == [path.read_bytes()]
    for gone in (False, True):
        coil_table(path, 0.0, seed=9)
        if gone:
            path.unlink()
        with pytest.raises(InputError, match=r"r1.csv: changed while the batch ran"):
            bundle.record(path)


@pytest.mark.parametrize(
    ("batch", "words", "told"),
    [
        (NOISE.format(draws=30), ["--max-cases", "29"], "30 cases exceed the limit of 29"),
        ("", [], "no [batch]"),
        ('[batch]\ndata = "nothing/*.csv"\n', [], '"nothing/*.csv" matches no file'),
        (None, ["-o", "first.csv"], "first.csv cannot be made a folder"),
        (None, ["--workers", "0"], "--workers must be a whole number above 0, not 0"),
        (None, ["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], "exclude each other"),
        (None, ["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler at tcp://127.0.0.1:9"),
        (None, ["--scheduler", "nonsense"], "no Dask scheduler at nonsense"),
    ],
)
def test_wrong_words(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, batch: str | None, words: list[str], told: str
) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.3)
    monkeypatch.chdir(folder)
    if batch is not None:
        write(folder, batch)
    output = [] if "-o" in words else ["-o", "out"]
    assert told in refused(capsys, "study.toml", *output, *words)
    assert not list(folder.glob("out/cases/*"))


def test_a_folder_without_its_manifest(folder: Path, here: Any, capsys: Any) -> None:
    write(folder, NOISE.format(draws=3))
    here()
    run(folder)
    path = folder / "out" / "batch.json"
    path.unlink()
    assert "cases without batch.json" in refused(capsys, folder / "study.toml", "-o", folder / "out")
    for damaged, told in (
        ("[]", "has no JSON object"),
        ('{"fmuid": "0.1.0", "stu', "is not JSON (Unterminated string"),
        ("[" * 100_000, "is not JSON ("),
        ('{"fmuid": "0.0.9", "study": [], "files": ["a"]}', "made by fmuid 0.0.9, this is "),
    ):
        path.write_text(damaged)
        said = refused(capsys, folder / "study.toml", "-o", folder / "out")
        assert told in said and "--no-resume" in said and "--output" in said


@pytest.mark.parametrize(
    ("name", "other", "told"),
    [
        ("python", "3.11.9.final.0", None),
        ("python", "3.12.1.final.0", "runs python 3.12.1, this machine 3.11.7"),
        ("fmuid", "0.1.1", "runs fmuid 0.1.1, this machine 0.1.0"),
        ("fmuid", None, "has no fmuid. Install fmuid 0.1.0 there"),
        ("numpy", "2.9.0", None),
        ("numpy", "1.26.4", "runs numpy 1.26.4, this machine 2.4.6"),
    ],
)
def test_versions(name: str, other: str | None, told: str | None) -> None:
    mine = {"python": "3.11.7.final.0", "fmuid": "0.1.0", "dask": "2026.8.0", "numpy": "2.4.6", "pandas": "3.1.1"}
    found = difference(mine, mine | {name: other})
    assert found is None if told is None else told in str(found)


class Unlike:
    """Client of a cluster on which one side runs another version."""

    def __init__(self, scheduler: dict[str, str | None], worker: dict[str, str | None]) -> None:
        here = versions()
        workers = {"tcp://a:1": {"packages": here}, "tcp://b:2": {"packages": here | worker}}
        self.found = {"scheduler": {"packages": here | scheduler}, "workers": workers}

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"n_workers": 2}

    def get_versions(self, packages: list[str]) -> dict[str, Any]:
        assert packages == ["fmuid"]
        return self.found


def test_a_cluster_with_other_versions() -> None:
    cluster._check(Unlike({}, {}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the worker tcp://b:2 has no fmuid"):
        cluster._check(Unlike({}, {"fmuid": None}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the scheduler at tcp://s:8786 runs dask 2020.1.0"):
        cluster._check(Unlike({"dask": "2020.1.0"}, {}), "tcp://s:8786")
