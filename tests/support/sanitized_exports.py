"""A pytest plugin (``-p tests.support.sanitized_exports``): what is exported for Linux is compiled with sanitizers."""

import subprocess
from pathlib import Path

from fmuid.export import build
from tests.support.sanitizers import SANITIZE


def pytest_configure() -> None:
    usual = build._compile

    def compiled(directory: Path, source: str, target: str, file: str) -> bytes:
        if target != build._LINUX:
            return usual(directory, source, target, file)
        command = ["gcc", "-std=c99", "-ffp-contract=off", "-fvisibility=hidden", *SANITIZE]
        subprocess.run([*command, f"sources/{source}", "-o", file, "-lm"], cwd=directory, check=True)
        return (directory / file).read_bytes()

    build._compile = compiled
