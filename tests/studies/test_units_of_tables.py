"""A study whose table is in other units, times and dialects finds the same parameters."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.errors import InputError
from fmuid.studies import Study
from tests.support.paths import FMUS, ROOT

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "table.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
{more}
[parameters]
R = {{ start = 3.0, min = 0.0 }}
L = {{ start = 0.2, min = 1e-4 }}
"""


def study(folder: Path, table: pd.DataFrame, more: str = "", **how: str) -> Study:
    table.to_csv(folder / "table.csv", index=False, **how)  # type: ignore[call-overload]
    (folder / "study.toml").write_text(STUDY.format(fmu=(FMUS / "Coil" / "Coil.fmu").as_posix(), more=more))
    return Study.read(folder / "study.toml")


@pytest.fixture(scope="module")
def measured() -> pd.DataFrame:
    return pd.read_csv(ROOT / "experiments" / "coil" / "healthy.csv").iloc[:400]


def test_the_same_estimates_from_other_units(tmp_path: Path, measured: pd.DataFrame) -> None:
    right = study(tmp_path, measured).identify()
    t, u, i = (measured[name] for name in ("time", "u", "i"))
    milli = pd.DataFrame({"Time (ms)": 1000 * t, "u (mV)": 1000 * u, "i [kA]": i / 1000})
    clock = pd.DataFrame({"zeit": t / 60, "u": u, "i": 1000 * i})
    bare = pd.DataFrame({"u": u, "i": i})
    steps = np.diff(t)
    assert np.ptp(steps) < 1e-12
    for table, more, how in (
        (milli, "", {"sep": ";", "decimal": ","}),
        (clock, 'time = "zeit"\ntime_unit = "min"\nunits = { i = "mA" }', {}),
        (bare, f"sample_rate = {float(1 / steps[0])!r}", {}),
    ):
        found = study(tmp_path, table, more, **how).identify()
        np.testing.assert_allclose(found.values, right.values, rtol=1e-6)


def test_a_unit_that_does_not_fit_is_refused(tmp_path: Path, measured: pd.DataFrame) -> None:
    with pytest.raises(InputError, match=r"i: column unit 'rpm' does not convert to 'A'"):
        study(tmp_path, measured.rename(columns={"i": "i (rpm)"})).problem()
