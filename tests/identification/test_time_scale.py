"""Times that are taken for another unit: a record against the time constants of its model."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, Simulator
from fmuid.apps.cli.options import DONE
from fmuid.identification import TimeScaleMismatch, doubt_of_time
from tests.support.coil_study import COIL, coil_table, fmuid_

R, L = 4.0, 0.1


def doubt(step: float, count: int) -> tuple[TimeScaleMismatch, float] | None:
    """Return what is found of a coil's record of steps, and the time constant."""
    t = step * np.arange(count)
    u = np.where(np.arange(count) % 100 < 50, 10.0, 0.0)
    frame = pd.DataFrame({"time": t, "u": u, "i": np.where(u > 0, 2.5, 0.1)})
    simulator = Simulator(COIL, Experiment(frame, ["u"], ["i"], interpolation="zoh"), ["R", "L"])
    found = doubt_of_time(simulator, [R, L])
    return None if found is None else (found.kind, found.time_constant)


def test_records_in_the_model_s_time_scale_and_in_a_wrong_unit() -> None:
    for step, count in ((1e-3, 400), (1e-3, 60_000), (0.1, 200), (2e-4, 400)):
        assert doubt(step, count) is None, step
    for step, kind in ((1.0, TimeScaleMismatch.TOO_LONG), (1e-6, TimeScaleMismatch.TOO_SHORT)):
        found = doubt(step, 400)
        assert found is not None
        assert found[0] is kind
        assert found[1] == pytest.approx(L / R, rel=0.1)


@pytest.mark.slow
def test_it_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coil_table(tmp_path / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(tmp_path / "run.csv").iloc[:200]
    frame.assign(time=1000.0 * frame["time"]).to_csv(tmp_path / "run.csv", index=False)
    study = tmp_path / "study.toml"
    assert fmuid_("init", COIL, tmp_path / "run.csv", "--output", study) == DONE
    assert "time unit" in capsys.readouterr().out
    assert fmuid_("simulate", study) == DONE
    assert "time unit" in capsys.readouterr().err
