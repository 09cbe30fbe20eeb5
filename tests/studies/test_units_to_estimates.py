"""Columns in unknown units, and models whose time is not in seconds: the remedy leads to the estimates."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.options import DONE
from tests.support.coil_study import fmuid_, result

RECORD = fmuid.datasets.coil()


def write(folder: Path, heads: tuple[str, str, str], factor: float) -> Path:
    frame = RECORD.table.assign(i=RECORD.table["i"] / factor)[["time", "u", "i"]]
    pd.DataFrame(frame.to_numpy(), columns=[*heads]).to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


def identified(folder: Path, *options: str) -> None:
    """Check that `fmuid init` with some options leads to the estimates."""
    study = folder / "study.toml"
    assert fmuid_("init", RECORD.fmu, folder / "a.csv", "--output", study, *options) == DONE
    check_estimates(study)


def check_estimates(study: Path) -> None:
    assert fmuid_("identify", study, "--output", study.parent / "out", "--no-isolation", "--no-report") == DONE
    found = result(study.parent / "out")["parameters"]
    for name, truth in RECORD.truth.items():
        assert abs(found[name]["value"] - truth) < 4 * found[name]["std"]


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("A*10", 10),
        *(pytest.param(each, 10, marks=pytest.mark.slow) for each in ("pu", "dB")),
        pytest.param("%", 0.1, marks=pytest.mark.slow),  # a hundredth of 10 A
        *(pytest.param(each, 1, marks=pytest.mark.slow) for each in ("foo", "Aeff", "A rms")),
    ],
)
def test_unknown_units_are_refused_with_a_remedy_that_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str, factor: float
) -> None:
    path, study = write(tmp_path, ("time", "u [V]", f"i [{unit}]"), factor), tmp_path / "study.toml"
    assert fmuid_("init", RECORD.fmu, path, "--output", study) != DONE
    said = " ".join("".join(capsys.readouterr()).split())
    assert f"a.csv: unit '{unit}' of 'i' does not convert to 'A'." in said
    plain, multiple = re.search(r'→ Add (--unit \S+) for numbers in A, ("--unit.*?") for', said).groups()  # type: ignore[union-attr]
    assert fmuid_("identify", study, "--output", tmp_path / "out") != DONE
    identified(tmp_path, *shlex.split(plain if factor == 1 else multiple))


@pytest.mark.slow
def test_the_same_remedy_in_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, study = write(tmp_path, ("time", "u [V]", "i"), 10), tmp_path / "study.toml"
    assert fmuid_("init", RECORD.fmu, path, "--output", study) == DONE
    path.write_text(path.read_text().replace(",i\n", ",i [A*10]\n", 1))
    assert fmuid_("identify", study, "--output", tmp_path / "out") != DONE
    said = " ".join("".join(capsys.readouterr()).split())
    assert "i: column unit 'A*10' does not convert to 'A' of Coil. Set units = { i = \"A\" } for numbers in A" in said
    multiple = re.search(r'or ("pu of 10 A") for multiples of 10 A', said)
    assert multiple is not None
    study.write_text(study.read_text().replace("warmup", f"units = {{ i = {multiple[1]} }}\n#", 1))
    check_estimates(study)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["h", "d"])
def test_models_whose_time_is_not_in_seconds(tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str) -> None:
    path = write(tmp_path, (f"Time [{unit}]", "u [V]", "i [A]"), 1)
    fmuid_("init", RECORD.fmu, path, "--output", tmp_path / "study.toml")
    said = " ".join("".join(capsys.readouterr()).split())
    assert "time unit looks wrong" in said
    assert '"s" if the model counts in the unit of the file' in said
    identified(tmp_path, "--time-unit", "s")
