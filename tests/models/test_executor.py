"""A system owns what runs it: made once, freed by closing it or with its last user, and only its own."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid.data.experiment import Experiment
from fmuid.models.component import Numerics
from fmuid.models.system import System
from fmuid.simulation.executor_pool import close, closing, executor_of
from fmuid.simulation.forward_simulation import twin_simulation
from fmuid.simulation.simulator import Simulator
from tests.support.paths import FMUS
from tests.support.probe_fmu import ProbeMaker

TIMES = np.arange(3.0)
COUNTED = Experiment(pd.DataFrame({"time": TIMES, "instances": 0.0}), outputs=["instances"])
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


def test_an_executor_is_made_once_and_closed_with_the_variants() -> None:
    """The twins of forward sensitivities belong to the system whose twins they are."""
    coil = FMUS / "Coil" / "Coil.fmu"
    frame = pd.DataFrame({"time": 0.01 * np.arange(20), "u": 1.0, "i": 0.0})
    with closing(System(coil, numerics=Numerics("model-exchange"))) as system:
        simulators = [Simulator(system, Experiment(frame, ["u"], ["i"]), ["R", "L"]) for _ in range(2)]
        runs = [twin_simulation(simulator) for simulator in simulators]
        simulators[0]([4.0, 0.1])
        for run in runs:
            run.simulate(np.tile([4.0, 0.1], 3))
        executors: list[Any] = [executor_of(s) for s in (*(run.system for run in runs), system)]
        assert executors[0] is executors[1] is not executors[2]
        there = [weakref.ref(i) for each in executors[1:3] for thread in each._threads for i in thread._instances]
        assert len(there) == 3 + 1
    gc.collect()
    assert not any(each() for each in there)


def test_what_a_system_owns_is_closed_when_its_block_fails(probe: ProbeMaker) -> None:
    path = probe(maxOutputDerivativeOrder="3", **BEARS_THREADS)
    with pytest.raises(ZeroDivisionError), closing(System(path)) as system:
        Simulator(system, COUNTED)([])
        raise ZeroDivisionError
    assert Simulator(path, COUNTED)([]).max() == 1
