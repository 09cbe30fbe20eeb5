"""Vectors and matrices as whole parameters of a study."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from fmuid.apps.cli.options import DONE
from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.studies import Study
from tests.support.coil_study import COIL, coil_table, fmuid_
from tests.support.exported import export_text

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "run.csv"
inputs = ["u"]
outputs = ["i"]
[parameters]
{parameters}
"""


def read(folder: Path, parameters: str, *overrides: str) -> Study:
    coil_table(folder / "run.csv", 0.0, seed=1)
    (folder / "study.toml").write_text(STUDY.format(fmu=COIL.as_posix(), parameters=parameters))
    return Study.read(folder / "study.toml", overrides)


def test_by_element(tmp_path: Path) -> None:
    text = (
        "A = { start = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], min = 0.0, max = [[9.0, 9.0, 9.0], [9.0, 9.0, 7.0]] }\n"
        '"m.b" = { start = [7.0, 0.0], nominal = 2.0 }\nR = { start = 3.0 }'
    )
    found = read(tmp_path, text).parameters
    names = [f"A[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    assert list(found) == [*names, "m.b[1]", "m.b[2]", "R"]
    assert [found[name].start for name in names] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert found["A[2,3]"].max == 7.0
    assert {found[name].min for name in names} == {0.0}
    assert found["m.b[2]"].nominal == 2.0
    again = read(tmp_path, text, "parameters.R.start=4").parameters
    assert again["R"].start == 4.0


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (
            "A = { start = [[1.0, 2.0], [3.0]] }",
            r"\[parameters\] 'A': start must be a number, a vector or a matrix with rows of one length",
        ),
        ("A = { start = " + 100 * "[" + "1.0" + 100 * "]" + " }", "'A': start must be a number, a vector or a matrix"),
        ("A = { start = [] }", "'A': start must be a number, a vector or a matrix"),
        ("A = { start = [1.0, [2.0]] }", "'A': start must be a number, a vector or a matrix"),
        (
            "A = { start = [1.0, 2.0], min = [0.0] }",
            "'A': min must be a single one, or have as many rows and columns as start",
        ),
        ("A = { start = [1.0, 2.0], prior = { mean = 1.0, std = 1.0 } }", "'A': a prior must be of single elements"),
        ('"A[2]" = { start = 1.0 }\nA = { start = [1.0, 2.0] }', r"has 'A\[2\]' by itself and in the whole array"),
        ('A = { start = [1.0, "x"] }', r"\[parameters.\"A\[2\]\"\] start must be a number"),
        ("A = { start = [1.0, 2.0], min = [0.0, [1.0]] }", r"min must be a number, not \[1.0\]"),
        ("A = { start = [1.0, 2.0], nominla = 1.0 }", "has no key 'nominla'"),
    ],
)
def test_what_is_no_array(tmp_path: Path, parameters: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, parameters)


# --- a linear system of which FMU and study have the matrices ---

