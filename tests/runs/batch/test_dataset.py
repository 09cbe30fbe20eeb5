"""The rows of a batch on disk: complete or absent, and the same in any order."""

import errno
import hashlib
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fmuid import FmuidError, InputError, files
from fmuid.runs import read_part
from fmuid.runs.batch import dataset as module
from fmuid.runs.batch.dataset import Dataset

COLUMNS = {
    "case": "int64",
    "table": "string",
    "set.x": "float64",
    "status": "string",
    "on": "bool",
    "finished": "datetime64[us, UTC]",
}
CASES = 1000


def row(case: int) -> dict[str, Any]:
    when = datetime(2026, 1, 1, tzinfo=UTC)
    words = {"table": f"r{case % 3}", "set.x": case / 7 if case % 5 else float("nan"), "status": "converged"}
    return {"case": case, **words, "on": case % 2 == 0, "finished": when}


def filled(folder: Path, cases: list[int], *, each: int) -> Dataset:
    """Return a dataset with cases in parts of some cases each."""
    found = Dataset(folder, COLUMNS, CASES)
    with found.locked():
        for at in range(0, len(cases), each):
            found.append([row(case) for case in cases[at : at + each]])
    return found


def expected(cases: list[int]) -> pd.DataFrame:
    frame = pd.DataFrame([row(case) for case in sorted(cases)])
    return frame.astype({"finished": "datetime64[us, UTC]"})


def same(found: pd.DataFrame, other: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(found, other, check_exact=True)


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_rows_come_back_sorted_and_exact(tmp_path: Path) -> None:
    order = np.random.default_rng(1).permutation(50).tolist()
    found = filled(tmp_path, order, each=7)
    assert len(found.parts()) == 8
    same(found.read(), expected(order))
    plain = pd.read_parquet(tmp_path / "cases")  # what a user does
    same(plain.sort_values("case", ignore_index=True), expected(order))
    assert np.flatnonzero(found.finished()).tolist() == list(range(50))
    empty = filled(tmp_path / "none", [], each=1)
    assert list(empty.read()) == list(COLUMNS)
    assert list(empty.read(["status"])) == ["case", "status"]
    assert empty.read().dtypes.tolist() == expected([1]).dtypes.tolist()


def test_many_small_parts_are_merged_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOSE_PARTS", 5)
    found = filled(tmp_path, list(range(20)), each=1)
    assert len(found.parts()) <= 6
    same(found.read(), expected(list(range(20))))


def test_rows_that_are_there_twice_count_once(tmp_path: Path) -> None:
    """As after a kill between the writing of merged parts and the end of the old ones."""
    found = filled(tmp_path, list(range(6)), each=2)
    found._write(found._together([found._load(path, list(COLUMNS)) for path in found.parts()[1:]], list(COLUMNS)))
    assert len(found.parts()) == 4
    same(found.read(["set.x"]), expected(list(range(6)))[["case", "set.x"]])
    same(found.read(), expected(list(range(6))))
    found.compact()
    assert len(found.parts()) == 1
    same(pd.read_parquet(tmp_path / "cases"), expected(list(range(6))))


def test_full_disk_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = filled(tmp_path, [0, 1], each=1)
    steps: list[tuple[Any, str]] = [(os, "fsync"), (Path, "replace"), (Path, "open")]
    for owner, step in steps:
        with monkeypatch.context() as full:
            full.setattr(owner, step, full_disk)
            with pytest.raises(FmuidError, match=r"write failed: No space left on device.*are kept") as raised:
                found.append([row(2)])
        assert not isinstance(raised.value, InputError)  # exit code 1: nothing given is wrong
        same(found.read(), expected([0, 1]))
        assert not list(found.cases.glob(".*"))
    found.append([row(2)])
    same(found.read(), expected([0, 1, 2]))


def test_a_damaged_part_is_found_and_removed(tmp_path: Path) -> None:
    """Cut, and with a bit flipped in a page, its header or the table of contents: only its rows are lost."""
    found = filled(tmp_path, list(range(9)), each=3)
    part = found.parts()[1]
    whole = part.read_bytes()
    places = np.random.default_rng(4).integers(0, len(whole), 5).tolist()
    damaged = [whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :] for place in places]
    for content in [b"", whole[:500], *damaged]:
        part.write_bytes(content)
        for read in (found.read, lambda: read_part(part)):
            with pytest.raises(InputError, match=rf"{part.name}: damaged \(wrong digest\)"):
                read()
    assert found.repair() == (part,)
    assert np.flatnonzero(found.finished()).tolist() == [0, 1, 2, 6, 7, 8]
    rest = [read_part(path).to_pandas() for path in found.parts()]
    same(pd.concat(rest, ignore_index=True), expected([0, 1, 2, 6, 7, 8]))


