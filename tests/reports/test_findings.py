"""Words and numbers for people: how values, deviations and intervals are written, and which words end a search."""

from __future__ import annotations

import math

import pytest

from fmuid.files import file_name
from fmuid.formatting import bounded, rounded, with_std
from fmuid.reports.topics import uncertainty


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (9.8434, 0.0418, "9.843 ± 0.042"),
        (0.0012345678, 1.2e-7, "0.00123457 ± 0.00000012"),
        (1234.5, 98.0, "1234 ± 98"),
        (1234567.0, 23456.0, "1.235e+06 ± 2.3e+04"),
        (-4.7e3, 1.6e10, "0 ± 1.6e+10"),  # nothing of the value is known
        (2.6e10, 1.6e10, "2.6e+10 ± 1.6e+10"),
        (4.0, math.inf, "4"),
        (4.0, 0.0, "4"),
    ],
)
def test_value_and_standard_deviation(value: float, std: float, shown: str) -> None:
    assert with_std(value, std) == shown


def test_texts_of_a_number_and_of_names() -> None:
    assert rounded(math.pi, math.nan) == "3.14159"
    assert file_name("i_start[run 1]-drive.M/x") == "i_start_run_1_-drive.M_x"
    assert [bounded(each, 9) for each in ("a" * 9, "a" * 10, "a\n  b\u202e", " " * 50 + "b")] == [
        "a" * 9,
        "a" * 8 + "…",
        "a b",
        "…",
    ]


@pytest.mark.parametrize(
    ("ends", "shown"),
    [
        ((3.608, 3.915), "3.608 to 3.915"),
        ((-math.inf, math.inf), "not identifiable"),
        ((0.0013772, math.inf), "above 0.001"),
        ((-math.inf, 0.05), "below 0.0500"),
        ((math.nan, 1.0), ""),
    ],
)
def test_interval(ends: tuple[float, float], shown: str) -> None:
    assert uncertainty._interval(*ends, value=0.04) == shown
