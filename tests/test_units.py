"""Units as they are written, against what they are in SI."""

import math

import pytest

from fmuid.units import parse_unit

SPEED, TORQUE, OHM = (0, 0, -1, 0, 0, 0, 0, 1), (1, 2, -2, 0, 0, 0, 0, 0), (1, 2, -3, -2, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("text", "exponents", "factor", "offset"),
    [
        ("rad/s", SPEED, 1.0, 0.0),
        *((each, SPEED, math.pi / 30, 0.0) for each in ("rpm", "1/min", "n/min", "min⁻¹", "rev/min", "U/min")),
        ("Hz", (0, 0, -1, 0, 0, 0, 0, 0), 1.0, 0.0),
        *((each, TORQUE, 1.0, 0.0) for each in ("N.m", "Nm", "N·m", "kg.m2/s2")),
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


@pytest.mark.parametrize(
    "text", ["filtered", "phase 1", "1,2", "dB", "x" * 50, "V +", "import os", "9**9**9**9", "(9)^(9)^9", "V^0.5"]
)
def test_what_is_no_unit(text: str) -> None:
    assert parse_unit(text) is None
