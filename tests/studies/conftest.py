"""Fixtures of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the files that `FULL` names; their content is not read with the study."""
    (tmp_path / "sub").mkdir()
    for name in ("sub/Coil.fmu", "run1.csv", "run2.csv"):
        (tmp_path / name).write_text("")
    return tmp_path
