"""Words, units and tables for people."""

import csv
import math
from pathlib import Path

import pandas as pd
import pytest

from fmuid import files
from fmuid.formatting import listed, two_digits
from fmuid.runs import read_table
from fmuid.units import parse_unit


def test_words_in_a_list() -> None:
    assert [listed(list(words)) for words in ("", "a", "ab", "abc")] == ["", "a", "a and b", "a, b and c"]


def test_two_digits_without_exponents() -> None:
    values = (0.0, 0.0123, 1.84, 99.4, 99.6, -180.4, 7.1e7, float("inf"))
    assert [two_digits(each) for each in values] == ["0", "0.012", "1.8", "99", "100", "-180", "7.1e+07", "inf"]


SPEED, TORQUE, OHM = (0, 0, -1, 0, 0, 0, 0, 1), (1, 2, -2, 0, 0, 0, 0, 0), (1, 2, -3, -2, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("text", "exponents", "factor", "offset"),
    [
        ("rad/s", SPEED, 1.0, 0.0),
        *((each, SPEED, math.pi / 30, 0.0) for each in ("rpm", "1/min", "n/min", "min⁻¹", "rev/min", "U/min")),
        ("Hz", (0, 0, -1, 0, 0, 0, 0, 0), 1.0, 0.0),
        *((each, TORQUE, 1.0, 0.0) for each in ("N.m", "Nm", "N·m", "kg.m2/s2")),
        ("mrad", (0, 0, 0, 0, 0, 0, 0, 1), 1e-3, 0.0),
        ("mNm", TORQUE, 1e-3, 0.0),
        *((each, OHM, 1.0, 0.0) for each in ("Ohm", "Ω", "V/A")),
        ("W/(m2.K)", (1, 0, -3, 0, -1, 0, 0, 0), 1.0, 0.0),
        ("degC", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 273.15),
        ("°F", (0, 0, 0, 0, 1, 0, 0, 0), 5 / 9, 459.67 * 5 / 9),
        ("%", (0,) * 8, 0.01, 0.0),
        ("-", (0,) * 8, 1.0, 0.0),
        ("V/krpm", (1, 2, -2, -1, 0, 0, 0, -1), 0.03 / math.pi, 0.0),
        ("g/L", (1, -3, 0, 0, 0, 0, 0, 0), 1.0, 0.0),
    ],
)
def test_units(text: str, exponents: tuple[int, ...], factor: float, offset: float) -> None:
    found = parse_unit(text)
    assert found is not None
    assert found.exponents == exponents
    assert found.factor == pytest.approx(factor, rel=1e-12)
    assert found.offset == pytest.approx(offset, rel=1e-12)


@pytest.mark.parametrize("text", ["A", "V", "W", "s", "m", "rad", "rad/s", "N.m"])
def test_frequent_units_are_those_of_their_multiples(text: str) -> None:
    unit, thousandth = parse_unit(text), parse_unit(f"m{text}")
    assert unit is not None
    assert thousandth is not None
    assert (unit.factor, unit.offset, unit.exponents) == (1.0, 0.0, thousandth.exponents)
    assert thousandth.factor == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["filtered", "phase 1", "1,2", "dB", "x" * 50, "V +", "import os", "9**9**9**9", "(9)^(9)^9", "V^0.5"]
)
def test_what_is_no_unit(text: str) -> None:
    assert parse_unit(text) is None


FORMULA = "=cmd|'/C calc'!A0"


@pytest.mark.parametrize("copies", [1, files.MOST_BY_PANDAS])
def test_no_cell_of_a_csv_is_a_formula(tmp_path: Path, copies: int) -> None:
    texts = [FORMULA, "+1+1", "-2+3", "@SUM(A1)", "\t=1", "'=1", "'", "plain", "-1.5", "d'or"]
    frame = pd.DataFrame({"parameter": texts * copies, "=x": -1.5, "'+y'": range(len(texts) * copies), "-1.5": True})
    path = files.write_table(tmp_path / "a.csv", frame)
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == ["parameter", "'=x", "''+y'", "-1.5"]
    assert [row[0] for row in rows[: len(texts)]] == [
        *("'" + FORMULA, "'+1+1", "'-2+3", "'@SUM(A1)", "'\t=1", "''=1", "'", "plain", "-1.5", "d'or")
    ]
    assert {row[1] for row in rows} == {"-1.5"}
    pd.testing.assert_frame_equal(read_table(path), frame)
