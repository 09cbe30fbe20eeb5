"""The coil of docs/method/coil.md: the data, table 1.1, and what the draws must show."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from experiments import pages
from experiments.coil import study
from fmuid.reports.topics.diagnosis import verdict


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(study.HERE / "draws.csv")


@pytest.fixture(scope="module")
def single() -> dict[int, fmuid.Diagnosis]:
    path = study.HERE / "test.toml"
    return {n: fmuid.Study.read(path, [f"experiments.0.data=test{n}.csv"]).diagnose() for n in study.TESTS}


def test_the_data_are_the_exact_response_to_a_held_voltage() -> None:
    resistance, inductance = 5.2, 0.11
    block = expm(np.array([[-resistance / inductance, 1.0 / inductance], [0.0, 0.0]]) * study.STEP)
    current, expected = 0.0, []
    for voltage in study.voltage():
        expected.append(current)
        current = block[0, 0] * current + block[0, 1] * float(voltage)
    assert study.current(resistance, inductance) == pytest.approx(np.array(expected), abs=1e-12)
    assert set(study.voltage()) == {-1.0, 1.0}


def test_table_1_1(single: dict[int, fmuid.Diagnosis]) -> None:
    for number, case in study.TESTS.items():
        size = single[number]["turns.dR"]
        assert abs(size.value - case.fault) < 3 * study.theory(case.R, case.fault).spread
        # the chapter's estimate has an error of its own
        assert abs(size.value - case.chapter[2]) < 4 * math.sqrt(2) * size.std
        assert single[number].kind == ("fault" if case.fault else "healthy")
    assert verdict(single[1]).text.startswith("FAULT: turns, dR = ")


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2, 5])
def test_fresh_draws_scatter_and_alarm_as_the_theory_says(number: int) -> None:
    case, count = study.TESTS[number], 40
    expected = study.theory(case.R, case.fault)
    found = study.draws(case.R, case.fault, count, 1000 + number)
    error = found["dR"] - case.fault
    assert error.mean() == pytest.approx(expected.bias, abs=4 * expected.spread / math.sqrt(count))
    assert error.std() / expected.spread == pytest.approx(1.0, abs=4 / math.sqrt(2 * count))
    rate = math.sqrt(expected.rate * (1 - expected.rate) / count)
    assert found["called"].mean() == pytest.approx(expected.rate, abs=4 * rate + 0.5 / count)


@pytest.mark.parametrize("number", study.TESTS)
def test_the_committed_draws_reach_what_is_wanted(committed: pd.DataFrame, number: int) -> None:
    case, part = study.TESTS[number], committed[committed["test"] == number]
    expected, error = study.theory(case.R, case.fault), part["dR"] - case.fault
    assert len(part) == study.DRAWS
    assert abs(error.mean()) < 0.02
    assert error.std() == pytest.approx(expected.spread, rel=0.15)
    if number == 2:
        assert 0.002 <= part["called"].mean() <= 0.03
    else:
        assert part["called"].mean() == pytest.approx(expected.rate, abs=0.05)
    if number in (1, 4):
        assert part["called"].all()


def test_the_committed_draws_are_these(committed: pd.DataFrame) -> None:
    case = study.TESTS[3]
    again, there = study.draws(case.R, case.fault, 2, 3), committed[committed["test"] == 3].head(2)
    assert again["dR"].to_numpy() == pytest.approx(there["dR"].to_numpy(), rel=1e-4)
    assert again["D"].to_numpy() == pytest.approx(there["D"].to_numpy(), rel=1e-3)


def test_warm_and_cold_coils_alarm_at_the_level() -> None:
    alarms = pd.read_csv(study.HERE / "alarms.csv")
    assert tuple(alarms["R"]) == study.WARM
    for kind in ("called", "alarms"):
        assert (alarms[kind] / alarms["draws"]).between(0.002, 0.03).all()


def test_the_page_shows_table_1_1(single: dict[int, fmuid.Diagnosis]) -> None:
    page = (study.HERE / "README.md").read_text(encoding="utf-8")
    assert pages.insert(page, {"single": study.single_table(single)}) == page, "run python -m experiments.coil.study"


def test_the_healthy_result_is_of_the_committed_model() -> None:
    content = json.loads((study.HERE / "healthy" / "result.json").read_text(encoding="utf-8"))
    assert content["setup"]["models"][""]["name"] == "Coil"
    assert content["setup"]["models"][""]["digest"] == fmuid.FMU(study.FMUS / "Coil" / "Coil.fmu").digest
    assert not fmuid.Study.read(study.HERE / "test.toml").notes
