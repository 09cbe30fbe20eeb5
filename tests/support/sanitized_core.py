"""A pytest plugin (``-p tests.support.sanitized_core``) that has tests run with the library named by SANITIZED_CORE."""

from __future__ import annotations

import os
from pathlib import Path

from fmuid.simulation import native


def pytest_configure() -> None:
    usual = native._path
    native._path = lambda: Path(os.environ["SANITIZED_CORE"])
    native.core()  # which is loaded once
    native._path = usual
