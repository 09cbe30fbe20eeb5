"""What a newcomer gives `fmuid init` by mistake: each ends in one clear sentence, with no study that looks ready."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from tests.support.coil_study import COIL, fmuid_

ROWS = "".join(f"{k / 100},{k % 20 // 10},{np.sin(k)}\n" for k in range(50))
TABLES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "empty. Give a header"),
    "a page": ("<html><body>Log in</body></html>\n", "no samples below the header"),
    "a PDF": (b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n1 0 obj\n", "not found (columns: %PDF-1.4)"),
    "binary": (bytes(range(1, 256)) * 9, "not text in UTF-8, UTF-16 or cp1252"),
    "times alone": ("time\n0\n1\n2\n", "no column for the input u"),
    "no sample": ("time,u,i\n0,1,nan\n1,1,nan\n", "output column 'i' has no sample"),
    "other letters": (f"时间,напряжение,電流\n{ROWS}", "(columns: 时间, напряжение, 電流)"),
}


@pytest.mark.parametrize("table", TABLES)
def test_tables_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str) -> None:
    content, sentence = TABLES[table]
    path = tmp_path / "bench.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    said = said_of(capsys, COIL, path, "-o", tmp_path / "study.toml")
    assert "bench.csv: " in said
    assert sentence in said


def said_of(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return what `fmuid init` prints when it does not succeed: one error, or remarks beside what was found."""
    assert fmuid_("init", *arguments) != DONE
    out, error = capsys.readouterr()
    assert "Traceback" not in out + error
    assert error.count("\n") == (1 if error else 0)
    return str(error or out)


def started(tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: pd.DataFrame, *more: str) -> str:
    """Return what `fmuid init` says of a table of the coil."""
    frame.to_csv(tmp_path / "bench.csv", index=False)
    assert fmuid_("init", COIL, tmp_path / "bench.csv", "-o", tmp_path / "study.toml", *more) in (DONE, NOT_SUCCEEDED)
    (tmp_path / "study.toml").unlink()
    return str(capsys.readouterr().out)


def test_channels_that_measured_nothing_or_in_another_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = fmuid.datasets.coil().table[["time", "u", "i"]]
    said = started(tmp_path, capsys, frame)
    assert "is constant" not in said and "times as much as measured" not in said
    said = started(tmp_path, capsys, frame.assign(i=0.25))
    assert "bench.csv: output 'i' is constant (0.25)." in said
    said = started(tmp_path, capsys, frame.assign(u=1000 * frame["u"]))
    (ratio,) = re.findall(r"bench.csv: simulated 'i' varies (\S+) times as much as measured", said)
    assert float(ratio) == pytest.approx(1000, rel=0.3)


def test_a_header_of_400_names(tmp_path: Path) -> None:
    names = ",".join(f"c{k}" for k in range(400))
    rows = "".join(f"{k / 100},{k % 3},{np.sin(k)},{'1,' * 399}1\n" for k in range(8))
    (tmp_path / "bench.csv").write_text(f"time,u,i,{names}\n{rows}")
    assert fmuid_("init", COIL, tmp_path / "bench.csv", "-o", tmp_path / "study.toml") == DONE
