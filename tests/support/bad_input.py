"""A study to be spoilt, and the one sentence that is expected of it."""

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import WRONG_INPUT
from tests.support.paths import ROOT

COIL = ROOT / "fmus/Coil/Coil.fmu"
SOUND = """
[model]
fmu = "Coil.fmu"

[[experiments]]
data = "run.csv"
inputs = ["u"]
outputs = ["i"]

[parameters]
R = { start = 3.0, min = 0.0, max = 10.0 }

[noise]
variance = "estimate"

[estimation]
method = "levenberg-marquardt"
"""


def table(coil_folder: Path, frame: pd.DataFrame) -> None:
    frame.to_csv(coil_folder / "run.csv", index=False)


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Run the command, check what every refusal has in common, and return the sentence."""
    code = run([str(argument) for argument in arguments])
    out, sentence = capsys.readouterr()
    assert code == WRONG_INPUT
    assert out == ""
    assert sentence.startswith("error: ")
    assert sentence.endswith("\n")
    assert sentence.count("\n") == 1
    assert "Traceback" not in sentence
    assert len(re.findall(r"\.\s+[A-Z]", sentence)) <= 1  # what is wrong, what to do
    return sentence


def rezip(path: Path, change: Callable[[dict[str, bytes]], object]) -> None:
    """Rewrite an FMU after a change of its files."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
