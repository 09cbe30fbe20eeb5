"""Batches: the same rows however they are run, and messages with the user's own files."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import pytest

from fmuid.events import BatchStep
from fmuid.reports.render.progress import Display
from fmuid.reports.render.screen import Screen, showing
from fmuid.runs.batch.batch import Batch
from fmuid.runs.batch.case import CaseRunner
from tests.support.coil_batches import DRAWS, NOISE, expected, run, same, write
from tests.support.coil_study import COIL

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


def test_messages_name_the_users_own_data(fleet: Path, here: Any) -> None:
    here()
    found = run(fleet)
    same(found.frame, expected(fleet))
    failed = found.frame[found.frame["status"] == "failed"]
    assert failed["table"].tolist() == ["r2", "r2"]
    assert failed["message"].str.startswith(str(fleet / "records" / "r2.csv")).all()


@pytest.mark.parametrize("isolated", [False, True])
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
