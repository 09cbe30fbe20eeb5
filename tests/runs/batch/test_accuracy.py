"""Cases whose simulation is checked: what is known from other cases changes nothing but the time that it takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.runs.batch.summary import summarize
from fmuid.studies.study import Study
from tests.support.drawn_batches import summary_words
from tests.support.paths import ROOT
from tests.support.stepping import LAG, stepping_fmu

COIL = ROOT / "experiments" / "coil" / "healthy.toml"


def coil(batch: dict[str, Any], *overrides: str) -> CaseRunner:
    data = dict(Study.read(COIL, overrides).data)
    return CaseRunner(Study.of(data | {"batch": batch}, COIL))


def frame_of(runner: CaseRunner, order: list[int]) -> pd.DataFrame:
    frame = pd.DataFrame([runner(k).row for k in order]).astype(runner.columns)
    return frame.sort_values("case", ignore_index=True)


def same(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether all but the volatile columns are the same bit for bit."""
    return one.drop(columns=list(VOLATILE)).equals(other.drop(columns=list(VOLATILE)))


def test_what_is_known_is_not_simulated_again() -> None:
    batch = {"monte_carlo": {"realizations": 12, "std": 0.035, "true_values": {"R": 4.0, "L": 0.1}}}
    runner = coil(batch)
    found = frame_of(runner, [*range(12)])
    without = frame_of(coil(batch, 'estimation.solver_check="off"'), [*range(12)])
    assert (found["accuracy"] == "passed").all()
    assert found["shift"].max() < 1e-6
    assert found["checked"].sum() == 0  # none by simulations of its own
    for name in ("value.R", "std.L", "cost", "simulations"):
        assert found[name].equals(without[name])
    assert same(found, frame_of(coil(batch), [7, 3, *range(8, 12), 0, 1, 2, 4, 5, 6]))
    assert (without["accuracy"] == "").all()
    summary = summarize(found)
    assert summary.accuracy == {"passed": 12, "checked": int(found["checked"].sum()), "finer": 0}
    assert any("in 12 cases" in sentence for sentence in summary_words(summary))
    assert summarize(without).accuracy == {}


def test_starts_that_fail_or_alias() -> None:
    starts = [{"R": 3.0, "L": 0.2}, {"R": 20.0, "L": 0.01}, {"R": 50.0, "L": 5e-3}]
    found = frame_of(coil({"starting_points": starts}), [2, 1, 0])
    assert found["value.L"].to_numpy() == pytest.approx(np.full(3, 0.1007), abs=1e-4)
    assert found["finer"].tolist() == [0, 1, 1]
    assert (found["accuracy"] == "passed").all()


def test_a_simulation_that_is_wrong_for_all(tmp_path: Path) -> None:
    """Explicit Euler: every case is searched by model exchange, whichever came first."""
    step, truth = 0.05, 2.0
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    x, decay = np.zeros(u.size), np.exp(-truth * step)
    for i in range(u.size - 1):
        x[i + 1] = decay * x[i] + (1.0 - decay) / truth * u[i]
    for k in range(3):
        noisy = x + 0.004 * rng.standard_normal(x.size)
        pd.DataFrame({"time": step * np.arange(x.size), "u": u, "x": noisy}).to_csv(tmp_path / f"run{k}.csv")
    data = {
        "model": {"fmu": str(stepping_fmu(tmp_path, LAG, exchange=True))},
        "experiments": [{"data": "run0.csv", "inputs": ["u"], "outputs": ["x"], "interpolation": "zoh"}],
        "parameters": {"k": {"start": 0.05, "min": 0.01}},
        "batch": {"data": "run*.csv"},
    }
    study = Study.of(data, tmp_path / "study.toml")
    found = frame_of(CaseRunner(study), [0, 1, 2])
    assert (found["finer"] == 1).all()
    assert (np.abs(found["value.k"] - truth) < 4.0 * found["std.k"]).all()
    assert same(found, frame_of(CaseRunner(study), [2, 0, 1]))
    assert any("refined in 3 cases" in sentence for sentence in summary_words(summarize(found)))
