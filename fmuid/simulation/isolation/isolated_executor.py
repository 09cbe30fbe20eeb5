"""FMUs in a process of their own: a crash, a hang or runaway memory costs one simulation, not the study.

The process (`fmuid.processes`) is forked by a server that has all code loaded, so that a new one is there within some
hundredths of a second. Thetas, outputs and reports are in memory that both sides share; only orders
and their acknowledgement go through a socket. What the FMU prints goes to a file that is read here.

Which simulation is to blame for an end is settled in a fresh process that runs it alone, so that it does not depend on
what ran before.
"""

from __future__ import annotations

import logging
import math
import threading
import weakref
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.errors import FmuidError, InputError, SimulationError
from fmuid.models import STIFF_INTEGRATOR, Component, Isolation
from fmuid.processes import FAILED, GREW, HUNG, KILLED, MOST_KILLS, HostExitError
from fmuid.simulation import codes
from fmuid.simulation.instance_registry import Renewal, is_repeated, needs_process, note_process
from fmuid.simulation.isolation import CODE, server
from fmuid.simulation.isolation.host import FIRST_TIME_LIMIT, FmuHost, HostManager, end_words, left
from fmuid.simulation.simulation_plan import GridSimulation, new_reports, shares

STEP_LIMIT = 1e-4
"""What is added to `FIRST_TIME_LIMIT` for each communication step, s: far more than one takes, but of a slow model."""
CHUNK_BYTES = 1 << 25  # of outputs that are shared at a time: small beside the memory of any machine
MEASURE_SECONDS = 0.25  # between looks at how much a process has grown
_log = logging.getLogger("fmuid.fmu")
_living: weakref.WeakSet[IsolatedExecutor] = weakref.WeakSet()


