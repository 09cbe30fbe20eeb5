"""What an FMU does to the floating-point environment ends with the call that did it ."""

import ctypes
import platform
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fmuid import Simulator
from tests.support.isolated import NAMES, RECORD, thetas
from tests.support.misbehaving import Mode, Where, misbehaving_fmu
from tests.support.quick import first

MODES = [Mode.ROUND_UPWARD] + (
    [Mode.FLUSH, Mode.TRAP, Mode.LESS_PRECISE] if platform.machine() in ("x86_64", "AMD64") else []
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("misbehaving")


@pytest.fixture(autouse=True)
def _default_environment() -> Iterator[None]:
    """Have a test that fails spoil no other."""
    yield
    if sys.platform == "linux":
        ctypes.CDLL(None).fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV


def behavior() -> tuple[float, bool, bool, int]:
    """Return what tells how this thread rounds, whether it knows denormal numbers, x87's precision, and its traps."""
    one, tiny = np.array([1.0]), np.array([1e-310])
    long = np.array([1.0], np.longdouble)
    precise = long + np.array([np.ldexp(np.longdouble(1), -60)]) != long
    traps = ctypes.CDLL("libm.so.6").fegetexcept() if platform.libc_ver()[0] == "glibc" else 0
    return float((one / 3)[0]), bool((tiny * 0.5 > 0)[0]), bool(precise[0]), traps


def in_a_thread(task: Callable[[], None]) -> None:
    """Run a task in a thread of its own, and pass on what it raises."""
    failed: list[BaseException] = []

    def run() -> None:
        try:
            task()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]


def outputs(simulator: Simulator, some: NDArray[np.float64]) -> NDArray[np.float64]:
    found = simulator.many(some)
    assert found.errors == (None,) * len(some)
    return found.outputs


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", first(1, ["model-exchange", "co-simulation"]))
def test_a_simulation_does_not_depend_on_those_before_it(folder: Path, mode: Mode, kind: str) -> None:
    """Simulations 3 and 8 change it half-way: all others, in the same call and after it, are bit for bit the same."""
    some = thetas(mode)
    before = behavior()
    values = {"at": 0.95}
    simulator = Simulator(misbehaving_fmu(folder), RECORD, NAMES, values=values, interface=kind)
    sound = outputs(simulator, some * [1.0, 1.0, 0.0])
    found = outputs(simulator, some)
    assert behavior() == before
    good = some[:, 2] == 0.0
    assert np.array_equal(found[good], sound[good])
    assert np.array_equal(outputs(simulator, some[::-1]), found[::-1])
    if mode == Mode.ROUND_UPWARD:
        assert not np.array_equal(found[~good], sound[~good])  # it has an effect at all


@pytest.mark.parametrize("mode", first(1, MODES))
@pytest.mark.parametrize("where", [*list(Where)[1:], "loading", "instance"])
def test_no_call_of_an_instance_leaves_it_changed(folder: Path, mode: Mode, where: Where | str) -> None:
    given: dict[str, Any] = {}
    some, values = thetas(mode)[3:4], {"where": float(where)} if isinstance(where, Where) else {}
    if not values:
        given = {"at_loading": mode} if where == "loading" else {"token": f"at-instantiation-{int(mode)}"}
        some = thetas(Mode.SOUND)[:2]

    def live() -> None:
        before = behavior()
        simulator = Simulator(misbehaving_fmu(folder, **given), RECORD, NAMES, values=values)
        simulator.many(some)
        assert behavior() == before
        simulator.close()
        assert behavior() == before

    in_a_thread(live)
