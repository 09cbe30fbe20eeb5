"""Whatever a user gives wrongly ends in one clear sentence on stderr that names it, and exit code 2."""

from __future__ import annotations

import re
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from fmuid.cli.app import run
from fmuid.cli.options import WRONG_INPUT
from fmuid.data.tables import read_table
from fmuid.errors import InputError
from tests.support.paths import ROOT

COIL = ROOT / "fmus/Coil/Coil.fmu"
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
        ('[[experiments]]', '[model.values]\nL = 1' + "0" * 400 + '\n[[experiments]]', ("'L'", "finite number")),
        ('[[experiments]]', '[model.values]\nL = inf\n[[experiments]]', ("'L'", "finite number")),
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
        ("clock,u,i\n0,1,0\n0.1,1,0\n", ("run.csv", "'time'")),
        ("time,u\n0,1\n0.1,1\n", ("run.csv", "'i'")),
        ("time;u;i\n0;1,2,3;0\n1;1;0\n", ("run.csv", "'u'", "row 1")),
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


# --- what the fuzz tests found ----------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a = " + "{a = " * 5000, "nested too deeply"),
        ("a = " + "9" * 5000, "thousands of digits"),
        ("[" + "a." * 100_000 + "a]", "more than 100 parts"),  # which took minutes
        ("a.'b c'.\"d\" . " * 100 + "e = 1", "more than 100 parts"),
        (STUDY.replace("start = 3.0", "start = 1" + "0" * 400), "[parameters.R] start must be a number"),
        (STUDY.replace("min = 0.0", "min = -1" + "0" * 400), "[parameters.R] min must be a number"),
        (STUDY.replace('"estimate"', "1" + "0" * 400), "[noise] variance must be"),
        (STUDY.replace("Coil.fmu", "C" * 300), "there is no file"),
        (STUDY.replace("Coil.fmu", "C\\u0000"), "there is no file"),
        (STUDY.replace("run.csv", "r\\u0000"), "there is no file"),
    ],
)
def test_studies_beyond_what_readers_take(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    (folder / "study.toml").write_text(text)
    sentence = refused(capsys, "simulate", folder / "study.toml")
    assert "study.toml" in sentence
    assert said in sentence


def test_override_beyond_what_readers_take(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for value in ("[" * 5000, "9" * 5000):
        sentence = refused(capsys, "simulate", folder / "study.toml", "--set", f"parameters.R.start={value}")
        assert "[parameters.R] start must be a number" in sentence


@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".fmu"])
def test_names_that_no_file_has(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    coil = folder / "Coil.fmu"
    for command in (
        ("info", name),
        ("init", name, folder / "run.csv", "--output", folder / "new.toml"),
        ("init", coil, f"{name}.csv", "--output", folder / "new.toml"),
        ("init", coil, folder / "run.csv", "--output", folder / name),
        ("simulate", name),
        ("apply", name, coil, "--output", folder / "new.fmu"),
    ):
        assert name in refused(capsys, *command)


RESULT = """{"outcome": "converged", "converged": true,
"parameters": {"R": {"value": 4.0, "std": 0.1, "start": 3.0}},
"covariance": {"names": ["R"], "matrix": [[0.01]]}, "noise_variance": {"i": 1e-6}, "criterion": 1.0, "iterations": 1,
"simulations": 2, "elapsed_s": 0.1, "version": "0"}"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("4.0", "[4.0]"),
        ("4.0", '{"a": 1}'),
        ('"iterations": 1', '"iterations": 1e999'),
        ("1e-6", "[]"),
        ("4.0", "1" + "0" * 400),
        ("4.0", "[" * 100_000),
        ("0.01", "-0.01"),
        ('"outcome": "converged"', '"outcome": "fine"'),
        ('"outcome": "converged", ', ""),
    ],
)
def test_damaged_results(folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str) -> None:
    command = ("apply", folder / "result.json", folder / "Coil.fmu", "--output", folder / "new.fmu")
    (folder / "result.json").write_text(RESULT)
    assert run([str(word) for word in command]) == 0
    capsys.readouterr()
    (folder / "result.json").write_text(RESULT.replace(old, new))
    said = refused(capsys, *command)
    assert "result.json" in said and "run fmuid identify again" in said


def test_columns_of_lists(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = pd.DataFrame({"time": [0.0, 1.0], "u": [[1.0, 2.0], [3.0]], "i": [0.0, 0.0]})
    frame.to_parquet(folder / "run.parquet")
    (folder / "study.toml").write_text(STUDY.replace("run.csv", "run.parquet"))
    assert "column 'u' holds '[1. 2.]' in row 1" in refused(capsys, "simulate", folder / "study.toml")


def test_mat_files_with_a_name_twice(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = {"time": np.arange(3.0), "u": np.ones(3), "i": np.ones(3)}
    savemat(folder / "run.mat", columns)
    content = (folder / "run.mat").read_bytes()
    (folder / "run.mat").write_bytes(content + content[128:])  # after its header
    (folder / "study.toml").write_text(STUDY.replace("run.csv", "run.mat"))
    assert "run.mat: the file is no readable MAT file" in refused(capsys, "simulate", folder / "study.toml")


@pytest.mark.parametrize(
    ("place", "content"),
    [
        (184, b"\x7f"),  # the type of numbers: SciPy's reader ends the process
        (184, b"\x0e"),
        (145, b"\x08"),  # complex, without the imaginary part: what follows would be taken for it
        (144, b"\x01"),
        (144, b"\x02"),
        (152, b"\x07"),
        (136, b"\x63"),
        (132, b"\xff\xff\xff\x7f"),
    ],
)
@pytest.mark.parametrize("compressed", [False, True])
def test_damaged_mat_files(
    folder: Path, capsys: pytest.CaptureFixture[str], place: int, content: bytes, compressed: bool
) -> None:
    savemat(folder / "run.mat", {"time_s": np.arange(3.0), "u": np.ones(3), "i": np.ones(3)})
    raw = bytearray((folder / "run.mat").read_bytes())
    raw[place : place + len(content)] = content
    if compressed:
        inside = zlib.compress(bytes(raw[128:]))
        raw[128:] = struct.pack("<II", 15, len(inside)) + inside
    (folder / "run.mat").write_bytes(raw)
    (folder / "study.toml").write_text(STUDY.replace("run.csv", "run.mat"))
    assert "run.mat: " in refused(capsys, "simulate", folder / "study.toml")


def test_slopes_that_overflow(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table(folder, pd.DataFrame({"time": [0.0, 1e-10, 1.0, 2.0], "u": [0.0, 1e300, 0.0, 1.0], "i": 0.0}))
    text = STUDY.replace('outputs = ["i"]', 'outputs = ["i"]\ninterpolation = "cubic"')
    (folder / "study.toml").write_text(text)
    assert "changes too fast for double precision" in refused(capsys, "simulate", folder / "study.toml")


def test_mat_files_nested_deeply(tmp_path: Path) -> None:
    cell: Any = np.array([1.0])
    for depth in range(60):
        if depth == 40:
            savemat(tmp_path / "some.mat", {"time": [0.0, 1.0], "c": cell})
            assert list(read_table(tmp_path / "some.mat").columns) == ["time"]
        cell = np.array([cell, None], dtype=object)[:1]
    savemat(tmp_path / "deep.mat", {"time": [0.0, 1.0], "c": cell})
    with pytest.raises(InputError, match=r"deep\.mat: the file is no readable MAT file"):
        read_table(tmp_path / "deep.mat")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('m="1"', 'm="INF"', "m of BaseUnit must be a finite number"),
        ('m="1"', 'm="nan"', "m of BaseUnit must be a finite number"),
        ('factor="0.001"', 'factor="0"', "has the factor 0"),
        ('value="4.5"', 'value="INF"', "value of Real must be a finite number"),
    ],
)
def test_values_without_finite_numbers(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    unit = '<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>'
    text = f"""<ParameterSet version="1.0" name="values"><Parameters><Parameter name="R"><Real value="4.5"/></Parameter>
    </Parameters><Units>{unit}</Units></ParameterSet>"""
    command = ("apply", folder / "values.ssv", folder / "Coil.fmu", "--output", folder / "new.fmu")
    (folder / "values.ssv").write_text(text)
    assert run([str(word) for word in command]) == 0
    capsys.readouterr()
    (folder / "values.ssv").write_text(text.replace(old, new))
    assert said in refused(capsys, *command)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<Unit name=", "<Unit named=", "a Unit without its name"),
        (" modelName=", " named=", "a fmiModelDescription without its name"),
        (" guid=", " named=", "no guid"),
    ],
)
def test_names_that_are_missing(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    def change(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        assert old in text
        files["modelDescription.xml"] = text.replace(old, new, 1).encode()

    rezip(folder / "Coil.fmu", change)
    assert said in refused(capsys, "info", folder / "Coil.fmu")


def test_numbers_that_overflow_warn_of_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its misfit overflows, as here that of measurements; warnings are errors."""
    for value in (1e200, 1e300):
        table(folder, pd.DataFrame({"time": [0.0, 1e-3, 2e-3], "u": 1.0, "i": [0.0, value, -value]}))
        assert run(["simulate", str(folder / "study.toml"), "--output", str(folder / "out")]) == 0
        assert "nan %" in capsys.readouterr().out
