"""What the tests of models share."""

from functools import partial
from pathlib import Path

import pytest

from tests.support.ssp_texts import Maker, pack


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unpack into a folder of the test."""
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(tmp_path / "cache" / name))


@pytest.fixture
def package(tmp_path: Path) -> Maker:
    """Return a function that packs a system structure."""
    return partial(pack, tmp_path)
