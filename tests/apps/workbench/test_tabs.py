"""What is left of a closed tab: no words in the terminal, no session, no process."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from fmuid.apps.workbench import Folder, Workbench, server
from fmuid.apps.workbench.pages.study import StudyPage
from fmuid.processes import AVAILABLE, SERVER
from tests.support import waiting_page
from tests.support.coil_study import coil_table
from tests.support.isolated import processes, wait_until
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.tab import Tab
from tests.support.workbench import PATIENCE, asked_for, bench_of, running

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


@pytest.mark.parametrize("mode", [Mode.SLOW, Mode.SOUND])
@pytest.mark.parametrize("isolated", [False, pytest.param(True, marks=NEEDS_PROCESSES)])
def test_closed_tab_leaves_no_process(tmp_path: Path, isolated: bool, mode: Mode) -> None:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(
        f'[model]\nfmu = "{misbehaving_fmu(tmp_path).as_posix()}"\nfixed = {{ mode = {int(mode)}, amount = 300 }}\n'
        '[[experiments]]\ndata = "first.csv"\ninputs = ["u"]\noutputs = { x = "i" }\n'
        "[parameters]\ngain = { start = 1.0 }\n"
    )
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
