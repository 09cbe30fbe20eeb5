"""The reader process: what a library does to it costs one sentence, and it serves all files."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

from fmuid import InputError, read_data
from fmuid.data import readers
from fmuid.data.readers import base
from fmuid.processes import IsolatedCaller
from tests.support import reading
from tests.support.table_variants import FILES, FRAME

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="files are read in the same process there")
SENTENCES = {
    "crash": r"crashed \(SIGSEGV\)",
    "hang": "not read within [0-9.]+ s",
    "grow": "took more than 200 MB",
    "kill": "process was killed",
    "refuse": "not enough memory",
}


@pytest.mark.parametrize("what", SENTENCES)
def test_read_isolated_refuses_files_over_which_the_process_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    FILES["a.parquet"](tmp_path / "a.parquet")
    with monkeypatch.context() as patched:
        patched.setattr(readers, "_plain_columns", getattr(reading, what))
        patched.setattr(base, "READING_SECONDS", 0.2 if what == "hang" else 600.0)
        if what == "grow":
            caller = IsolatedCaller(600.0, 200.0)
            patched.setattr(base, "_reader", lambda: caller)
        with pytest.raises(InputError, match=SENTENCES[what]) as caught:
            read_data(tmp_path / "a.parquet")
        assert str(caught.value).startswith(f"{tmp_path / 'a.parquet'}: ")
    assert len(read_data(tmp_path / "a.parquet")) == len(FRAME)


def test_read_isolated_refuses_a_file_that_claims_more_than_the_memory(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("time", shape=(1 << 50,), dtype="f8", chunks=(1 << 20,))
    with pytest.raises(InputError, match=r"a\.h5: not (enough memory|a readable HDF5 file)"):
        read_data(tmp_path / "a.h5")


def test_one_process_reads_all_files_of_all_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a.parquet", "compound.h5", "vectors.mat"):
        FILES[name](tmp_path / name)
    monkeypatch.chdir(tmp_path)
    seen: set[int] = set()

    def read(name: str) -> None:
        np.testing.assert_array_equal(read_data(name)["w"], FRAME["w"])
        seen.add(base._reader().call(os.getpid))

    threads = [threading.Thread(target=read, args=(name,)) for name in ("a.parquet", "compound.h5", "vectors.mat") * 3]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 1
    assert seen != {os.getpid()}
