"""Parameters that take few values: each combination is searched with, the best is kept, and a study says them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.estimation import Evaluator, TerminationReason
from fmuid.identification.problem import MAX_COMBINATIONS, choices_of
from fmuid.runs.batch.case import CaseRunner
from tests.support.choices import choices_fmu
from tests.support.closed_forms import coil_response
from tests.support.compiled import ProbeMaker
from tests.support.fmu_texts import FMI2, write_fmu
from tests.support.quick import first
from tests.support.running import run_prediction, run_study

GAIN, N, B = 2.0, 3, True
NOISE = 0.01


def record() -> pd.DataFrame:
    """Return x' = gain (u + b - n x) in closed form, u held between samples."""
    rng, times = np.random.default_rng(4), 0.02 * np.arange(120.0)
    u = np.repeat(rng.choice([-1.0, 1.0, 2.0], 12), 10)
    x = coil_response(times, u + B, float(N), 1.0 / GAIN, linear=False)
    return pd.DataFrame({"time": times, "u": u, "x": x + NOISE * rng.standard_normal(times.size)})


@pytest.fixture(scope="module")
def experiment() -> fmuid.Experiment:
    return fmuid.Experiment(record(), inputs=["u"], outputs=["x"], interpolation="zoh")


@pytest.fixture(scope="module")
def fmu(probe: ProbeMaker) -> Path:
    return probe("CHOICES")


def problem(fmu: Path, experiment: fmuid.Experiment, choices: Any, **more: Any) -> fmuid.Problem:
    return fmuid.Problem(fmu, experiment, {"gain": fmuid.Parameter(1.0, min=0.01)}, choices=choices, **more)


@pytest.mark.parametrize("more", first(1, [{}, {"noise": fmuid.Noise(NOISE**2)}, {"loss": "huber"}]), ids=str)
def test_the_true_combination_is_found(fmu: Path, experiment: fmuid.Experiment, more: dict[str, Any]) -> None:
    given = problem(fmu, experiment, {"n": [1, 2, 3], "b": "all"}, **more)
    result = fmuid.identify(given)
    assert result.converged
    assert result.chosen == {"n": N, "b": B}
    assert abs(result["gain"] - GAIN) < 4 * result["gain"].std
    assert len(result.history.combinations) == 6
    behind = [each.behind for each in result.history.combinations]
    assert behind[0] == 0.0 < behind[1]
    assert behind == sorted(behind)
    assert result.history.combinations[0].estimates["gain"] == pytest.approx(result["gain"], abs=result["gain"].std)
    left = given.measured - Evaluator(given.as_in(result)).predict(result.values[None])[0]
    assert np.std(left) == pytest.approx(NOISE, rel=0.2)


@pytest.mark.slow
def test_an_int32_and_a_boolean_of_fmi_3_are_found(tmp_path: Path, experiment: fmuid.Experiment) -> None:
    result = fmuid.identify(problem(choices_fmu(tmp_path), experiment, {"n": "all", "b": "all"}))
    assert [type(each) for each in result.chosen.values()] == [int, bool]
    assert result.chosen == {"n": N, "b": B}
    assert len(result.history.combinations) == 8  # n from its bounds


def test_it_is_the_search_with_these_values_fixed(fmu: Path, experiment: fmuid.Experiment) -> None:
    """Priors count: what takes the others far from theirs is behind by these, too."""
    free = {"gain": fmuid.Parameter(2.0, min=0.01, prior=fmuid.Normal(2.5, 0.1))}
    one, other = (
        fmuid.identify(
            fmuid.Problem(fmu, experiment, free, values={"n": n, "b": True}, noise=fmuid.Noise(delay_std=0.0))
        )
        for n in (3, 2)
    )
    result = fmuid.identify(
        fmuid.Problem(
            fmu, experiment, free, choices={"n": [2, 3]}, values={"b": True}, noise=fmuid.Noise(delay_std=0.0)
        )
    )
    np.testing.assert_array_equal(result.values, one.values)
    prior = ((other["gain"] - 2.5) ** 2 - (one["gain"] - 2.5) ** 2) / 0.1**2
    assert abs(prior) > 1.0
    told = result.history.combinations[1]
    assert told.behind == pytest.approx(2.0 * (one.fit.log_likelihood - other.fit.log_likelihood) + prior)
    assert told.estimates == {"gain": other["gain"]}
    assert result.history.simulations == one.history.simulations + other.history.simulations


def test_values_that_cannot_be_simulated_are_left_out(fmu: Path, experiment: fmuid.Experiment) -> None:
    result = fmuid.identify(problem(fmu, experiment, {"n": [9, 3]}, values={"b": True}))
    assert result.chosen == {"n": 3}
    assert (result.history.combinations[1].outcome, result.history.combinations[1].behind) == (None, np.inf)
    with pytest.raises(fmuid.SimulationError):
        fmuid.identify(problem(fmu, experiment, {"n": [9]}))


