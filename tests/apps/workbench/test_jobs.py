"""Commands of the workbench, and what is left of a closed tab: no words, no session, no process."""

import asyncio
import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fmuid import simulation
from fmuid.apps.workbench import Folder, Workbench, jobs, server
from fmuid.apps.workbench.pages.study import StudyPage
from fmuid.processes import AVAILABLE, SERVER
from tests.support import waiting_page
from tests.support.coil_study import coil_table
from tests.support.isolated import processes, wait_until
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.quick import first
from tests.support.tab import Tab
from tests.support.workbench import PATIENCE, asked_for, bench_of, running


class Stubborn:
    """Stands for a process that goes on until it is ended."""

    def __init__(self, *_: object, **__: object) -> None:
        self.pid, self.running, self.waited = -1, True, list[float]()

    def wait(self, seconds: float) -> int | None:
        self.waited.append(seconds)
        return None if self.running else 3

    def end(self) -> None:
        self.running = False


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the requests to end that are sent."""
    sent: list[int] = []
    monkeypatch.setattr(jobs, "Child", Stubborn)
    monkeypatch.setattr(os, "kill", lambda pid, _signal: sent.append(pid))
    return sent


def test_command_that_does_not_end_is_killed(tmp_path: Path, asked: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    job = jobs.Job(tmp_path / "study.toml", tmp_path, ["identify", "study.toml"])
    job.insist()
    assert asked == []  # nobody has asked
    job.cancel()
    for seconds, requests, goes_on in ((1.0, 1, True), (jobs.SECOND_REQUEST, 2, True), (jobs.LAST_REQUEST, 2, False)):
        now[0] += seconds
        job.insist()
        assert (len(asked), job.running) == (requests, goes_on)
    assert job.seconds == now[0] - 100.0
    job.cancel()
    assert len(asked) == 2  # it has ended
    assert job.events() == ([], 0)
    job.close(0.0)
    assert job.printed() == ""


def test_one_command_per_folder(tmp_path: Path, asked: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "LAST_REQUEST", 0.0)
    all_of, study = jobs.Jobs(), tmp_path / "study.toml"
    first = all_of.begin(study, tmp_path, ["identify", "study.toml"])
    assert all_of.begin(study, tmp_path / "." / ".", ["diagnose", "study.toml"]) is first is all_of.of(tmp_path)
    other = all_of.begin(study, tmp_path / "other", ["identify", "study.toml"])
    assert all_of.running() == [first, other]
    child: Any = first._child
    child.end()
    again = all_of.begin(study, tmp_path, ["diagnose", "study.toml"])
    assert again is not first
    assert not first._printed.exists()  # its files are gone
    all_of.close()
    assert len(asked) == 2
    assert all_of.running() == []


NEEDS_PROCESSES = pytest.mark.skipif(not AVAILABLE, reason="FMUs are not run in processes of their own here")


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workbench]:
    monkeypatch.setattr(server, "_pages", lambda: {"/study": waiting_page.build})
    with running(Workbench(Folder(tmp_path))) as found:
        yield found
        waiting_page.go.set()


def test_closed_tab_is_served_no_more(bench: Workbench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    sessions = bench._guard._applications["/study"]._sessions

    async def drag_and_close() -> None:
        tab = Tab(bench.address, "/study")
        await tab.open()
        assert len(sessions) == 1
        name = (await tab.models())["typed"]
        waiting_page.begun.clear()
        waiting_page.go.clear()
        for k in range(50):
            tab.change(name, "value", str(k))
        await asyncio.to_thread(waiting_page.begun.wait, PATIENCE)
        tab.drop()
        waiting_page.go.set()

    asyncio.run(drag_and_close())
    wait_until(lambda: not sessions, PATIENCE)
    assert [each.getMessage() for each in caplog.records] == []


@pytest.mark.parametrize("mode", first(1, [Mode.SLOW, Mode.SOUND]))
@pytest.mark.parametrize("isolated", [False, pytest.param(True, marks=NEEDS_PROCESSES)])
def test_closed_tab_leaves_no_process(tmp_path: Path, isolated: bool, mode: Mode) -> None:
    _study(tmp_path, mode, 300)
    if isolated:
        SERVER.start()
    before, doc = len(processes()), asked_for("study.toml")
    page = StudyPage(doc, bench_of(tmp_path), isolated=isolated)
    wait_until(lambda: len(processes()) > before or not isolated, PATIENCE)
    if mode is Mode.SOUND:
        wait_until(lambda: doc.session_callbacks, PATIENCE)  # it has simulated
    (destroyed,) = doc.session_destroyed_callbacks
    destroyed(None)
    page._newest._thread.join(PATIENCE)
    assert not page._newest._thread.is_alive()
    assert len(processes()) <= before


@NEEDS_PROCESSES
def test_a_stopped_workbench_ends_what_its_pages_simulate(tmp_path: Path) -> None:
    _study(tmp_path, Mode.SLOW, 20000)
    SERVER.start()
    before = len(processes())
    with running(Workbench(Folder(tmp_path))) as bench:
        Tab(bench.address, "/study?file=study.toml")
        wait_until(lambda: len(processes()) > before, PATIENCE)
        assert simulation.printed() == ""  # it waits for no simulation
        assert len(processes()) > before
    wait_until(lambda: len(processes()) <= before, PATIENCE)


def _study(folder: Path, mode: Mode, amount: int) -> None:
    coil_table(folder / "first.csv", 0.0, seed=1)
    (folder / "study.toml").write_text(
        f'[model]\nfmu = "{misbehaving_fmu(folder).as_posix()}"\nfixed = {{ mode = {int(mode)}, amount = {amount} }}\n'
        '[[experiments]]\ndata = "first.csv"\ninputs = ["u"]\noutputs = { x = "i" }\n'
        "[parameters]\ngain = { start = 1.0 }\n"
    )
