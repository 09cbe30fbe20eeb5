"""What the tests of isolation share."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.exported import export_text


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where FMUs that misbehave are built, once for all tests."""
    return tmp_path_factory.mktemp("misbehaving")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return an exporter of the models in `tests.support.resting`, each once."""
    folder, known = tmp_path_factory.mktemp("resting"), dict[str, Path]()

    def export(text: str) -> Path:
        if text not in known:
            known[text] = export_text(folder, text)
        return known[text]

    return export
