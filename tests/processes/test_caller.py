"""Functions called in an isolated process: their values and errors come back, and what ends the process is one call."""

import os
import signal
import subprocess
import sys
import time
from collections import OrderedDict
from datetime import UTC, datetime
from fractions import Fraction
from typing import Any

import numpy as np
import psutil
import pytest

from fmuid import InputError, SimulationError
from fmuid.processes import HostExitError, IsolatedCaller, ProcessEnd
from tests.support.isolated import wait_until

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork")
CALLER = IsolatedCaller(600.0)
VALUES = [
    None,
    {"a": [1, 2.5, float("inf"), "é\udc80"], 3: (True, b"\0\1"), "when": datetime(2026, 1, 2, 3, 4, 5, 6, UTC)},
    {"x": np.arange(6.0).reshape(2, 3), "t": np.array(["2026-01-01", "NaT"], "M8[ns]"), "n": np.zeros((0, 3), "i2")},
    [np.array(["a", "bcd"]), np.array(3), np.array([True, False]), np.array([1 + 2j])],
]


def same(first: Any, second: Any) -> bool:
    """Whether two values are equal, types of containers and arrays included."""
    if type(first) is not type(second):
        return False
    if isinstance(first, dict):
        return list(first) == list(second) and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, np.ndarray):
        return bool(first.dtype == second.dtype and first.shape == second.shape and first.tobytes() == second.tobytes())
    return bool(first == second)


def give(value: Any) -> Any:
    """Return a value, or raise it."""
    if isinstance(value, Exception):
        raise value
    return value


def take(megabytes: int) -> None:
    """Take memory and keep it for a while."""
    room = bytearray(megabytes << 20)
    room[::4096] = bytes(len(room[::4096]))
    time.sleep(600.0)


def test_values_come_back() -> None:
    for value in VALUES:
        assert same(CALLER.call(give, value), value)
    assert same(CALLER.call(give, OrderedDict(a=1)), {"a": 1})
    with pytest.raises(UnicodeError, match="invalid start byte"):
        CALLER.call(str, b"\xff", "utf-8")


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (InputError("x.h5: no table"), InputError),
        (OSError(5, "Input/output error", "x"), OSError),
        (KeyError("k"), KeyError),
        (SimulationError("a.fmu", 0.5, {"R": 4.0}, "fmi2DoStep returned fmi2Error", ("said",)), SimulationError),
        (np.linalg.LinAlgError("Singular matrix"), ValueError),  # of another package: its nearest base
    ],
)
def test_errors_come_back(error: Exception, kind: type[Exception]) -> None:
    with pytest.raises(kind) as caught:
        CALLER.call(give, error)
    assert type(caught.value) is kind
    assert str(caught.value) == str(error)
    assert vars(caught.value) == vars(error)


@pytest.mark.parametrize("value", [Fraction(1, 2), np.array([None]), {1, 2}])
def test_a_value_that_answers_do_not_have_is_an_error(value: Any) -> None:
    with pytest.raises(TypeError, match="cannot be sent between processes"):
        CALLER.call(give, value)


@pytest.mark.parametrize(
    ("function", "arguments", "end"),
    [
        (os.abort, (), HostExitError(ProcessEnd.CRASHED, signal.SIGABRT)),
        (os._exit, (3,), HostExitError(ProcessEnd.EXITED, 3)),
    ],
)
def test_a_process_that_is_lost_costs_one_call(function: Any, arguments: Any, end: HostExitError) -> None:
    before = CALLER.call(os.getpid)
    with pytest.raises(HostExitError) as caught:
        CALLER.call(function, *arguments)
    assert caught.value == end
    caught.value.__traceback__ = None  # as contexts do
    assert CALLER.call(os.getpid) not in (before, os.getpid())
    assert not psutil.pid_exists(before)


def test_a_process_that_was_ended_between_calls_costs_none() -> None:
    first = CALLER.call(os.getpid)
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: not psutil.pid_exists(first) or psutil.Process(first).status() == psutil.STATUS_ZOMBIE)
    assert CALLER.call(os.getpid) != first


def test_limits() -> None:
    with pytest.raises(HostExitError) as caught:
        IsolatedCaller(0.2).call(time.sleep, 600.0)
    assert caught.value == HostExitError(ProcessEnd.HUNG, 200)
    with pytest.raises(HostExitError) as caught:
        IsolatedCaller(600.0, memory=150.0).call(take, 200)
    assert caught.value == HostExitError(ProcessEnd.GREW, 150)


SCRIPT = """
import wave, numpy
from fmuid.processes import (IsolatedCaller)
for name in ("fmuid.processes", "wave", "numpy"):
    print(IsolatedCaller(600.0).call(eval, f"{name!r} in __import__('sys').modules"))
"""


def test_the_process_is_no_copy_of_its_owner() -> None:
    """It has loaded what it needs itself, and nothing that its owner has."""
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=600)
    assert run.stdout.split() == ["True", "False", "False"]
