"""Tables for people hold no formulas, and read back as they were."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd
import pytest

from fmuid import files
from fmuid.runs import read_table

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
