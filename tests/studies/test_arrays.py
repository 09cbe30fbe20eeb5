"""Vectors and matrices as whole parameters of a study."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from fmuid import InputError, Study
from fmuid.apps.cli.options import DONE
from fmuid.array_types import Floats
from tests.support.coil_study import COIL, fmuid_
from tests.support.exported import export_text

STUDY = f"""
model.fmu = "{COIL.as_posix()}"
experiments = [{{ data = "run.csv", inputs = ["u"], outputs = ["i"] }}]
[parameters]
"""


def read(folder: Path, parameters: str, *overrides: str) -> Study:
    (folder / "run.csv").touch()
    (folder / "study.toml").write_text(STUDY + parameters)
    return Study.read(folder / "study.toml", overrides)


def test_by_element(tmp_path: Path) -> None:
    text = (
        "A = { start = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], min = 0.0, max = [[9.0, 9.0, 9.0], [9.0, 9.0, 7.0]] }\n"
        '"m.b" = { start = [7.0, 0.0], nominal = 2.0 }\nR = { start = 3.0 }'
    )
    found = read(tmp_path, text, "parameters.R.start=4").parameters
    names = [f"A[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    assert list(found) == [*names, "m.b[1]", "m.b[2]", "R"]
    assert [found[name].start for name in names] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert {found[name].min for name in names} == {0.0}
    assert (found["A[2,3]"].max, found["m.b[2]"].nominal, found["R"].start) == (7.0, 2.0, 4.0)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ("A = { start = [[1.0, 2.0], [3.0]] }", "parameters: 'A': start must be .* a matrix with equal rows"),
        ("A = { start = " + 100 * "[" + "1.0" + 100 * "]" + " }", "'A': start must be"),
        ("A = { start = [1.0, 2.0], min = [0.0] }", "'A': min must be one value, or as many as start"),
        ("A = { start = [1.0, 2.0], prior = { mean = 1.0, std = 1.0 } }", "'A': an array takes no prior"),
        ('"A[2]" = { start = 1.0 }\nA = { start = [1.0, 2.0] }', r"'A\[2\]' is given alone and in the array"),
        ('A = { start = [1.0, "x"] }', r'parameters."A\[2\]".start: must be a number'),
    ],
)
def test_wrong_arrays(tmp_path: Path, parameters: str, said: str) -> None:
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
    """Export the system, its parameters named as elements of arrays in FMI 2.0; beside it data."""
    folder = tmp_path_factory.mktemp("linear")
    with zipfile.ZipFile(export_text(folder, LINEAR)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = re.sub(r'name="A(\d)(\d)"', r'name="A[\1,\2]"', files["modelDescription.xml"].decode())
    files["modelDescription.xml"] = re.sub(r'name="([bs])(\d)"', r'name="\1[\2]"', text).encode()
    with zipfile.ZipFile(folder / "Arrays.fmu", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    write_data(folder / "run.csv", B)
    return folder


def write_data(path: Path, b: Floats) -> None:
    """Write the outputs, exact from sample to sample, under a held input."""
    step, rows = expm(0.05 * np.block([[A, b[:, None]], [np.zeros((1, 3))]])), 200
    u = np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], rows // 10), 10)
    x = np.zeros((rows, 2))
    x[0] = START
    for k in range(1, rows):
        x[k] = (step @ [*x[k - 1], u[k - 1]])[:2]
    pd.DataFrame({"time": 0.05 * np.arange(rows), "u": u, "y1": x[:, 0], "y2": x[:, 1]}).to_csv(path, index=False)


WHOLE = """
model = {{ fmu = "Arrays.fmu", fixed.b = {b} }}
parameters.A.start = {a}
noise.variance = 1e-6
[[experiments]]
data = "run.csv"
inputs = ["u"]
outputs = ["y1", "y2"]
interpolation = "zoh"
fixed.s = {s}
"""
SHAPES = {"a": "[[-1.5, 1.0], [-2.0, -1.0]]", "b": "[1.0, 2.0]", "s": "[0.4, -0.2]"}


def test_matrices_in_parameters_and_values(linear: Path) -> None:
    (linear / "study.toml").write_text(WHOLE.format(**SHAPES))
    study = Study.read(linear / "study.toml")
    assert study.model.values == {"b[1]": 1.0, "b[2]": 2.0}
    assert study.tables[0].values == {"s[1]": 0.4, "s[2]": -0.2}
    result = study.identify()
    np.testing.assert_allclose(result.values.reshape(2, 2), A, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "rows", "said"),
    [
        ("b", "[1.0]", r"model.fixed.b: 1 values given, but .* has 2. Give all, or single ones as .b\[1\]"),
        ("b", '[1.0, "x"]', r"'b\[2\]' .* Real .*'x'"),
        ("s", "[0.4]", r"experiments\[0\].fixed.s: 1 values given, but .* has 2"),
        ("a", "[-1.5, 1.0, 2.0, 1.0]", "parameters.A: 4 values given, but .* has 2 x 2"),
        ("b", "[1.0, 2.0], fixed.d = [1.0]", "d: 1 values given, but .* has one"),
    ],
)
def test_arrays_of_another_shape(linear: Path, name: str, rows: str, said: str) -> None:
    (linear / "wrong.toml").write_text(WHOLE.format(**SHAPES | {name: rows}))
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
    """The fault's own model has a fixed vector; an input gain is 0.5 larger."""
    study = WHOLE.format(**SHAPES)
    (linear / "study.toml").write_text(study)
    assert fmuid_("identify", linear / "study.toml", "--output", linear / "healthy", "--no-report") == DONE
    write_data(linear / "faulty.csv", np.add(B, [0.0, 0.5]))
    faulty = study.replace("run.csv", "faulty.csv") + FAULT
    (linear / "faulty.toml").write_text(faulty)
    found = Study.read(linear / "faulty.toml").diagnose()
    assert found.evidence.suspects[0].change.value == pytest.approx(0.5, rel=0.05)
    (linear / "wrong.toml").write_text(faulty.replace("{ b = [1.0, 2.0] }", "{ b = [1.0] }"))
    with pytest.raises(InputError, match=r"diagnosis.faults.gain: fixed.b: 1 values given"):
        Study.read(linear / "wrong.toml").diagnose()
