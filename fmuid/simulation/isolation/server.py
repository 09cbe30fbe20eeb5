"""The far side of isolation: what a process that runs the FMUs of one system is ordered to do.

Thetas, outputs and reports are in memory that both sides share (`layout`).
"""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.errors import SimulationError
from fmuid.processes import shared_memory
from fmuid.simulation.codes import REPORT

if TYPE_CHECKING:
    from fmuid.simulation.executor import InProcessExecutor
    from fmuid.simulation.simulation_plan import GridSimulation

DOING_WORDS = 512
"""Words at the beginning of the shared memory: two for each thread, what it is doing and how often it has begun."""

Arrays = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]

_memory: list[mmap.mmap] = []
_executor: list[InProcessExecutor] = []
_runs: dict[int, GridSimulation] = {}


def layout(m: int, n_theta: int, n_times: int, n_outputs: int) -> tuple[int, int, int, int]:
    """Return where reports, thetas and outputs begin in the shared memory, and its size, bytes."""
    reports = 8 * DOING_WORDS
    thetas = reports + 8 * REPORT * m
    outputs = thetas + 8 * m * n_theta
    return reports, thetas, outputs, outputs + 8 * m * n_times * n_outputs


def arrays(memory: mmap.mmap, shape: tuple[int, int, int, int]) -> Arrays:
    """Return reports (m, REPORT), thetas (m, N) and outputs (m, K, n_outputs) of shape (m, N, K, n_outputs)."""
    m, n_theta, n_times, n_outputs = shape
    reports, thetas, outputs, _ = layout(*shape)
    return (
        np.frombuffer(memory, np.intp, REPORT * m, reports).reshape(m, REPORT),
        np.frombuffer(memory, np.float64, m * n_theta, thetas).reshape(m, n_theta),
        np.frombuffer(memory, np.float64, m * n_times * n_outputs, outputs).reshape(m, n_times, n_outputs),
    )


def start(components: dict[str, Any], limit: int, renewal: int | None) -> None:
    """Make the system that this process runs (`fmuid.simulation.executor.InProcessExecutor`)."""
    from fmuid.simulation.executor import InProcessExecutor
    from fmuid.simulation.instance_registry import Renewal

    _executor[:] = [InProcessExecutor(components, limit, None if renewal is None else Renewal(renewal))]


def know(number: int, simulation: GridSimulation, forgotten: Sequence[int]) -> None:
    """Remember a run by its number, and forget others."""
    for each in forgotten:
        _runs.pop(each, None)
    _runs[number] = simulation


def run(
    number: int, shape: tuple[int, int, int, int], size: int, varying: Sequence[Sequence[Any]]
) -> tuple[list[int], float, int | None]:
    """Simulate; return which components were found stiff, the longest simulation, s, and what it takes (`Renewal`)."""
    simulation, (executor,) = _runs[number], _executor
    if not _memory or len(_memory[0]) != size:
        _memory[:] = [shared_memory(size)]
        executor.show_doing(np.frombuffer(_memory[0], np.intp, DOING_WORDS))
    for given, new in zip(simulation.varying, varying, strict=True):
        for array, values in zip((given.magnitudes, given.initial, given.steps), new, strict=True):
            array[:] = values
    reports, thetas, outputs = arrays(_memory[0], shape)
    before = [each and each.integrator for each in simulation.plan.integrations]
    executor.run(simulation, thetas, outputs, reports)
    after = [each and each.integrator for each in simulation.plan.integrations]
    stiff = [i for i, pair in enumerate(zip(before, after, strict=True)) if pair[0] != pair[1]]
    return stiff, executor.longest, None if executor.renewal is None else int(executor.renewal)


def failure(number: int, *arguments: Any) -> SimulationError | None:
    """Return what outputs and report of a simulation say (`InProcessExecutor.failure`)."""
    (executor,) = _executor
    return executor.failure(_runs[number], *arguments)


def close() -> None:
    """Free all instances."""
    for executor in _executor:
        executor.close()


def watch() -> None:
    """Let all threads of this process write what they are doing where the other side sees it."""
    from fmuid.simulation.worker import shared_words

    shared_words.append(np.frombuffer(shared_memory(8 * DOING_WORDS), np.intp, DOING_WORDS))
