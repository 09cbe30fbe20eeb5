"""One instance of every component of a system, kept and reused by one thread, reset between simulations."""

from __future__ import annotations

import errno
import itertools
import logging
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.errors import InputError, SimulationError
from fmuid.models import Component
from fmuid.simulation import codes
from fmuid.simulation.failures import describe
from fmuid.simulation.instance import Instance, warn
from fmuid.simulation.instance_registry import Renewal, is_repeated, needs_process, note_process
from fmuid.simulation.simulation_loop import SimulationLoop
from fmuid.simulation.simulation_plan import GridSimulation, new_reports

_log = logging.getLogger("fmuid.fmu")
# Longest that one call of the core should last, s: between calls an interruption gets through.
CALL_SECONDS = 0.2
FATAL = 4  # fmi2Fatal
MESSAGES_TOLD = 3  # of one failed simulation


shared_words: list[Indices] = []
"""Where the threads of a process that is watched write what they are doing; empty in any other."""

_slots = itertools.count()


def _words() -> Indices:
    if not shared_words:
        return np.zeros(2, np.intp)
    at = 2 * next(_slots) % len(shared_words[0])
    return shared_words[0][at : at + 2]


class SimulationThread:
    """One instance of every component of a system, used by one thread only.

    All calls to an instance, from instantiation to freeing, come from the same thread: some FMUs keep
    thread-local data. The first is the caller's own thread.

    Parameters
    ----------
    components : mapping of str to Component
    index : int
        Its number; 0 is the caller's own thread.
    renewal : Renewal, optional
        What brings it back to its beginning; default: found out with the first simulation.
    told : set of str, optional
        The warnings that were passed on, shared by the threads of a system.

    Attributes
    ----------
    doing : (2,) array of intp
        What it is doing now (`codes.IDLE` and so on), and how often it was told to simulate.
    longest : float
        Duration of the longest simulation so far, s.
    renewal : Renewal or None
        None: not known yet.
    """

    def __init__(
        self,
        components: Mapping[str, Component],
        index: int,
        renewal: Renewal | None = None,
        told: set[str] | None = None,
    ) -> None:
        self._components, self._index = components, index
        self._spent = needs_process(components.values())  # what a process allows only once was done
        self.renewal = Renewal.PROCESS if self._spent else renewal
        self._executor = ThreadPoolExecutor(1, f"fmuid-{index}") if index else None
        self._instances: list[Instance] = []
        self._loops: weakref.WeakKeyDictionary[GridSimulation, SimulationLoop] = weakref.WeakKeyDictionary()
        self._used = np.zeros(0, np.intp)
        self._seconds = CALL_SECONDS  # of one simulation, as last measured
        self._cancelled = False
        self._told = set[str]() if told is None else told
        self.doing = _words()
        self.longest = 0.0

    def start(self, task: Callable[..., None], *arguments: Any) -> Future[None] | None:
        """Run a task in this thread: at once, or returning a future; an OSError where it cannot have one."""
        self._cancelled = False
        if self._executor is not None:
            try:
                return self._executor.submit(task, *arguments)
            except RuntimeError as error:  # what Python makes of pthread_create's EAGAIN
                raise OSError(errno.EAGAIN, str(error)) from error
        task(*arguments)
        return None

    def run(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N) into outputs (m, K, n_y) and reports (m, codes.REPORT)."""
        done = 0
        while done < len(thetas) and not self._cancelled:
            share = max(1, int(CALL_SECONDS / self._seconds)) if self.renewal is Renewal.RESET else 1
            part = slice(done, min(len(thetas), done + share))
            began = time.perf_counter()
            self._call(simulation, thetas[part], outputs[part], reports[part])
            self._seconds = max((time.perf_counter() - began) / share, 1e-6)
            if (reports[part, 2] == codes.DONE_WELL).all():
                if self.renewal is None:
                    self._try_reset(simulation, thetas[part], outputs[part])
            else:
                part = self._valid(part, reports)
                if (reports[part, 2][reports[part, 0] >= 0] >= FATAL).any():
                    self.close(fatal=True)
            done = part.stop
        self._pass_on_warnings(reports)

    def _valid(self, part: slice, reports: Indices) -> slice:
        """Return the part of a call that counts; what comes after it is simulated again by another instance."""
        begun = reports[part]
        again = begun[:, 2] == codes.UNDONE  # the one before them failed fatally
        if (
            self.renewal is Renewal.RESET and self._can_be_replaced
        ):  # what they were to begin with was spoilt by the one before them
            stuck = begun[:, 0] == codes.RESET
            if stuck.any():
                self.close(fatal=bool((begun[stuck, 2] >= FATAL).any()))
            again |= stuck
        return slice(part.start, part.start + int(np.argmax(again)) if again.any() else part.stop)

    def _try_reset(self, simulation: GridSimulation, theta: Floats, expected: Floats) -> None:
        """Repeat the first simulation, after a reset and by a new instance: find out what an FMU needs every time."""
        if not np.isfinite(expected).all():
            return
        with self._busy(codes.REPEATING):
            self._judge_reset(simulation, theta, expected)

    def _judge_reset(self, simulation: GridSimulation, theta: Floats, expected: Floats) -> None:
        same, fatal = self._repeats(simulation, theta, expected)
        if same:
            self.renewal = Renewal.RESET
            return
        self.close(fatal)
        if self._can_be_replaced:
            self._prepare()
            same, fatal = self._repeats(simulation, theta, expected)
            self.close(fatal)
        if same:
            self._give_up_reset()
        else:
            self.renewal = Renewal.PROCESS
            note_process(self._components.values())

    def _repeats(self, simulation: GridSimulation, theta: Floats, expected: Floats) -> tuple[bool, bool]:
        """Simulate again; return whether the outputs are the same, and whether the FMU failed fatally."""
        outputs, report = np.empty_like(expected), new_reports(1)
        self._simulate(simulation, theta, outputs, report)
        return report[0, 0] < 0 and is_repeated(outputs, expected), bool(report[0, 0] >= 0 and report[0, 2] >= FATAL)

    def _give_up_reset(self, fatal: bool = False) -> None:
        self.renewal = Renewal.INSTANCE if self._can_be_replaced else Renewal.PROCESS
        self.close(fatal)
        if self._index == 0 and self.renewal is Renewal.INSTANCE:
            _log.warning(
                "%s: a reset does not bring it back to its beginning, so it is instantiated anew for every "
                "simulation, which is slow and, for some FMUs, fails after a thousand times",
                ", ".join(self._labels),
                extra={"no_reset": True},
            )

    def _pass_on_warnings(self, reports: Indices) -> None:
        for instance in self._instances:
            if instance.messages and not (reports[:, 0] >= 0).any():
                warn(instance, self._told)
            instance.forget_messages()

    @contextmanager
    def _busy(self, doing: int) -> Iterator[None]:
        before, self.doing[0] = int(self.doing[0]), doing
        try:
            yield
        finally:
            self.doing[0] = before

    def explain(
        self, simulation: GridSimulation, theta: Floats, parameters: Mapping[str, float]
    ) -> SimulationError | None:
        """Repeat a failed simulation with the FMU's debug log on; return the error (None if it succeeds now)."""
        outputs = np.empty((1, simulation.grid.times.size, len(simulation.output_names)))
        reports = new_reports(1)
        if self.renewal is not Renewal.RESET and (self.renewal is not None or self._can_be_replaced):
            self.close()  # whether a reset undoes the failure is not known
        self._prepare()
        for instance in self._instances:
            instance.forget_messages()
            instance.set_logging(True)
        self._simulate(simulation, theta[np.newaxis], outputs, reports)
        error = self.error(simulation, outputs[0], reports[0], parameters)
        if reports[0, 0] >= 0 and reports[0, 2] >= FATAL:
            self.close(fatal=True)
        for instance in self._instances:
            instance.set_logging(False)
            instance.forget_messages()
        return error

    def error(
        self, simulation: GridSimulation, outputs: Floats, report: Indices, parameters: Mapping[str, float]
    ) -> SimulationError | None:
        """Return what a report and the outputs say, as an error; None where the simulation succeeded."""
        function, component, _, sample = (int(word) for word in report[:4])
        if function >= 0:
            at = float(simulation.grid.times[max(sample, 0)])
            if function == codes.LOOP:
                loop = simulation.plan.loops[component]
                what = f"the loop of direct feed-through through {loop.words} ({len(loop.signals)} unknowns) has no "
                return SimulationError(", ".join(self._labels), at, parameters, what + "solution that is found", [])
            said = _last_words(self._instances[component]) if self._instances else []
            what = self._describe(simulation, report)
            return SimulationError(self._labels[component], at, parameters, what, said)
        finite = np.isfinite(outputs)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            what = f"output {simulation.output_names[column]!r} is not finite"
            said = [text for instance in self._instances for text in _last_words(instance)]
            return SimulationError(", ".join(self._labels), float(simulation.grid.times[row]), parameters, what, said)
        return None

    def _describe(self, simulation: GridSimulation, report: Indices) -> str:
        failure, component, status, _, bad = (int(word) for word in report[:5])
        time, step = (float(number) for number in report[5:].view(np.float64))
        description = list(self._components.values())[component].fmu.description
        integration, count = simulation.plan.integrations[component], len(description.states)
        state = description.states[bad % count] if bad >= 0 and count else "of the model"
        state += f" (its sensitivity to parameter {bad // count})" if count and bad >= count else ""
        integrator = integration.integrator if integration else ""
        return describe(failure, status, description.major_version, integrator, state, (time, step))

    def close(self, fatal: bool = False) -> None:
        """Free the instances; after a fatal error they are left alone."""
        with self._busy(codes.CLOSING):
            for instance in self._instances:
                instance.close(fatal)
        self._instances = []
        self._loops.clear()

    def cancel(self, simulation: GridSimulation) -> None:
        """Let the simulations of a run end soon, as failed; it must be forgotten before its next one."""
        self._cancelled = True
        loop = self._loops.get(simulation)
        if loop is not None:
            loop.cancel()

    def forget(self, simulation: GridSimulation) -> None:
        """Lay a run out anew before its next simulation."""
        self._loops.pop(simulation, None)

    def shut_down(self) -> None:
        """Free the instances in their own thread and end it."""
        future = self.start(self.close)
        if self._executor is not None and future is not None:
            future.result()
            self._executor.shutdown()

    @property
    def _can_be_replaced(self) -> bool:
        used = [model.fmu.description.interfaces[model.kind] for model in self._components.values()]
        return not any(interface.once_per_process for interface in used)

    @property
    def _labels(self) -> list[str]:
        paths = {name: model.fmu.path for name, model in self._components.items()}
        return [f"{name} ({path})" if name else str(path) for name, path in paths.items()]

    def check_process(self) -> None:
        """Refuse to go on where a process allows one simulation only, and that is done.

        Raises
        ------
        InputError
        """
        if self.renewal is not Renewal.PROCESS or not self._spent:
            return
        why = "it declares that a process may instantiate it only once"
        if self._can_be_replaced:
            why = "not even a new instance does: it keeps something outside its instances"
        raise InputError(
            f"{', '.join(self._labels)} can be simulated only once in a process: a reset does not bring it back to its "
            f"beginning, and {why}; run it isolated (isolation=fmuid.Isolation(), the default of commands), or export "
            "it with a reset that works"
        )

    def _prepare(self) -> None:
        if not self._instances:
            self.check_process()
            with self._busy(codes.PREPARING):
                for component, model in self._components.items():
                    name = f"{component or model.fmu.name}-{self._index}"
                    self._instances.append(Instance(model.fmu, model.kind, name))
            self._used = np.zeros(len(self._instances), np.intp)

    def _call(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        if self.renewal not in (None, Renewal.RESET):
            self.close()
        self._prepare()
        self._simulate(simulation, thetas, outputs, reports)
        if self.renewal is None and reports[0, 0] == codes.RESET:  # the simulation before failed: nothing was known
            self._give_up_reset(fatal=reports[0, 2] >= FATAL)
            self._prepare()
            self._simulate(simulation, thetas, outputs, reports)

    def _simulate(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        loop = self._loops.get(simulation)
        if loop is None:
            with self._busy(codes.PREPARING):
                loop = self._loops[simulation] = SimulationLoop(
                    simulation.plan, simulation.grid, self._instances, self._used
                )
        if self._cancelled:
            loop.cancel()
        began = time.perf_counter()
        self.doing[1] += 1
        self._spent = True
        with self._busy(max(codes.SIMULATING, int(self.doing[0]))):
            loop.run(thetas, outputs, reports)
        self.longest = max(self.longest, (time.perf_counter() - began) / len(thetas))


def _last_words(instance: Instance) -> list[str]:
    """Return the last distinct messages of an instance, warnings and errors before mere information."""
    serious = [text for status, text in instance.messages if status > 0]
    words = serious or [text for _, text in instance.messages]
    return list(dict.fromkeys(words))[-MESSAGES_TOLD:]
