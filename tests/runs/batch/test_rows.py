"""Rows of cases: estimates, noise, values held, solver checks; cases that fail, studies that are refused."""

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

from fmuid import Experiment, InputError, Marquardt, Problem, Study, read_data
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import identify
from fmuid.runs import CaseList
from fmuid.runs.batch import case as case_run
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from fmuid.runs.batch.case_list import truth_of
from fmuid.runs.batch.case_problem import problem_of
from fmuid.runs.batch.summary import summarize
from tests.support.coil_cases import COIL, STD, TIMES, L, R, bits, current, study_of
from tests.support.compiled import ProbeMaker
from tests.support.drawn_batches import summary_words
from tests.support.paths import ROOT
from tests.support.stepping import LAG, stepping_fmu

# --- what becomes of them


def monte_carlo(case_folder: Path, draws: int, **more: Any) -> CaseRunner:
    return CaseRunner(
        study_of(
            case_folder,
            {"monte_carlo": {"realizations": draws, "std": {"i": STD}, "true_values": {"R": R, "L": L}}, **more},
            noise={"delay_std": 0.0},
        )
    )


@pytest.mark.slow
def test_estimates_of_a_monte_carlo_scatter_as_the_closed_form(case_folder: Path) -> None:
    draws, h = 100, 1e-6
    runner = monte_carlo(case_folder, draws)
    frame = pd.DataFrame([runner(k).row for k in range(draws)])
    assert (frame["status"] == "converged").all()
    by_r, by_l = current(R + h, L) - current(R - h, L), current(R, L + h) - current(R, L - h)
    jacobian = np.stack([by_r, by_l]).T / (2 * h)
    covariance = STD**2 * np.linalg.inv(jacobian.T @ jacobian)
    for name, truth, std in zip("RL", (R, L), np.sqrt(np.diag(covariance)).tolist(), strict=True):
        values = frame[f"value.{name}"]
        assert abs(values.mean() - truth) < 4 * std / math.sqrt(draws)
        assert values.std() == pytest.approx(std, rel=4 / math.sqrt(2 * draws))
        assert frame[f"std.{name}"].median() == pytest.approx(std, rel=0.02)  # wider where slow noise is suspected
    assert frame["noise.i"].mean() == pytest.approx(STD**2, rel=0.05)
    one = {"monte_carlo": {"realizations": 1, "std": STD, "true_values": {"R": R}}}
    assert truth_of(study_of(case_folder, one)) == {"R": R, "L": 0.2}


def test_records_are_identified_as_studies_of_their_own(case_folder: Path) -> None:
    runner = CaseRunner(study_of(case_folder, {"data": "records/*.csv"}))
    for k, name in enumerate(("run1", "run10", "run2")):
        row = runner(k).row
        alone = study_of(case_folder, None)
        table = Experiment(read_data(case_folder / "records" / f"{name}.csv"), ["u"], ["i"], interpolation="zoh")
        result = identify(Problem(alone.system, table, alone.parameters), restart=False)
        assert (row["table"], row["status"], row["message"]) == (name, "converged", "converged")
        assert [row["value.R"], row["value.L"]] == result.values.tolist()
        assert [row["std.R"], row["std.L"]] == result.std.tolist()
        assert (row["noise.i"], row["cost"]) == (result.fit.noise_variance["i"], result.fit.cost)
        assert (row["iterations"], row["simulations"]) == (result.history.iterations, result.history.simulations)


def test_noise_is_common_to_what_it_is_compared_over_and_differs_else(case_folder: Path) -> None:
    def measured(batch: dict[str, Any]) -> list[NDArray[np.float64]]:
        noise = {"realizations": 2, "std": STD, "true_values": {"R": R, "L": L}}
        runner = CaseRunner(study_of(case_folder, {"monte_carlo": noise} | batch))
        problems = [runner.problem(case) for case in runner.cases]
        return [problem.measured - current(R, L) for problem in problems]

    plain = measured({})
    assert all(map(np.array_equal, plain * 4, measured({"starting_points": 2, "free_parameters": [["R"], ["R", "L"]]})))
    swept = measured({"sweep": {"i_start": [0.0, 1.0]}})
    rest = np.exp(-R / L * TIMES)  # what an initial current adds
    assert np.array_equal(swept[0], plain[0])
    assert swept[2] - rest == pytest.approx(plain[0], abs=1e-8)
    assert swept[3] - rest == pytest.approx(plain[1], abs=1e-8)
    noises = [*plain, *measured({"seed": 1}), *measured({"data": "records/*.csv"})]
    assert np.std(noises, axis=1) == pytest.approx(STD, rel=0.3)
    correlation = np.corrcoef(noises) - np.eye(len(noises))
    assert np.abs(correlation).max() < 5 / math.sqrt(TIMES.size)
    assert np.array_equal(measured({"data": ["records/run2.csv"]})[1], measured({"data": "records/*.csv"})[5])


EXCHANGE = {"fmu": str(COIL), "interface": "model-exchange"}


