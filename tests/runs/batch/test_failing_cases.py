"""Cases that fail, studies that are refused."""

import itertools
import logging
import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fmuid import InputError, Marquardt
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.runs import CaseList
from fmuid.runs.batch import case as case_run
from fmuid.runs.batch.case import CaseRunner
from tests.support.coil_cases import bits, study_of
from tests.support.compiled import ProbeMaker

# --- failures


def test_failing_simulations_are_rows_and_are_counted(case_folder: Path, probe: ProbeMaker) -> None:
    times = np.arange(20.0)
    x = 2.0 * times + 0.01 * np.random.default_rng(0).standard_normal(20)
    frame = pd.DataFrame({"time": times, "u": 1.0, "x": x})
    frame.to_csv(case_folder / "table.csv", index=False)
    study = study_of(
        case_folder,
        {"sweep": {"fail_init": [0.0, 1.0]}},
        model={"fmu": str(probe())},
        experiments=[{"data": "table.csv", "inputs": ["u"], "outputs": ["x"]}],
        parameters={"gain": {"start": 1.0}},
    )
    runner = CaseRunner(study)
    good, bad = runner(0).row, runner(1).row
    assert (good["status"], good["rejected"]) == ("converged", 0)
    assert good["value.gain"] == pytest.approx(2.0, rel=1e-3)
    assert bad["status"] == "failed"
    assert 'the FMU says: "nothing: cannot initialise with 1"' in str(bad["message"])
    assert math.isnan(bad["value.gain"])  # type: ignore[arg-type]
    assert bad["rejected"] == bad["simulations"] != 0
    assert bits(runner(0).row) == bits(good)


