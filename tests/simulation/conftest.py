"""What the tests of isolation share."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where FMUs that misbehave are built, once for all tests."""
    return tmp_path_factory.mktemp("misbehaving")
