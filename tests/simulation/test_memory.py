"""An FMU that keeps something outside its instances, by which each simulation changes the ones after it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, Isolation, Parameter, Problem, Simulator, System, identify
from fmuid.errors import InputError
from fmuid.models import SolverConfiguration
from fmuid.reports.topics.solver_check import run_words
from fmuid.reports.topics.validation import check_words
from fmuid.simulation import Subject, validate
from fmuid.simulation.executor_pool import closing
from tests.support.isolated import PROCESSES
from tests.support.stepping import LAG, stepping_fmu

pytestmark = PROCESSES
MEMORY = 1e-3  # added to the input after each simulation


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where the FMUs are, each compiled once."""
    return tmp_path_factory.mktemp("memory")


def experiment() -> Experiment:
    """Return a record of x' = u - 3 x in closed form, u held."""
    step, n, k = 0.01, 100, 3.0
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    x = np.zeros(n)
    for i in range(n - 1):
        x[i + 1] = u[i] / k + (x[i] - u[i] / k) * np.exp(-k * step)
    frame = pd.DataFrame({"time": step * np.arange(n), "u": u, "x": x + 1e-3 * rng.standard_normal(n)})
    return Experiment(frame, ["u"], ["x"], interpolation="zoh")


def test_each_simulation_has_a_new_process(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Outputs are those of the same FMU without the memory, bit for bit, also where several go at a time."""
    thetas = [[1.0], [2.0], [1.0]]
    expected = Simulator(stepping_fmu(folder, LAG, order=4), experiment(), ["k"])(thetas)
    with closing(System(stepping_fmu(folder, LAG, order=4, memory=MEMORY), isolation=Isolation())) as system:
        simulator = Simulator(system, experiment(), ["k"])
        with caplog.at_level(logging.WARNING, "fmuid.fmu"):
            np.testing.assert_array_equal(simulator(thetas), expected)
            np.testing.assert_array_equal(simulator([1.0]), expected[0])
    (record,) = caplog.records
    assert "keeps data outside its instances; each simulation uses a new process" in record.getMessage()


def test_identify_by_new_processes(folder: Path) -> None:
    """The cost never rises over accepted steps, the estimate is that of the FMU without memory, the result says how."""
    found = []
    for memory in (0.0, MEMORY):
        with closing(System(stepping_fmu(folder, LAG, order=4, memory=memory), isolation=Isolation())) as system:
            problem = Problem(system, experiment(), {"k": Parameter(1.0, min=0.1, max=10.0)})
            found.append(identify(problem, solver_check="off", restart=False))
    plain, result = found
    assert result.values[0] == plain.values[0]
    trace = result.trace
    for _, costs in trace[trace["accepted"]].groupby("round")["cost"]:
        assert (np.diff(costs) <= 0.0).all()
    assert [each.setup.models[""]["run"]["new_processes"] for each in found] == [False, True]
    assert run_words(SolverConfiguration(**result.setup.models[""]["run"])).endswith(
        "in a new process for each simulation"
    )


def test_one_simulation_in_a_process(folder: Path) -> None:
    """Without new processes it is refused, at once where several simulations were asked for."""
    path, sentence = (
        stepping_fmu(folder, LAG, order=4, memory=2 * MEMORY),
        r"outside its instances, so only one simulation is possible",
    )
    with pytest.raises(InputError, match=sentence):
        Simulator(path, experiment(), ["k"])([[1.0], [2.0]])
    with pytest.raises(InputError, match=sentence):
        identify(Problem(path, experiment(), {"k": Parameter(1.0, min=0.1, max=10.0)}))


def test_outputs_at_random_are_refused(folder: Path) -> None:
    """What differs from process to process no process mends."""
    path = stepping_fmu(folder, LAG, order=4, memory=MEMORY, seed="getpid()")
    with closing(System(path, isolation=Isolation())) as system:
        simulator = Simulator(system, experiment(), ["k"])
        with pytest.raises(InputError, match=r"outputs differ between simulations .* also in new processes"):
            simulator([1.0])


def test_validate_says_so(folder: Path) -> None:
    found = validate(stepping_fmu(folder, LAG, order=4, memory=3 * MEMORY))
    (check,) = (each for each in found.checks if each.subject is Subject.RESET)
    assert check.result == "failed"
    assert "it keeps data outside its instances" in check_words(check)[0]
