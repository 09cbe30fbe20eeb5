"""Arrays of files that fmuid wrote, and of files that are damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid.data import read_arrays, write_arrays


def test_damaged_arrays_are_one_error(tmp_path: Path) -> None:
    """Cut, overwritten, or with bytes more: they are read right, or refused."""
    path, random = tmp_path / "a.npz", np.random.default_rng(3)
    given: dict[str, Any] = {"a": random.standard_normal(40), "text": np.frombuffer(b"{}" * 50, np.uint8)}
    write_arrays(path, given)
    whole, refused = path.read_bytes(), 0
    for _ in range(60):
        content, at = bytearray(whole), int(random.integers(len(whole)))
        content[at : at + int(random.integers(4))] = random.bytes(int(random.integers(4)))
        path.write_bytes(content if random.integers(3) else content[:at])
        try:
            found = read_arrays(path)
        except ValueError:
            refused += 1
        else:
            assert found.keys() == given.keys()
            assert all(np.array_equal(found[name], value) for name, value in given.items())
    assert refused > 30


def test_arrays_that_would_be_executed_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        read_arrays(tmp_path / "a.npz")


def test_arrays_that_were_changed_are_refused(tmp_path: Path) -> None:
    """The archive is whole, what is in it is not."""
    path = write_arrays(tmp_path / "a.npz", {"a": np.arange(3.0), "b": np.zeros(2)})
    with np.load(path) as file:
        given = dict(file)
    for change in ({"a": np.arange(4.0)}, {"a": np.arange(3)}, {"b": np.full(2, -0.0)}, {"c": np.zeros(0)}):
        np.savez(path, **given | change)
        with pytest.raises(ValueError, match="its content is not what was written"):
            read_arrays(path)
    del given["digest"]
    np.savez(path, **given)
    with pytest.raises(ValueError, match="digest"):
        read_arrays(path)
