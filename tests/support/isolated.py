"""What the tests of isolation share: the record of a first-order lag, thetas of which some misbehave, what is right."""

import contextlib
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest

from fmuid import Experiment, Isolation, Numerics, SimulationError, Simulator, System
from fmuid.array_types import Floats
from tests.support.misbehaving import Mode, lag, misbehaving_fmu

NAMES = ("gain", "T", "mode")
TIMES: Floats = np.linspace(0.0, 3.9, 40)
U: Floats = np.sign(np.sin(3 * TIMES + 0.1))
RECORD_FRAME = pd.DataFrame({"time": TIMES, "u": U, "x": 0.0 * TIMES})
RECORD = Experiment(RECORD_FRAME, ["u"], ["x"], interpolation="zoh", name="record")
PROCESSES = [
    pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork"),
    pytest.mark.usefixtures("nothing_said"),
]
"""Marks of tests of FMUs in processes of their own."""
BAD = (3, 8)
"""The simulations of `thetas` in which the FMU misbehaves."""


def thetas(mode: Mode, seed: int = 1) -> Floats:
    """Return gains, time constants and modes (12, 3), of which those at `BAD` misbehave."""
    some = np.random.default_rng(seed).uniform([1.0, 0.2, 0.0], [3.0, 1.0, 0.0], (12, 3))
    some[list(BAD), 2] = mode
    return some


def pair() -> tuple[None, Isolation]:
    """Return no isolation, and that of separate processes."""
    return None, Isolation()


def closed_form(some: Floats) -> Floats:
    """Return the outputs (m, K) of thetas where the FMU behaves."""
    return np.array([lag(TIMES, U, gain, T) for gain, T, _ in some])


@cache
def _alone(fmu: Path) -> Simulator:
    return Simulator(fmu, RECORD, NAMES)


def expected(folder: Path, some: Floats) -> Floats:
    """Return the outputs (m, K, 1) of thetas where the FMU behaves, simulated in-process: those of the closed form."""
    outputs = _alone(misbehaving_fmu(folder))(np.array(some) * [1.0, 1.0, 0.0])
    assert np.abs(outputs[:, :, 0] - closed_form(some)).max() < 1e-14
    return outputs


def processes() -> list[psutil.Process]:
    """Return all processes that this one has started, and those that they have."""
    return psutil.Process().children(recursive=True)


def computing(command: int) -> list[psutil.Process]:
    """Return the processes of FMUs below one, which are not its own children, that have computed for a while."""
    found = []
    for each in psutil.Process(command).children(recursive=True):
        with contextlib.suppress(psutil.Error):  # it has ended
            if each.ppid() != command and each.cpu_times().user > 0.3:
                found.append(each)
    return found


def left_behind(simulator: Simulator, folder: Path, mode: Mode) -> list[psutil.Process]:
    """Return the processes that an FMU starts and leaves behind; the simulations are what they are without."""
    some = thetas(Mode.SOUND)
    simulator(some)
    there = {process.pid for process in processes()}
    some[5, 2] = mode
    assert np.array_equal(simulator(some), expected(folder, some))
    return [process for process in processes() if process.pid not in there]


def wait_until(condition: Callable[[], Any], seconds: float = 600.0) -> None:
    """Wait for something to become true, and fail where it does not for far longer than any machine takes."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come true in time"
        time.sleep(0.01)


def check_costs_only_its_own(fmu: Path, some: Floats, words: str, isolation: Isolation, **given: Any) -> None:
    """Check that each bad simulation is an error with these words, and all others are bit for bit those in-process."""
    numerics = given.pop("numerics", Numerics())
    values = {"at": 0.95, **given}
    isolated = Simulator(System(fmu, numerics=numerics, isolation=isolation), RECORD, NAMES, values=values)
    found = isolated.many(some)
    isolated.close()
    sound = some * [1.0, 1.0, 0.0]
    alone = Simulator(System(fmu, numerics=numerics), RECORD, NAMES, values=values).many(sound)
    good = [i for i in range(len(some)) if i not in BAD]
    assert [error is None for error in found.errors] == [i not in BAD for i in range(len(some))]
    assert np.array_equal(found.outputs[good], alone.outputs[good])
    assert np.abs(alone.outputs[:, :, 0] - closed_form(some)).max() < 1e-5
    for i in BAD:
        error = found.errors[i]
        assert isinstance(error, SimulationError)
        assert words in str(error)
        assert "\n" not in str(error)
        assert error.fmu == str(fmu)
        assert error.parameters == dict(zip(NAMES, some[i].tolist(), strict=True))
        assert np.isnan(found.outputs[i]).all()
