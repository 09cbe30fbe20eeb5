"""Phase signals in a study file: the example of the page, its results, predictions, batches."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmuid
from fmuid.runs import predict_with
from fmuid.runs.batch.case import CaseRunner
from tests.support.winding_machine import MACHINE, record

FMU = Path("fmus/InductionMachine/InductionMachine.fmu").resolve()
STUDY = f"""
[model]
fmu = "{FMU.as_posix()}"

[[experiments]]
data = "run.csv"
inputs = ["w"]

[experiments.observation]
phases = "abc"
isolated = true
angle = {{ column = "theta" }}
currents = {{ ids = ["ia", "ib"], iqs = ["ia", "ib"] }}
voltages = {{ uds = ["ua", "ub", "uc"], uqs = ["ua", "ub", "uc"] }}
sensors.ia = {{ gain = 1.0, offset = 0.0, delay = 0.0 }}
sensors.ib = {{ gain = {{ start = 1.0, prior_std = 0.05 }} }}
phase_resistance = {{ a = 0.0 }}
dead_time_voltage = 0.0

[parameters]
Rs = {{ start = 12.0, min = 0.0 }}
Rr = {{ start = 3.0, min = 0.0 }}
Lm = {{ start = 0.5, min = 1e-3 }}
Lf = {{ start = 0.05, min = 1e-4 }}
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("phases")
    frame = record(800, noise=0.05, seed=7).copy()
    frame["ib"] *= 1.02
    frame.to_csv(folder / "run.csv", index=False)
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    return folder / "study.toml"


def test_a_study_of_phase_signals(path: Path) -> None:
    study = fmuid.Study.read(path)
    result = study.identify()
    assert result.names == (*MACHINE, "gain(ib)")
    assert np.abs((result.values - [*MACHINE.values(), 1.02]) / result.std).max() < 4.0
    assert result["Rs"].unit == "Ohm" and not result["gain(ib)"].unit
    found = predict_with(study, result, study.tables[0])
    assert found.fit.outputs == ("ia", "ib") and found.fit.units == ("A", "A")
    assert all(score.inside > 0.9 for score in found.scores)


def test_directed_tests_are_of_sensors_and_lines(path: Path) -> None:
    study = fmuid.Study.read(path)
    problem = study.problem()
    found = {(each.kind.value, each.subject) for each in problem.directions(study.identify())}
    wanted = [("delay", ("ia",)), ("gain", ("ia",)), ("offset", ("ib",)), ("input_gain", ("uc",)), ("joint", ("ub",))]
    assert set(wanted) <= found
    assert ("gain", ("ib",)) not in found  # it is a parameter
    assert any(kind == "dead_time" and "ia" in subject for kind, subject in found)


def _data() -> dict[str, Any]:
    return tomllib.loads(STUDY)


def test_batches_simulate_sensors(path: Path) -> None:
    drawn = {"realizations": 1, "std": 0.1, "true_values": {**MACHINE, "gain(ib)": 0.97}}
    study = fmuid.Study.of({**_data(), "batch": {"monte_carlo": drawn}}, path)
    assert CaseRunner(study)(0).row["value.gain(ib)"] == pytest.approx(0.97, abs=0.02)


def test_simulators_of_the_workbench_move_sensors(path: Path) -> None:
    study = fmuid.Study.read(path)
    (simulator,) = study.simulators()
    starts = [each.start for each in study.parameters.values()]
    outputs = simulator([starts, [*starts[:-1], 2.0]])
    assert simulator.parameters[-1] == "gain(ib)"
    np.testing.assert_allclose(outputs[1], outputs[0] * [1.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('angle = { column = "theta" }\n', "", "missing key 'angle'"),
        ('column = "theta"', 'column = "phi"', "angle column 'phi' not found"),
        ('"abc"', '"delta"', "needs sensors of three lines"),
        ('"ub", "uc"', '"ub", "ua"', "'ua' has two roles"),
        ("start = 1.0, prior_std = 0.05", "start = 0.0", "gain: start = 0 needs prior_std"),
        ("gain = 1.0, offset", "gain = 0.0, offset", "gain = 0 shows nothing"),
        ("sensors.ib", "sensors.ix", "unknown column 'ix'"),
        ('inputs = ["w"]', 'inputs = ["w", "uds"]', "'uds' has a column"),
        ("gain = { start", "gian = { start", "unknown key 'gian'"),
    ],
)
def test_bad_keys_get_one_sentence(path: Path, old: str, new: str, words: str) -> None:
    other = path.with_name("bad.toml")
    other.write_text(STUDY.replace(old, new), encoding="utf-8")
    with pytest.raises(fmuid.InputError) as caught:
        _ = fmuid.Study.read(other).tables
    assert words in str(caught.value) and str(caught.value).count("bad.toml") <= 1