def test_rows_are_the_same_bit_for_bit_in_any_order(case_folder: Path) -> None:
    batch = {
        "monte_carlo": {"realizations": 2, "std": STD, "true_values": {"R": R, "L": L}},
        "data": ["records/run1.csv", "records/run2.csv"],
        "free_parameters": [["R"], ["R", "L"]],
    }
    first, second = (CaseRunner(study_of(case_folder, batch, model=EXCHANGE)) for _ in range(2))
    forward = [bits(first(k).row) for k in range(len(first.cases))]
    for k in np.random.default_rng(4).permutation(len(forward)).tolist():
        assert bits(second(k).row) == forward[k]
    assert len({row["value.R"] for row in forward}) == len(forward)


def test_a_stiff_case_does_not_change_the_next(case_folder: Path) -> None:
    alone, after = (CaseRunner(study_of(case_folder, {"sweep": {"L": [1e-8, L]}}, model=EXCHANGE)) for _ in range(2))
    stiff = after.problem(after.cases[0])
    Evaluator(stiff).predict(np.array([[R]]))
    assert stiff.models[""]["run"]["stiff"]
    after(0)
    assert bits(after(1).row) == bits(alone(1).row)


def test_a_global_search_is_the_study_s_own(case_folder: Path) -> None:
    bounds = {"R": {"start": 3.0, "min": 0.5, "max": 8.0}, "L": {"start": 0.2, "min": 1e-3, "max": 1.0}}
    words = {"parameters": bounds, "estimation": {"method": "multi-start", "n_starts": 4}}
    row = CaseRunner(study_of(case_folder, {"starting_points": 1}, **words))(0).row
    assert row["status"] == "converged"
    assert row["value.R"] == pytest.approx(study_of(case_folder, None, **words).identify()["R"], rel=1e-6)
    with pytest.raises(InputError, match="parameter 'L' has no max"):
        CaseList.of(study_of(case_folder, {"starting_points": 1}, estimation={"method": "multi-start"}))


def test_joint_prior_with_a_fixed_parameter(case_folder: Path) -> None:
    mean, covariance = np.array([4.2, 0.11]), np.array([[0.04, 0.003], [0.003, 0.0004]])
    prior = {"names": ["R", "L"], "mean": mean.tolist(), "covariance": covariance.tolist()}
    study = study_of(case_folder, {"sweep": {"L": [0.15]}}, prior=prior)
    parameters = problem_of(study, study.tables, ("R",), {"L": 0.15}, {}).parameters
    thetas = np.array([[3.5], [4.0], [5.0]])
    found = (parameters.prior_residual(thetas) ** 2).sum(axis=1)
    away = np.hstack([thetas, np.full((3, 1), 0.15)]) - mean
    expected = np.einsum("ki,ij,kj->k", away, np.linalg.inv(covariance), away)
    assert np.diff(found) == pytest.approx(np.diff(expected))
    assert CaseRunner(study)(0).row["status"] == "converged"
    alone = study_of(
        case_folder, {"sweep": {"L": [0.15]}}, prior=prior | {"names": ["L"], "mean": [1], "covariance": [[1]]}
    )
    assert len(problem_of(alone, alone.tables, ("R",), {"L": 0.15}, {}).parameters.prior_whitening) == 0


def test_parameters_per_experiment(case_folder: Path) -> None:
    tables = [{"data": f"records/run{k}.csv", "inputs": ["u"], "outputs": ["i"]} for k in (1, 2)]
    parameters = {"R": {"start": 3.0, "min": 0.5, "per_experiment": True}, "L": {"start": 0.2, "min": 1e-3}}
    noise = {"realizations": 1, "std": 1e-6, "true_values": {"R[run1]": 3.8, "R": 4.4, "L": 0.1}}
    study = study_of(
        case_folder, {"monte_carlo": noise, "starting_points": 1}, experiments=tables, parameters=parameters
    )
    assert truth_of(study) == {"R[run1]": 3.8, "R[run2]": 4.4, "L": 0.1}
    row = CaseRunner(study)(0).row
    assert [row[f"value.{name}"] for name in truth_of(study)] == pytest.approx([3.8, 4.4, 0.1], rel=1e-5)
    assert "start.R" in row
    held = study_of(
        case_folder, {"monte_carlo": noise, "sweep": {"R": [3.8]}}, experiments=tables, parameters=parameters
    )
    assert truth_of(held) == {"R[run1]": 3.8, "R[run2]": 4.4, "L": 0.1}


HEALTHY = ROOT / "experiments" / "coil" / "healthy.toml"


def coil(batch: dict[str, Any], *overrides: str) -> CaseRunner:
    data = dict(Study.read(HEALTHY, overrides).data)
    return CaseRunner(Study.of(data | {"batch": batch}, HEALTHY))


def frame_of(runner: CaseRunner, order: list[int]) -> pd.DataFrame:
    frame = pd.DataFrame([runner(k).row for k in order]).astype(runner.columns)
    return frame.sort_values("case", ignore_index=True)


def same(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether all but the volatile columns are the same bit for bit."""
    return one.drop(columns=list(VOLATILE)).equals(other.drop(columns=list(VOLATILE)))


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
