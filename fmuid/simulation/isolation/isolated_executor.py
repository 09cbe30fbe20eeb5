"""Executors with FMUs in separate processes: a crash costs one simulation.

A server with all code loaded forks the process (`fmuid.processes`) in some hundredths of a second. Thetas, outputs
and reports are in shared memory; only orders go through a socket. Printed text goes to a file.
A fresh process with one simulation settles which one is to blame, independent of earlier ones.
"""

from __future__ import annotations

import logging
import math
import threading
import weakref
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from fmuid.array_types import Indices
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.models import STIFF_INTEGRATOR, Component, Isolation
from fmuid.processes import MOST_KILLS, HostExitError, ProcessEnd
from fmuid.simulation import codes
from fmuid.simulation.instance_registry import Renewal, is_repeated, labels, needs_process, note_process
from fmuid.simulation.isolation import CODE, server
from fmuid.simulation.isolation.host import TIME_LIMITS, FmuHost, HostManager, end_words, left
from fmuid.simulation.simulation_plan import GridSimulation, SimulationJob, shares

_log = logging.getLogger("fmuid.fmu")
_living: weakref.WeakSet[IsolatedExecutor] = weakref.WeakSet()


class IsolatedExecutor:
    """Runs one system in a separate process, `limit` simulations at a time."""

    def __init__(self, components: Mapping[str, Component], limit: int, settings: Isolation, told: set[str]) -> None:
        self.lock = threading.RLock()
        self._components, self._settings, self._labels = dict(components), settings, labels(components)
        self._limit = min(limit, settings.threads or limit)
        self._keeper = HostManager(settings, [CODE], told)
        self._renewal: Renewal | None = None
        self._numbers: weakref.WeakKeyDictionary[GridSimulation, int] = weakref.WeakKeyDictionary()
        self._next, self._known, self._forgotten = 0, set[int](), list[int]()
        self._steps = 0  # of the simulation with most of them
        self._found_stiff = 0  # models, in any run
        self.cancelled = False
        _living.add(self)

    # --- simulations

    def run(self, job: SimulationJob) -> None:
        """Simulate thetas; a lost process gives reports of `codes.PROCESS`."""
        found = -1
        while found != self._found_stiff:  # then all are run again: outputs must not depend on the machine's speed
            found = self._found_stiff
            self._run_chunks(job)

    def _run_chunks(self, job: SimulationJob) -> None:
        # 32 MB of outputs are shared at a time: small beside the memory of any machine
        first, largest = 0, max(1, (1 << 25) // max(1, job.outputs[:1].nbytes))
        while first < len(job):
            known = self._alone
            part = job[first : first + self._most(largest)]
            self._run_part(part)
            if self._renewal is Renewal.PROCESS and not known:
                self._try_processes(part[:1])  # and then that part again
                continue
            self._keeper.replace_outgrown()
            first += len(part)

    @property
    def _alone(self) -> bool:
        return needs_process(self._components.values())

    def _most(self, largest: int) -> int:
        """Return the number of the next simulations."""
        if self._alone:
            self._keeper.replace()
            return 1
        if self._renewal is None:
            return 1
        # the first ones alone: their need is no growth; then a look at the growth every quarter of a second
        before, recycle = self._host().simulations, self._settings.max_simulations_per_process
        often = 1 if not before else max(1, int(0.25 / max(self._keeper.longest, 1e-6)))
        return min(largest, self._limit * often, max(1, recycle - before) if recycle else largest)

    def _try_processes(self, first: SimulationJob) -> None:
        """Check that new processes repeat the outputs; new instances do not."""
        found = []
        for _ in range(2):
            self._keeper.replace()
            job = first.simulation.job(first.thetas)
            job.outputs[:] = np.nan
            self._run_part(job)
            found.append(job.outputs)
        if not is_repeated(*found):
            raise InputError(
                f"{self._labels}: outputs differ between simulations with the same parameters, also in new "
                "processes. Export it without random numbers."
            )
        if note_process(self._components.values()):
            _log.warning(
                "%s: it keeps data outside its instances; each simulation uses a new process, which is slow",
                self._labels,
            )

    def _run_part(self, job: SimulationJob) -> None:
        left, suspects = np.arange(len(job)), list[int]()
        kills, unblamed = np.zeros(len(job), np.intp), 0
        while left.size:
            if suspects:
                self._keeper.replace()  # they run alone, each in a fresh process
            group = np.array(suspects[:1], np.intp) if suspects else left
            fresh = self._host().simulations == 0
            end, undone = self._attempt(job, group)
            if end is None and group is left:
                return
            left = np.setdiff1d(left, np.setdiff1d(group, undone), assume_unique=True)
            suspects = [each for each in suspects if each in left]
            if end is None:
                continue
            ended = self._keeper.bury()
            doing = np.zeros(0, np.intp) if ended is None else ended.doing[: 2 * self._limit : 2].copy()
            # code that failed by itself was doing nothing of what threads say: it may be any of them
            blamed = undone.tolist() if end.kind == ProcessEnd.FAILED else self._blamed(group, undone, doing)
            if not blamed:
                unblamed = unblamed + 1 if len(undone) == len(group) else 0
                if (doing == codes.REPEATING).any() and end.kind != ProcessEnd.KILLED:
                    self._give_up_reset()
                elif unblamed == MOST_KILLS or end.kind == ProcessEnd.HUNG:
                    self._write(end, job.reports, left)
                    return
            elif end.kind == ProcessEnd.KILLED and (kills[blamed] < MOST_KILLS).all():
                kills[blamed] += 1
            elif len(blamed) == 1 and (end.kind == ProcessEnd.HUNG or (fresh and len(group) == 1)):
                self._write(end, job.reports, np.array(blamed))
                left = np.setdiff1d(left, blamed, assume_unique=True)
                suspects = [each for each in suspects if each != blamed[0]]
            else:
                suspects = list(dict.fromkeys([*blamed, *suspects]))

    def _attempt(self, job: SimulationJob, group: Indices) -> tuple[HostExitError | None, Indices]:
        """Simulate a group; return the end of the process, if any, and open thetas."""
        host, end, simulation = self._host(), None, job.simulation
        shape = (len(group), job.thetas.shape[1], *job.outputs.shape[1:])
        (their_reports, their_thetas, their_outputs), size = host.room(shape)
        their_reports[:] = codes.UNDONE
        their_thetas[:] = job.thetas[group]
        try:
            number = self._tell(host, simulation)
            host.simulations += len(group)
            stiff, longest, renewal = host.order(
                server.run,
                number,
                shape,
                size,
                simulation.varying,
                limit=self._time_limit(simulation),
                reports=their_reports,
            )
            self._keeper.longest = max(self._keeper.longest, longest)
            self._renewal = None if renewal is None else Renewal(renewal)
            self._steps = max(self._steps, simulation.steps)
            for component in stiff:
                simulation.integrate(component, STIFF_INTEGRATOR)
                self._found_stiff += 1
        except HostExitError as ended:
            end = ended
        done = their_reports[:, 2] != codes.UNDONE
        job.outputs[group[done]], job.reports[group[done]] = their_outputs[done], their_reports[done]
        return end, group[~done]

    def _blamed(self, group: Indices, undone: Indices, doing: Indices) -> list[int]:
        """Return the thetas in simulation at the end of the process."""
        pairs = zip(shares(len(group), self._limit), doing, strict=False)
        waiting = [group[share][np.isin(group[share], undone)] for share, what in pairs if what == codes.SIMULATING]
        return [int(each[0]) for each in waiting if each.size]

    def _time_limit(self, simulation: GridSimulation) -> float:
        """Return the limit of a simulation, s; a longer one counts as first."""
        if self._settings.time_limit:
            return self._settings.time_limit
        first = TIME_LIMITS.first + TIME_LIMITS.per_step * simulation.steps if simulation.steps > self._steps else 0.0
        return max(first, self._keeper.time_limit)

    def failure(
        self, job: SimulationJob, parameters: Mapping[str, float], explain: bool = False
    ) -> SimulationError | None:
        """Return the error of a job of one simulation; None if it succeeded."""
        function, kind, number = job.reports[0, :3].tolist()
        if function < 0 and np.isfinite(job.outputs).all():
            return None
        if function == codes.PROCESS:
            end = HostExitError(ProcessEnd(kind), number)
        else:
            try:
                if self._alone:
                    self._keeper.replace()
                host = self._host()
                host.simulations += explain
                known = self._tell(host, job.simulation)
                given = job.thetas, job.outputs, job.reports, dict(parameters), explain
                return host.order(server.failure, known, *given, limit=self._time_limit(job.simulation))
            except HostExitError as ended:
                self._keeper.bury()
                end = ended
        return SimulationError(self._labels, math.nan, parameters, end_words(end))

    # --- the process

    def _host(self) -> FmuHost:
        self._check_cancelled()
        try:
            host = self._keeper.host(self._begin)
        except HostExitError:
            raise FmuidError(f"{self._labels}: its process ends repeatedly before the first simulation") from None
        self._check_cancelled()  # it could not be struck while it began
        return host

    def _check_cancelled(self) -> None:
        if self.cancelled:
            raise FmuidError(f"{self._labels}: simulations cancelled")

    def _begin(self, host: FmuHost) -> None:
        for model in self._components.values():
            _ = model.fmu.directory  # unpacked here, where what is wrong with it can be said
        self._known.clear()
        host.order(server.start, self._components, self._limit, self._renewal, limit=TIME_LIMITS.first)

    def _tell(self, host: FmuHost, simulation: GridSimulation) -> int:
        """Return a run's number, after the process knows it."""
        number = self._numbers.get(simulation)
        if number is None:
            number = self._numbers[simulation] = self._next
            self._next += 1
            weakref.finalize(simulation, self._forgotten.append, number).atexit = False
        if number not in self._known:
            forgotten = self._forgotten[:]
            host.order(server.know, number, simulation, forgotten, limit=TIME_LIMITS.first)
            host.records[number] = host.sent
            for each in forgotten:
                host.records.pop(each, None)
            del self._forgotten[: len(forgotten)]
            self._known.add(number)
        return number

    def forget(self, simulation: GridSimulation) -> None:
        """Send a changed run again before its next simulation."""
        self._numbers.pop(simulation, None)

    def cancel(self) -> None:
        """End simulations of other threads, with an error there."""
        self.cancelled = True
        self._keeper.strike()

    def _write(self, end: HostExitError, reports: Indices, indices: Indices) -> None:
        limits = {ProcessEnd.HUNG: self._settings.time_limit, ProcessEnd.GREW: self._settings.memory_limit_mb}
        reports[indices, :4] = codes.PROCESS, end.kind, end.number if limits.get(end.kind, 1) else 0, -1

    def _give_up_reset(self) -> None:
        self._renewal = Renewal.INSTANCE
        _log.warning("%s: its reset crashes; each simulation uses a new instance, which is slow", self._labels)

    def printed(self) -> str:
        """Return and forget the FMUs' printed text; while they run, nothing."""
        if not self.lock.acquire(blocking=False):
            return ""  # kept for a later call
        try:
            return self._keeper.printed()
        finally:
            self.lock.release()

    def close(self) -> None:
        """End the process; a later simulation makes a new one."""
        with self.lock:
            self._keeper.close()


def printed() -> str:
    """Return and forget the printed text of all FMUs."""
    return "".join([*left(), *(executor.printed() for executor in list(_living))])


class MultiProcessExecutor:
    """Shares simulations between up to `limit` processes, one at a time each."""

    def __init__(self, components: Mapping[str, Component], limit: int, settings: Isolation, told: set[str]) -> None:
        self.lock = threading.RLock()
        self._parts = [IsolatedExecutor(components, 1, settings, told) for _ in range(limit)]
        self._threads = ThreadPoolExecutor(limit, "fmuid-process")

    def run(self, job: SimulationJob) -> None:
        """Simulate thetas in equal shares; a model found stiff is run again."""
        plan = job.simulation.plan
        self._run_shares(job)
        if job.simulation.plan is not plan:
            for part in self._parts:
                part.forget(job.simulation)
            self._run_shares(job)

    def _run_shares(self, job: SimulationJob) -> None:
        (own, share), *others = zip(self._parts, shares(len(job), len(self._parts)), strict=False)
        futures: list[Future[None]] = []
        try:
            futures += [self._threads.submit(part.run, job[rest]) for part, rest in others]
            own.run(job[share])
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
        self, job: SimulationJob, parameters: Mapping[str, float], explain: bool = False
    ) -> SimulationError | None:
        """Return the error of a job of one simulation; None if it succeeded."""
        return self._parts[0].failure(job, parameters, explain)

    def printed(self) -> str:
        """Return and forget the FMUs' printed text."""
        return "".join(part.printed() for part in self._parts)

    def cancel(self) -> None:
        """End simulations of other threads, with an error there."""
        for part in self._parts:
            part.cancel()

    def close(self) -> None:
        """End the processes; a later simulation makes new ones."""
        with self.lock:
            for part in self._parts:
                part.close()
