"""Cases of a batch: what they are, that they depend on nothing but themselves, and what their rows say."""

from __future__ import annotations

import itertools
import logging
import math
import pickle
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.stats import qmc

from fmuid.batches import run_case as case_run
from fmuid.batches.case_problem import problem_of
from fmuid.batches.cases import Cases, truth_of
from fmuid.batches.run_case import VOLATILE, CaseRunner, directions_of
from fmuid.data.experiment import Experiment
from fmuid.data.noise import Noise
from fmuid.data.parameters import Parameter
from fmuid.errors import InputError
from fmuid.estimation import Marquardt
from fmuid.estimation.identification import identify
from fmuid.estimation.least_squares import LeastSquares
from fmuid.model_problem import Problem
from fmuid.simulation.simulator import Simulator
from fmuid.studies.study import Study
from tests.support.paths import FMUS
from tests.support.probe_fmu import ProbeMaker

COIL = FMUS / "Coil" / "Coil.fmu"
TIMES = np.arange(120) * 2e-3
VOLTAGE, STD = 10.0, 0.02
R, L = 4.0, 0.1


def current(r: float, inductance: float) -> NDArray[np.float64]:
    """Return the current after a step of the voltage, in closed form."""
    return np.asarray(VOLTAGE / r * (1.0 - np.exp(-r / inductance * TIMES)))


def record(seed: int, r: float = R) -> pd.DataFrame:
    noise = STD * np.random.default_rng(seed).standard_normal(TIMES.size)
    return pd.DataFrame({"time": TIMES, "u": VOLTAGE, "i": current(r, L) + noise})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the study's own table and three records."""
    record(0).to_csv(tmp_path / "table.csv", index=False)
    (tmp_path / "records").mkdir()
    for k in (1, 2, 10):
        record(k, R + 0.1 * k).to_csv(tmp_path / "records" / f"run{k}.csv", index=False)
    return tmp_path


