"""Cases in groups over workers, of which some end, and in processes of their own."""

import logging
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from distributed import KilledWorker

from fmuid import FmuidError, Study
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.case import CaseRunner
from fmuid.runs.batch.study_package import StudyPackage
from fmuid.runs.batch.worker import GroupResult, IsolatedCases, run_group
from tests.support.coil_batches import DRAWS, Here, run
from tests.support.coil_cases import bits
from tests.support.misbehaving import Mode, Where, misbehaving_fmu

pytestmark = pytest.mark.usefixtures("blank_figures")


def test_the_inside_of_dask_is_quiet() -> None:
    """Also by loggers that have levels of their own."""
    names = ("distributed", "distributed.client", "distributed.core", "tornado.application")
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    with cluster._quiet():
        assert not any(logger.isEnabledFor(logging.CRITICAL) for logger in loggers)
    assert [logger.level for logger in loggers] == before


def test_a_case_that_ends_its_workers_is_given_up(folder: Path, here: Any) -> None:
    class Deadly(Here):
        def run(self, parcel: StudyPackage, cases: Any, record_of: Any) -> cluster.Results:
            yield GroupResult(given_up=(7,))
            yield from super().run(parcel, cases[cases != 7], record_of)

    here(kind=Deadly)
    frame = run(folder).frame
    assert (frame["status"] == "failed").tolist() == [case == 7 for case in range(DRAWS)]
    assert "worker process ended repeatedly" in frame["message"][7]
    assert np.isnan(frame["value.R"][7])
    assert frame["draw"][7] == 7


class Dying:
    """Stands for a client whose workers die of one case, be it alone or in a group."""

    status, dashboard_link = "running", None

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"total_threads": 1}

    def submit(self, function: Any, *arguments: Any, **_: bool) -> Any:
        class Ended:
            def exception(self) -> Exception | None:
                if function is run_group and 5 in arguments[1]:
                    return KilledWorker("group", None, 3)  # type: ignore[arg-type]
                return None

            def result(self) -> GroupResult:
                return GroupResult([{"case": case} for case in arguments[1]], {}, 0.01)

            def add_done_callback(self, put: Any) -> None:
                put(self)

        return Ended()


def test_a_group_whose_workers_die_is_taken_apart() -> None:
    crew: Any = cluster.WorkerPool(Dying(), "tcp://here:1", None)
    found = [each for each in crew.run(None, np.arange(12), lambda _: {}) if each is not None]
    assert sorted(row["case"] for each in found for row in each.rows) == [case for case in range(12) if case != 5]
    assert [each.given_up for each in found if each.given_up] == [(5,)]


def test_workers_have_a_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with cluster._scratch_folder() as folder:
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o777 == 0o700
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(FmuidError, match=r"missing: no folder for workers: No such file.*TMPDIR"):
        cluster._scratch_folder().__enter__()


needs_fork = pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork")


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


@needs_fork
def test_cases_that_spoil_the_connection_cost_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.processes.limits.STOPPED_SECONDS", 0.2)
    modes: list[int] = [Mode.SOUND, Mode.FORGE, Mode.STOP_PARENT, Mode.SOUND]
    found = IsolatedCases(study_of(tmp_path, modes)).run(range(4))
    assert [outcome.row["status"] == "failed" for outcome in found] == [False, True, False, False]
    assert "corrupted the connection" in str(found[1].row["message"])
    assert len({found[i].row["value.gain"] for i in (0, 2, 3)}) == 1


@needs_fork
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
