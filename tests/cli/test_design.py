"""`fmuid design` and `fmuid simulate --sensitivities` from end to end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.cli.options import DONE, WRONG_INPUT
from tests.support.coil_study import STUDY, coil_table, fmuid_

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(STUDY + "[noise]\nvariance = 4e-4\n")
    times = 1e-3 * np.arange(300)
    for name, voltage in {"constant": 1.0 + 0.0 * times, "square": np.sign(np.sin(120.0 * times + 1e-6))}.items():
        pd.DataFrame({"time": times, "u": voltage}).to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


@pytest.mark.usefixtures("drawn_figures")
def test_design(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (folder / "study.toml", folder / "constant.csv", folder / "square.csv", "--in-process")
    assert fmuid_("design", *words, "-o", folder / "out", "--by", "worst") == DONE
    found = pd.read_csv(folder / "out" / "design.csv")
    assert list(found["excitation"]) == ["square", "constant"]
    assert found["worst"].is_monotonic_increasing
    assert "square" in capsys.readouterr().out
    assert "square is the best of 2 excitations" in (folder / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--by", "size"), '"determinant" or "worst"'),
        (("--fault", "x"), "has no [diagnosis]"),
        (("--set", "noise.variance=estimate"), "does not say how large the noise of 'i' is"),
    ],
)
def test_wrong_words(folder: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = fmuid_("design", folder / "study.toml", folder / "square.csv", *words, "--in-process")
    assert code == WRONG_INPUT
    assert said in capsys.readouterr().err


def test_sensitivities(folder: Path) -> None:
    words = (folder / "study.toml", "--sensitivities", "-o", folder / "out", "--in-process")
    assert fmuid_("simulate", *words) == DONE
    table = pd.read_csv(folder / "out" / "sensitivities.csv")
    assert list(table.columns) == ["time", "i/R", "i/L"]
    assert (folder / "out" / "figures" / "sensitivities.png").is_file()