def study_of(folder: Path, batch: Mapping[str, Any] | None, **tables: Any) -> Study:
    data: dict[str, Any] = {
        "model": {"fmu": str(COIL)},
        "experiments": [{"table": "table.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "hold"}],
        "parameters": {"R": {"start": 3.0, "min": 0.5, "max": 8.0}, "L": {"start": 0.2, "min": 1e-3}},
    }
    return Study.of(data | tables | ({} if batch is None else {"batch": batch}), folder / "study.toml")


def bits(row: Mapping[str, object]) -> dict[str, object]:
    """Return a row without its volatile columns, such that equal ones are the same bit for bit."""
    return {k: v.hex() if isinstance(v, float) else v for k, v in row.items() if k not in VOLATILE}


# --- what the cases are


def test_product_in_its_documented_order(folder: Path) -> None:
    batch = {
        "noise": {"draws": 3, "std": STD},
        "starts": [{"R": 2.0}, {"R": 5.0}],
        "subsets": [["R"], ["L", "R"]],
        "values": {"i_start": [0.0, 0.1, 0.2]},
        "tables": "records/*.csv",
    }
    cases = Cases.of(study_of(folder, batch))
    axes = ["run1", "run10", "run2"], [0.0, 0.1, 0.2], ["R", "R L"], [2.0, 5.0], [0, 1, 2]
    expected = list(itertools.product(*axes))
    assert len(cases) == len(expected) == 108
    assert cases.columns == ("table", "start.R", "set.i_start", "free", "draw")
    for i, (table, held, free, start, draw) in enumerate(expected):
        case = cases[i]
        assert case.settings == {"table": table, "start.R": start, "set.i_start": held, "free": free, "draw": draw}
        assert (case.index, case.record, case.draw) == (i, table, draw)
        assert case.table == cases.table_of(i) == folder / "records" / f"{table}.csv"
        assert (case.held, case.starts, case.free) == ({"i_start": held}, {"R": start}, tuple(free.split()))
    assert cases[-1] == cases[107]
    with pytest.raises(IndexError):
        cases[108]


def test_list_goes_through_all_axes_together(folder: Path) -> None:
    batch = {
        "combine": "list",
        "tables": ["records/run2.csv", "records/*.csv"],
        "starts": 3,
        "values": {"i_start": {"from": 0.0, "to": 1.0, "count": 3}},
    }
    cases = Cases.of(study_of(folder, batch))
    found = [(case.settings["table"], case.settings["set.i_start"]) for case in cases]
    assert found == [("run2", 0.0), ("run1", 0.5), ("run10", 1.0)]
    assert len({case.settings["start.L"] for case in cases}) == 3


def test_a_product_of_very_many_cases_costs_nothing(folder: Path) -> None:
    batch = {"values": {"i_start": list(range(10000))}, "noise": {"draws": 100_000_000, "std": STD}, "starts": 1000}
    cases = Cases.of(study_of(folder, batch))
    assert len(cases) == 10**15
    case = cases[10**15 - 10**8 - 1]
    assert (case.held["i_start"], case.draw) == (9999, 10**8 - 1)
    assert case.starts == cases[998 * 10**8].starts
    with pytest.raises(InputError, match="spans 10000000000000000 cases, more than can be run"):
        Cases.of(study_of(folder, batch | {"starts": 10000}))


def test_drawn_starts_are_those_of_their_seed(folder: Path) -> None:
    both = [case.starts for case in Cases.of(study_of(folder, {"starts": 40, "seed": 5}))]
    for k, starts in enumerate(both):
        units = np.random.default_rng(np.random.SeedSequence([5, 1, k])).random(2)
        # R between its bounds by orders of magnitude, L, which has but one, half of itself from its start
        expected = {"R": math.exp(math.log(0.5) + units[0] * math.log(16)), "L": 0.1 + 0.2 * units[1]}
        assert starts == pytest.approx(expected, rel=1e-12)
    other = Cases.of(study_of(folder, {"starts": 2, "seed": 5, "subsets": [["L"]], "values": {"i_start": [1, 2, 3]}}))
    assert [case.starts for case in other] == both[:2] * 3
    assert np.isnan([float(case.settings["start.R"]) for case in other]).all()
    known = study_of(folder, {"starts": 400}, prior={"names": ["L"], "mean": [0.1], "covariance": [[1e-4]]})
    drawn = [case.starts["L"] for case in Cases.of(known)]
    assert 0.07 < min(drawn) < 0.071
    assert 0.129 < max(drawn) < 0.13


@pytest.mark.parametrize(("method", "count"), [("sobol", 64), ("sobol", 50), ("latin-hypercube", 50)])
def test_design_is_that_of_scipy(folder: Path, method: str, count: int) -> None:
    sample = {"method": method, "count": count, "ranges": {"L": [0.05, 0.2], "i_start": [-1.0, 1.0]}}
    cases = Cases.of(study_of(folder, {"sample": sample, "seed": 3}))
    rng = np.random.default_rng(np.random.SeedSequence([3, 2]))
    engine = qmc.Sobol(2, rng=rng) if method == "sobol" else qmc.LatinHypercube(2, rng=rng)
    units = engine.random(64 if method == "sobol" else count)[:count]
    expected = np.array([0.05, -1.0]) + units * np.array([0.15, 2.0])
    found = np.array([[float(case.settings[f"set.{name}"]) for name in ("L", "i_start")] for case in cases])
    assert found == pytest.approx(expected, rel=1e-12)
    assert ((found >= [0.05, -1.0]) & (found <= [0.2, 1.0])).all()
    assert cases[0].free == ("R",)


def test_records_are_called_as_shortly_as_they_can_be_told_apart(folder: Path) -> None:
    def names(*tables: str) -> list[str]:
        settings = study_of(folder, {"tables": list(tables)}).batch
        assert settings is not None
        return list(settings.records())

    (folder / "more").mkdir()
    record(3).to_csv(folder / "more" / "run1.csv", index=False)
    assert names("records/*.csv") == ["run1", "run10", "run2"]
    assert names("more/*.csv", "records/*1.csv") == ["more/run1", "records/run1"]
    assert names("**/run1.csv", str(folder / "table.csv"))[:2] == ["more/run1", "records/run1"]
    record(3).to_parquet(folder / "more" / "run1.parquet")
    assert names("more/run1.*") == ["more/run1.csv", "more/run1.parquet"]
    given = study_of(folder, {"tables": {"first": "records/run2.csv"}})
    assert [case.settings for case in Cases.of(given)] == [{"table": "first"}]


def test_a_study_is_its_data_and_names_its_files(folder: Path) -> None:
    path = folder / "study.toml"
    path.write_text(
        f'title = "Coils"\n[model]\nfmu = "{COIL.as_posix()}"\n[[experiments]]\ntable = "table.csv"\ninputs = ["u"]\n'
        'outputs = ["i"]\n[parameters]\nR = { start = 3.0 }\n[batch]\ntables = "records/*.csv"\n'
        "noise = { draws = 2, std = { i = 0.1 } }\n",
        encoding="utf-8",
    )
    overrides = ["parameters.R.start=2.5", "batch.noise.draws=7", "batch.values.i_start=[0.0, 1.0]"]
    study = Study.read(path, overrides)
    assert Study.of(study.data, path) == study
    assert study.parameters["R"].start == 2.5
    assert len(Cases.of(study)) == 42
    assert study.files() == (COIL, folder / "table.csv", *(folder / "records" / f"run{k}.csv" for k in (1, 10, 2)))
    begun = Study.of(Study.read(path, ["batch.sample.count=4", "batch.sample.ranges.i_start=[0.0, 1.0]"]).data, path)
    assert len(Cases.of(begun)) == 24


# --- what becomes of them


def monte_carlo(folder: Path, draws: int, **more: Any) -> CaseRunner:
    return CaseRunner(
        study_of(folder, {"noise": {"draws": draws, "std": {"i": STD}, "truth": {"R": R, "L": L}}, **more})
    )


@pytest.mark.slow
def test_estimates_of_a_monte_carlo_scatter_as_the_closed_form_says(folder: Path) -> None:
    draws, h = 150, 1e-6
    runner = monte_carlo(folder, draws)
    frame = pd.DataFrame([runner(k).row for k in range(draws)])
    assert (frame["status"] == "converged").all()
    jacobian = np.stack(
        [(current(R + h, L) - current(R - h, L)) / (2 * h), (current(R, L + h) - current(R, L - h)) / (2 * h)]
    ).T
    covariance = STD**2 * np.linalg.inv(jacobian.T @ jacobian)
    for name, truth, std in zip("RL", (R, L), np.sqrt(np.diag(covariance)).tolist(), strict=True):
        values = frame[f"value.{name}"]
        assert abs(values.mean() - truth) < 4 * std / math.sqrt(draws)
        assert values.std() == pytest.approx(std, rel=4 / math.sqrt(2 * draws))
        assert frame[f"std.{name}"].mean() == pytest.approx(std, rel=0.03)  # σ̂ scatters by 6 % a draw
    assert frame["noise.i"].mean() == pytest.approx(STD**2, rel=0.05)
    assert truth_of(study_of(folder, {"noise": {"draws": 1, "std": STD, "truth": {"R": R}}})) == {"R": R, "L": 0.2}


def test_rows_have_the_columns_that_the_runner_names(folder: Path) -> None:
    runner = CaseRunner(study_of(folder, {"tables": ["records/run1.csv", "records/none.csv"], "starts": 1}))
    expected = "case table start.R start.L status message undetermined value.R value.L std.R "
    expected += "std.L noise.i criterion iterations simulations rejected accuracy shift finer"
    assert [*runner.columns] == [*expected.split(), *VOLATILE]
    rows = [runner(k).row for k in range(2)]
    assert [list(row) for row in rows] == [list(runner.columns)] * 2
    frame = pd.DataFrame(rows).astype(runner.columns)
    assert frame["status"].tolist() == ["converged", "failed"]
    assert frame.loc[1, "message"] == f"{folder / 'records/none.csv'}: there is no such file: give a table"
    assert frame[["value.R", "std.L", "noise.i", "criterion"]].isna().to_numpy()[1].all()
    assert [rows[1][name] for name in ("iterations", "simulations", "rejected")] == [0, 0, 0]
    assert (frame["elapsed_s"] > 0).all()


def test_records_are_identified_as_studies_of_their_own(folder: Path) -> None:
    runner = CaseRunner(study_of(folder, {"tables": "records/*.csv"}))
    for k, name in enumerate(("run1", "run10", "run2")):
        row = runner(k).row
        alone = study_of(folder, None)
        table = Experiment.read(folder / "records" / f"{name}.csv", ["u"], ["i"], interpolation="hold")
        result = identify(Problem(alone.system, table, alone.parameters))
        assert (row["table"], row["status"], row["message"]) == (name, "converged", "converged")
        assert [row["value.R"], row["value.L"]] == result.values.tolist()
        assert [row["std.R"], row["std.L"]] == result.std.tolist()
        assert (row["noise.i"], row["criterion"]) == (result.noise_variance["i"], result.criterion)
        assert (row["iterations"], row["simulations"]) == (result.iterations, result.simulations)


def test_values_held_and_subsets_are_those_of_a_study_that_says_so(folder: Path) -> None:
    study = study_of(folder, {"values": {"L": [0.1, 0.12]}, "starts": [{"R": 2.0}, {"R": 5.0}]})
    runner = CaseRunner(study)
    for k, (held, start) in enumerate(itertools.product((0.1, 0.12), (2.0, 5.0))):
        row = runner(k).row
        parameters = {"R": Parameter(start, min=0.5, max=8.0)}
        result = identify(Problem(study.system, study.tables, parameters, values={"L": held}))
        assert (row["value.R"], row["set.L"], row["start.R"]) == (result["R"], held, start)
        assert math.isnan(row["value.L"])  # type: ignore[arg-type]
    runner = CaseRunner(study_of(folder, {"subsets": [["R"], ["R", "L"]]}))
    alone, both = runner(0).row, runner(1).row
    held_at_start = Problem(study.system, study.tables, {"R": study.parameters["R"]}, values={"L": 0.2})
    assert alone["value.R"] == identify(held_at_start)["R"]
    assert math.isnan(alone["std.L"])  # type: ignore[arg-type]
    assert both["value.L"] == identify(study.problem())["L"]


def disturbed(study: Study, truth: dict[str, float], words: list[int]) -> Experiment:
    """Return the study's experiment as simulated at a truth, with the noise of these words of a seed."""
    (table,) = study.tables
    clean = Simulator(study.system, table, tuple(truth))(list(truth.values()))
    noise = np.random.default_rng(np.random.SeedSequence(words)).standard_normal(clean.shape)
    frame = table.frame.assign(i=(clean + STD * noise)[:, 0])
    return Experiment(frame, ["u"], ["i"], interpolation="hold")


def test_truth_takes_the_values_swept_unless_it_has_its_own(folder: Path) -> None:
    for truth in ({"R": R}, {"R": R, "L": 0.1}):
        batch = {"values": {"L": [0.1, 0.13]}, "noise": {"draws": 2, "std": STD, "truth": truth}, "seed": 9}
        study = study_of(folder, batch)
        assert truth_of(study) == truth
        runner = CaseRunner(study)
        for k, (held, draw) in enumerate(itertools.product((0.1, 0.13), (0, 1))):
            experiment = disturbed(study, {"L": held} | truth, [9, 3, draw, 0])
            parameters = {"R": study.parameters["R"]}
            result = identify(Problem(study.system, experiment, parameters, values={"L": held}))
            assert runner(k).row["value.R"] == result["R"]


def test_noise_is_common_to_what_it_is_compared_over_and_differs_else(folder: Path) -> None:
    def measured(batch: dict[str, Any]) -> list[NDArray[np.float64]]:
        noise = {"draws": 2, "std": STD, "truth": {"R": R, "L": L}}
        runner = CaseRunner(study_of(folder, {"noise": noise} | batch))
        problems = [runner.problem(case) for case in runner.cases]
        return [problem.measured - current(R, L) for problem in problems]

    plain = measured({})
    assert all(map(np.array_equal, plain * 4, measured({"starts": 2, "subsets": [["R"], ["R", "L"]]})))
    swept = measured({"values": {"i_start": [0.0, 1.0]}})
    rest = np.exp(-R / L * TIMES)  # what an initial current adds
    assert np.array_equal(swept[0], plain[0])
    assert swept[2] - rest == pytest.approx(plain[0], abs=1e-8)
    assert swept[3] - rest == pytest.approx(plain[1], abs=1e-8)
    noises = [*plain, *measured({"seed": 1}), *measured({"tables": "records/*.csv"})]
    assert np.std(noises, axis=1) == pytest.approx(STD, rel=0.3)
    correlation = np.corrcoef(noises) - np.eye(len(noises))
    assert np.abs(correlation).max() < 5 / math.sqrt(TIMES.size)
    assert np.array_equal(measured({"tables": ["records/run2.csv"]})[1], measured({"tables": "records/*.csv"})[5])


def test_noise_needs_no_measurements_and_leaves_missing_ones_out(folder: Path) -> None:
    record(0)[["time", "u"]].to_csv(folder / "table.csv", index=False)
    row = monte_carlo(folder, 1)(0).row
    assert row["status"] == "converged"
    frame = record(0)
    frame.loc[10:50, "i"] = np.nan
    frame.to_csv(folder / "table.csv", index=False)
    runner = monte_carlo(folder, 1)
    assert runner.problem(runner.cases[0]).measured.size == TIMES.size - 41


def test_no_measurements_are_made_up_to_check_a_model_with(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[Problem] = []

    def watched(*arguments: Any) -> Problem:
        checked.append(problem_of(*arguments))
        return checked[-1]

    monkeypatch.setattr("fmuid.batches.case_problem.problem_of", watched)
    Cases.of(study_of(folder, {"subsets": [["R"], ["R", "L"]]}))
    assert len(checked) == 3
    for problem in checked:
        assert problem.measured.size > len(problem.parameters)
        assert np.isnan(problem.measured).all()


def test_rows_are_the_same_bit_for_bit_in_any_order(folder: Path) -> None:
    batch = {
        "noise": {"draws": 3, "std": STD, "truth": {"R": R, "L": L}},
        "tables": "records/*.csv",
        "subsets": [["R"], ["R", "L"]],
        "starts": 2,
    }
    model = {"fmu": str(COIL), "interface": "model-exchange"}
    first, second = (CaseRunner(study_of(folder, batch, model=model)) for _ in range(2))
    forward = [bits(first(k).row) for k in range(len(first.cases))]
    for k in np.random.default_rng(4).permutation(len(forward)).tolist():
        assert bits(second(k).row) == forward[k]
    assert len({row["value.R"] for row in forward}) == len(forward)


def test_a_stiff_case_does_not_change_the_next(folder: Path) -> None:
    model = {"fmu": str(COIL), "interface": "model-exchange"}
    alone, after = (CaseRunner(study_of(folder, {"values": {"L": [1e-8, L]}}, model=model)) for _ in range(2))
    stiff = after.problem(after.cases[0])
    stiff.predict(np.array([[R]]))
    assert stiff.models[""]["run"]["stiff"]
    after(0)
    assert bits(after(1).row) == bits(alone(1).row)


def test_a_row_says_what_is_not_determined(folder: Path) -> None:
    """A current that is always zero, of a coil without a voltage: nothing is known of R and L."""
    frame = record(0)
    frame["u"], frame["i"] = 0.0, 0.0
    frame.loc[:5, "u"] = 1e-3  # what it drives drowns in the noise
    frame.to_csv(folder / "table.csv", index=False)
    row = monte_carlo(folder, 1)(0).row
    assert (row["status"], row["message"]) == ("not converged", "undetermined")
    found = directions_of(str(row["undetermined"]))
    assert {name for each in found for name in each.names} <= {"R", "L"}
    assert found
    assert CaseRunner(study_of(folder, {"starts": 1, "tables": "records/*.csv"}))(0).row["undetermined"] == ""


def test_a_global_search_is_the_study_s_own(folder: Path) -> None:
    bounds = {"R": {"start": 3.0, "min": 0.5, "max": 8.0}, "L": {"start": 0.2, "min": 1e-3, "max": 1.0}}
    words = {"parameters": bounds, "estimator": {"method": "global", "starts": 4, "search": "multistart"}}
    row = CaseRunner(study_of(folder, {"starts": 1}, **words))(0).row
    assert row["status"] == "converged"
    assert row["value.R"] == pytest.approx(study_of(folder, None, **words).identify()["R"], rel=1e-6)
    with pytest.raises(InputError, match="a global search needs a bounded box, and parameter 'L' has no max"):
        Cases.of(study_of(folder, {"starts": 1}, estimator={"method": "global"}))


def test_what_a_joint_prior_says_where_one_of_its_parameters_is_held(folder: Path) -> None:
    mean, covariance = np.array([4.2, 0.11]), np.array([[0.04, 0.003], [0.003, 0.0004]])
    prior = {"names": ["R", "L"], "mean": mean.tolist(), "covariance": covariance.tolist()}
    study = study_of(folder, {"values": {"L": [0.15]}}, prior=prior)
    parameters = problem_of(study, study.tables, ("R",), {"L": 0.15}, {}).parameters
    thetas = np.array([[3.5], [4.0], [5.0]])
    found = (parameters.prior_residual(thetas) ** 2).sum(axis=1)
    away = np.hstack([thetas, np.full((3, 1), 0.15)]) - mean
    expected = np.einsum("ki,ij,kj->k", away, np.linalg.inv(covariance), away)
    assert np.diff(found) == pytest.approx(np.diff(expected))
    assert CaseRunner(study)(0).row["status"] == "converged"
    alone = study_of(
        folder, {"values": {"L": [0.15]}}, prior=prior | {"names": ["L"], "mean": [1], "covariance": [[1]]}
    )
    assert len(problem_of(alone, alone.tables, ("R",), {"L": 0.15}, {}).parameters.prior_whitening) == 0


def test_parameters_per_experiment(folder: Path) -> None:
    tables = [{"table": f"records/run{k}.csv", "inputs": ["u"], "outputs": ["i"]} for k in (1, 2)]
    parameters = {"R": {"start": 3.0, "min": 0.5, "per_experiment": True}, "L": {"start": 0.2, "min": 1e-3}}
    noise = {"draws": 1, "std": 1e-6, "truth": {"R[run1]": 3.8, "R": 4.4, "L": 0.1}}
    study = study_of(folder, {"noise": noise, "starts": 1}, experiments=tables, parameters=parameters)
    assert truth_of(study) == {"R[run1]": 3.8, "R[run2]": 4.4, "L": 0.1}
    row = CaseRunner(study)(0).row
    assert [row[f"value.{name}"] for name in truth_of(study)] == pytest.approx([3.8, 4.4, 0.1], rel=1e-5)
    assert "start.R" in row
    held = study_of(folder, {"noise": noise, "values": {"R": [3.8]}}, experiments=tables, parameters=parameters)
    assert truth_of(held) == {"R[run1]": 3.8, "R[run2]": 4.4, "L": 0.1}


# --- failures


def test_failing_simulations_are_rows_and_are_counted(folder: Path, probe: ProbeMaker) -> None:
    times = np.arange(20.0)
    x = 2.0 * times + 0.01 * np.random.default_rng(0).standard_normal(20)
    frame = pd.DataFrame({"time": times, "u": 1.0, "x": x})
    frame.to_csv(folder / "table.csv", index=False)
    study = study_of(
        folder,
        {"values": {"fail_init": [0.0, 1.0]}},
        model={"fmu": str(probe())},
        experiments=[{"table": "table.csv", "inputs": ["u"], "outputs": ["x"]}],
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


def test_problems_count_the_points_that_cannot_be_simulated() -> None:
    failed = 0

    def function(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal failed
        if theta[0] > 3.0:
            failed += 1
            raise ArithmeticError
        return np.asarray(np.exp(-theta[0] * TIMES))

    problem = LeastSquares.from_function(function, np.exp(-4.0 * TIMES), {"a": Parameter(0.1)})
    assert identify(problem)["a"] <= 3.0
    assert problem.failures == failed > 0


@pytest.mark.parametrize("error", [MemoryError(), ZeroDivisionError("float division"), np.linalg.LinAlgError("bad")])
def test_what_the_arithmetic_raises_is_a_row(folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(Marquardt, "search", fail)
    row = CaseRunner(study_of(folder, {"starts": 1}))(0).row
    assert row["status"] == "failed"
    assert row["message"] == (f"{type(error).__name__}: {error}" if str(error) else "MemoryError")


def test_interruptions_and_bugs_pass(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner, predict, calls = CaseRunner(study_of(folder, {"starts": 1})), LeastSquares.predict, itertools.count()

    def interrupted(self: LeastSquares, thetas: NDArray[np.float64]) -> NDArray[np.float64]:
        if next(calls) == 5:  # when the search is under way, which ends it with a result
            raise KeyboardInterrupt
        return predict(self, thetas)

    with monkeypatch.context() as patch:
        patch.setattr(LeastSquares, "predict", interrupted)
        with pytest.raises(KeyboardInterrupt):
            runner(0)
    with monkeypatch.context() as patch:
        patch.setattr(case_run, "problem_of", lambda *_: None)
        with pytest.raises(AttributeError):
            runner(0)
    assert runner(0).row["status"] == "converged"


def test_the_log_has_the_warnings_of_its_own_thread(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, runner = logging.getLogger("fmuid.fmu"), CaseRunner(study_of(folder, {"starts": 1}))

    def warn(settings: Marquardt, problem: LeastSquares, *_: object) -> Any:
        log.warning("the coil %s", "hums")
        log.info("nothing")
        other = threading.Thread(target=log.warning, args=("another case",))
        other.start()
        other.join()
        return identify(problem, settings)

    with monkeypatch.context() as patch:
        patch.setattr(Marquardt, "search", warn)
        assert runner(0).log == "the coil hums"
    assert runner(0).log == ""
    assert not any(isinstance(each, case_run._ThreadWarnings) for each in logging.getLogger("fmuid").handlers)


def test_other_measurements_of_an_experiment() -> None:
    table = record(0).assign(j=1.0)
    before = Experiment(table, {"u": "u", "fed": "i"}, {"i": "i", "j": "j"}, discard=0.1, units={"i": "A"})
    values = np.stack([np.arange(120.0), np.full(120, 2.0)]).T
    values[70, 0] = np.nan
    after = before.with_outputs(values)
    sent = pickle.loads(pickle.dumps(after))  # without its table, which is not made before it is asked for
    assert sent.frame.equals(after.frame)
    assert after.frame is after.frame
    again = Experiment(after.frame, after.inputs, after.outputs, discard=0.1, units={"i": "A"})
    for experiment in (after, again):
        assert np.array_equal(experiment.output_values, values, equal_nan=True)
        assert np.array_equal(experiment.input_values, before.input_values)
        assert experiment.counted.sum() == 2 * 70 - 1
    assert np.array_equal(before.frame["i"], table["i"])
    assert not after.output_values.flags.writeable
    with pytest.raises(InputError, match=r"finite or NaN, of shape \(120, 2\)"):
        before.with_outputs(values[:, :1])
    with pytest.raises(InputError, match="has no sample"):
        before.with_outputs(np.full((120, 2), np.nan))


# --- refusals

WRONG: list[tuple[dict[str, Any], str]] = [
    ({}, r"\[batch\] varies nothing: give at least one of tables"),
    ({"seed": 3, "combine": "list"}, "varies nothing"),
    ({"stats": 3}, r"has no key 'stats' \(did you mean 'starts'"),
    ({"combine": "lists", "starts": 2}, r'combine must be "product" or "list" \(did you mean'),
    ({"starts": 2, "seed": -1}, r"\[batch\] seed must be a whole number, 0 or above, not -1"),
    ({"starts": 0}, r"starts must be a whole number above 0, or a list of starts, .*, not 0"),
    ({"starts": []}, "starts must be a whole number above 0, or a list"),
    ({"starts": [{"R": "x"}]}, "starts must be a table of which each entry is a number"),
    ({"starts": [{"Q": 1.0}]}, "starts names 'Q', which is no parameter of this study"),
    ({"starts": [{"R": 9.0}]}, r"starts\[0\].R: start 9 lies outside its bounds, 0.5 to 8"),
    ({"tables": 3}, 'tables must be a pattern of files, "records/\\*.csv"'),
    ({"tables": []}, "tables must be a pattern of files"),
    ({"tables": "nothing/*.csv"}, r'\[batch\] tables: "nothing/\*.csv" matches no file in '),
    ({"tables": ["records/run9.csv"]}, r"tables: there is no file .*run9.csv, the record 'run9'"),
    ({"subsets": ["R"]}, "subsets must be a list of different lists of parameters"),
    ({"subsets": [["R", "L"], ["L", "R"]]}, "subsets must be a list of different lists"),
    ({"subsets": [["R", "l"]]}, r"subsets names 'l', which is no parameter of this study \(did you mean 'L'"),
    ({"subsets": [["R"]], "values": {"R": [1.0]}}, "subsets names 'R', which values or sample hold"),
    ({"starts": [{"R": 2.0}], "values": {"R": [1.0]}}, "starts names 'R', which values or sample hold"),
    ({"values": {"R": [1.0], "L": [1.0]}}, "holds all parameters of the study at values"),
    ({"values": {"R": []}}, r"values must be a table of which each entry is a list of values of one type"),
    ({"values": {"i_start": [1.0, True]}}, "a list of values of one type"),
    ({"values": {"i_start": [0.1, math.inf]}}, "finite number"),
    ({"values": {"i_start": {"from": 1.0, "to": 2.0}}}, "with just these three"),
    ({"values": {"i_start": {"from": 1.0, "to": 1.0, "count": 3}}}, "whose from and to differ"),
    ({"values": {"R": ["big"]}}, r'values.R: a parameter is held at numbers, not at "big"'),
    ({"values": {"i_stat": [1.0]}}, r"\[batch\] does not fit: Coil.fmu has no variable 'i_stat' \(did you mean"),
    ({"values": {"i_start": ["big"]}}, "does not fit: 'i_start' is of type Real and cannot be held at 'big'"),
    ({"values": {"u": [1.0]}}, "does not fit: 'u' is an input from .*table.csv; it cannot also be given a value"),
    ({"sample": {"ranges": {"L": [0.1, 0.2]}}}, r"\[batch.sample\] needs the key 'count': how many points"),
    ({"sample": {"count": 3}}, r"\[batch.sample\] needs the key 'ranges': the variables that are held"),
    ({"sample": {"count": 10**8, "ranges": {"L": [0.1, 0.2]}}}, "count must be a whole number up to 16777216"),
    ({"sample": {"count": 3, "ranges": {}}}, "ranges must be a table { variable ="),
    ({"sample": {"count": 3, "ranges": {"L": [0.2, 0.1]}}}, r"each entry is \[lowest, highest\]"),
    ({"sample": {"count": 3, "method": "halton", "ranges": {"L": [0.1, 0.2]}}}, 'method must be "sobol" or'),
    ({"sample": {"count": 3, "ranges": {"L": [0.1, 0.2]}}, "values": {"L": [0.1]}}, "'L' both by values and by sample"),
    ({"noise": {"std": 0.1}}, r"\[batch.noise\] needs the key 'draws': how many draws"),
    ({"noise": {"draws": 2}}, r"needs the standard deviation of the noise of 'i': give std = { i = ... }, or its"),
    ({"noise": {"draws": 2, "std": {"j": 0.1}}}, "std names 'j', which is no measured output"),
    ({"noise": {"draws": 2, "std": 0}}, "std must be a number above 0"),
    ({"noise": {"draws": 2, "std": 0.1, "truth": {"Q": 1.0}}}, "does not fit: Coil.fmu has no variable 'Q'"),
    ({"noise": {"draws": 2, "std": 0.1, "truth": {"R": math.inf}}}, "finite number"),
    ({"combine": "list", "starts": 2, "values": {"i_start": [1.0]}}, r"\(1 of values.i_start, 2 of starts\)"),
]


@pytest.mark.parametrize(("batch", "sentence"), WRONG)
def test_refusals_are_one_sentence(folder: Path, batch: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        Cases.of(study_of(folder, batch))
    assert str(folder / "study.toml") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refusals_of_the_whole_study(folder: Path) -> None:
    with pytest.raises(InputError, match=r"has no \[batch\]: give it"):
        Cases.of(study_of(folder, None))
    with pytest.raises(InputError, match="no parameters: name at least one"):
        Cases.of(study_of(folder, {"starts": 2}, parameters={}))
    twice = [{"table": f"records/run{k}.csv", "inputs": ["u"], "outputs": ["i"]} for k in (1, 2)]
    with pytest.raises(InputError, match=r"has tables, each in place of .* the study has 2 \[\[experiments\]\]"):
        Cases.of(study_of(folder, {"tables": "records/*.csv"}, experiments=twice))
    with pytest.raises(InputError, match="has no parameter 'Q'"):
        Cases.of(study_of(folder, {"starts": 2}, parameters={"Q": {"start": 1.0}}))


def test_the_noise_of_a_study_is_that_of_its_draws(folder: Path) -> None:
    study = study_of(folder, {"noise": {"draws": 2}}, noise={"variance": 0.04})
    assert study.batch is not None
    assert study.batch.noise is not None
    assert study.noise == Noise(0.04)
    assert study.batch.noise.std == pytest.approx({"i": 0.2})