WRONG: tuple[tuple[Any, str], ...] = (
    ({"m": [1, 2]}, "has no 'm'"),
    ({"n": []}, "one or more different values"),
    ({"n": [1, 1]}, "one or more different values"),
    ({"n": "all"}, "declares no values of 'n'"),
    ({"gain": [1.0, 2.0]}, "in parameters and in choices"),
    ({"n": range(MAX_COMBINATIONS), "b": "all"}, "more than 1000"),
    ({"n": ["three"]}, "n"),
)


def test_values_that_an_enumeration_declares(tmp_path: Path, fmu: Path, experiment: fmuid.Experiment) -> None:
    for choices, told in WRONG:
        with pytest.raises(fmuid.InputError, match=told):
            problem(fmu, experiment, choices)
    types = '<TypeDefinitions><SimpleType name="Gear"><Enumeration><Item name="low" value="1"/><Item name="high" value="4"/></Enumeration></SimpleType></TypeDefinitions>'  # noqa: E501
    text = FMI2.replace("<ModelVariables>", f"{types}<ModelVariables>")
    text = text.replace('<Integer start="4"/>', '<Enumeration declaredType="Gear" start="4"/>')
    system = fmuid.System(write_fmu(tmp_path / "Motor.fmu", text))
    assert choices_of(system, {"poles": "all"}) == {"poles": (1, 4)}


STUDY = """
model.fmu = "{fmu}"
experiments = [{{ data = "table.csv", inputs = ["u"], outputs = ["x"], interpolation = "zoh" }}]
[parameters]
gain = {{ start = 1.0, min = 0.01 }}
n = {{ choices = [1, 2, 3] }}
b = {{ choices = "all" }}
"""

DIAGNOSIS = "[diagnosis]\nbaseline = 'table.csv'\n[diagnosis.faults.a]\nparameters = {}\n"


@pytest.fixture
def study(tmp_path: Path, fmu: Path) -> Path:
    record().to_csv(tmp_path / "table.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY.format(fmu=fmu.as_posix()))
    return tmp_path / "study.toml"


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_a_study_and_a_batch(study: Path) -> None:
    found = run_study(study, study.parent / "out")
    assert found.result.chosen == {"n": N, "b": B}
    assert found.fits[0].fit[0] > 95.0
    ssv = (study.parent / "out" / "parameters.ssv").read_text()
    assert '<ssv:Integer value="3"' in ssv
    assert '<ssv:Boolean value="true"' in ssv
    kept = fmuid.Result.from_json(study.parent / "out" / "result.json")
    assert kept.history.combinations == found.result.history.combinations
    predicted = run_prediction(study.parent / "out", [study.parent / "table.csv"])
    assert predicted.predictions[0].scores[0].rmse < 2 * NOISE
    study.write_text(study.read_text() + '\n[batch]\ndata = "*.csv"\n')
    row = CaseRunner(fmuid.Study.read(study))(0).row
    assert (row["status"], row["chosen.n"], row["chosen.b"]) == ("converged", "3", "True")
    assert float(str(row["value.gain"])) == pytest.approx(GAIN, rel=0.05)


def test_wrong_choices_in_a_study(study: Path) -> None:
    text = study.read_text()
    for words, told in (
        ("n = { choices = [1, 2], start = 1 }", "choices and start cannot be combined"),
        ("n = { min = 1 }", "missing key 'start'"),
        ("n = { choices = [[1]] }", "choices"),
        (f"n = {{ choices = [1] }}\n{DIAGNOSIS}", "cannot be combined with choices of b"),
    ):
        study.write_text(text[: text.index("\nn = {") + 1] + text[text.index("b = {") :] + words)
        with pytest.raises(fmuid.InputError, match=told):
            fmuid.Study.read(study)


def test_an_interrupted_search_keeps_what_was_tried(
    fmu: Path, experiment: fmuid.Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = problem(fmu, experiment, {"n": [1, 2, 3]}, values={"b": True})
    plain, count = fmuid.identify(problem(fmu, experiment, {"n": [3]}, values={"b": True})), 0

    def search(*_: object) -> fmuid.Result:
        nonlocal count
        count += 1
        return replace(plain, outcome=TerminationReason.INTERRUPTED if count == 2 else TerminationReason.CONVERGED)

    monkeypatch.setattr(fmuid.Marquardt, "search", search)
    result = fmuid.identify(given, solver_check="off", restart=False)
    assert count == len(result.history.combinations) == 2
    assert result.outcome is TerminationReason.INTERRUPTED
