"""Cases of a batch: what they are, that they depend on nothing but themselves; directed tests of cases."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import qmc

from fmuid import InputError
from fmuid.runs import CaseList
from tests.support.coil_cases import STD, record, study_of
from tests.support.coil_study import STUDY, coil_table, fmuid_

# --- what the cases are


def test_product_in_its_documented_order(case_folder: Path) -> None:
    batch = {
        "monte_carlo": {"realizations": 3, "std": STD},
        "starting_points": [{"R": 2.0}, {"R": 5.0}],
        "free_parameters": [["R"], ["L", "R"]],
        "sweep": {"i_start": [0.0, 0.1, 0.2]},
        "data": "records/*.csv",
    }
    cases = CaseList.of(study_of(case_folder, batch))
    axes = ["run1", "run10", "run2"], [0.0, 0.1, 0.2], ["R", "R L"], [2.0, 5.0], [0, 1, 2]
    expected = list(itertools.product(*axes))
    assert len(cases) == len(expected) == 108
    assert cases.columns == ("table", "start.R", "set.i_start", "free", "draw")
    for i, (table, held, free, start, draw) in enumerate(expected):
        case = cases[i]
        assert case.settings == {"table": table, "start.R": start, "set.i_start": held, "free": free, "draw": draw}
        assert (case.index, case.record, case.draw) == (i, table, draw)
        assert case.table == cases.table_of(i) == case_folder / "records" / f"{table}.csv"
        assert (case.held, case.starts, case.free) == ({"i_start": held}, {"R": start}, tuple(free.split()))
    assert cases[-1] == cases[107]
    with pytest.raises(IndexError):
        cases[108]


def test_list_goes_through_all_axes_together(case_folder: Path) -> None:
    batch = {
        "combine": "zip",
        "data": ["records/run2.csv", "records/*.csv"],
        "starting_points": 3,
        "sweep": {"i_start": {"from": 0.0, "to": 1.0, "count": 3}},
    }
    cases = CaseList.of(study_of(case_folder, batch))
    found = [(case.settings["table"], case.settings["set.i_start"]) for case in cases]
    assert found == [("run2", 0.0), ("run1", 0.5), ("run10", 1.0)]
    assert len({case.settings["start.L"] for case in cases}) == 3


def test_a_product_of_very_many_cases_costs_nothing(case_folder: Path) -> None:
    batch = {
        "sweep": {"i_start": list(range(10000))},
        "monte_carlo": {"realizations": 100_000_000, "std": STD},
        "starting_points": 1000,
    }
    cases = CaseList.of(study_of(case_folder, batch))
    assert len(cases) == 10**15
    case = cases[10**15 - 10**8 - 1]
    assert (case.held["i_start"], case.draw) == (9999, 10**8 - 1)
    assert case.starts == cases[998 * 10**8].starts
    with pytest.raises(InputError, match="10000000000000000 cases are too many"):
        CaseList.of(study_of(case_folder, batch | {"starting_points": 10000}))


def test_drawn_starts_are_those_of_their_seed(case_folder: Path) -> None:
    both = [case.starts for case in CaseList.of(study_of(case_folder, {"starting_points": 40, "seed": 5}))]
    for k, starts in enumerate(both):
        units = np.random.default_rng(np.random.SeedSequence([5, 1, k])).random(2)
        # R between its bounds by orders of magnitude, L, which has but one, half of itself from its start
        expected = {"R": math.exp(math.log(0.5) + units[0] * math.log(16)), "L": 0.1 + 0.2 * units[1]}
        assert starts == pytest.approx(expected, rel=1e-12)
    other = CaseList.of(
        study_of(
            case_folder, {"starting_points": 2, "seed": 5, "free_parameters": [["L"]], "sweep": {"i_start": [1, 2, 3]}}
        )
    )
    assert [case.starts for case in other] == both[:2] * 3
    assert np.isnan([float(case.settings["start.R"]) for case in other]).all()
    known = study_of(
        case_folder, {"starting_points": 400}, prior={"names": ["L"], "mean": [0.1], "covariance": [[1e-4]]}
    )
    drawn = [case.starts["L"] for case in CaseList.of(known)]
    assert 0.07 < min(drawn) < 0.071
    assert 0.129 < max(drawn) < 0.13


@pytest.mark.parametrize(("method", "count"), [("sobol", 64), ("sobol", 50), ("latin-hypercube", 50)])
def test_design_is_that_of_scipy(case_folder: Path, method: str, count: int) -> None:
    sample = {"method": method, "points": count, "ranges": {"L": [0.05, 0.2], "i_start": [-1.0, 1.0]}}
    cases = CaseList.of(study_of(case_folder, {"space_filling": sample, "seed": 3}))
    rng = np.random.default_rng(np.random.SeedSequence([3, 2]))
    engine = qmc.Sobol(2, rng=rng) if method == "sobol" else qmc.LatinHypercube(2, rng=rng)
    units = engine.random(64 if method == "sobol" else count)[:count]
    expected = np.array([0.05, -1.0]) + units * np.array([0.15, 2.0])
    found = np.array([[float(case.settings[f"set.{name}"]) for name in ("L", "i_start")] for case in cases])
    assert found == pytest.approx(expected, rel=1e-12)
    assert ((found >= [0.05, -1.0]) & (found <= [0.2, 1.0])).all()
    assert cases[0].free == ("R",)


def test_records_are_called_as_shortly_as_they_can_be_told_apart(case_folder: Path) -> None:
    def names(*tables: str) -> list[str]:
        settings = study_of(case_folder, {"data": list(tables)}).batch
        assert settings is not None
        return list(settings.records())

    (case_folder / "more").mkdir()
    record(3).to_csv(case_folder / "more" / "run1.csv", index=False)
    assert names("records/*.csv") == ["run1", "run10", "run2"]
    assert names("more/*.csv", "records/*1.csv") == ["more/run1", "records/run1"]
    assert names("**/run1.csv", str(case_folder / "table.csv"))[:2] == ["more/run1", "records/run1"]
    record(3).to_parquet(case_folder / "more" / "run1.parquet")
    assert names("more/run1.*") == ["more/run1.csv", "more/run1.parquet"]
    given = study_of(case_folder, {"data": {"first": "records/run2.csv"}})
    assert [case.settings for case in CaseList.of(given)] == [{"table": "first"}]


SWEEP = "fixed = { L = 0.1 }\n[[experiments]]".join(STUDY.split("[[experiments]]")).partition("L = { start")[0]
BATCH = "[batch]\nsweep = { L = [0.13, 0.1] }\n"


@pytest.mark.parametrize("asked", [False, True])
def test_model_errors_of_cases(tmp_path: Path, here: Any, capsys: pytest.CaptureFixture[str], asked: bool) -> None:
    """Where they are asked for, in a worker of its own: no other quick test has one."""
    words = ["--workers", "1"] if asked else ["--no-isolation"]
    if not asked:
        here()
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    study = tmp_path / "study.toml"
    study.write_text(SWEEP + '[estimation]\nmodel_error = "report"\n' * asked + BATCH)
    fmuid_("batch", study, "--output", tmp_path / "out", "--no-report", *words)
    rows = pd.concat(map(pd.read_parquet, (tmp_path / "out/cases").glob("*.parquet"))).sort_values("set.L")
    assert rows["reasons"].str.contains("model_error").tolist() == [False, asked]
    said = capsys.readouterr().out
    assert ("were not tested in the cases" in said) is not asked
    assert ("50 %" in said) is asked