@pytest.mark.parametrize("error", [MemoryError(), ZeroDivisionError("float division"), np.linalg.LinAlgError("bad")])
def test_what_the_arithmetic_raises_is_a_row(
    case_folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(Marquardt, "search", fail)
    row = CaseRunner(study_of(case_folder, {"starting_points": 1}))(0).row
    assert row["status"] == "failed"
    assert row["message"] == (f"{type(error).__name__}: {error}" if str(error) else "MemoryError")


def test_interruptions_and_bugs_pass(case_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner, predict, calls = (
        CaseRunner(study_of(case_folder, {"starting_points": 1})),
        Evaluator._rows,
        itertools.count(),
    )

    def interrupted(self: Evaluator[LeastSquares], thetas: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        if next(calls) == 5:  # when the optimizer is under way, which ends with a result
            raise KeyboardInterrupt
        return predict(self, thetas)

    for owner, name, function, error in (
        (Evaluator, "_rows", interrupted, KeyboardInterrupt),
        (case_run, "problem_of", lambda *_: None, AttributeError),
    ):
        with monkeypatch.context() as patch, pytest.raises(error):
            patch.setattr(owner, name, function)
            runner(0)
    assert runner(0).row["status"] == "converged"


def test_the_log_has_the_warnings_of_its_own_thread(case_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, runner = logging.getLogger("fmuid.fmu"), CaseRunner(study_of(case_folder, {"starting_points": 1}))
    handlers, search = list(logging.getLogger("fmuid").handlers), Marquardt.search

    def warn(settings: Marquardt, problem: Any, *more: Any) -> Any:
        log.warning("the coil %s", "hums")
        log.info("nothing")
        other = threading.Thread(target=log.warning, args=("another case",))
        other.start()
        other.join()
        return search(settings, problem, *more)

    with monkeypatch.context() as patch:
        patch.setattr(Marquardt, "search", warn)
        assert runner(0).log == "the coil hums"
    assert runner(0).log == ""
    assert logging.getLogger("fmuid").handlers == handlers


# --- refusals

RANGES = {"ranges": {"L": [0.1, 0.2]}}
NOISE = {"realizations": 2, "std": 0.1}
WRONG: list[tuple[dict[str, Any], str]] = [
    ({}, r"batch: nothing varies between cases. Set data"),
    ({"stats": 3}, r"unknown key 'stats' \(did you mean 'starting_points'"),
    ({"combine": "zipp", "starting_points": 2}, r'combine: must be "product" or "zip" \(did you mean'),
    ({"starting_points": 2, "seed": -1}, r"batch.seed: must be a whole number, 0 or above, not -1"),
    (
        {"starting_points": 0},
        r"starting_points: must be a whole number above 0 or a list of starting points, .*, not 0",
    ),
    ({"starting_points": [{"R": "x"}]}, r"starting_points\[0\].R: must be a number"),
    ({"starting_points": [{"Q": 1.0}]}, "starting_points: unknown parameter 'Q'"),
    ({"starting_points": [{"R": 9.0}]}, r"starting_points\[0\].R: start 9 is outside \[0.5, 8\]"),
    ({"data": 3}, 'data: must be a pattern of files, "records/\\*.csv"'),
    ({"data": "nothing/*.csv"}, r'batch.data: "nothing/\*.csv" matches no file in '),
    ({"data": ["records/run9.csv"]}, r"data: file .*run9.csv of 'run9' not found"),
    ({"free_parameters": [["R", "L"], ["L", "R"]]}, "free_parameters: must be a list of different lists"),
    ({"free_parameters": [["R", "l"]]}, r"free_parameters: unknown parameter 'l' \(did you mean 'L'"),
    ({"free_parameters": [["R"]], "sweep": {"R": [1.0]}}, "free_parameters: 'R' is also in sweep"),
    ({"starting_points": [{"R": 2.0}], "sweep": {"R": [1.0]}}, "starting_points: 'R' is also in sweep"),
    ({"sweep": {"R": [1.0], "L": [1.0]}}, "no parameter is free"),
    ({"sweep": {"R": []}}, r"batch.sweep.R: must be a list of finite values of one type"),
    ({"sweep": {"i_start": [1.0, True]}}, "a list of finite values of one type"),
    ({"sweep": {"i_start": [0.1, math.inf]}}, "a list of finite values"),
    ({"sweep": {"i_start": {"from": 1.0, "to": 2.0}}}, "missing key 'count': number of values"),
    ({"sweep": {"i_start": {"from": 1.0, "to": 1.0, "count": 3}}}, "of at least two different values"),
    ({"sweep": {"R": ["big"]}}, r'sweep.R: a parameter takes numbers, not "big"'),
    ({"sweep": {"i_stat": [1.0]}}, r"batch: Coil.fmu: no variable 'i_stat' \(did you mean"),
    ({"sweep": {"i_start": ["big"]}}, "'i_start' is of type Real and cannot have the value 'big'"),
    ({"sweep": {"u": [1.0]}}, "'u' is an input of .*table.csv and has a value"),
    ({"space_filling": {**RANGES}}, r"batch.space_filling: missing key 'points': number"),
    ({"space_filling": {"points": 3}}, r"batch.space_filling: missing key 'ranges': variables"),
    ({"space_filling": {"points": 10**8, **RANGES}}, "points: must be a whole number up to 16777216"),
    ({"space_filling": {"points": 3, "ranges": {}}}, "ranges: must be { variable ="),
    (
        {"space_filling": {"points": 3, "ranges": {"L": [0.2, 0.1]}}},
        r"batch.space_filling.ranges.L: must be \[lowest, highest\]",
    ),
    ({"space_filling": {"points": 3, "method": "halton", **RANGES}}, 'method: must be "sobol" or'),
    ({"space_filling": {"points": 3, **RANGES}, "sweep": {"L": [0.1]}}, "'L' is in sweep and in space_filling"),
    ({"monte_carlo": {"std": 0.1}}, r"batch.monte_carlo: missing key 'realizations'"),
    ({"monte_carlo": {"realizations": 2}}, r"unknown noise level of 'i'"),
    ({"monte_carlo": {"realizations": 2, "std": {"j": 0.1}}}, "std: unknown output 'j'"),
    ({"monte_carlo": {"realizations": 2, "std": 0}}, "std: must be a number above 0"),
    ({"monte_carlo": {**NOISE, "true_values": {"Q": 1.0}}}, "Coil.fmu: no variable 'Q'"),
    ({"monte_carlo": {**NOISE, "true_values": {"R": math.inf}}}, "finite number"),
    ({"combine": "zip", "starting_points": 2, "sweep": {"i_start": [1.0]}}, "1 of sweep.i_start, 2 of starting_"),
]


@pytest.mark.parametrize(("batch", "sentence"), WRONG)
def test_refusals_are_one_sentence(case_folder: Path, batch: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        CaseList.of(study_of(case_folder, batch))
    assert str(case_folder / "study.toml") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refusals_of_the_whole_study(case_folder: Path) -> None:
    with pytest.raises(InputError, match=r"no \[batch\]"):
        CaseList.of(study_of(case_folder, None))
    with pytest.raises(InputError, match="no free parameter"):
        CaseList.of(study_of(case_folder, {"starting_points": 2}, parameters={}))
    twice = [{"data": f"records/run{k}.csv", "inputs": ["u"], "outputs": ["i"]} for k in (1, 2)]
    with pytest.raises(InputError, match=r"the study has 2 experiments"):
        CaseList.of(study_of(case_folder, {"data": "records/*.csv"}, experiments=twice))
    with pytest.raises(InputError, match="no parameter 'Q'"):
        CaseList.of(study_of(case_folder, {"starting_points": 2}, parameters={"Q": {"start": 1.0}}))
