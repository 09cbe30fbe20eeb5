"""Exports that several tests run."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.support.exported import export_text

Exporter = Callable[..., Path]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exporter:
    """Return a function that exports a text for this platform, once for each text and options."""

    @cache
    def export(text: str, **options: str | tuple[str, ...]) -> Path:
        return export_text(tmp_path_factory.mktemp("exported"), text, **options)

    return export
