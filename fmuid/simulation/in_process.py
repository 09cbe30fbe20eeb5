"""Instances of a system in this process: a worker in each of as many threads as FMUs and machine allow."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future, wait

import numpy as np
from numpy.typing import NDArray

from fmuid.arrays import Floats
from fmuid.errors import SimulationError
from fmuid.fmi import Custody, Run, codes, shares
from fmuid.models import STIFF_INTEGRATOR, Component
from fmuid.simulation.worker import Worker


class InProcessExecutor:
    """The workers of one system in this process, as many as the FMUs and the machine allow.

    Parameters
    ----------
    components : mapping of str to Component
    limit : int
        The largest number of workers.
    resets : bool, optional
        Whether instances can be reset; default: found out.

    Attributes
    ----------
    lock : RLock
        Held by who runs simulations and asks for their failures.
    """

    def __init__(self, components: Mapping[str, Component], limit: int, resets: bool | None = None) -> None:
        self.lock = threading.RLock()
        self._components, self._limit, self._resets = components, limit, resets
        self._workers = [Worker(components, 0, resets)]
        self._custody = Custody((model.fmu, model.kind) for model in components.values())
        self._doing: NDArray[np.intp] | None = None

    def run(self, run: Run, thetas: Floats, outputs: Floats, reports: NDArray[np.intp]) -> None:
        """Simulate all thetas (m, N), in equal shares over the workers; a model found stiff is run again as such.

        Outputs (m, K, n_outputs) and reports (m, codes.REPORT) are filled in (`fmuid.fmi.loop.Loop.run`).
        """
        with self._custody.turn(self):
            self._run_shares(run, thetas, outputs, reports)
            if any(run.plan.integrations) and self._found_stiff(run, reports):
                for worker in self._workers:
                    worker.forget(run)
                self._run_shares(run, thetas, outputs, reports)

    def _found_stiff(self, run: Run, reports: NDArray[np.intp]) -> bool:
        """Have a run integrate as such the models that the default integrator found stiff; return if there are any."""
        stiff = {int(component) for function, component, *_ in reports if function == codes.STIFF}
        models = list(self._components.values())
        undecided = [component for component in stiff if models[component].numerics.integrator is None]
        for component in undecided:
            run.integrate(component, STIFF_INTEGRATOR)
        return bool(undecided)

    def _run_shares(self, run: Run, thetas: Floats, outputs: Floats, reports: NDArray[np.intp]) -> None:
        count = min(self._limit, len(thetas))
        while len(self._workers) < count:
            self._workers.append(Worker(self._components, len(self._workers), self._resets))
            self.show_doing(self._doing)
        futures: list[Future[None]] = []
        try:
            if count == 1:
                self._workers[0].start(self._workers[0].run, run, thetas, outputs, reports)
                return
            for worker, share in reversed(list(zip(self._workers, shares(len(thetas), count), strict=False))):
                # the caller's own share last: it is worked off at once
                future = worker.start(worker.run, run, thetas[share], outputs[share], reports[share])
                futures += [future] if future else []
            wait(futures)
        except BaseException:  # an interruption: the other threads are not to go on for nobody
            for worker in self._workers:
                worker.cancel(run)
            wait(futures)
            for worker in self._workers:
                worker.forget(run)
            raise
        for future in futures:
            future.result()

    def failure(
        self,
        run: Run,
        theta: Floats,
        outputs: Floats,
        report: NDArray[np.intp],
        parameters: Mapping[str, float],
        explain: bool = False,
    ) -> SimulationError | None:
        """Return what the outputs (K, n_outputs) and the report of a simulation say; None where it succeeded.

        To `explain` it, the simulation is repeated to hear what the FMU says; the error names the `parameters`.
        """
        worker = self._workers[0]
        known = worker.error(run, outputs, report, parameters)
        if known is None or not explain:
            return known
        with self._custody.turn(self):
            return worker.explain(run, theta, parameters) or known

    @property
    def longest(self) -> float:
        """Duration of the longest simulation so far, s."""
        return max(worker.longest for worker in self._workers)

    def show_doing(self, words: NDArray[np.intp] | None) -> None:
        """Let the workers write what they are doing into shared words, two for each."""
        self._doing = words
        if words is not None:
            for i, worker in enumerate(self._workers):
                worker.doing = words[2 * i : 2 * i + 2]

    def printed(self) -> str:
        """Return what the FMUs printed: unknown in this process, whose own output it joins."""
        return ""

    def vacate(self, abandon: bool) -> None:
        """Free the instances for others that cannot live beside them, or leave them alone, never to be used again."""
        self._workers[0].close(fatal=abandon)

    def close(self) -> None:
        """Free all instances; a later simulation makes new ones."""
        with self.lock:
            for worker in self._workers:
                worker.shut_down()
            self._workers = [Worker(self._components, 0, self._resets)]
            self.show_doing(self._doing)
