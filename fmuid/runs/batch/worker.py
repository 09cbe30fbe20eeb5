"""What a worker does for a batch: unpack the study once, and run groups of cases."""

from __future__ import annotations

import gc
import shutil
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from distributed import get_worker
from distributed.versions import get_package_info

from fmuid.errors import FmuidError, InputError
from fmuid.processes import AVAILABLE
from fmuid.runs.batch.dataset import bounded
from fmuid.runs.batch.run_case import CaseOutcome, CaseRunner
from fmuid.runs.batch.study_package import CopiedFiles, StudyPackage
from fmuid.studies import Study

# What must be the same on both sides, to how many places of the version.
VERSION_PLACES = {"python": 2, "fmuid": 9, "dask": 9, "distributed": 9, "numpy": 1, "pandas": 1}


@dataclass(frozen=True)
class GroupResult:
    """What a group of cases gave.

    Attributes
    ----------
    rows : list of dict
        One a case.
    logs : dict of int to str
        What cases printed, of those that did.
    seconds : float
        How long it took, without unpacking.
    given_up : tuple of int
        Cases that ended their worker again and again.
    """

    rows: Sequence[dict[str, Any]] = ()
    logs: Mapping[int, str] = field(default_factory=dict)
    seconds: float = 0.0
    given_up: tuple[int, ...] = ()


def versions() -> dict[str, str | None]:
    """Return what runs in this process, as far as it must be alike on all sides."""
    found = get_package_info(VERSION_PLACES)
    return {name: found.get(name) for name in VERSION_PLACES}


def difference(here: Mapping[str, str | None], there: Mapping[str, str | None]) -> str | None:
    """Return in words what a worker runs that differs from what runs here; None where all is alike."""
    for name, places in VERSION_PLACES.items():
        mine, theirs = here.get(name), there.get(name)
        if theirs is None and mine is not None:
            return f"has no {name}: install {name} {mine} there"
        if mine is not None and theirs is not None and mine.split(".")[:places] != theirs.split(".")[:places]:
            shown = [".".join(each.split(".")[: max(places, 3)][:3]) for each in (theirs, mine)]
            return f"runs {name} {shown[0]}, and here it is {shown[1]}: install the same on both sides"
    return None


def run_group(parcel: StudyPackage, cases: Sequence[int], records: Mapping[str, bytes]) -> GroupResult:
    """Run cases one after the other.

    Parameters
    ----------
    parcel : StudyPackage
    cases : sequence of int
    records : mapping of str to bytes
        Names and content of the records that they need.

    Raises
    ------
    InputError
        If this worker is not like the sender, or the study is wrong here.
    """
    _check_worker(parcel)
    opened = _open_studies(parcel).opened(parcel)
    try:
        for name, content in records.items():
            opened.put(name, content)
        began = time.perf_counter()
        outcomes = opened.run(cases)
        seconds = time.perf_counter() - began
    except OSError as error:
        raise FmuidError(f"the worker {_address()} cannot write below {opened.folder}: {error.strerror}") from None
    finally:
        for name in records:
            (opened.folder / name).unlink(missing_ok=True)
    rows = [dict(outcome.row) for outcome in outcomes]
    logs = {case: bounded(outcome.log) for case, outcome in zip(cases, outcomes, strict=True) if outcome.log}
    return GroupResult(rows, logs, seconds)


def _check_worker(parcel: StudyPackage) -> None:
    said = difference(parcel.versions, versions())
    if said is not None:
        raise InputError(f"the worker {_address()} {said}")


def _runner_of(study: Study, copies: CopiedFiles, isolated: bool) -> Callable[[Sequence[int]], list[CaseOutcome]]:
    if not (isolated and AVAILABLE):
        runner = CaseRunner(study, copies)
        return lambda cases: [runner(case) for case in cases]
    from fmuid.runs.batch.isolated_cases import IsolatedCases  # for Linux and macOS only

    return IsolatedCases(study, copies).run


class _OpenStudy:
    """The study of one thread of a worker, in a folder of its own, and what runs its cases."""

    def __init__(self, parcel: StudyPackage, folder: Path) -> None:
        self.folder = folder
        self.run = _runner_of(parcel.unpack(folder), parcel.copies(folder), parcel.isolated)

    def put(self, name: str, content: bytes) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


class _OpenStudies:
    """The open studies of a worker for one batch, in a private folder that goes with them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._opened: dict[int, _OpenStudy] = {}
        self._folder = Path(tempfile.mkdtemp(prefix="fmuid-", dir=_local_directory()))
        self._end = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def opened(self, parcel: StudyPackage) -> _OpenStudy:
        """Return the study of this thread: an FMU's instances stay with the thread that made them."""
        thread = threading.get_ident()
        with self._lock:
            if thread not in self._opened:
                self._opened[thread] = _OpenStudy(parcel, self._folder / f"{len(self._opened)}")
            return self._opened[thread]

    def close(self) -> None:
        """Free the FMUs and remove the folder."""
        with self._lock:
            self._opened.clear()
        self._end()


# Whose studies are open here. They go with their parcel, which the scheduler has its workers drop when the sender ends,
# however it does; that may take until Python's next collection, so a sender that can says so itself.
_parcels: weakref.WeakSet[StudyPackage] = weakref.WeakSet()
_opening = threading.Lock()


def _open_studies(parcel: StudyPackage) -> _OpenStudies:
    with _opening:
        if parcel.unpacked is None:
            parcel.unpacked = _OpenStudies()
            _parcels.add(parcel)
        studies: _OpenStudies = parcel.unpacked
        return studies


def forget(token: str) -> None:
    """Free what this worker keeps for a parcel."""
    with _opening:
        for parcel in [each for each in _parcels if each.token == token]:
            parcel.unpacked.close()
            parcel.unpacked = None
            _parcels.discard(parcel)
    gc.collect()  # errors that are kept hold on to what met them


def _local_directory() -> str | None:
    try:
        return get_worker().local_directory
    except ValueError:  # outside a worker
        return None


def _address() -> str:
    try:
        return str(get_worker().address)
    except ValueError:
        return "here"
