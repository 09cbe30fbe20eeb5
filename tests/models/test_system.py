"""Systems: order of the exchange, refusals; executors made once, freed by closing a system or with its last user."""

import gc
import weakref

import numpy as np
import pytest

from fmuid import InputError, SimulationError, Simulator, System
from fmuid.simulation import close, closing
from tests.support.compiled import ProbeMaker
from tests.support.experiments import record


def test_direct_feedthrough_is_passed_on_in_dependency_order(probe: ProbeMaker) -> None:
    """A chain c <- b <- a through y = x + u: the first sample already reaches the end, whatever the given order."""
    path = probe()
    system = System(components={"c": path, "a": path, "b": path}, connections=[("b.y", "c.u"), ("a.y", "b.u")])
    assert [connection.source for group, _ in system.exchange_order for connection in group] == [("a", "y"), ("b", "y")]
    got = Simulator(system, record([0.0, 1.0], {"a.u": 3.0}, ["c.y"]))([])
    # after one step of 1 s each x is 3: y_a = 3 + 3, y_b = 3 + 6, y_c = 3 + 9
    assert got[:, 0].tolist() == [3.0, 12.0]


def test_a_loop_of_feedthrough_without_a_solution_fails_by_name(probe: ProbeMaker) -> None:
    path = probe()
    system = System(components={"a": path, "b": path}, connections=[("a.y", "b.u"), ("b.y", "a.u")])
    with pytest.raises(SimulationError, match=r"no solution found for the algebraic loop .*a\.u"):
        Simulator(system, record([0.0, 1.0], {}, ["a.x"]), ["a.x"])([1.0])


def test_undeclared_dependencies_count_as_dependence_on_all_inputs(probe: ProbeMaker) -> None:
    path = probe()
    with pytest.raises(InputError, match=r"algebraic loop.*'[ab]\.ten_n' is of type Integer"):
        System(components={"a": path, "b": path}, connections=[("a.ten_n", "b.n"), ("b.ten_n", "a.n")])


@pytest.mark.parametrize(
    ("connections", "message"),
    [
        ([("a.x", "b.v")], r"no connected variable 'b.v'"),
        ([("a.u", "b.u")], "Connect an output to an input"),
        ([("a.x", "b.x")], "Connect an output to an input"),
        ([("a.ten_n", "b.u")], "Integer cannot feed Real"),
        ([("a.x", "b.u")], r"units rad and rad/s do not convert"),
        ([("a.y", "b.u"), ("a.y", "b.u")], "fed by two connections"),
    ],
)
def test_wrong_connections_are_one_sentence(
    probe: ProbeMaker, connections: list[tuple[str, str]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        System(components={"a": probe(), "b": probe()}, connections=connections)


def test_a_connected_input_cannot_come_from_the_table_or_be_a_parameter(probe: ProbeMaker) -> None:
    system = System(components={"a": probe(), "b": probe()}, connections=[("a.y", "b.u")])
    for name, parameters in (("b.u", []), ("a.u", ["b.u"])):
        with pytest.raises(InputError, match=r"'b\.u' has a connection"):
            Simulator(system, record([0.0, 1.0], {name: 3.0}, ["b.y"]), parameters)


def test_component_names(probe: ProbeMaker) -> None:
    with pytest.raises(InputError, match="empty name"):
        System(components={"": probe()})
    nested = System(components={"a.b": probe(), "a": probe()})
    assert nested.split("a.b.x") == ("a.b", "x")
    assert nested.split("a.x") == ("a", "x")


COUNTED = record(np.arange(3.0), {}, ["instances"])
"""An experiment whose output is how many instances there are in the library."""
BEARS_THREADS = {"canBeInstantiatedOnlyOncePerProcess": "false"}  # so that nobody waits with freeing


def test_closing_a_system_frees_its_own_instances_only(probe: ProbeMaker) -> None:
    path = probe(maxOutputDerivativeOrder="1", **BEARS_THREADS)  # another file: its library counts its own instances
    kept = Simulator(path, COUNTED)
    assert kept([]).max() == 1
    with closing(System(path)) as system:
        first, second = (Simulator(system, COUNTED) for _ in range(2))
        assert (first([]).max(), second([]).max(), kept([]).max()) == (2, 2, 2)
    assert kept([]).max() == 1
    assert second([]).max() == 2  # anew
    close(system)
    close(system)
    assert kept([]).max() == 1


def test_instances_go_with_the_last_user_of_a_system(probe: ProbeMaker) -> None:
    path = probe(maxOutputDerivativeOrder="2", **BEARS_THREADS)
    system = System(path)
    first, second = (Simulator(system, COUNTED) for _ in range(2))
    kept = Simulator(path, COUNTED)
    assert first(np.zeros((8, 0))).max() >= 1
    assert kept([]).max() >= 2
    gone = weakref.ref(system)
    del system, first
    assert kept([]).max() >= 2  # second uses it
    gc.disable()
    try:
        del second
        assert gone() is None
    finally:
        gc.enable()
    gc.collect()
    assert kept([]).max() == 1
