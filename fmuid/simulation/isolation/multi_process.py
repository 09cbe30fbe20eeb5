"""FMUs that are not safe in threads, in several processes with one instance each: as many simulations at a time."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait

from fmuid.array_types import Floats, Indices
from fmuid.errors import SimulationError
from fmuid.models import Component, Isolation
from fmuid.simulation.isolation.isolated import IsolatedExecutor
from fmuid.simulation.simulation_plan import GridSimulation, shares


class MultiProcessExecutor:
    """Several `IsolatedExecutor` of one simulation at a time, which share what is to be simulated.

    Parameters
    ----------
    components : mapping of str to Component
    limit : int
        The largest number of processes.
    settings : Isolation
        Of each process.
    told : set of str, optional
        The warnings that were passed on.

    Attributes
    ----------
    lock : RLock
        Held by who runs simulations and asks for their failures.
    """

    def __init__(
        self, components: Mapping[str, Component], limit: int, settings: Isolation, told: set[str] | None = None
    ) -> None:
        told = set() if told is None else told
        self.lock = threading.RLock()
        self._parts = [IsolatedExecutor(components, 1, settings, told) for _ in range(limit)]
        self._threads = ThreadPoolExecutor(limit, "fmuid-process")

    def run(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N) in equal shares; where one finds a model stiff, all are run again as such."""
        plan = simulation.plan
        self._run_shares(simulation, thetas, outputs, reports)
        if simulation.plan is not plan:
            for part in self._parts:
                part.forget(simulation)
            self._run_shares(simulation, thetas, outputs, reports)

    def _run_shares(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        count = min(len(self._parts), len(thetas))
        futures: list[Future[None]] = []
        try:
            for part, share in reversed(list(zip(self._parts, shares(len(thetas), count), strict=False))):
                given = simulation, thetas[share], outputs[share], reports[share]
                if part is self._parts[0]:  # the caller's own share last: it is worked off at once
                    part.run(*given)
                else:
                    futures.append(self._threads.submit(part.run, *given))
            for future in futures:
                future.result()
        except BaseException:  # also an interruption, which reaches this thread alone
            self.cancel()
            wait(futures)
            raise
        finally:
            for part in self._parts:
                part.cancelled = False

    def failure(
        self,
        simulation: GridSimulation,
        theta: Floats,
        outputs: Floats,
        report: Indices,
        parameters: Mapping[str, float],
        explain: bool = False,
    ) -> SimulationError | None:
        """Return what outputs and report of one simulation say as an error; None where it succeeded."""
        return self._parts[0].failure(simulation, theta, outputs, report, parameters, explain)

    def printed(self) -> str:
        """Return and forget what the FMUs printed."""
        return "".join(part.printed() for part in self._parts)

    def cancel(self) -> None:
        """Have simulations that other threads run here end, with an error there."""
        for part in self._parts:
            part.cancel()

    def close(self) -> None:
        """End the processes; a later simulation makes new ones."""
        with self.lock:
            for part in self._parts:
                part.close()
