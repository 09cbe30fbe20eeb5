"""Dask: groups of cases on workers of this machine, or of a scheduler."""

from __future__ import annotations

import contextlib
import logging
import queue
import tempfile
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import dask
import distributed
from dask.system import CPU_COUNT

from fmuid.array_types import Indices
from fmuid.errors import FmuidError, InputError
from fmuid.runs.batch.local_workers import CALM, LocalWorkers
from fmuid.runs.batch.study_package import StudyPackage
from fmuid.runs.batch.worker import GroupResult, difference, forget, run_group, versions

# Time for a scheduler to answer, and to name its first worker, s; Dask's 30 s are long for a wrong address.
ANSWER_SECONDS = 10.0


@dataclass(frozen=True)
class PoolSettings:
    """Numbers of the groups of a batch."""

    groups_per_thread: int = 3  # waiting or running: a worker goes on while results and the next group travel
    group_seconds: float = 3.0  # scheduling a group costs some ms, its loss little
    max_group_cases: int = 5000  # their rows are small beside the data
    max_group_mb: float = 16.0  # of data, in the memory of the scheduler
    max_worker_ends: int = 5  # of a group, before it is taken apart: by chance so often only on a failing machine
    max_case_ends: int = 1  # of a case after its group, before it is given up
    look_seconds: float = 1.0  # between checks of the cluster
    tick_seconds: float = 0.25  # without a result, until the caller regains control


SETTINGS = PoolSettings()
DASK: Any = distributed  # parts of it have no types
Client: TypeAlias = Any
Future: TypeAlias = Any
RecordOf = Callable[[int], dict[str, bytes]]
Results = Generator[GroupResult | None, None, None]


