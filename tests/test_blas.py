"""Linear algebra has one thread wherever fmuid computes, and the process gets its threads back."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import scipy.linalg.blas  # loads SciPy's library, which `threads` is to see
from threadpoolctl import threadpool_info, threadpool_limits

import fmuid
from fmuid import Problem, Study
from fmuid.array_types import Floats
from fmuid.blas import ONE_THREAD
from fmuid.estimation import Evaluator
from fmuid.runs.batch.case import CaseRunner
from tests.support.coil_batches import NOISE, write
from tests.support.coil_study import coil_table
from tests.support.quick import first

assert scipy.linalg.blas


def threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def two() -> Iterator[None]:
    """BLAS has two threads around each test."""
    with threadpool_limits(2, user_api="blas"):
        yield


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[set[int]]:
    """The threads that BLAS had at each simulation of several points."""
    found: list[set[int]] = []
    predict = Evaluator._rows

    def noting(self: Evaluator[Problem], thetas: Floats) -> tuple[Floats, int]:
        found.append(threads())
        return predict(self, thetas)

    monkeypatch.setattr(Evaluator, "_rows", noting)
    return found


def diagnosis(_: Problem, result: fmuid.Result) -> object:
    test = fmuid.datasets.faulty_coil()
    faults = {"turns": fmuid.Fault(test.fmu, {"dR": test.parameters["dR"]})}
    return fmuid.diagnose(test.experiment, result, faults, fmuid.datasets.coil().fmu)


WORK: dict[str, Callable[[Problem, fmuid.Result], object]] = {
    "identify": lambda problem, _: fmuid.identify(problem),
    "Marquardt": lambda problem, _: fmuid.Marquardt().search(Evaluator(problem)),
    "profiles": lambda problem, result: fmuid.profile_likelihood(problem, result, ["R"]),
    "sample": lambda problem, result: fmuid.sample_posterior(
        problem, result, fmuid.identification.SamplerSettings(max_steps=50, seed=1)
    ),
    "map_criterion": lambda problem, result: fmuid.map_cost(problem, result, "R", "L", points=5),
    "diagnose": diagnosis,
}


@pytest.mark.parametrize("name", first(2, WORK))
def test_work_has_one_thread_and_gives_the_others_back(name: str, seen: list[set[int]]) -> None:
    problem = fmuid.datasets.coil().problem()
    result = fmuid.identify(problem)
    seen.clear()
    WORK[name](problem, result)
    assert seen
    assert all(each == {1} for each in seen)
    assert threads() == {2}


def test_a_case_of_a_batch_has_one_thread_in_whatever_worker(tmp_path: Path, seen: list[set[int]]) -> None:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    write(tmp_path, NOISE.format(draws=1))
    assert CaseRunner(Study.read(tmp_path / "study.toml"))(0).row["status"] == "converged"
    assert seen
    assert all(each == {1} for each in seen)


def test_the_last_to_leave_gives_back_what_the_first_found() -> None:
    first, second = threading.Event(), threading.Event()

    def stay() -> None:
        with ONE_THREAD:
            first.set()
            second.wait(600.0)

    other = threading.Thread(target=stay)
    with ONE_THREAD:
        other.start()
        first.wait(600.0)
    assert threads() == {1}
    second.set()
    other.join()
    assert threads() == {2}
