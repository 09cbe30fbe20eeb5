"""A study of a coil, its table, and the command line that runs it."""

import json
from pathlib import Path
from typing import Any

from experiments.batches import campaign
from experiments.batches.campaign import NOISE
from fmuid.apps.cli.app import run
from tests.support.paths import FMUS

COIL = FMUS / "Coil/Coil.fmu"
STUDY = 'title = "Coil"' + campaign.STUDY.format(fmu=COIL.as_posix(), table="first.csv")

SECOND = """
i_start = { start = 0.0, nominal = 0.1, per_experiment = true }
[[experiments]]
data = "second.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
"""
# Nothing but a search that is given no time.
HASTY = ["--set", "estimation.max_iterations=1", "--set", "estimation.restarts=false"]


def coil_table(path: Path, start: float, seed: int, noise: float = NOISE) -> None:
    """Write a record of 600 samples that begins with a current, A."""
    campaign.write_table(path, seed, 600, start, noise)


def result(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def fmuid_(*arguments: str | Path) -> int:
    return run([str(argument) for argument in arguments])
