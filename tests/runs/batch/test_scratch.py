"""Folders of workers: removed once all processes that use them have ended, whatever ended them, and never before."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import dask
import psutil
import pytest

from fmuid.errors import FmuidError
from fmuid.runs.batch import local_workers as scratch
from fmuid.runs.batch.local_workers import CALM, scratch_folder
from fmuid.runs.batch.worker_pool import crew

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no locks of this kind")

HOLD = """
import subprocess, sys
from fmuid.runs.batch.local_workers import scratch_folder
with scratch_folder() as (folder, locks):
    (folder / "inside").mkdir()
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=sys.stdin, pass_fds=locks)
    print(folder, flush=True)
    child.wait()
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders are made, of this process and those that it starts."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def holder(place: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A process with a folder, and one more below it that shares the lock and ends with the standard input."""
    assert not list(place.iterdir())
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLD], text=True, **pipes) as process:  # type: ignore[call-overload]
        yield process, Path(process.stdout.readline().strip())
        process.kill()


def begin_another() -> None:
    with scratch_folder():
        pass


def test_a_folder(place: Path) -> None:
    with scratch_folder() as (folder, locks):
        assert folder.parent == place
        assert folder.stat().st_mode & 0o777 == 0o700
        assert len(locks) == 1
        with scratch_folder() as (other, _):
            assert folder.is_dir()
            assert other != folder
    assert not list(place.iterdir())


def test_killed(holder: tuple[subprocess.Popen[str], Path]) -> None:
    """A folder stays while the process lives, while one lives that has inherited its lock, and no longer."""
    process, folder = holder
    (below,) = psutil.Process(process.pid).children()
    begin_another()
    assert (folder / "inside").is_dir()
    process.kill()
    process.wait()
    begin_another()
    assert (folder / "inside").is_dir()
    assert process.stdin is not None
    process.stdin.close()
    below.wait(600)
    begin_another()
    assert not folder.exists()


def test_what_is_left_alone(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders that are being made, of another user, of another machine, and where a link leads."""
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(scratch, "_lock_name", lambda: "lock-elsewhere")
        elsewhere.setattr(shutil, "rmtree", lambda *_, **__: None)
        begin_another()
        (foreign,) = place.iterdir()
    (place / f"{scratch.PREFIX}new").mkdir()
    (place / "target").mkdir()
    (place / "target" / scratch._lock_name()).touch()
    (place / f"{scratch.PREFIX}link").symlink_to(place / "target")
    begin_another()
    assert len(list(place.iterdir())) == 4
    assert foreign.is_dir()
    (foreign / scratch._lock_name()).touch()
    with monkeypatch.context() as somebody:
        somebody.setattr(os, "geteuid", lambda: 12345)
        begin_another()
    assert foreign.is_dir()
    begin_another()
    assert not foreign.exists()


def test_no_room(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(place / "missing"))
    with pytest.raises(FmuidError, match=r"missing: no folder for workers: No such file.*TMPDIR"):
        begin_another()


def test_the_folder_of_workers_is_locked(place: Path) -> None:
    """By the process that keeps them too."""
    with crew(workers=1) as there:
        host = there._local
        assert host is not None
        (lock,) = host._locks
        inode = os.fstat(lock).st_ino
        descriptors = Path(f"/proc/{host._process.pid}/fd")
        if descriptors.is_dir():
            assert inode in {each.stat().st_ino for each in descriptors.iterdir() if each.exists()}
    assert not list(place.iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("place")
def test_workers_of_this_machine_do_not_watch_themselves() -> None:
    """Neither they nor who schedules them: what Dask does so every few milliseconds nobody sees here."""
    with crew(workers=1) as there:
        there._client.wait_for_workers(1)
        for name, value in CALM.items():
            assert dask.config.get(name) == value
            assert set(there._client.run(dask.config.get, name).values()) == {value}
    assert dask.config.get("distributed.admin.tick.interval") != CALM["distributed.admin.tick.interval"]


@pytest.mark.slow
@pytest.mark.usefixtures("place")
def test_tasks_that_nobody_asks() -> None:
    """What Dask's tasks come to when a scheduler is lost is told in our words, and not by asyncio at the very end."""
    code = (
        "import asyncio, gc\n"
        "from fmuid.runs.batch.worker_pool import crew\n"
        "async def lost():\n"
        "    raise OSError('nobody asks')\n"
        "async def begin():\n"
        "    asyncio.ensure_future(lost())\n"
        "    await asyncio.sleep(0)\n"
        "if __name__ == '__main__':\n"
        "    with crew(workers=1) as there:\n"
        "        there._client.sync(begin)\n"
        "        gc.collect()\n"
        "    gc.collect()\n"
    )
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, capture_output=True, text=True, timeout=600, check=False)
    assert (done.returncode, done.stderr) == (0, "")
