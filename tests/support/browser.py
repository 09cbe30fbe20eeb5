"""A browser for tests: Chromium, where it is there with its driver."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
# No host is found but this machine, and the browser itself asks for none.
FLAGS = (
    *("headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking"),
    *("disable-component-update", "disable-sync", "disable-dev-shm-usage"),
    # It goes on drawing where it takes its window for a covered one.
    *("disable-backgrounding-occluded-windows", "disable-renderer-backgrounding"),
    "host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
)
# More than enough, s, on a machine with other work.
PATIENCE = 120.0


@contextmanager
def chromium(folder: Path) -> Iterator[Any]:
    """Give a browser that keeps its files in a folder; the test is skipped where there is none."""
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("there is no Chromium with its driver")
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options: Any = Options()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"user-data-dir={folder / 'user'}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver: Any = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()
