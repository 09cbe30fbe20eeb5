"""Work of one worker: groups of cases, out of reach of crashing FMUs."""

from __future__ import annotations

import gc
import os
import shutil
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fmuid.errors import FmuidError, InputError
from fmuid.models import Isolation
from fmuid.processes import AVAILABLE, LIMITS, HostExitError
from fmuid.runs.batch.case import CaseOutcome, CaseRunner
from fmuid.runs.batch.study_package import StudyPackage, put
from fmuid.simulation import TIME_LIMITS, FmuHost, HostManager, executor_of, watch
from fmuid.studies import Study

# What must be the same on both sides, to how many places of the version.
VERSION_PLACES = {"python": 2, "fmuid": 9, "dask": 9, "distributed": 9, "numpy": 1, "pandas": 1}
# Kept of the log of a case, bytes: an FMU that prints in every step would fill the disk.
LOG_BYTES = 64 * 1024


@dataclass(frozen=True)
class GroupResult:
    """Rows, logs by case, duration in s, and cases given up."""

    rows: Sequence[dict[str, Any]] = ()
    logs: Mapping[int, str] = field(default_factory=dict)
    seconds: float = 0.0
    given_up: tuple[int, ...] = ()


def versions() -> dict[str, str | None]:
    """Return the versions here that must be alike on all sides."""
    from distributed.versions import get_package_info

    found = get_package_info(VERSION_PLACES)
    return {name: found.get(name) for name in VERSION_PLACES}


def difference(here: Mapping[str, str | None], there: Mapping[str, str | None]) -> str | None:
    """Return the first difference of versions as text; None where all are alike."""
    for name, places in VERSION_PLACES.items():
        mine, theirs = here.get(name), there.get(name)
        if theirs is None and mine is not None:
            return f"has no {name}. Install {name} {mine} there."
        if mine is not None and theirs is not None and mine.split(".")[:places] != theirs.split(".")[:places]:
            shown = [".".join(each.split(".")[:3]) for each in (theirs, mine)]
            return f"runs {name} {shown[0]}, this machine {shown[1]}. Install the same version on both."
    return None


def run_group(parcel: StudyPackage, cases: Sequence[int], records: Mapping[str, bytes]) -> GroupResult:
    """Run cases one after the other with the contents of their records."""
    said = difference(parcel.versions, versions())
    if said is not None:
        raise InputError(f"the worker {_worker('address', 'here')} {said}")
    opened = _open_study(parcel)
    try:
        put(opened.folder, records)
        began = time.perf_counter()
        outcomes = opened.run(cases)
        seconds = time.perf_counter() - began
    except OSError as error:
        where = f"worker {_worker('address', 'here')}: {opened.folder}"
        raise FmuidError(f"{where}: write failed: {error.strerror}") from None
    finally:
        for name in records:
            (opened.folder / name).unlink(missing_ok=True)
    rows = [dict(outcome.row) for outcome in outcomes]
    logs = {case: bounded(outcome.log) for case, outcome in zip(cases, outcomes, strict=True) if outcome.log}
    return GroupResult(rows, logs, seconds)


def bounded(text: str) -> str:
    """Return a log cut to `LOG_BYTES`: its beginning and its end."""
    content = text.encode(errors="replace")
    if len(content) <= LOG_BYTES:
        return text
    half = LOG_BYTES // 2 - 40
    ends = content[:half].decode(errors="ignore"), content[-half:].decode(errors="ignore")
    return f"{ends[0]}\n... {len(content) - 2 * half} bytes left out ...\n{ends[1]}"


def _worker(attribute: str, default: Any) -> Any:
    """Return an attribute of the Dask worker of this thread; the default outside one."""
    from distributed import get_worker

    try:
        return getattr(get_worker(), attribute)
    except ValueError:
        return default


