"""Instances of a system, kept and reused: one set for each thread, instantiated once, reset between simulations."""

from __future__ import annotations

import itertools
import logging
import os
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmuid.component import Component
from fmuid.errors import SimulationError
from fmuid.fmi import kernels
from fmuid.fmi.instance import Instance, describe_failure, status_word, warn
from fmuid.fmi.loop import Loop
from fmuid.plan import PlannedRun
from fmuid.system import System

Array = NDArray[np.float64]
_log = logging.getLogger("fmuid.fmu")
# Longest that one compiled call should last, s: between calls an interruption gets through.
CALL_SECONDS = 0.2
FATAL = 4  # fmi2Fatal
# Two simulations with the same parameters, before and after a reset, may differ by this share of the largest output:
# an integrator that keeps its last step length is still the same model.
RESET_TOLERANCE = 1e-6
MESSAGES_TOLD = 3  # of one failed simulation


class Worker:
    """One instance of every component of a system, used by one thread only.

    All calls to an instance, from instantiation to freeing, come from the same thread: some FMUs keep
    thread-local data. The first worker is the caller's own thread, the others have one each.
    """

    def __init__(self, components: Mapping[str, Component], index: int) -> None:
        self._components, self._index = components, index
        self._executor = ThreadPoolExecutor(1, f"fmuid-{index}") if index else None
        self._instances: list[Instance] = []
        self._loops: weakref.WeakKeyDictionary[PlannedRun, Loop] = weakref.WeakKeyDictionary()
        self._used = np.zeros(0, np.intp)
        self._seconds = CALL_SECONDS  # of one simulation, as last measured
        self._resets: bool | None = None  # whether fmi2Reset brings an instance back to its beginning; not yet known
        self._told: set[str] = set()

    def start(self, task: Callable[..., None], *arguments: Any) -> Future[None] | None:
        """Run a task in this worker's thread: at once, or returning a future."""
        if self._executor is not None:
            return self._executor.submit(task, *arguments)
        task(*arguments)
        return None

    def run(self, run: PlannedRun, thetas: Array, outputs: Array, reports: NDArray[np.intp]) -> None:
        """Simulate all thetas (m, N) into outputs (m, K, n_y) and reports (m, 4)."""
        done = 0
        while done < len(thetas):
            share = max(1, int(CALL_SECONDS / self._seconds)) if self._resets else 1
            part = slice(done, min(len(thetas), done + share))
            began = time.perf_counter()
            self._call(run, thetas[part], outputs[part], reports[part])
            self._seconds = max((time.perf_counter() - began) / share, 1e-6)
            failed = bool((reports[part, 0] >= 0).any())
            if failed and (reports[part, 2][reports[part, 0] >= 0] >= FATAL).any():
                self.close(fatal=True)
            elif not failed and self._resets is None:
                self._try_reset(run, thetas[part], outputs[part])
            done = part.stop
        self._pass_on_warnings(failed=bool((reports[:, 0] >= 0).any()))

    def _try_reset(self, run: PlannedRun, theta: Array, expected: Array) -> None:
        """Repeat the first simulation after a reset: an FMU that keeps something is instantiated anew every time."""
        if not np.isfinite(expected).all():
            return
        same, fatal = self._repeats(run, theta, expected)
        self._resets = same
        if not same:
            self._give_up_reset(fatal)
        if not same and self._can_be_replaced:
            self._prepare()
            same, fatal = self._repeats(run, theta, expected)
            self.close(fatal)
            if not same and self._index == 0:
                _log.warning(
                    "%s: not even a new instance begins where the first did: the FMU keeps something outside its "
                    "instances, and results depend on the simulations before them",
                    ", ".join(self._labels),
                )

    def _repeats(self, run: PlannedRun, theta: Array, expected: Array) -> tuple[bool, bool]:
        """Simulate again; return whether the outputs are the same, and whether the FMU failed fatally."""
        outputs, report = np.empty_like(expected), np.empty((1, 4), np.intp)
        self._simulate(run, theta, outputs, report)
        tolerance = RESET_TOLERANCE * np.abs(expected).max(initial=0.0)
        same = report[0, 0] < 0 and np.allclose(outputs, expected, rtol=0.0, atol=tolerance)
        return bool(same), bool(report[0, 0] >= 0 and report[0, 2] >= FATAL)

    def _give_up_reset(self, fatal: bool = False) -> None:
        self._resets = False
        self.close(fatal)
        if self._index == 0:
            _log.warning(
                "%s: a reset does not bring it back to its beginning, so it is instantiated anew for every "
                "simulation, which is slow and, for some FMUs, fails after a thousand times",
                ", ".join(self._labels),
            )

    def _pass_on_warnings(self, failed: bool) -> None:
        for instance in self._instances:
            if instance.messages and not failed:
                warn(instance, self._told)
            instance.messages.clear()

    def explain(self, run: PlannedRun, theta: Array, parameters: Mapping[str, float]) -> SimulationError | None:
        """Repeat a failed simulation with the FMU's debug log on; return the error (None if it succeeds now)."""
        outputs = np.empty((1, run.grid.times.size, len(run.output_names)))
        reports = np.empty((1, 4), np.intp)
        if self._resets is False or (self._resets is None and self._can_be_replaced):
            self.close()  # whether a reset undoes the failure is not known
        self._prepare()
        for instance in self._instances:
            instance.messages.clear()
            instance.set_logging(True)
        self._simulate(run, theta[np.newaxis], outputs, reports)
        error = self.error(run, outputs[0], reports[0], parameters)
        if reports[0, 0] >= 0 and reports[0, 2] >= FATAL:
            self.close(fatal=True)
        for instance in self._instances:
            instance.set_logging(False)
            instance.messages.clear()
        return error

    def error(
        self, run: PlannedRun, outputs: Array, report: NDArray[np.intp], parameters: Mapping[str, float]
    ) -> SimulationError | None:
        """Return what a report and the outputs say, as an error; None where the simulation succeeded."""
        function, component, status, sample = (int(word) for word in report)
        if function >= 0:
            at = float(run.grid.times[max(sample, 0)])
            if function == kernels.LOOP:
                return SimulationError(", ".join(self._labels), at, parameters, run.describe_loop(component), [])
            said = _last_words(self._instances[component]) if self._instances else []
            what = self._describe(run, component, function, status)
            return SimulationError(self._labels[component], at, parameters, what, said)
        bad = np.argwhere(~np.isfinite(outputs))
        if len(bad):
            row, column = bad[0]
            what = f"output {run.output_names[column]!r} is not finite"
            said = [text for instance in self._instances for text in _last_words(instance)]
            return SimulationError(", ".join(self._labels), float(run.grid.times[row]), parameters, what, said)
        return None

    def _describe(self, run: PlannedRun, component: int, function: int, status: int) -> str:
        model = list(self._components.values())[component]
        version = model.fmu.description.major_version
        if function < kernels.STEPPER:
            return describe_failure(version, function, status)
        if model.kind == "co-simulation":
            from fmuid.fmi.co_simulation import describe

            return describe(function - kernels.STEPPER, status_word(version, status))
        from fmuid.fmi import integrators

        integration, loop = run.plan.integrations[component], self._loops.get(run)
        integrator = integration.integrator if integration else ""
        bad = loop.bad_state(component) if loop is not None else "of the model"
        at, step = loop.whereabouts(component) if loop is not None else (np.nan, np.nan)
        return integrators.describe(function - kernels.STEPPER, status, version, integrator, bad, at, step)

    def close(self, fatal: bool = False) -> None:
        """Free the instances; after a fatal error they are left alone."""
        for instance in self._instances:
            instance.close(fatal)
        self._instances = []
        self._loops.clear()

    def forget(self, run: PlannedRun) -> None:
        """Lay a run out anew before its next simulation."""
        self._loops.pop(run, None)

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

    def _prepare(self) -> None:
        if not self._instances:
            for component, model in self._components.items():
                name = f"{component or model.fmu.name}-{self._index}"
                self._instances.append(Instance(model.fmu, model.kind, name))
            self._used = np.zeros(len(self._instances), np.intp)

    def _call(self, run: PlannedRun, thetas: Array, outputs: Array, reports: NDArray[np.intp]) -> None:
        if self._resets is False:
            self.close()
        self._prepare()
        self._simulate(run, thetas, outputs, reports)
        if self._resets is None and reports[0, 0] == kernels.RESET:  # the simulation before failed: nothing was known
            self._give_up_reset(fatal=reports[0, 2] >= FATAL)
            self._prepare()
            self._simulate(run, thetas, outputs, reports)

    def _simulate(self, run: PlannedRun, thetas: Array, outputs: Array, reports: NDArray[np.intp]) -> None:
        loop = self._loops.get(run)
        if loop is None:
            loop = self._loops[run] = Loop(run.plan, run.grid, self._instances, self._used)
        loop.run(thetas, outputs, reports)


