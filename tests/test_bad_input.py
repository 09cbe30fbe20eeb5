"""Whatever a user gives wrongly ends in one clear sentence on stderr that names it, and exit code 2."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pandas as pd
import pytest

from fmuid.cli import WRONG_INPUT, run

COIL = Path(__file__).parents[1] / "fmus/Coil/Coil.fmu"
STUDY = """
[model]
fmu = "Coil.fmu"

[[experiments]]
table = "run.csv"
inputs = ["u"]
outputs = ["i"]

[parameters]
R = { start = 3.0, min = 0.0, max = 10.0 }

[noise]
variance = "estimate"

[estimator]
method = "marquardt"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a study of the coil in which everything is right."""
    shutil.copy(COIL, tmp_path / "Coil.fmu")
    (tmp_path / "study.toml").write_text(STUDY)
    time = np.arange(50) * 1e-3
    table(tmp_path, pd.DataFrame({"time": time, "u": np.ones(50), "i": 0.25 * (1 - np.exp(-40 * time))}))
    return tmp_path


def table(folder: Path, frame: pd.DataFrame) -> None:
    frame.to_csv(folder / "run.csv", index=False)


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
    # one sentence: no full stop followed by another one
    assert not re.search(r"\.\s+[A-Z]", sentence)
    return sentence


def rezip(path: Path, change: Callable[[dict[str, bytes]], object]) -> None:
    """Rewrite an FMU after a change of its files."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


# --- the FMU ----------------------------------------------------------------------------


def test_not_a_zip(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "Coil.fmu").write_text("no archive")
    for command in (("info", folder / "Coil.fmu"), ("identify", folder / "study.toml")):
        sentence = refused(capsys, *command)
        assert "Coil.fmu" in sentence
        assert "zip" in sentence


