"""Tests run again with C that gcc has compiled with the sanitizers of addresses and of undefined behaviour."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.paths import ROOT

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-O1", "-g", "-shared", "-fPIC")
needs_sanitizers = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("gcc") is None, reason="needs gcc's sanitizers"
)


def assert_nothing_found(plugin: str, files: Sequence[str], words: Sequence[str] = (), **environment: str) -> None:
    """Run files of tests in a process of their own with a plugin that gives them sanitized code."""
    told = [
        subprocess.run(["gcc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True, check=True)
        for name in ("asan", "ubsan")
    ]
    preloaded = {
        "LD_PRELOAD": " ".join(each.stdout.strip() for each in told),
        "ASAN_OPTIONS": "detect_leaks=0,handle_segv=0",  # Python leaks at its end
    }
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-s", "-p", "no:faulthandler", "-p", plugin, *words]
    run = subprocess.run(
        [*command, *(str(Path(ROOT, "tests", f"{name}.py")) for name in files)],
        env=os.environ | preloaded | environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]
