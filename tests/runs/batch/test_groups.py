"""Cases in groups over workers, of which some end."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
from distributed import KilledWorker
from distributed.utils import LoopRunner, sync

from fmuid.errors import FmuidError
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.local_workers import CALM
from fmuid.runs.batch.study_package import StudyPackage
from fmuid.runs.batch.worker import GroupResult, run_group
from fmuid.runs.batch.worker_pool import GroupSizes
from tests.support.coil_batches import DRAWS, Here, run

pytestmark = pytest.mark.usefixtures("blank_figures")


def test_the_inside_of_dask_is_quiet() -> None:
    """Also by loggers that have levels of their own."""
    names = ("distributed", "distributed.client", "distributed.core", "tornado.application")
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    with cluster._quiet():
        assert not any(logger.isEnabledFor(logging.CRITICAL) for logger in loggers)
    assert [logger.level for logger in loggers] == before


def test_sizes_of_groups() -> None:
    sizes = GroupSizes()
    assert sizes.next(10_000, 2) == 1
    seen = []
    for _ in range(20):
        count = sizes.next(10_000, 2)
        seen.append(count)
        sizes.learn(count, 0.04 * count + (2.0 if len(seen) == 1 else 0.0))
    assert seen[:4] == [1, 1, 2, 4]  # the first took long, and its worker is warm now
    assert seen[-1] == 75  # 3 s
    assert sizes.next(40, 2) == 10
    assert sizes.next(3, 2) == 1
    sizes.learn(75, 750.0)
    assert sizes.next(10_000, 2) == 1


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


@pytest.mark.slow
def test_workers_of_this_machine_do_not_watch_themselves() -> None:
    """Neither they nor who schedules them: what Dask does so every few milliseconds nobody sees here."""
    with cluster.crew(workers=1) as there:
        there._client.wait_for_workers(1)
        for name, value in CALM.items():
            assert dask.config.get(name) == value
            assert set(there._client.run(dask.config.get, name).values()) == {value}
    assert dask.config.get("distributed.admin.tick.interval") != CALM["distributed.admin.tick.interval"]


@pytest.mark.slow
def test_lost_tasks_of_dask_say_nothing() -> None:
    code = """if 1:
        import asyncio, gc
        from fmuid.runs.batch.worker_pool import crew
        async def lost():
            raise OSError('nobody asks')
        async def begin():
            asyncio.ensure_future(lost())
            await asyncio.sleep(0)
        if __name__ == '__main__':
            with crew(workers=1) as there:
                there._client.sync(begin)
                gc.collect()
            gc.collect()
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interrupt_before_the_loop_answers(caplog: pytest.LogCaptureFixture) -> None:
    """Ctrl-C while Dask's loop is busy with something else leaves no log lines on the terminal."""
    runner: Any = LoopRunner(asynchronous=False)
    runner.start()

    async def late() -> None:
        raise AssertionError

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with cluster._quiet():
            runner.loop.add_callback(time.sleep, 0.2)
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            with pytest.raises(KeyboardInterrupt):
                sync(runner.loop, late)
            time.sleep(0.3)  # the loop comes to it
    finally:
        signal.signal(signal.SIGALRM, before)
        runner.stop()
    assert caplog.text == ""
