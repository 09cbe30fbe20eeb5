"""Instances of a system in this process, in as many threads as FMUs and machine allow."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future, wait

from fmuid.array_types import Floats, Indices
from fmuid.errors import SimulationError
from fmuid.models import STIFF_INTEGRATOR, Component
from fmuid.simulation import codes
from fmuid.simulation.instance_registry import InstanceLock, Renewal
from fmuid.simulation.simulation_plan import GridSimulation, shares
from fmuid.simulation.worker import SimulationThread


class InProcessExecutor:
    """Runs one system in threads of this process, as many as the FMUs and the machine allow.

    Parameters
    ----------
    components : mapping of str to Component
    limit : int
        The largest number of threads.
    renewal : Renewal, optional
        What brings instances back to their beginning; default: found out with the first simulation.

    Attributes
    ----------
    lock : RLock
        Held by who runs simulations and asks for their failures.
    renewal : Renewal or None
        None: not known yet.
    """

    def __init__(
        self,
        components: Mapping[str, Component],
        limit: int,
        renewal: Renewal | None = None,
        told: set[str] | None = None,
    ) -> None:
        self.lock = threading.RLock()
        self._components, self._limit, self.renewal = components, limit, renewal
        self._told = set[str]() if told is None else told
        self._threads = [SimulationThread(components, 0, renewal, self._told)]
        self._custody = InstanceLock((model.fmu, model.kind) for model in components.values())
        self._doing: Indices | None = None
        self._running: GridSimulation | None = None

    def run(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N), in equal shares over the threads; a model found stiff is run again as such.

        Outputs (m, K, n_outputs) and reports (m, codes.REPORT) are filled in
        (`fmuid.simulation.simulation_loop.SimulationLoop.run`).
        """
        with self._custody.turn(self):
            self._running = simulation
            self._run_shares(simulation, thetas, outputs, reports)
            self.renewal = self._threads[0].renewal
            if len(thetas) > 1:  # in several threads each may have made one
                self._threads[0].check_process()
            if any(simulation.plan.integrations) and self._found_stiff(simulation, reports):
                for thread in self._threads:
                    thread.forget(simulation)
                self._run_shares(simulation, thetas, outputs, reports)

    def _found_stiff(self, simulation: GridSimulation, reports: Indices) -> bool:
        """Have a run integrate as such the models that the default integrator found stiff; return if there are any."""
        stiff = {int(component) for function, component, *_ in reports if function == codes.STIFF}
        models = list(self._components.values())
        undecided = [component for component in stiff if models[component].numerics.integrator is None]
        for component in undecided:
            simulation.integrate(component, STIFF_INTEGRATOR)
        return bool(undecided)

    def _run_shares(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        count = min(self._limit, len(thetas))
        while len(self._threads) < count:
            self._threads.append(SimulationThread(self._components, len(self._threads), self.renewal, self._told))
            self.show_doing(self._doing)
        futures: list[Future[None]] = []
        try:
            if count == 1:
                self._threads[0].start(self._threads[0].run, simulation, thetas, outputs, reports)
                return
            for thread, share in reversed(list(zip(self._threads, shares(len(thetas), count), strict=False))):
                # the caller's own share last: it is worked off at once
                future = thread.start(thread.run, simulation, thetas[share], outputs[share], reports[share])
                futures += [future] if future else []
            wait(futures)
        except BaseException:  # an interruption: the other threads are not to go on for nobody
            for thread in self._threads:
                thread.cancel(simulation)
            wait(futures)
            for thread in self._threads:
                thread.forget(simulation)
            raise
        for future in futures:
            future.result()

    def failure(
        self,
        simulation: GridSimulation,
        theta: Floats,
        outputs: Floats,
        report: Indices,
        parameters: Mapping[str, float],
        explain: bool = False,
    ) -> SimulationError | None:
        """Return what the outputs (K, n_outputs) and the report of a simulation say; None where it succeeded.

        To `explain` it, the simulation is repeated to hear what the FMU says; the error names the `parameters`.
        """
        thread = self._threads[0]
        known = thread.error(simulation, outputs, report, parameters)
        if known is None or not explain:
            return known
        with self._custody.turn(self):
            return thread.explain(simulation, theta, parameters) or known

    @property
    def longest(self) -> float:
        """Duration of the longest simulation so far, s."""
        return max(thread.longest for thread in self._threads)

    def show_doing(self, words: Indices | None) -> None:
        """Let the threads write what they are doing into shared words, two for each."""
        self._doing = words
        if words is not None:
            for i, thread in enumerate(self._threads):
                thread.doing = words[2 * i : 2 * i + 2]

    def printed(self) -> str:
        """Return what the FMUs printed: unknown in this process, whose own output it joins."""
        return ""

    def vacate(self, abandon: bool) -> None:
        """Free the instances for others that cannot live beside them, or leave them alone, never to be used again."""
        self._threads[0].close(fatal=abandon)

    def cancel(self) -> None:
        """Have the simulations that another thread runs here fail, at the end of the system's use."""
        if self._running is not None:
            for thread in self._threads:
                thread.cancel(self._running)

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""
        with self.lock:
            for thread in self._threads:
                thread.shut_down()
            self._threads = [SimulationThread(self._components, 0, self.renewal, self._told)]
            self.show_doing(self._doing)
