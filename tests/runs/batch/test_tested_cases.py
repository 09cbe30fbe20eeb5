"""Directed tests in a batch: off unless the study asks for them, and the report says so."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.coil_study import STUDY, coil_table, fmuid_

SWEEP = "fixed = { L = 0.1 }\n[[experiments]]".join(STUDY.split("[[experiments]]")).partition("L = { start")[0]
BATCH = "[batch]\nsweep = { L = [0.13, 0.1] }\n"


@pytest.mark.parametrize("asked", [pytest.param(False, marks=pytest.mark.slow), True])
def test_model_errors_of_cases(tmp_path: Path, capsys: pytest.CaptureFixture[str], here: Any, asked: bool) -> None:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    study = tmp_path / "study.toml"
    study.write_text(SWEEP + '[estimation]\nmodel_error = "report"\n' * asked + BATCH)
    here()
    fmuid_("batch", study, "--output", tmp_path / "out", "--no-report")
    rows = pd.concat(map(pd.read_parquet, (tmp_path / "out/cases").glob("*.parquet"))).sort_values("set.L")
    assert rows["reasons"].str.contains("model_error").tolist() == [False, asked]
    said = capsys.readouterr().out
    assert ("were not tested in the cases" in said) is not asked
    assert ("50 %" in said) is asked
