"""Vectors and matrices as whole parameters of a study."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.studies import Study
from tests.support.coil_study import COIL, coil_table

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
table = "run.csv"
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
