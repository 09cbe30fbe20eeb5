"""Executor in threads of this process, as FMUs and machine allow."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future, wait

from fmuid.errors import SimulationError
from fmuid.models import STIFF_INTEGRATOR, Component
from fmuid.simulation import codes
from fmuid.simulation.instance_registry import InstanceLock, Renewal
from fmuid.simulation.simulation_plan import GridSimulation, SimulationJob, shares
from fmuid.simulation.worker import SimulationThread


class InProcessExecutor:
    """Runs one system in at most `limit` threads of this process; `renewal` None: found by the first simulation."""

    def __init__(
        self, components: Mapping[str, Component], limit: int, told: set[str], renewal: Renewal | None = None
    ) -> None:
        self.lock = threading.RLock()
        self._components, self._limit, self.renewal = components, limit, renewal
        self._told = told
        self._threads = [SimulationThread(components, 0, told, renewal)]
        self._custody = InstanceLock((model.fmu, model.kind) for model in components.values())
        self._running: GridSimulation | None = None

    def run(self, job: SimulationJob) -> None:
        """Simulate thetas in equal shares; a model found stiff is run again."""
        with self._custody.turn(self):
            self._running = job.simulation
            self._run_shares(job)
            self.renewal = self._threads[0].renewal
            if len(job) > 1:  # in several threads each may have made one
                self._threads[0].check_process()
            if any(job.simulation.plan.integrations) and self._found_stiff(job):
                for thread in self._threads:
                    thread.forget(job.simulation)
                self._run_shares(job)

    def _found_stiff(self, job: SimulationJob) -> bool:
        """Integrate models found stiff as such; return whether there are any."""
        stiff = set(job.reports[job.reports[:, 0] == codes.STIFF, 1].tolist())
        models = list(self._components.values())
        undecided = [component for component in stiff if models[component].numerics.integrator is None]
        for component in undecided:
            job.simulation.integrate(component, STIFF_INTEGRATOR)
        return bool(undecided)

    def _run_shares(self, job: SimulationJob) -> None:
        parts = shares(len(job), self._limit)
        while len(self._threads) < len(parts):
            self._threads.append(SimulationThread(self._components, len(self._threads), self._told, self.renewal))
        futures: list[Future[None]] = []
        try:
            for thread, share in reversed(list(zip(self._threads, parts, strict=False))):
                # the caller's own share last: it is worked off at once
                future = thread.start(thread.run, job[share])
                futures += [future] if future else []
            for future in futures:
                future.result()
        except BaseException:  # an interruption: the other threads are not to go on for nobody
            for thread in self._threads:
                thread.cancel(job.simulation)
            wait(futures)
            for thread in self._threads:
                thread.forget(job.simulation)
            raise

    def failure(
        self, job: SimulationJob, parameters: Mapping[str, float], explain: bool = False
    ) -> SimulationError | None:
        """Return the error of a job of one simulation, if any; to `explain` it, repeat it with the FMU's log."""
        thread = self._threads[0]
        known = thread.error(job, parameters)
        if known is None or not explain:
            return known
        with self._custody.turn(self):
            return thread.explain(job, parameters) or known

    @property
    def longest(self) -> float:
        """Duration of the longest simulation, s."""
        return max(thread.longest for thread in self._threads)

    def printed(self) -> str:
        """Return nothing: FMUs print into this process's own output."""
        return ""

    def vacate(self, abandon: bool) -> None:
        """Free the instances for others, or abandon them."""
        self._threads[0].close(fatal=abandon)

    def cancel(self) -> None:
        """Let simulations in other threads fail, at the end of use."""
        if self._running is not None:
            for thread in self._threads:
                thread.cancel(self._running)

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""
        with self.lock:
            for thread in self._threads:
                thread.shut_down()
            self._threads = [SimulationThread(self._components, 0, self._told, self.renewal)]
