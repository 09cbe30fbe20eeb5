"""FMUs whose instances cannot share one process are kept apart (`fmuid.simulation.instance_registry`)."""

from __future__ import annotations

import gc
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid.errors import InputError
from fmuid.models.component import Component, Numerics
from fmuid.models.description import KINDS
from fmuid.models.fmu import FMU
from fmuid.models.system import System
from fmuid.simulation.executor_pool import threads
from fmuid.simulation.instance_registry import in_threads
from fmuid.simulation.simulator import Simulator
from tests.support.isolated import NAMES, RECORD, closed_form, thetas
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.paths import FMUS
from tests.support.quick import first

SAYS_SO: dict[str, Any] = {"canBeInstantiatedOnlyOncePerProcess": "false"}
OPEN_MODELICA: dict[str, Any] = {"tool": "OpenModelica Compiler OpenModelica v1.26.0 (64-bit)", **SAYS_SO}
ACCURACY = {"co-simulation": 1e-14, "model-exchange": 1e-5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sharing")


def check(simulator: Simulator) -> None:
    """Check that simulations come out right."""
    kind = simulator.system.components[""].kind
    some = thetas(Mode.SOUND)
    found = simulator.many(some)
    assert found.errors == (None,) * len(some)
    assert np.abs(found.outputs[:, :, 0] - closed_form(some)).max() < ACCURACY[kind]


@pytest.fixture(autouse=True)
def _four_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "4")


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({}, False),
        (SAYS_SO, True),
        ({"tool": "fmuid"}, True),
        ({"tool": "Reference FMUs (v0.0.39)"}, True),
        ({"tool": "Some Tool 2.0"}, False),
        ({"tool": "Some Tool 2.0", **SAYS_SO}, True),
        (OPEN_MODELICA, False),
        ({"canBeInstantiatedOnlyOncePerProcess": "true"}, False),
        ({"tool": "fmuid", "canBeInstantiatedOnlyOncePerProcess": "true"}, False),
        ({"tool": "fmuid", "needsExecutionTool": "true"}, False),
    ],
)
@pytest.mark.parametrize("version", [2, 3])
def test_threads_are_for_fmus_that_are_known_to_bear_them(
    tmp_path: Path, said: dict[str, Any], expected: bool, version: int
) -> None:
    description = FMU(misbehaving_fmu(tmp_path, version=version, **said)).description
    assert [in_threads(description, kind) for kind in KINDS] == [expected] * 2


def test_all_fmus_of_this_project_run_in_threads() -> None:
    paths = sorted(FMUS.glob("*/*.fmu"))
    assert paths
    for path in paths:
        (model,) = System(path).components.values()
        assert in_threads(model.fmu.description, model.kind), path


@pytest.mark.parametrize("said", [{}, OPEN_MODELICA], ids=["nothing", "OpenModelica"])
@pytest.mark.parametrize("kind", first(1, KINDS))
def test_an_fmu_that_may_not_bear_threads_has_none(folder: Path, said: dict[str, Any], kind: str) -> None:
    check(Simulator(misbehaving_fmu(folder, token="alone", **said), RECORD, NAMES, interface=kind))


def test_the_fmu_of_these_tests_does_not_bear_threads(folder: Path) -> None:
    """With the word of an FMU that it does, it fails: what these tests show is not for nothing."""
    assert threads() == 4
    fmu = misbehaving_fmu(folder, token="alone", **SAYS_SO)
    simulator = Simulator(fmu, RECORD, NAMES)
    try:
        assert any(simulator.many(np.repeat(thetas(Mode.SOUND), 4, axis=0)).errors)
    except InputError as error:  # threads that disturb the repeated first simulation look like memory outside instances
        assert "outside its instances" in str(error)


def test_no_instance_is_freed_while_another_lives(folder: Path) -> None:
    fmu = misbehaving_fmu(folder, token="alone in a crowd")
    first, second = (Simulator(fmu, RECORD, NAMES) for _ in range(2))
    check(first)
    check(second)
    first.close()
    check(second)
    check(first)
    del second
    gc.collect()
    check(first)


def test_a_fatal_end_of_one_is_not_waited_for(folder: Path) -> None:
    """An instance that may not be touched any more does not keep others from being freed."""
    fmu = misbehaving_fmu(folder, token="alone after a fatal one")
    simulator = Simulator(fmu, RECORD, NAMES)
    assert any(simulator.many(thetas(Mode.RETURN_FATAL)).errors)
    simulator.close()
    check(Simulator(fmu, RECORD, NAMES, interface="model-exchange"))


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("co-simulation",) * 4, KINDS * 2], ids=["one interface", "both"])
def test_systems_in_threads_wait_for_each_other(folder: Path, kinds: tuple[str, ...]) -> None:
    """Threads of the user's own, as those of a worker of a cluster, each with a system of the same FMU."""
    fmu, failed = misbehaving_fmu(folder, token="alone in threads of others"), list[BaseException]()
    together = threading.Barrier(len(kinds))

    def run(kind: str) -> None:
        try:
            simulator = Simulator(fmu, RECORD, NAMES, interface=kind)
            together.wait()
            for _ in range(3):
                check(simulator)
        except BaseException as error:
            failed.append(error)

    running = [threading.Thread(target=run, args=(kind,)) for kind in kinds]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()
    assert not failed


def test_one_system_cannot_have_both_interfaces(folder: Path) -> None:
    fmu = misbehaving_fmu(folder, token="alone", tool="Some Tool")
    parts = {kind[:2]: Component(fmu, Numerics(interface=kind)) for kind in KINDS}
    experiment = type(RECORD)(RECORD.frame, {"co.u": "u"}, {"mo.x": "x"})
    with pytest.raises(InputError, match=r"can crash FMUs of Some Tool.*one interface"):
        Simulator(System(components=parts), experiment)([])
