"""Commands that the workbench runs, with a process that is none."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from fmuid.apps.workbench import jobs


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
    for seconds, requests, running in ((1.0, 1, True), (jobs.SECOND_REQUEST, 2, True), (jobs.LAST_REQUEST, 2, False)):
        now[0] += seconds
        job.insist()
        assert (len(asked), job.running) == (requests, running)
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
