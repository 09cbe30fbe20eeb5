"""One instance per component, kept by one thread and reset between simulations."""

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

from fmuid.array_types import Indices
from fmuid.errors import InputError, SimulationError
from fmuid.models import Component
from fmuid.simulation import codes
from fmuid.simulation.instance import Instance, warn
from fmuid.simulation.instance_registry import Renewal, is_repeated, label, labels, needs_process, note_process
from fmuid.simulation.simulation_loop import SimulationLoop
from fmuid.simulation.simulation_plan import GridSimulation, SimulationJob

_log = logging.getLogger("fmuid.fmu")
# Longest that one call of the core should last, s: between calls an interruption gets through.
CALL_SECONDS = 0.2


shared_words: list[Indices] = []
"""Where the threads of a process that is watched write what they are doing; empty in any other."""

_slots = itertools.count()


def _words() -> Indices:
    if not shared_words:
        return np.zeros(2, np.intp)
    at = 2 * next(_slots) % len(shared_words[0])
    return shared_words[0][at : at + 2]


class SimulationThread:
    """One instance per component, used by one thread: some FMUs keep thread-local data.

    Thread 0 is the caller's own. `renewal` None is not known yet. `told` are warnings passed on so far.
    """

    doing: Indices  # state (`codes.IDLE` ...) and number of simulations (2,)
    longest: float  # duration of the longest simulation, s

    def __init__(
        self, components: Mapping[str, Component], index: int, told: set[str], renewal: Renewal | None = None
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
        self._told = told
        self.doing = _words()
        self.longest = 0.0

    def start(self, task: Callable[..., None], *arguments: Any) -> Future[None] | None:
        """Run a task in this thread, or return a future; an OSError without threads."""
        self._cancelled = False
        if self._executor is not None:
            try:
                return self._executor.submit(task, *arguments)
            except RuntimeError as error:  # what Python makes of pthread_create's EAGAIN
                raise OSError(errno.EAGAIN, str(error)) from error
        task(*arguments)
        return None

    def run(self, job: SimulationJob) -> None:
        """Fill in outputs and reports of a job."""
        done = 0
        while done < len(job) and not self._cancelled:
            share = max(1, int(CALL_SECONDS / self._seconds)) if self.renewal is Renewal.RESET else 1
            part = job[done : done + share]
            began = time.perf_counter()
            self._call(part)
            self._seconds = max((time.perf_counter() - began) / share, 1e-6)
            if (part.reports[:, 2] == codes.DONE_WELL).all():
                if self.renewal is None and np.isfinite(part.outputs).all():
                    with self._busy(codes.REPEATING):
                        self._judge_reset(part)
            else:
                part = self._valid(part)
                if (part.reports[part.failed, 2] >= codes.FATAL).any():
                    self.close(fatal=True)
            done += len(part)
        for instance in self._instances:
            if not job.failed.any():
                warn(instance, self._told)
            instance.forget_messages()

    def _valid(self, part: SimulationJob) -> SimulationJob:
        """Return the valid part of a call; the rest is simulated again."""
        again = part.reports[:, 2] == codes.UNDONE  # after a fatal failure
        if self.renewal is Renewal.RESET and self._can_be_replaced:
            stuck = part.reports[:, 0] == codes.RESET  # spoilt by the simulation before
            if stuck.any():
                self.close(fatal=bool((part.reports[stuck, 2] >= codes.FATAL).any()))
            again |= stuck
        return part[: int(np.argmax(again))] if again.any() else part

    def _judge_reset(self, first: SimulationJob) -> None:
        """Repeat the first simulation after a reset, then by a new instance."""
        same, fatal = self._repeats(first)
        if same:
            self.renewal = Renewal.RESET
            return
        self.close(fatal)
        if self._can_be_replaced:
            self._prepare()
            same, fatal = self._repeats(first)
            self.close(fatal)
        if self._cancelled:  # a repetition that was cut short says nothing of the FMU
            return
        if same:
            self._give_up_reset()
        else:
            self.renewal = Renewal.PROCESS
            note_process(self._components.values())

    def _repeats(self, first: SimulationJob) -> tuple[bool, bool]:
        """Simulate again; return whether outputs are the same, and fatality."""
        again = first.simulation.job(first.thetas)
        self._simulate(again)
        return not again.failed[0] and is_repeated(again.outputs, first.outputs), self._is_fatal(again)

    @staticmethod
    def _is_fatal(job: SimulationJob) -> bool:
        return bool(job.reports[0, 2] >= codes.FATAL)

    def _give_up_reset(self, fatal: bool = False) -> None:
        self.renewal = Renewal.INSTANCE if self._can_be_replaced else Renewal.PROCESS
        self.close(fatal)
        if self._index == 0 and self.renewal is Renewal.INSTANCE:
            _log.warning(
                "%s: its reset does not work; each simulation uses a new instance, which is slow",
                labels(self._components),
                extra={"no_reset": True},
            )

    @contextmanager
    def _busy(self, doing: int) -> Iterator[None]:
        before, self.doing[0] = int(self.doing[0]), doing
        try:
            yield
        finally:
            self.doing[0] = before

    def explain(self, failed: SimulationJob, parameters: Mapping[str, float]) -> SimulationError | None:
        """Repeat a failed simulation with the FMU's debug log; return its error."""
        job = failed.simulation.job(failed.thetas)
        if self.renewal is not Renewal.RESET and (self.renewal is not None or self._can_be_replaced):
            self.close()  # whether a reset undoes the failure is not known
        self._prepare()
        for instance in self._instances:
            instance.forget_messages()
            instance.set_logging(True)
        self._simulate(job)
        error = self.error(job, parameters)
        if self._is_fatal(job):
            self.close(fatal=True)
        for instance in self._instances:
            instance.set_logging(False)
            instance.forget_messages()
        return error

    def error(self, job: SimulationJob, parameters: Mapping[str, float]) -> SimulationError | None:
        """Return the error of a job of one simulation; None without one."""
        simulation, outputs, report = job.simulation, job.outputs[0], job.reports[0]
        function, component, _, sample = (int(word) for word in report[:4])
        if function >= 0:
            at = float(simulation.grid.times[max(sample, 0)])
            if function == codes.LOOP:
                loop = simulation.plan.loops[component]
                what = f"no solution found for the algebraic loop {loop.words} ({len(loop.signals)} unknowns)"
                return SimulationError(labels(self._components), at, parameters, what, [])
            said = _last_words(self._instances[component]) if self._instances else []
            what = self._describe(simulation, report)
            return SimulationError(label(*list(self._components.items())[component]), at, parameters, what, said)
        finite = np.isfinite(outputs)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            what = f"output {simulation.output_names[column]!r} is not finite"
            said = [text for instance in self._instances for text in _last_words(instance)]
            return SimulationError(labels(self._components), float(simulation.grid.times[row]), parameters, what, said)
        return None

    def _describe(self, simulation: GridSimulation, report: Indices) -> str:
        failure, component, status, _, bad = (int(word) for word in report[:5])
        time, step = (float(number) for number in report[5:].view(np.float64))
        description = list(self._components.values())[component].fmu.description
        integration, count = simulation.plan.integrations[component], len(description.states)
        state = description.states[bad % count] if bad >= 0 and count else "of the model"
        state += f" (its sensitivity to parameter {bad // count})" if count and bad >= count else ""
        integrator = integration.integrator if integration else ""
        return codes.describe(failure, status, description.major_version, integrator, state, (time, step))

    def close(self, fatal: bool = False) -> None:
        """Free the instances; after a fatal error they are left alone."""
        with self._busy(codes.CLOSING):
            for instance in self._instances:
                instance.close(fatal)
        self._instances = []
        self._loops.clear()

    def cancel(self, simulation: GridSimulation) -> None:
        """End the simulations of a run; it must be forgotten afterwards."""
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

    def check_process(self) -> None:
        """Refuse a second simulation in a process that allows one (InputError)."""
        if self.renewal is not Renewal.PROCESS or not self._spent:
            return
        kept = "it keeps data outside its instances"
        why = kept if self._can_be_replaced else "it declares one instance per process"
        raise InputError(
            f"{labels(self._components)}: its reset does not work and {why}, so only one simulation is possible. "
            "Use process isolation (isolation=fmuid.Isolation()), or export the FMU with a working reset."
        )

    def _prepare(self) -> None:
        if not self._instances:
            self.check_process()
            with self._busy(codes.PREPARING):
                for component, model in self._components.items():
                    name = f"{component or model.fmu.name}-{self._index}"
                    self._instances.append(Instance(model.fmu, model.kind, name))
            self._used = np.zeros(len(self._instances), np.intp)

    def _call(self, job: SimulationJob) -> None:
        if self.renewal not in (None, Renewal.RESET):
            self.close()
        self._prepare()
        self._simulate(job)
        if self.renewal is None and job.reports[0, 0] == codes.RESET:  # the simulation before failed: nothing was known
            self._give_up_reset(self._is_fatal(job))
            self._prepare()
            self._simulate(job)

    def _simulate(self, job: SimulationJob) -> None:
        simulation = job.simulation
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
            loop.run(job.thetas, job.outputs, job.reports)
        self.longest = max(self.longest, (time.perf_counter() - began) / len(job))


def _last_words(instance: Instance) -> list[str]:
    """Return the last three distinct messages, warnings and errors first."""
    serious = [text for status, text in instance.messages if status > 0]
    words = serious or [text for _, text in instance.messages]
    return list(dict.fromkeys(words))[-3:]