def _last_words(instance: Instance) -> list[str]:
    """Return the last distinct messages of an instance, warnings and errors before mere information."""
    serious = [text for status, text in instance.messages if status > 0]
    words = serious or [text for _, text in instance.messages]
    return list(dict.fromkeys(words))[-MESSAGES_TOLD:]


class Workers:
    """The workers of one system, shared by all its simulators, as many as the FMUs and the machine allow."""

    def __init__(self, components: Mapping[str, Component], limit: int) -> None:
        self.lock = threading.RLock()
        self._components, self._limit = components, limit
        self._workers = [Worker(components, 0)]

    def run(self, run: PlannedRun, thetas: Array, outputs: Array, reports: NDArray[np.intp]) -> None:
        """Simulate all thetas, in equal shares over the workers; a model found stiff is run again as such."""
        self._run_shares(run, thetas, outputs, reports)
        if any(run.plan.integrations) and self._found_stiff(reports):
            run.integrate_as_now_chosen()
            for worker in self._workers:
                worker.forget(run)
            self._run_shares(run, thetas, outputs, reports)

    def _found_stiff(self, reports: NDArray[np.intp]) -> bool:
        """Mark the models that the default integrator has found stiff; return whether there are any."""
        from fmuid.fmi.block import STIFF

        stiff = {int(component) for function, component, _, _ in reports if function == kernels.STEPPER + STIFF}
        models = [list(self._components.values())[component] for component in stiff]
        undecided = [model for model in models if model.numerics.integrator is None]
        for model in undecided:
            model.stiff = True
        return bool(undecided)

    def _run_shares(self, run: PlannedRun, thetas: Array, outputs: Array, reports: NDArray[np.intp]) -> None:
        count = min(self._limit, len(thetas))
        while len(self._workers) < count:
            self._workers.append(Worker(self._components, len(self._workers)))
        edges = [len(thetas) * i // count for i in range(count + 1)]
        shares = [slice(a, b) for a, b in itertools.pairwise(edges)]
        futures: list[Future[None]] = []
        try:
            for i in reversed(range(count)):  # the caller's own share last: it is worked off at once
                future = self._workers[i].start(
                    self._workers[i].run, run, thetas[shares[i]], outputs[shares[i]], reports[shares[i]]
                )
                futures += [future] if future else []
        finally:
            if futures:
                wait(futures)
        for future in futures:
            future.result()

    @property
    def first(self) -> Worker:
        """The worker of the caller's own thread."""
        return self._workers[0]

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""
        with self.lock:
            for worker in self._workers:
                worker.shut_down()
            self._workers = [Worker(self._components, 0)]


# Workers know the components but not the system, so that an entry goes, and frees its instances, with its system.
_workers: weakref.WeakKeyDictionary[System, Workers] = weakref.WeakKeyDictionary()


def workers_of(system: System) -> Workers:
    """Return the workers of a system, made at the first call."""
    if system not in _workers:
        limit = (os.cpu_count() or 1) if system.can_be_repeated else 1
        _workers[system] = Workers(system.components, limit)
    return _workers[system]