LINEAR = """
model Linear "two states"
  parameter Real A11 = -1; parameter Real A12 = 0; parameter Real A21 = 0; parameter Real A22 = -1;
  parameter Real b1 = 0; parameter Real b2 = 0;
  parameter Real s1 = 0; parameter Real s2 = 0;
  parameter Real d = 0;
  input Real u;
  output Real y1(start = s1, fixed = true);
  output Real y2(start = s2, fixed = true);
equation
  der(y1) = A11*y1 + A12*y2 + b1*u;
  der(y2) = A21*y1 + A22*y2 + b2*u + d*u;
end Linear;
"""
A, B, START = np.array([[-2.0, 1.5], [-3.0, -0.5]]), np.array([1.0, 2.0]), np.array([0.4, -0.2])


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export the system and call its parameters as FMUs of FMI 2.0 call the elements of arrays; beside it a record."""
    folder = tmp_path_factory.mktemp("linear")
    made = export_text(folder, LINEAR)
    with zipfile.ZipFile(made) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = files["modelDescription.xml"].decode()
    text = re.sub(r'name="A(\d)(\d)"', r'name="A[\1,\2]"', text)
    files["modelDescription.xml"] = re.sub(r'name="([bs])(\d)"', r'name="\1[\2]"', text).encode()
    with zipfile.ZipFile(folder / "Arrays.fmu", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    write_record(folder / "run.csv", B)
    return folder


def write_record(path: Path, b: Floats) -> None:
    """Write what the system does, exactly from sample to sample, under a held input."""
    step, rows = expm(0.05 * np.block([[A, b[:, None]], [np.zeros((1, 3))]])), 200
    u = np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], rows // 10), 10)
    x = np.zeros((rows, 2))
    x[0] = START
    for k in range(1, rows):
        x[k] = (step @ [*x[k - 1], u[k - 1]])[:2]
    pd.DataFrame({"time": 0.05 * np.arange(rows), "u": u, "y1": x[:, 0], "y2": x[:, 1]}).to_csv(path, index=False)


WHOLE = """
[model]
fmu = "Arrays.fmu"
[model.fixed]
b = {b}
[[experiments]]
data = "run.csv"
inputs = ["u"]
outputs = ["y1", "y2"]
interpolation = "zoh"
[experiments.fixed]
s = {s}
[parameters]
A = {{ start = {a} }}
[noise]
variance = 1e-6
"""
SHAPES = {"a": "[[-1.5, 1.0], [-2.0, -1.0]]", "b": "[1.0, 2.0]", "s": "[0.4, -0.2]"}


def test_matrices_in_parameters_and_values(linear: Path) -> None:
    (linear / "study.toml").write_text(WHOLE.format(**SHAPES))
    study = Study.read(linear / "study.toml")
    assert study.model.values == {"b[1]": 1.0, "b[2]": 2.0}
    assert study.tables[0].values == {"s[1]": 0.4, "s[2]": -0.2}
    result = study.identify()
    found = [[result[f"A[{i},{j}]"] for j in (1, 2)] for i in (1, 2)]
    np.testing.assert_allclose(found, A, rtol=1e-4)


@pytest.mark.parametrize(
    ("table", "rows", "said"),
    [
        ("b", "[1.0]", r"\[model.fixed\] 'b' has 1 values and 2 in .*: give all, or single ones by .b\[1\]"),
        ("b", "[1.0, 2.0, 3.0]", "'b' has 3 values and 2 in"),
        ("b", "[[1.0, 2.0]]", "'b' has 1 x 2 values and 2 in"),
        ("b", "[1.0, [2.0]]", r"\[model.fixed\] 'b': the value must be a number, a vector or a matrix with rows"),
        ("b", "[]", "'b': the value must be a number, a vector or a matrix"),
        ("b", '[1.0, "x"]', r"'b\[2\]' is of type Real and cannot have the value 'x'"),
        ("s", "[0.4]", r"\[experiments.fixed\]\[0\] 's' has 1 values and 2 in"),
        ("a", "[[-1.5, 1.0]]", "parameters 'A' has 1 x 2 values and 2 x 2 in"),
        ("a", "[-1.5, 1.0, 2.0, 1.0]", "parameters 'A' has 4 values and 2 x 2 in"),
        ("b", "[1.0, 2.0]\nd = [1.0]", "'d' has 1 values and is one number in"),
    ],
)  # fmt: skip
def test_arrays_of_another_shape(linear: Path, table: str, rows: str, said: str) -> None:
    (linear / "wrong.toml").write_text(WHOLE.format(**SHAPES | {table: rows}))
    with pytest.raises(InputError, match=said):
        Study.read(linear / "wrong.toml").problem()


FAULT = """
[diagnosis]
baseline = "healthy/result.json"
[diagnosis.faults.gain]
fmu = "Arrays.fmu"
fixed = { b = [1.0, 2.0] }
parameters = { d = { nominal = 1.0 } }
"""


@pytest.mark.slow
def test_matrices_of_a_fault(linear: Path) -> None:
    """The fault's own model has a vector held at values; an input gain is 0.5 larger."""
    study = WHOLE.format(**SHAPES)
    (linear / "study.toml").write_text(study)
    assert fmuid_("identify", linear / "study.toml", "--output", linear / "healthy", "--no-report") == DONE
    write_record(linear / "faulty.csv", np.add(B, [0.0, 0.5]))
    faulty = study.replace("run.csv", "faulty.csv") + FAULT
    (linear / "faulty.toml").write_text(faulty)
    found = Study.read(linear / "faulty.toml").diagnose()
    assert found.evidence.suspects[0].change.value == pytest.approx(0.5, rel=0.05)
    (linear / "wrong.toml").write_text(faulty.replace("{ b = [1.0, 2.0] }", "{ b = [1.0] }"))
    with pytest.raises(InputError, match=r"\[diagnosis.faults.gain\]: fixed 'b' has 1 values and 2 in"):
        Study.read(linear / "wrong.toml").diagnose()