class GroupSizes:
    """Cases of a group: one at first, then `PoolSettings.group_seconds` long."""

    def __init__(self) -> None:
        self._size, self._seconds = 1, float("inf")

    def learn(self, count: int, seconds: float) -> None:
        """Note the duration of a group of `count` cases, s."""
        each = seconds / count
        self._seconds = min(each, 0.5 * (each + self._seconds))  # the first of a worker are slow
        fitting = int(SETTINGS.group_seconds / max(self._seconds, 1e-9))
        self._size = max(1, min(fitting, SETTINGS.max_group_cases, max(self._size, 2 * count)))

    def next(self, left: int, threads: int) -> int:
        """Return the size of the next group."""
        return max(1, min(self._size, left // (2 * threads)))


class WorkerPool:
    """The workers of a batch; `local` is None where the scheduler has its own."""

    def __init__(self, client: Client, address: str, local: LocalWorkers | None) -> None:
        self._client, self._local, self._address = client, local, address
        self.dashboard = "" if local is not None else str(client.dashboard_link or "")  # address of Dask's page
        self._looked, self.threads = 0.0, 0
        self._flying: dict[Future, list[int]] = {}
        self._done: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._killed: dict[int, int] = {}

    def run(self, parcel: StudyPackage, cases: Indices, record_of: RecordOf) -> Results:
        """Run cases in groups; yield results as they come, None in between."""
        try:
            yield from self._run(parcel, cases, record_of)
        finally:
            with contextlib.suppress(Exception):  # a scheduler that is lost has its workers forget by itself
                if self._local is None and self._client.status == "running":
                    self._client.run(forget, parcel.token)

    def _run(self, parcel: StudyPackage, cases: Indices, record_of: RecordOf) -> Results:
        with self._watched():
            shipped = self._client.submit(_as_it_is, parcel, pure=False)
        left, sizes, position = deque[list[int]](), GroupSizes(), 0
        while position < len(cases) or left or self._flying:
            self._look()
            threads = max(self.threads, 1)
            while (position < len(cases) or left) and len(self._flying) < SETTINGS.groups_per_thread * threads:
                if left:
                    self._submit(shipped, *_gather(left.popleft(), record_of))
                    continue
                most = sizes.next(len(cases) - position, threads)
                group, records = _gather(cases[position : position + most].tolist(), record_of)
                self._submit(shipped, group, records)
                position += len(group)
            try:
                future = self._done.get(timeout=SETTINGS.tick_seconds)
            except queue.Empty:
                yield None
                continue
            group = self._flying.pop(future)
            found = self._result(future, group)
            if found is None:
                left.extend([case] for case in group)
                continue
            if found.seconds > 0:
                sizes.learn(len(group), found.seconds)
            yield found

    def _submit(self, shipped: Future, group: list[int], records: dict[str, bytes]) -> None:
        with self._watched():
            future = self._client.submit(run_group, shipped, group, records, pure=False)
        self._flying[future] = group
        future.add_done_callback(self._done.put)

    def _result(self, future: Future, group: list[int]) -> GroupResult | None:
        """Return the result of a group; None to run its cases one by one."""
        with self._watched():
            error = future.exception()
        if error is None:
            with self._watched():
                found: GroupResult = future.result()
            return found
        if not isinstance(error, DASK.KilledWorker):
            raise error
        for case in group:
            self._killed[case] = self._killed.get(case, 0) + 1
        if len(group) > 1 or self._killed[group[0]] <= SETTINGS.max_case_ends:
            return None
        return GroupResult(given_up=(group[0],))

    def _look(self) -> None:
        """Update the number of threads; check the scheduler."""
        if self._local is not None:
            self._local.look()
        if time.monotonic() - self._looked < SETTINGS.look_seconds:
            return
        with self._watched():
            self.threads = int(self._client.scheduler_info(n_workers=0)["total_threads"])
        self._looked = time.monotonic()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Turn the errors of a lost scheduler into one sentence."""
        lost = FmuidError(
            f"connection to the scheduler at {self._address} lost. Finished cases are kept: start a scheduler, "
            "and repeat the command."
        )
        try:
            yield
        except (OSError, TimeoutError, CancelledError):
            raise lost from None
        if self._client.status != "running":
            raise lost


@contextlib.contextmanager
def crew(scheduler: str | None = None, workers: int | None = None) -> Iterator[WorkerPool]:
    """Give the workers of a scheduler, or of this machine."""
    with _quiet(), contextlib.ExitStack() as stack:
        if scheduler is not None:
            client = stack.enter_context(_client(scheduler))
            _check(client, scheduler)
            yield WorkerPool(client, scheduler, None)
            return
        folder = stack.enter_context(_scratch_folder())
        stack.enter_context(dask.config.set({"temporary-directory": str(folder)} | CALM))
        options = {"host": "127.0.0.1", "port": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"}
        options["allowed_failures"] = SETTINGS.max_worker_ends
        described = {"cls": DASK.Scheduler, "options": options}
        cluster = stack.enter_context(DASK.SpecCluster(workers={}, scheduler=described))
        _quieten(cluster)
        client = stack.enter_context(_client(cluster.scheduler_address))
        local = LocalWorkers(cluster.scheduler_address, workers or CPU_COUNT, folder)
        stack.callback(local.close)
        yield WorkerPool(client, cluster.scheduler_address, local)


@contextlib.contextmanager
def _scratch_folder() -> Iterator[Path]:
    try:
        made = tempfile.TemporaryDirectory(prefix="fmuid-batch-", ignore_cleanup_errors=True)
    except OSError as error:
        why = f"{tempfile.gettempdir()}: no folder for workers: {error.strerror}"
        raise FmuidError(f"{why}. Free disk space, or set TMPDIR to another folder.") from None
    with made as folder:
        yield Path(folder)


@contextlib.contextmanager
def _client(address: str) -> Iterator[Client]:
    try:
        client = DASK.Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError, RuntimeError) as error:
        why = f"no Dask scheduler at {address} ({(str(error).splitlines() or ['no answer'])[0]})"
        raise InputError(f"{why}. Check that it runs, and its address, for example tcp://host:8786.") from None
    _quieten(client)
    try:
        yield client
    finally:
        client.close(timeout=2)


def _check(client: Client, address: str) -> None:
    """Check that scheduler and workers run the versions of this process."""
    until = time.monotonic() + ANSWER_SECONDS
    while not client.scheduler_info(n_workers=0)["n_workers"]:
        if time.monotonic() > until:
            raise InputError(f"the scheduler at {address} has no workers. Start some: dask worker {address}")
        time.sleep(SETTINGS.tick_seconds)
    found: dict[str, Any] = client.get_versions(packages=["fmuid"])
    here = versions()
    sides = {f"the scheduler at {address}": found["scheduler"]}  # which reads what it passes on
    sides |= {f"the worker {name}": each for name, each in found["workers"].items()}
    for name, theirs in sides.items():
        said = difference(here, (theirs or {}).get("packages", {}))
        if said:
            raise InputError(f"{name} {said}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log lines and warnings off the terminal."""
    # Dask's loop speaks through tornado: an interrupted call is cancelled by a name that does not exist yet.
    # Some of Dask's loggers have levels and handlers of their own.
    names = ["distributed", *(name for name in logging.root.manager.loggerDict if name.startswith("distributed."))]
    loggers = [logging.getLogger(name) for name in (*names, "tornado.application")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(), dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"}):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _quieten(part: Any) -> None:
    """Silence messages of asyncio about tasks of Dask's loop."""
    part.loop.asyncio_loop.set_exception_handler(lambda _loop, _context: None)


def _gather(cases: Sequence[int], record_of: RecordOf) -> tuple[list[int], dict[str, bytes]]:
    """Return the first cases and their records, as many as memory allows."""
    group: list[int] = []
    records: dict[str, bytes] = {}
    for case in cases:
        new = record_of(case)
        if group and sum(map(len, (records | new).values())) > SETTINGS.max_group_mb * 1e6:
            break
        records |= new
        group.append(case)
    return group, records


def _as_it_is(parcel: StudyPackage) -> StudyPackage:
    """Return a parcel: a task's result survives a lost worker, scattered data do not."""
    return parcel