class IsolatedExecutor:
    """Runs one system in a process of its own, at most `limit` simulations at a time.

    Attributes
    ----------
    lock : RLock
        Held by who runs simulations and asks for their failures.
    cancelled : bool
        Whether what is running in another thread is to end.
    """

    def __init__(
        self, components: Mapping[str, Component], limit: int, settings: Isolation, told: set[str] | None = None
    ) -> None:
        self.lock = threading.RLock()
        self._components, self._settings = dict(components), settings
        self._limit = min(limit, settings.threads or limit)
        self._keeper = HostManager(settings, [CODE], set() if told is None else told)
        self._renewal: Renewal | None = None
        self._numbers: weakref.WeakKeyDictionary[GridSimulation, int] = weakref.WeakKeyDictionary()
        self._next, self._known, self._forgotten = 0, set[int](), list[int]()
        self._steps = 0  # of the simulation with most of them
        self._found_stiff = 0  # models, in any run
        self.cancelled = False
        _living.add(self)

    # --- simulations

    def run(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate all thetas (m, N); those at which the process comes to an end have a report of `codes.PROCESS`.

        Where one of them finds a model stiff, all are run as such, also those that were through before, as in-process:
        how many go at a time depends on how fast the machine is, and the outputs must not.
        """
        found = -1
        while found != self._found_stiff:
            found = self._found_stiff
            self._run_chunks(simulation, thetas, outputs, reports)

    def _run_chunks(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        first, largest = 0, max(1, CHUNK_BYTES // max(1, outputs[:1].nbytes))
        while first < len(thetas):
            known = self._alone
            part = slice(first, first + self._most(largest))
            self._run_part(simulation, thetas[part], outputs[part], reports[part])
            if self._renewal is Renewal.PROCESS and not known:
                self._try_processes(simulation, thetas[part][:1])  # and then that part again
                continue
            self._keeper.replace_outgrown()
            first = part.stop

    @property
    def _alone(self) -> bool:
        """Whether each simulation needs a new process."""
        return needs_process(self._components.values())

    def _most(self, largest: int) -> int:
        """Return how many simulations may go next."""
        if self._alone:
            self._keeper.replace()
            return 1
        if self._renewal is None:
            return 1
        # the first ones by themselves, so that what they need is known and not taken for growth
        before, recycle = self._host().simulations, self._settings.max_simulations_per_process
        often = 1 if not before else max(1, int(MEASURE_SECONDS / max(self._keeper.longest, 1e-6)))
        return min(largest, self._limit * often, max(1, recycle - before) if recycle else largest)

    def _try_processes(self, simulation: GridSimulation, theta: Floats) -> None:
        """See whether new processes give the same outputs each, where new instances do not."""
        found = []
        for _ in range(2):
            self._keeper.replace()
            outputs = np.full((1, simulation.grid.times.size, len(simulation.output_names)), np.nan)
            self._run_part(simulation, theta, outputs, new_reports(1))
            found.append(outputs)
        if not is_repeated(*found):
            raise InputError(
                f"{self._labels} gives other outputs each time it is simulated with the same parameters, also in new "
                "processes; export it without what is random in it"
            )
        if note_process(self._components.values()):
            _log.warning(
                "%s: the FMU keeps something outside its instances, so that a new process is started for every "
                "simulation, which is slow",
                self._labels,
            )

    def _run_part(self, simulation: GridSimulation, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        left, suspects = np.arange(len(thetas)), list[int]()
        kills, unblamed = np.zeros(len(thetas), np.intp), 0
        while left.size:
            if suspects:
                self._keeper.replace()  # they run alone, each in a fresh process
            group = np.array(suspects[:1], np.intp) if suspects else left
            fresh = self._host().simulations == 0
            end, undone = self._attempt(simulation, thetas, outputs, reports, group)
            if end is None and group is left:
                return
            left = np.setdiff1d(left, np.setdiff1d(group, undone), assume_unique=True)
            suspects = [each for each in suspects if each in left]
            if end is None:
                continue
            doing = self._keeper.states_at_end()[: self._limit]
            # code that failed by itself was doing nothing of what threads say: it may be any of them
            blamed = undone.tolist() if end.kind == FAILED else self._blamed(group, undone, doing)
            if not blamed:
                unblamed = unblamed + 1 if len(undone) == len(group) else 0
                if (doing == codes.REPEATING).any() and end.kind != KILLED:
                    self._give_up_reset()
                elif unblamed == MOST_KILLS or end.kind == HUNG:
                    self._write(end, left, reports)
                    return
            elif end.kind == KILLED and (kills[blamed] < MOST_KILLS).all():
                kills[blamed] += 1
            elif len(blamed) == 1 and (end.kind == HUNG or (fresh and len(group) == 1)):
                self._write(end, np.array(blamed), reports)
                left = np.setdiff1d(left, blamed, assume_unique=True)
                suspects = [each for each in suspects if each != blamed[0]]
            else:
                suspects = list(dict.fromkeys([*blamed, *suspects]))

    def _attempt(
        self,
        simulation: GridSimulation,
        thetas: Floats,
        outputs: Floats,
        reports: Indices,
        group: Indices,
    ) -> tuple[HostExitError | None, Indices]:
        """Simulate some thetas; return how the process came to an end, if it did, and what is still to be done."""
        host, end = self._host(), None
        shape = (len(group), thetas.shape[1], *outputs.shape[1:])
        (their_reports, their_thetas, their_outputs), size = host.room(shape)
        their_reports[:] = codes.UNDONE
        their_thetas[:] = thetas[group]
        varying = [(each.magnitudes, each.initial, each.steps) for each in simulation.varying]
        try:
            number = self._tell(host, simulation)
            host.simulations += len(group)
            stiff, longest, renewal = host.order(
                server.run, number, shape, size, varying, limit=self._time_limit(simulation), reports=their_reports
            )
            self._keeper.longest = max(self._keeper.longest, longest)
            self._renewal = None if renewal is None else Renewal(renewal)
            self._steps = max(self._steps, _steps(simulation))
            for component in stiff:
                simulation.integrate(component, STIFF_INTEGRATOR)
                self._found_stiff += 1
        except HostExitError as ended:
            end = ended
        done = their_reports[:, 2] != codes.UNDONE
        if len(group) == len(outputs) and done.all():
            outputs[:], reports[:] = their_outputs, their_reports
            return end, group[:0]
        outputs[group[done]], reports[group[done]] = their_outputs[done], their_reports[done]
        return end, group[~done]

    def _blamed(self, group: Indices, undone: Indices, doing: Indices) -> list[int]:
        """Return the thetas that were being simulated when the process came to its end."""
        count, open_ones, found = min(self._limit, len(group)), set(undone.tolist()), []
        for share, what in zip(shares(len(group), count), doing, strict=False):
            waiting = [each for each in group[share].tolist() if each in open_ones]
            if what == codes.SIMULATING and waiting:
                found.append(waiting[0])
        return found

    def _time_limit(self, simulation: GridSimulation) -> float:
        """Return how long a simulation may take, s; one of more steps than all before is like the first of all."""
        if self._settings.time_limit:
            return self._settings.time_limit
        first = FIRST_TIME_LIMIT + STEP_LIMIT * _steps(simulation) if _steps(simulation) > self._steps else 0.0
        return max(first, self._keeper.time_limit)

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
        function, kind, number = (int(word) for word in report[:3])
        if function < 0 and np.isfinite(outputs).all():
            return None
        if function != codes.PROCESS:
            try:
                if self._alone:
                    self._keeper.replace()
                host = self._host()
                host.simulations += explain
                words = theta, outputs, report, dict(parameters), explain
                number = self._tell(host, simulation)
                return host.order(server.failure, number, *words, limit=self._time_limit(simulation))
            except HostExitError as end:
                self._keeper.bury()
                kind, number = end.kind, end.number
        return SimulationError(self._labels, math.nan, parameters, end_words(HostExitError(kind, number)))

    # --- the process

    @property
    def _labels(self) -> str:
        return ", ".join(f"{name} ({model.fmu.path})" if name else str(model.fmu.path) for name, model in self._models)

    @property
    def _models(self) -> list[tuple[str, Component]]:
        return list(self._components.items())

    def _host(self) -> FmuHost:
        """Return the process, a new one where there is none."""
        self._check_cancelled()
        try:
            host = self._keeper.host(self._begin)
        except HostExitError:
            raise FmuidError(
                f"the process that is to run {self._labels} ends again and again before it has begun"
            ) from None
        self._check_cancelled()  # it could not be struck while it began
        return host

    def _check_cancelled(self) -> None:
        if self.cancelled:
            raise FmuidError(f"the simulations of {self._labels} were cancelled")

    def _begin(self, host: FmuHost) -> None:
        for _, model in self._models:
            _ = model.fmu.directory  # unpacked here, where what is wrong with it can be said
        self._known.clear()
        host.order(server.start, self._components, self._limit, self._renewal, limit=FIRST_TIME_LIMIT)

    def _tell(self, host: FmuHost, simulation: GridSimulation) -> int:
        """Return the number of a run, which the process knows now."""
        number = self._numbers.get(simulation)
        if number is None:
            number = self._numbers[simulation] = self._next
            self._next += 1
            weakref.finalize(simulation, self._forgotten.append, number).atexit = False
        if number not in self._known:
            forgotten = self._forgotten[:]
            host.order(server.know, number, simulation, forgotten, limit=FIRST_TIME_LIMIT)
            host.records[number] = host.sent
            for each in forgotten:
                host.records.pop(each, None)
            del self._forgotten[: len(forgotten)]
            self._known.add(number)
        return number

    def forget(self, simulation: GridSimulation) -> None:
        """Tell a run anew before its next simulation: it has changed."""
        self._numbers.pop(simulation, None)

    def cancel(self) -> None:
        """Have simulations that another thread runs here end, with an error there."""
        self.cancelled = True
        self._keeper.strike()

    def _write(self, end: HostExitError, indices: Indices, reports: Indices) -> None:
        limits = {HUNG: self._settings.time_limit, GREW: self._settings.memory_limit_mb}
        reports[indices, :4] = codes.PROCESS, end.kind, end.number if limits.get(end.kind, 1) else 0, -1

    def _give_up_reset(self) -> None:
        self._renewal = Renewal.INSTANCE
        _log.warning(
            "%s: a reset crashes it, so it is instantiated anew for every simulation, which is slow and, for some "
            "FMUs, fails after a thousand times",
            self._labels,
        )

    def printed(self) -> str:
        """Return and forget what the FMUs printed."""
        with self.lock:
            return self._keeper.printed()

    def close(self) -> None:
        """End the process; a later simulation makes a new one."""
        with self.lock:
            self._keeper.close()


def printed() -> str:
    """Return and forget what all FMUs printed that nobody has asked for."""
    return "".join([*left(), *(executor.printed() for executor in list(_living))])


def _steps(simulation: GridSimulation) -> int:
    return int(simulation.grid.substeps.sum())


class MultiProcessExecutor:
    """Several `IsolatedExecutor` of one simulation at a time, which share what is to be simulated.

    Parameters
    ----------
    limit : int
        The largest number of processes, each under the `settings`.

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
