"""Cases in a process of their own: several to an order, each with what it printed and its own end."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid.runs.batch.case import CaseRunner
from fmuid.studies.study import Study
from tests.support.coil_cases import bits
from tests.support.misbehaving import Mode, Where, misbehaving_fmu

if sys.platform == "win32":
    pytest.skip("processes of their own need fork", allow_module_level=True)

from fmuid.runs.batch.worker import IsolatedCases


def study_of(folder: Path, modes: list[int], **other: Any) -> Study:
    times = 0.1 * np.arange(20.0)
    rng = np.random.default_rng(5)
    pd.DataFrame({"time": times, "u": 1.0, "x": 1.0 - np.exp(-times) + 0.01 * rng.normal(size=20)}).to_csv(
        folder / "table.csv", index=False
    )
    data: dict[str, Any] = {
        "model": {"fmu": str(misbehaving_fmu(folder))},
        "experiments": [{"data": "table.csv", "inputs": ["u"], "outputs": ["x"]}],
        "parameters": {"gain": {"start": 1.2, "min": 0.5, "max": 2.0}},
        "estimation": {"solver_check": "off"},  # which only the first of like cases would simulate, and print, more for
        "batch": {"sweep": {"mode": [float(mode) for mode in modes]}},
    }
    data |= other
    return Study.of(data, folder / "study.toml")


@pytest.mark.slow
def test_what_several_cases_of_an_order_print_is_told_apart(tmp_path: Path) -> None:
    study = study_of(tmp_path, [Mode.SOUND, Mode.SOUND, Mode.SPEAK, Mode.SOUND, Mode.SPEAK])
    found = IsolatedCases(study).run(range(5))
    assert [bool(outcome.log) for outcome in found] == [False, False, True, False, True]
    assert found[4].log
    assert found[2].log.startswith(found[4].log)
    plain = CaseRunner(study)
    for k in (0, 1, 3):
        assert found[k].row["value.gain"] == plain(k).row["value.gain"]


def test_a_case_that_ends_the_process_costs_no_other_of_its_order(tmp_path: Path) -> None:
    found = IsolatedCases(study_of(tmp_path, [Mode.SOUND, Mode.SPEAK, Mode.SEGFAULT, Mode.SOUND])).run(range(4))
    assert [outcome.row["status"] == "failed" for outcome in found] == [False, False, True, False]
    assert "SIGSEGV" in str(found[2].row["message"])
    assert found[1].log
    assert not found[3].log
    assert found[3].row["value.gain"] == found[0].row["value.gain"]


def test_cases_that_spoil_the_connection_cost_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    modes: list[int] = [Mode.SOUND, Mode.FORGE, Mode.STOP_PARENT, Mode.SOUND]
    found = IsolatedCases(study_of(tmp_path, modes)).run(range(4))
    assert [outcome.row["status"] == "failed" for outcome in found] == [False, True, False, False]
    assert "corrupted the connection" in str(found[1].row["message"])
    assert len({found[i].row["value.gain"] for i in (0, 2, 3)}) == 1


@pytest.mark.slow
def test_a_first_draw_that_ends_the_process_costs_the_others_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A case asks nothing of another one, whoever runs it."""
    fmu = str(misbehaving_fmu(tmp_path))
    batch = {"monte_carlo": {"realizations": 10, "std": 0.01, "true_values": {"gain": 1.0, "mode": 0.0}}}

    def draws(mode: Mode, low: float = 5.0, high: float = 6.0) -> Study:
        values = {"mode": float(mode), "where": float(Where.STEP), "bad_from": low, "bad_to": high}
        return study_of(tmp_path, [], model={"fmu": fmu, "fixed": values}, batch=batch)

    gain = float(str(CaseRunner(draws(Mode.SOUND))(0).row["value.gain"]))
    cases = IsolatedCases(draws(Mode.SEGFAULT, gain - 1e-4, gain + 1e-4))
    plain = CaseRunner(draws(Mode.RETURN_ERROR, gain - 1e-4, gain + 1e-4))
    begun: list[Any] = []
    begin = cases._begin

    def counted(host: Any) -> None:
        begun.append(host)
        begin(host)

    monkeypatch.setattr(cases, "_begin", counted)
    found = [cases.run([k])[0] for k in (1, 2, 3)]
    assert len(begun) == 1
    assert [bits(outcome.row) for outcome in found] == [bits(plain(k).row) for k in (1, 2, 3)]
    assert {outcome.row["status"] for outcome in found} == {"converged"}
