"""A pytest plugin (``-p tests.support.sanitized_core``) that has tests run with the library named by SANITIZED_CORE."""

import os
from pathlib import Path

from fmuid.simulation.native import library


def pytest_configure() -> None:
    usual = library._path
    library._path = lambda: Path(os.environ["SANITIZED_CORE"])
    library.core()  # which is loaded once
    library._path = usual