class OpenStudy:
    """The study of one thread of a worker; it owns its FMU instances, in a private folder."""

    def __init__(self, parcel: StudyPackage) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="fmuid-", dir=_worker("local_directory", None)))
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        study = parcel.unpack(self.folder)
        originals = {str(self.folder / name): original for name, original in parcel.originals.items()}
        self.run: Callable[[Sequence[int]], list[CaseOutcome]]
        if parcel.isolated and AVAILABLE:
            self.run = IsolatedCases(study, originals).run
        else:
            runner = CaseRunner(study, originals)
            self.run = lambda cases: [runner(case) for case in cases]


# Parcels with studies open here. Workers drop a parcel when its sender ends, however it does;
# as that may take until Python's next collection, a sender that can calls `forget`.
_parcels: weakref.WeakSet[StudyPackage] = weakref.WeakSet()


def _open_study(parcel: StudyPackage) -> OpenStudy:
    thread = threading.get_ident()
    if thread not in parcel.opened:
        parcel.opened[thread] = OpenStudy(parcel)
        _parcels.add(parcel)
    opened: OpenStudy = parcel.opened[thread]
    return opened


def forget(token: str) -> None:
    """Free what this worker keeps for a parcel."""
    for parcel in [each for each in _parcels if each.token == token]:
        parcel.opened.clear()
    gc.collect()  # errors that are kept hold on to what met them


_runner: list[CaseRunner] = []  # of a process that runs cases


def open_cases(data: Mapping[str, Any], path: Path, originals: Mapping[str, str] | None) -> None:
    """Make this process one that runs the cases of a study."""
    _runner[:] = [CaseRunner(Study.of(data, path), originals)]


def run_cases(indices: Sequence[int]) -> tuple[list[tuple[dict[str, object], str]], float]:
    """Return row and log of each case, and the longest simulation, s."""
    outcomes, position = [], 0
    for index in indices:
        outcome = _runner[0](index)
        printed, position = _printed_since(position)
        outcomes.append((outcome.row, "\n".join(filter(None, [outcome.log, printed]))))
    return outcomes, getattr(executor_of(_runner[0].study.system), "longest", 0.0)


def _printed_since(position: int) -> tuple[str, int]:
    """Return the output printed since a position, and the position now."""
    size = os.fstat(1).st_size
    if size == position:
        return "", size
    position = position if position < size else 0  # the other side has emptied the file
    return os.pread(1, min(size - position, LIMITS.printed_kept), position).decode("utf-8", errors="replace"), size


class IsolatedCases:
    """Runs cases in a process of their own, identification and FMU together.

    A case that ends the process runs again, with the FMU alone in its process: that shows the simulation to blame.
    """

    def __init__(self, study: Study, originals: Mapping[str, str] | None = None) -> None:
        settings = study.model.isolation or Isolation()
        self._opened = study.data, study.path, originals
        self._careful = CaseRunner(replace(study, model=replace(study.model, isolation=settings)), originals)
        self._keeper = HostManager(settings, [__name__])
        # the number of simulations of a case is known only afterwards
        self._alone = settings.max_simulations_per_process is not None

    def run(self, indices: Sequence[int]) -> list[CaseOutcome]:
        """Run cases in one order to the process; where it ends over several, one by one."""
        if self._alone and len(indices) > 1:
            return [outcome for index in indices for outcome in self.run([index])]
        keeper = self._keeper
        try:
            host = keeper.host(self._begin)
            rows, keeper.longest = host.order(run_cases, indices, limit=keeper.time_limit, computes=True)
            outcomes = [CaseOutcome(row, log) for row, log in rows]
            host.simulations += sum(int(str(outcome.row["simulations"])) for outcome in outcomes)
            keeper.replace_outgrown()
            keeper.printed()  # is in the logs
        except HostExitError:
            keeper.bury()
            printed = keeper.printed()  # several print it again
            if len(indices) > 1:
                return [outcome for index in indices for outcome in self.run([index])]
            outcome = self._careful(indices[0])
            return [replace(outcome, log="\n".join(filter(None, [outcome.log, printed])))]
        return outcomes

    def _begin(self, host: FmuHost) -> None:
        host.order(watch, limit=TIME_LIMITS.first)
        host.order(open_cases, *self._opened, limit=TIME_LIMITS.first)
