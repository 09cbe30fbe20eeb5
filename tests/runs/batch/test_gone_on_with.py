"""Batches that end early and are gone on with: what may change meanwhile, and what is said where it did."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fmuid.errors import FmuidError, InputError
from fmuid.events import BatchStep, Event
from fmuid.runs.batch.batch import Batch
from fmuid.runs.batch.study_package import BatchStudy, changes
from fmuid.studies.study import Study
from tests.support.coil_batches import (
    DRAWS,
    NOISE,
    expected,
    run,
    same,
    write,
)
from tests.support.coil_study import coil_table, fmuid_

pytestmark = pytest.mark.usefixtures("blank_figures")


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


@pytest.mark.slow
def test_begin_anew(folder: Path, here: Any) -> None:
    here()
    run(folder)
    write(folder, NOISE.format(draws=10))
    again = here()
    found = run(folder, resume=False)
    assert sorted(again.ran) == list(range(10))
    same(found.frame, expected(folder))


@pytest.mark.slow
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
        assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--no-isolation") == 1
    out, error = capsys.readouterr()
    assert error.startswith(f"error: {folder / 'out'} cannot be written to: No space left on device; the cases")
    assert error.count("\n") == 1
    second = here(4)
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--no-isolation") == 0
    assert len(first.ran) + len(second.ran) >= DRAWS
    assert len(second.ran) < DRAWS
    same(pd.read_parquet(folder / "out" / "cases"), expected(folder))
    out, error = capsys.readouterr()
    assert error == ""
    assert "Batch: 30 cases, 30 converged" in " ".join(out.split())
    told = json.loads((folder / "out" / "summary.json").read_text())["origin"]
    digests = [hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in ("study.toml", "first.csv")]
    assert [told["study"]["digest"], told["files"]["first.csv"]] == digests
    assert told["date"].startswith("20")


def test_a_lost_scheduler_keeps_what_there_is(folder: Path, here: Any, capsys: Any) -> None:
    lost = here(3, stop_after=12, error=FmuidError("the scheduler was lost"))
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--no-isolation") == 1
    assert "error: the scheduler was lost" in capsys.readouterr().err
    assert sorted(pd.read_parquet(folder / "out" / "cases")["case"]) == sorted(lost.ran)


def test_ctrl_c_on_the_command_line(folder: Path, here: Any, capsys: Any) -> None:
    ran = here(3, stop_after=12).ran
    assert fmuid_("batch", folder / "study.toml", "-o", folder / "out", "--no-isolation") == 1
    out, error = capsys.readouterr()
    assert error.endswith(f"interrupted: {len(ran)} of {DRAWS} cases are finished; the same command goes on\n")
    assert "summary.csv" in out


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f: write(f, NOISE.format(draws=DRAWS), R="7.0"), "parameters.R.start was 6.0"),
        (lambda f: write(f, NOISE.format(draws=31)), "batch.monte_carlo.realizations was 30"),
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
    assert said.endswith("choose another folder with --output, or remove its cases with --no-resume")


@pytest.mark.slow
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
    bundle = BatchStudy(Study.read(folder / "study.toml"), isolated=False, versions={})
    told = bundle.manifest()
    assert changes(json.loads(json.dumps(told)), told) == []
    assert changes(told | {"fmuid": "0.0.9"}, told) == [f"it was run by fmuid 0.0.9, this is {told['fmuid']}"]


def test_a_record_that_changes_meanwhile(fleet: Path) -> None:
    bundle = BatchStudy(Study.read(fleet / "study.toml"), isolated=False, versions={})
    path = fleet / "records" / "r1.csv"
    assert list(bundle.record(path).values()) == [path.read_bytes()]
    coil_table(path, 0.0, seed=9)
    with pytest.raises(InputError, match=r"r1.csv has changed while the batch ran"):
        bundle.record(path)
    path.unlink()
    with pytest.raises(InputError, match=r"r1.csv has changed while the batch ran"):
        bundle.record(path)


def test_records_do_not_travel_with_the_study(fleet: Path) -> None:
    parcel = BatchStudy(Study.read(fleet / "study.toml"), isolated=False, versions={}).parcel
    assert sorted(Path(name).name for name in parcel.files) == ["Coil.fmu", "first.csv"]