def test_truncated_zip(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = COIL.read_bytes()
    (folder / "Coil.fmu").write_bytes(content[: len(content) // 2])
    assert "zip" in refused(capsys, "info", folder / "Coil.fmu")


def test_damaged_zip(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The directory is whole, what it points to is not."""
    content = bytearray(COIL.read_bytes())
    content[200 : len(content) // 2] = bytes(len(content) // 2 - 200)
    (folder / "Coil.fmu").write_bytes(content)
    assert "Coil.fmu" in refused(capsys, "identify", folder / "study.toml")


def test_no_model_description(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rezip(folder / "Coil.fmu", lambda files: files.pop("modelDescription.xml"))
    assert "modelDescription.xml" in refused(capsys, "info", folder / "Coil.fmu")


@pytest.mark.parametrize("content", [b"<fmi", b"", b'<fmiModelDescription fmiVersion="2.0"/>', b"\xff\xfe"])
def test_unreadable_model_description(folder: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    rezip(folder / "Coil.fmu", lambda files: files.update({"modelDescription.xml": content}))
    for command in (("info", folder / "Coil.fmu"), ("identify", folder / "study.toml")):
        assert "modelDescription.xml" in refused(capsys, *command)


def test_no_binary_for_this_platform(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def strip(files: dict[str, bytes]) -> None:
        for name in [name for name in files if name.startswith(f"binaries/{fmpy.platform}/")]:
            del files[name]

    rezip(folder / "Coil.fmu", strip)
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert f"no binary for this platform ({fmpy.platform})" in sentence
    others = {"linux64", "win64", "darwin64"} - {fmpy.platform}
    assert all(platform in sentence for platform in others)


def test_fmi_1(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old = (
        b'<?xml version="1.0"?><fmiModelDescription fmiVersion="1.0" modelName="Coil" modelIdentifier="Coil" guid="x"/>'
    )
    rezip(folder / "Coil.fmu", lambda files: files.update({"modelDescription.xml": old}))
    sentence = refused(capsys, "info", folder / "Coil.fmu")
    assert "FMI 1.0" in sentence
    assert "2.0" in sentence


@pytest.mark.parametrize(
    "name", ["../escaped.txt", "/tmp/escaped.txt", "binaries/../../escaped.txt", "..\\escaped.txt"]
)
def test_archive_that_writes_outside(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    rezip(folder / "Coil.fmu", lambda files: files.update({name: b"x"}))
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert "escaped.txt" in sentence
    assert "outside" in sentence
    assert not Path("/tmp/escaped.txt").exists()


# --- variables --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("R = {", "Rs = {", ("'Rs'", "'R'")),
        ("R = {", "i_strat = {", ("'i_strat'", "did you mean 'i_start'")),
        ('inputs = ["u"]', 'inputs = { v = "u" }', ("'v'",)),
        ('outputs = ["i"]', 'outputs = { i_start1 = "i" }', ("'i_start1'", "'i_start'")),
        ('[[experiments]]', '[model.values]\nLL = 0.1\n[[experiments]]', ("'LL'", "'L'")),
        ('inputs = ["u"]', 'inputs = { u = "u", i = "i" }', ("'i'", "output")),
        ('outputs = ["i"]', 'outputs = { R = "i" }', ("'R'", "'parameter'")),
        ('inputs = ["u"]', 'inputs = { R = "u" }', ("'R'", "cannot be an input", "'parameter'")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "u = { start = 1.0 }", ("'u'", "input")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "i = { start = 1.0 }", ("'i'", "cannot be set")),
        ('[[experiments]]', '[model.values]\nR = 4.0\n[[experiments]]', ("'R'", "parameter and held")),
        ('[[experiments]]', '[model.values]\nL = "big"\n[[experiments]]', ("'L'", "big")),
        ('outputs = ["i"]', 'outputs = ["i"]\nunits = { i = "parsec" }', ("'parsec'", "'i'")),
    ],
)  # fmt: skip
def test_wrong_variable(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, named: tuple[str, ...]
) -> None:
    assert old in STUDY
    (folder / "study.toml").write_text(STUDY.replace(old, new))
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert all(word in sentence for word in named)


@pytest.mark.parametrize("variability", ["constant", "fixed"])
def test_fixed_parameter_set(folder: Path, capsys: pytest.CaptureFixture[str], variability: str) -> None:
    """A calculated parameter and a constant cannot be set from outside."""

    def fix(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        found = re.search(r'<ScalarVariable[^>]*name="R".*?</ScalarVariable>', text, re.DOTALL)
        assert found
        exact = variability == "constant"
        causality, initial = ("local", "exact") if exact else ("calculatedParameter", "calculated")
        kind = f'causality="{causality}" variability="{variability}" initial="{initial}"'
        new = f'<ScalarVariable name="R" valueReference="0" {kind}>'
        value = ' start="4"' if exact else ""
        files["modelDescription.xml"] = text.replace(
            found[0], f'{new}<Real unit="Ohm"{value}/></ScalarVariable>'
        ).encode()

    rezip(folder / "Coil.fmu", fix)
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert "'R'" in sentence
    assert "cannot be set" in sentence


# --- the study --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[parameters]", "[paramaters]", ("study.toml", "'paramaters'", "'parameters'")),
        ("inputs =", "imputs =", ("[experiments][0]", "'imputs'", "'inputs'")),
        ("R = {", "R = { strt = 1,", ("[parameters.R]", "'strt'", "'start'")),
        ("start = 3.0", "start = 30.0", ("[parameters.R]", "start 30 lies outside its bounds")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "", ("no parameters", "[parameters]")),
        ('outputs = ["i"]', "outputs = []", ("[experiments][0]", "no outputs")),
        ('outputs = ["i"]', "", ("[experiments][0]", "'outputs'")),
        ('"run.csv"', '"other.csv"', ("other.csv", "no file")),
        ('"Coil.fmu"', '"other.fmu"', ("other.fmu", "no file")),
        ('"run.csv"', '"Coil.fmu"', ("Coil.fmu", ".csv")),
        ('variance = "estimate"', "variance = 0", ("[noise]", "variance")),
        ('variance = "estimate"', "variance = { j = 1.0 }", ("noise.variance", "'j'")),
        ('inputs = ["u"]', 'inputs = ["u"]\ndiscard = 5.0', ("discard", "run.csv")),
        ('inputs = ["u"]', 'inputs = ["u"]\ninterpolation = { i = "hold" }', ("interpolation", "'i'")),
        ('inputs = ["u"]', 'inputs = ["w"]', ("'w'", "run.csv")),
        ('"marquardt"', '"linear"', ("[estimator]", "linear")),
        ("fmu =", "fmu ==", ("study.toml", "line 3")),
    ],
)  # fmt: skip
def test_wrong_study(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, named: tuple[str, ...]
) -> None:
    assert old in STUDY
    (folder / "study.toml").write_text(STUDY.replace(old, new))
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert all(word in sentence for word in named)


def test_missing_study(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "stduy.toml" in refused(capsys, "identify", folder / "stduy.toml")
    assert "study.toml" in refused(capsys, "simulate", folder / "stduy.toml")


def test_missing_fmu(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Koil.fmu" in refused(capsys, "info", folder / "Koil.fmu")
    assert "is" in refused(capsys, "info", folder)


# --- the table --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ("run.csv", "empty")),
        ("time,u,i\n", ("run.csv",)),
        ("time,u,i\n0,1,0\n0.1,on,0\n0.2,1,0\n", ("run.csv", "'u'", "on", "row 2")),
        ("time,u,i\n0,1,0\nsoon,1,0\n0.2,1,0\n", ("run.csv", "'time'", "soon")),
        ("time,u,i\n0,1,0\n0.2,1,0\n0.1,1,0\n", ("run.csv", "'time'", "row 3")),
        ("time,u,i\n0,1,0\n0.1,,0\n0.2,1,0\n", ("run.csv", "'u'", "row 2")),
        ("time,u,i\n0,1,0\n0.1,inf,0\n0.2,1,0\n", ("run.csv", "'u'", "row 2")),
        ("time,u,i\n0,1,\n0.1,1,\n0.2,1,\n", ("run.csv", "'i'", "no sample")),
        ("t,u,i\n0,1,0\n0.1,1,0\n", ("run.csv", "'time'")),
        ("time,u\n0,1\n0.1,1\n", ("run.csv", "'i'")),
        ("time;u;i\n0;1;0\n0,1;1;0\n", ("run.csv",)),
    ],
)  # fmt: skip
def test_wrong_table(folder: Path, capsys: pytest.CaptureFixture[str], text: str, named: tuple[str, ...]) -> None:
    (folder / "run.csv").write_text(text)
    sentence = refused(capsys, "identify", folder / "study.toml")
    assert all(word in sentence for word in named)


# --- the command line -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("identify",), "STUDY"),
        (("identfy", "study.toml"), "'identify'"),
        (("identify", "study.toml", "--ouptut", "x"), "--output"),
        (("identify", "study.toml", "--set"), "--set"),
        (("info", "a.fmu", "b.fmu"), "b.fmu"),
        (("--no-such",), "--no-such"),
    ],
)
def test_wrong_usage(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], named: str) -> None:
    sentence = refused(capsys, *arguments)
    assert named in sentence
    assert "--help" in sentence


def test_wrong_override(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    assert "'L'" in refused(capsys, "identify", study, "--set", "parameters.L.start=9")
    assert "path=value" in refused(capsys, "identify", study, "--set", "parameters.R.start")


def test_output_that_cannot_be_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "results").write_text("a file where the folder should be")
    assert run(["identify", str(folder / "study.toml")]) == WRONG_INPUT
    assert "results" in capsys.readouterr().err


def test_init_overwrites_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    sentence = refused(capsys, "init", folder / "Coil.fmu", folder / "run.csv", "--output", study)
    assert "study.toml is there already" in sentence
    assert study.read_text() == STUDY


def test_no_earlier_result_to_resume(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "result.json" in refused(capsys, "identify", folder / "study.toml", "--resume")