def test_a_case_that_the_batch_has_not(tmp_path: Path) -> None:
    found = filled(tmp_path, [0, 1], each=1)
    for case in (CASES, -1, None):
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist([row(1) | {"case": case}], found.schema), sink)
        content = sink.getvalue().to_pybytes()
        alien = found.cases / f"part-000000005-{hashlib.sha256(content).hexdigest()[:12]}.parquet"
        alien.write_bytes(content)
        for read in (found.read, found.finished, lambda: found.read(["status"])):
            with pytest.raises(InputError, match=rf"damaged \(case number not below {CASES}"):
                read()
        assert found.repair() == (alien,)
    same(found.read(), expected([0, 1]))


def test_other_files_are_no_parts(tmp_path: Path) -> None:
    found = filled(tmp_path, [0, 1], each=1)
    draft = found.cases / ".part-000000001-abc.parquet.77"
    others = [found.cases / name for name in ("part-0.parquet", "part-mine.parquet", "part-000000001-copy.parquet")]
    for path in [draft, *others]:
        path.write_bytes(b"PAR1")
    same(found.read(), expected([0, 1]))
    assert found.repair() == ()
    found.compact()
    assert len(found.parts()) == 1
    assert not draft.exists()
    assert all(path.is_file() for path in others)


def test_two_writers(tmp_path: Path) -> None:
    first, second = Dataset(tmp_path, COLUMNS, CASES), Dataset(tmp_path, COLUMNS, CASES)
    with first.locked(), pytest.raises(InputError, match=rf"written to by another batch \(process {os.getpid()} on"):
        second.locked().__enter__()
    with second.locked():
        pass
    assert not (tmp_path / files.LOCK).exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file.out cannot be made a folder: .*--output"):
        Dataset(tmp_path / "file" / "out", COLUMNS, CASES).locked().__enter__()


def test_a_lock_whose_owner_ends_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its file is removed between its opening here and its lock, which then is one of nothing."""
    lock, seen = files._lock, list[int]()

    def late(handle: int) -> bool:
        if not seen:
            (tmp_path / files.LOCK).unlink()
        seen.append(handle)
        return lock(handle)

    monkeypatch.setattr(files, "_lock", late)
    first, second = Dataset(tmp_path, COLUMNS, CASES), Dataset(tmp_path, COLUMNS, CASES)
    with first.locked(), pytest.raises(InputError, match="written to by another batch"):
        second.locked().__enter__()
    assert len(seen) == 3


@pytest.mark.slow
def test_a_killed_writer_leaves_no_lock(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from fmuid.runs.batch.dataset import Dataset\n"
        f"with Dataset(Path({str(tmp_path)!r}), {{'case': 'int64'}}, 9).locked(): print('locked', flush=True); "
        "sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as other:  # type: ignore[call-overload]
        assert other.stdout.readline() == b"locked\n"
        with pytest.raises(InputError, match=f"process {other.pid} on"):
            Dataset(tmp_path, COLUMNS, CASES).locked().__enter__()
        other.kill()
    with Dataset(tmp_path, COLUMNS, CASES).locked():
        pass


def test_clear_removes_rows_and_logs_and_nothing_else(tmp_path: Path) -> None:
    found = filled(tmp_path, [0, 1], each=1)
    found.write_manifest({})
    found.log(1, "said")
    assert [path.name for path in found.logs.iterdir()] == ["case-000001.txt"]
    (tmp_path / "notes.md").write_text("mine")
    found.clear()
    assert {path.name for path in tmp_path.iterdir()} == {"cases", "notes.md"}
    assert not list(found.cases.iterdir())
