"""Arrays of files that fmuid wrote, and of files that are damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid.files import ContentError, read_arrays


def test_damaged_arrays_are_one_error(tmp_path: Path) -> None:
    """Cut, overwritten, or with bytes more: they are read right, or refused."""
    path, random = tmp_path / "a.npz", np.random.default_rng(3)
    given: dict[str, Any] = {"a": random.standard_normal(40), "text": np.frombuffer(b"{}" * 50, np.uint8)}
    np.savez(path, **given)
    whole, refused = path.read_bytes(), 0
    for _ in range(200):
        content, at = bytearray(whole), int(random.integers(len(whole)))
        content[at : at + int(random.integers(4))] = random.bytes(int(random.integers(4)))
        path.write_bytes(content if random.integers(3) else content[:at])
        try:
            found = read_arrays(path)
        except ContentError:
            refused += 1
        else:
            assert all(np.array_equal(found[name], value) for name, value in given.items() if name in found)
    assert refused > 100


def test_arrays_that_would_be_executed_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ContentError, match="allow_pickle=False"):
        read_arrays(tmp_path / "a.npz")
