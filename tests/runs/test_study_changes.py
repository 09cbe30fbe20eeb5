"""The offered change of a study: each defect of a coil's study offers its own, and applied it is the remedy."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

import fmuid
from fmuid import Study
from fmuid.estimation import Grade
from fmuid.runs import ChangeKind, IdentificationRun, identified
from tests.support.coil_study import STUDY, coil_table
from tests.support.quick import first

FIXED = STUDY.replace("[[experiments]]", "fixed = { L = 0.13 }\n[[experiments]]").partition("L = { start")[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("changes")
    coil_table(made / "plain.csv", 0.0, seed=1)
    coil_table(made / "moving.csv", 2.0, seed=1)
    table = pd.read_csv(made / "plain.csv")
    table.assign(i=table["i"] + 0.05).to_csv(made / "offset.csv", index=False)
    return made


def found_by(folder: Path, text: str, settings: tuple[str, ...] = ()) -> IdentificationRun:
    path = folder / "study.toml"
    path.write_text(text)
    (run,) = identified(Study.read(path, list(settings), isolated=False))
    return run


CASES = {
    "fixed": ("plain", FIXED, ChangeKind.FREE, ("L",), "parameters.L={ start = 0.13 }"),
    "linear": ("plain", STUDY.replace('"zoh"', '"linear"'), ChangeKind.INTERPOLATION, ("u",), 'interpolation="zoh"'),
    "offset": ("offset", STUDY, ChangeKind.OFFSET, ("i",), 'preprocess.computed_columns.i="i - (0.050)"'),
    "moving": ("moving", STUDY, ChangeKind.WARMUP, ("first",), "experiments.0.warmup="),
}


@pytest.mark.parametrize("case", first(1, reversed(CASES)))
def test_the_offered_change_is_the_remedy(folder: Path, case: str) -> None:
    data, text, kind, subject, setting = CASES[case]
    shutil.copy(folder / f"{data}.csv", folder / "first.csv")
    found = found_by(folder, text).change
    assert found is not None
    assert (found.kind, found.subject) == (kind, subject)
    assert setting in found.settings[0]
    again = found_by(folder, text, found.settings)
    assert again.result.verdict is not None
    assert again.result.verdict.grade is Grade.PASSED
    assert again.change is None
    assert abs(again.result["R"] - 4.0) < 3.0 * again.result.std[0]
    assert found.gain > 10.0


def test_nothing_is_offered_where_nothing_is_wrong(folder: Path) -> None:
    shutil.copy(folder / "plain.csv", folder / "first.csv")
    assert found_by(folder, STUDY).change is None
    assert fmuid.Document.of(found_by(folder, STUDY)).remedy == ""
