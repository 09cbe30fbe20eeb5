"""Studies, results and tables beyond what their readers take: one sentence each."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from fmuid.apps.cli.app import run
from fmuid.data.data_file import read_data
from tests.support.bad_input import SOUND, refused, rezip, table

# --- what the fuzz tests found ----------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a = " + "{a = " * 5000, "nested too deeply"),
        ("a = " + "9" * 5000, "thousands of digits"),
        ("[" + "a." * 100_000 + "a]", "more than 100 parts"),  # which took minutes
        ("a.'b c'.\"d\" . " * 100 + "e = 1", "more than 100 parts"),
        (SOUND.replace("start = 3.0", "start = 1" + "0" * 400), "parameters.R.start: must be a number"),
        (SOUND.replace("min = 0.0", "min = -1" + "0" * 400), "parameters.R.min: must be a number"),
        (SOUND.replace('"estimate"', "1" + "0" * 400), "noise.variance: must be"),
        (SOUND.replace("Coil.fmu", "C" * 300), "not found"),
        (SOUND.replace("Coil.fmu", "C\\u0000"), "not found"),
        (SOUND.replace("run.csv", "r\\u0000"), "not found"),
    ],
)
def test_studies_beyond_what_readers_take(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    (coil_folder / "study.toml").write_text(text)
    sentence = refused(capsys, "simulate", coil_folder / "study.toml")
    assert "study.toml" in sentence
    assert said in sentence


def test_override_beyond_what_readers_take(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for value in ("[" * 5000, "9" * 5000):
        sentence = refused(capsys, "simulate", coil_folder / "study.toml", "--set", f"parameters.R.start={value}")
        assert "parameters.R.start: must be a number" in sentence


@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".fmu"])
def test_names_that_no_file_has(coil_folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    coil = coil_folder / "Coil.fmu"
    for command in (
        ("info", name),
        ("init", name, coil_folder / "run.csv", "--output", coil_folder / "new.toml"),
        ("init", coil, f"{name}.csv", "--output", coil_folder / "new.toml"),
        ("init", coil, coil_folder / "run.csv", "--output", coil_folder / name),
        ("simulate", name),
        ("apply", name, coil, "--output", coil_folder / "new.fmu"),
    ):
        assert name in refused(capsys, *command)


RESULT = """{"schema": "fmuid/result/2", "outcome": "converged", "converged": true,
"parameters": {"R": {"value": 4.0, "std": 0.1, "start": 3.0, "lower": "-inf", "upper": "inf"}},
"covariance": {"names": ["R"], "matrix": [[0.01]], "white_noise": [[0.01]]}, "fit": {"noise_variance": {"i": 1e-6},
"given_variance": {}, "cost": 1.0, "log_likelihood": null, "degrees_of_freedom": "inf"}, "identifiability": {},
"history": {"iterations": 1, "simulations": 2, "elapsed_s": 0.1}, "setup": {"version": "0"}}"""


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
def test_damaged_results(coil_folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str) -> None:
    command = ("apply", coil_folder / "result.json", coil_folder / "Coil.fmu", "--output", coil_folder / "new.fmu")
    (coil_folder / "result.json").write_text(RESULT)
    assert run([str(word) for word in command]) == 0
    capsys.readouterr()
    (coil_folder / "result.json").write_text(RESULT.replace(old, new))
    said = refused(capsys, *command)
    assert "result.json" in said and "run fmuid identify again" in said


def test_columns_of_lists(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = pd.DataFrame({"time": [0.0, 1.0], "u": [[1.0, 2.0], [3.0]], "i": [0.0, 0.0]})
    frame.to_parquet(coil_folder / "run.parquet")
    (coil_folder / "study.toml").write_text(SOUND.replace("run.csv", "run.parquet"))
    assert "column 'u': 'list<element: double>'" in refused(capsys, "simulate", coil_folder / "study.toml")


def test_mat_files_with_a_name_twice(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = {"time": np.arange(3.0), "u": np.ones(3), "i": np.ones(3)}
    savemat(coil_folder / "run.mat", columns)
    content = (coil_folder / "run.mat").read_bytes()
    (coil_folder / "run.mat").write_bytes(content + content[128:])  # after its header
    (coil_folder / "study.toml").write_text(SOUND.replace("run.csv", "run.mat"))
    assert "run.mat: not a readable MAT file" in refused(capsys, "simulate", coil_folder / "study.toml")


@pytest.mark.parametrize(
    ("place", "content"),
    [
        (184, b"\x7f"),  # the type of numbers: SciPy's reader ends the process
        (184, b"\x0e"),
        (145, b"\x08"),  # complex, without the imaginary part: what follows would be taken for it
        (144, b"\x01"),
        (144, b"\x02"),
        (152, b"\x07"),
        (132, b"\xff\xff\xff\x7f"),
    ],
)
@pytest.mark.parametrize("compressed", [False, True])
def test_damaged_mat_files(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], place: int, content: bytes, compressed: bool
) -> None:
    savemat(coil_folder / "run.mat", {"time_s": np.arange(3.0), "u": np.ones(3), "i": np.ones(3)})
    raw = bytearray((coil_folder / "run.mat").read_bytes())
    raw[place : place + len(content)] = content
    if compressed:
        inside = zlib.compress(bytes(raw[128:]))
        raw[128:] = struct.pack("<II", 15, len(inside)) + inside
    (coil_folder / "run.mat").write_bytes(raw)
    (coil_folder / "study.toml").write_text(SOUND.replace("run.csv", "run.mat"))
    assert "run.mat: " in refused(capsys, "simulate", coil_folder / "study.toml")


def test_slopes_that_overflow(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table(coil_folder, pd.DataFrame({"time": [0.0, 1e-10, 1.0, 2.0], "u": [0.0, 1e300, 0.0, 1.0], "i": 0.0}))
    text = SOUND.replace('outputs = ["i"]', 'outputs = ["i"]\ninterpolation = "pchip"')
    (coil_folder / "study.toml").write_text(text)
    assert "changes too fast" in refused(capsys, "simulate", coil_folder / "study.toml")


def test_mat_files_nested_deeply(tmp_path: Path) -> None:
    cell: Any = np.array([1.0])
    for _ in range(60):
        cell = np.array([cell, None], dtype=object)[:1]
    savemat(tmp_path / "deep.mat", {"time": [0.0, 1.0], "c": cell})
    assert list(read_data(tmp_path / "deep.mat").columns) == ["time"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('m="1"', 'm="INF"', "m of BaseUnit must be a finite number"),
        ('m="1"', 'm="nan"', "m of BaseUnit must be a finite number"),
        ('factor="0.001"', 'factor="0"', "factor 0"),
        ('value="4.5"', 'value="INF"', "value of Real must be a finite number"),
    ],
)
def test_values_without_finite_numbers(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    unit = '<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>'
    text = f"""<ParameterSet version="1.0" name="values"><Parameters><Parameter name="R"><Real value="4.5"/></Parameter>
    </Parameters><Units>{unit}</Units></ParameterSet>"""
    command = ("apply", coil_folder / "values.ssv", coil_folder / "Coil.fmu", "--output", coil_folder / "new.fmu")
    (coil_folder / "values.ssv").write_text(text)
    assert run([str(word) for word in command]) == 0
    capsys.readouterr()
    (coil_folder / "values.ssv").write_text(text.replace(old, new))
    assert said in refused(capsys, *command)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<Unit name=", "<Unit named=", "Unit without a name"),
        (" modelName=", " named=", "fmiModelDescription without a name"),
        (" guid=", " named=", "no guid"),
    ],
)
def test_names_that_are_missing(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    def change(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        assert old in text
        files["modelDescription.xml"] = text.replace(old, new, 1).encode()

    rezip(coil_folder / "Coil.fmu", change)
    assert said in refused(capsys, "info", coil_folder / "Coil.fmu")


def test_numbers_that_overflow_warn_of_nothing(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its RMSE overflows, as here that of measurements; warnings are errors."""
    for value in (1e200, 1e300):
        table(coil_folder, pd.DataFrame({"time": [0.0, 1e-3, 2e-3], "u": 1.0, "i": [0.0, value, -value]}))
        assert run(["simulate", str(coil_folder / "study.toml"), "--output", str(coil_folder / "out")]) == 0
        assert "inf A" in capsys.readouterr().out
