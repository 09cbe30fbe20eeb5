"""Far side of process isolation: orders to a process of FMUs.

Thetas, outputs and reports are in memory shared by both sides (`layout`).
"""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.errors import SimulationError
from fmuid.processes import shared_memory
from fmuid.simulation.codes import REPORT
from fmuid.simulation.instance_registry import Renewal
from fmuid.simulation.simulation_plan import GridSimulation, SimulationJob

if TYPE_CHECKING:
    from fmuid.simulation.executor import InProcessExecutor

DOING_WORDS = 512
"""Words at the beginning of the shared memory: two for each thread, what it is doing and how often it has begun."""

Arrays = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]

_memory: list[mmap.mmap] = []
_executor: list[InProcessExecutor] = []
_runs: dict[int, GridSimulation] = {}


def layout(m: int, n_theta: int, n_times: int, n_outputs: int) -> tuple[int, int, int, int]:
    """Return offsets of reports, thetas and outputs, and the size, bytes."""
    reports = 8 * DOING_WORDS
    thetas = reports + 8 * REPORT * m
    outputs = thetas + 8 * m * n_theta
    return reports, thetas, outputs, outputs + 8 * m * n_times * n_outputs


def arrays(memory: mmap.mmap, shape: tuple[int, int, int, int]) -> Arrays:
    """Return reports, thetas and outputs of shape (m, N, K, n_outputs)."""
    m, n_theta, n_times, n_outputs = shape
    reports, thetas, outputs, _ = layout(*shape)
    return (
        np.frombuffer(memory, np.intp, REPORT * m, reports).reshape(m, REPORT),
        np.frombuffer(memory, np.float64, m * n_theta, thetas).reshape(m, n_theta),
        np.frombuffer(memory, np.float64, m * n_times * n_outputs, outputs).reshape(m, n_times, n_outputs),
    )


def start(components: dict[str, Any], limit: int, renewal: int | None) -> None:
    """Make the executor of this process; its threads' words of state are in their order."""
    from fmuid.simulation.executor import InProcessExecutor

    watch()
    _executor[:] = [InProcessExecutor(components, limit, set(), None if renewal is None else Renewal(renewal))]


def know(number: int, simulation: GridSimulation, forgotten: Sequence[int]) -> None:
    """Remember a run by its number, and forget others."""
    for each in forgotten:
        _runs.pop(each, None)
    _runs[number] = simulation


def run(
    number: int, shape: tuple[int, int, int, int], size: int, varying: Sequence[Floats]
) -> tuple[list[int], float, int | None]:
    """Simulate; return stiff components, longest simulation, s, and `Renewal`."""
    simulation, (executor,) = _runs[number], _executor
    if not _memory or len(_memory[0]) != size:
        _memory[:] = [shared_memory(size)]
    for array, values in zip(simulation.varying, varying, strict=True):
        array[:] = values
    reports, thetas, outputs = arrays(_memory[0], shape)
    before = [each and each.integrator for each in simulation.plan.integrations]
    executor.run(SimulationJob(simulation, thetas, outputs, reports))
    after = [each and each.integrator for each in simulation.plan.integrations]
    stiff = [i for i, pair in enumerate(zip(before, after, strict=True)) if pair[0] != pair[1]]
    return stiff, executor.longest, None if executor.renewal is None else int(executor.renewal)


def failure(
    number: int, thetas: Floats, outputs: Floats, reports: Indices, parameters: dict[str, float], explain: bool
) -> SimulationError | None:
    """Return the error of a simulation (`InProcessExecutor.failure`)."""
    return _executor[0].failure(SimulationJob(_runs[number], thetas, outputs, reports), parameters, explain)


def close() -> None:
    """Free all instances."""
    for executor in _executor:
        executor.close()


def watch() -> None:
    """Let this process's threads write their states where others see them."""
    from fmuid.simulation.worker import shared_words

    shared_words.append(np.frombuffer(shared_memory(8 * DOING_WORDS), np.intp, DOING_WORDS))
