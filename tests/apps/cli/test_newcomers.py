"""What a newcomer gives `fmuid init` by mistake: each ends in one clear sentence, with no study that looks ready."""

from __future__ import annotations

import re
import zipfile
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
    "blank lines": ("\n\n\n", "empty. Give a header"),
    "a letter": ("hello there\nthis is a letter\n", "time column 'time' not found (columns: hello there)"),
    "a page": ("<html><body>Log in</body></html>\n", "no samples below the header"),
    "a PDF": (b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n1 0 obj\n", "not found (columns: %PDF-1.4)"),
    "a spreadsheet by another name": (b"PK\x03\x04" + bytes(200), "is a spreadsheet or packed file"),
    "binary": (bytes(range(1, 256)) * 9, "not text in UTF-8, UTF-16 or cp1252"),
    "times alone": ("time\n0\n1\n2\n", "no column for the input u"),
    "no sample": ("time,u,i\n0,1,nan\n1,1,nan\n", "output column 'i' has no sample"),
    "no time": ("time,u,i\n,1,2\n,1,3\n", "time column 'time': nan in row 1"),
    "one time": ("time,u,i\n1,1,2\n1,1,3\n", "fewer than two different times"),
    "header": ("time,u,i\n", "no samples below the header"),
    "separators": (",,,\n,,,\n", "empty. Give a header"),
    "a name twice": ("time,u,i,i\n0,1,2,3\n1,2,3,4\n", "column 'i' occurs twice"),
    "other letters": (f"时间,напряжение,電流\n{ROWS}", "(columns: 时间, напряжение, 電流)"),
    "infinite": ("time,u,i\n0,1,1\n0.1,inf,2\n0.2,1,3\n", "input column 'u' is inf in row 2 (t = 0.1 s)"),
}


def said_of(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return what `fmuid init` prints when it does not succeed: one error, or remarks beside what was found."""
    assert fmuid_("init", *arguments) != DONE
    out, error = capsys.readouterr()
    assert "Traceback" not in out + error
    assert error.count("\n") == (1 if error else 0)
    return str(error or out)


@pytest.mark.parametrize("table", TABLES)
def test_tables_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str) -> None:
    content, sentence = TABLES[table]
    path = tmp_path / "bench.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    said = said_of(capsys, COIL, path, "-o", tmp_path / "study.toml")
    assert "bench.csv: " in said
    assert sentence in said


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


def test_a_header_of_2000_names(tmp_path: Path) -> None:
    names = ",".join(f"c{k}" for k in range(2000))
    rows = "".join(f"{k / 100},{k % 3},{np.sin(k)},{'1,' * 1999}1\n" for k in range(8))
    (tmp_path / "bench.csv").write_text(f"time,u,i,{names}\n{rows}")
    assert fmuid_("init", COIL, tmp_path / "bench.csv", "-o", tmp_path / "study.toml") == DONE


def archive(path: Path, kind: str) -> None:
    """Write an FMU of the coil that is spoilt in one way."""
    with zipfile.ZipFile(COIL) as source:
        files = {name: source.read(name) for name in source.namelist()}
    inside = [name for name in files if name.startswith("binaries")]
    if kind == "another platform":
        files = {name.replace("linux64", "win64"): text for name, text in files.items() if "darwin" not in name}
        inside = [name for name in files if name.startswith("binaries") and "win64" not in name]
    elif kind == "in a folder":
        files = {f"Coil/{name}": text for name, text in files.items()}
    elif kind == "no description":
        del files["modelDescription.xml"]
    with zipfile.ZipFile(path, "w") as made:
        for name, text in files.items():
            if name not in inside or kind not in ("sources alone", "another platform"):
                made.writestr(name, text)


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("no description", "not an FMU: no modelDescription.xml at its top level"),
        ("in a folder", "not an FMU: no modelDescription.xml at its top level"),
        ("another platform", "no binary for this platform (linux64): binaries for win64"),
        ("sources alone", "no binary for this platform (linux64): no binaries at all"),
        ("cut", "not an FMU: no zip archive"),
        ("empty", "not an FMU: no zip archive"),
        ("a model", "not an FMU: no zip archive"),
    ],
)
def test_fmus_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, sentence: str) -> None:
    (tmp_path / "bench.csv").write_text(f"time,u,i\n{ROWS}")
    path = tmp_path / "Coil.fmu"
    texts = {"cut": COIL.read_bytes()[:20_000], "empty": b"", "a model": b"model Coil end Coil;"}
    if kind in texts:
        path.write_bytes(texts[kind])
    else:
        archive(path, kind)
    if "platform" in sentence:
        import fmpy

        sentence = sentence.replace("linux64", fmpy.platform)
    assert sentence in said_of(capsys, path, tmp_path / "bench.csv", "-o", tmp_path / "study.toml")
