"""Fixtures of these tests."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.bad_input import COIL, SOUND, table
from tests.support.coil_study import STUDY, coil_table


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    coil_table(tmp_path / "second.csv", 0.2, seed=2)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


@pytest.fixture
def coil_folder(tmp_path: Path) -> Path:
    """Return a folder with a study of the coil in which everything is right."""
    shutil.copy(COIL, tmp_path / "Coil.fmu")
    (tmp_path / "study.toml").write_text(SOUND)
    time = np.arange(50) * 1e-3
    table(tmp_path, pd.DataFrame({"time": time, "u": np.ones(50), "i": 0.25 * (1 - np.exp(-40 * time))}))
    return tmp_path
