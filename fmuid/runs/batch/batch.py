"""Batches: the identifications of a study's ``[batch]``, on all cores or a cluster, resumable."""

from __future__ import annotations

import contextlib
import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Indices
from fmuid.codec import object_of
from fmuid.display_mixins import HtmlTableMixin, PlotMixin
from fmuid.errors import InputError
from fmuid.events import BatchStep, Progress
from fmuid.runs.batch.case import CaseRunner
from fmuid.runs.batch.case_list import CaseList, truth_of
from fmuid.runs.batch.dataset import MANIFEST, Dataset
from fmuid.runs.batch.study_package import BatchStudy, changes
from fmuid.runs.batch.summary import Summary, summarize
from fmuid.runs.batch.worker import versions
from fmuid.runs.batch.worker_pool import crew
from fmuid.simulation import parameter_units
from fmuid.studies import Study

# A batch of more cases is rather a slip in an axis.
MAX_CASES = 100_000
# Time that rows wait for the disk, s, and in durations of the last writing: the most that a kill costs.
WRITE_SECONDS, WRITE_SHARE = 3.0, 20.0
_REMEDY = "Choose another folder with --output, or remove its cases with --no-resume."


@dataclass(frozen=True, eq=False)
class BatchResult(PlotMixin):
    """Findings of a batch so far.

    Attributes
    ----------
    dataset : Dataset
        The rows in the folder.
    finished : int
        Number of finished cases.
    total : int
        Cases of the batch.
    truth : mapping of str to float
        True values of the parameters; empty where measurements were identified.
    units : mapping of str to str
        Of parameters and swept variables; "" without one.
    folder : Path
        Folder of the rows.
    given_noise : bool
        True if the study gives all noise variances.
    interrupted : bool
        True if Ctrl-C ended it; the same batch in the same folder goes on.
    lost : tuple of Path
        Damaged parts of an earlier run, removed; their cases ran again.

    Examples
    --------
    >>> words = fmuid.datasets.coil().study | {"batch": {"monte_carlo": {"realizations": 3, "std": 0.01}}}
    >>> found = fmuid.Batch(fmuid.Study.of(words, "coil.toml"), "out", workers=1).run()
    >>> found.frame["status"].tolist()
    ['converged', 'converged', 'converged']
    """

    dataset: Dataset
    finished: int
    total: int
    truth: Mapping[str, float]
    units: Mapping[str, str]
    folder: Path
    given_noise: bool
    interrupted: bool = False
    lost: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        return f"BatchResult({self.finished} of {self.total} cases, {str(self.folder)!r})"

    @cached_property
    def frame(self) -> pd.DataFrame:
        """Finished cases, one row each, sorted (`CaseRunner.columns`)."""
        return self.dataset.read()

    def summary(self) -> Summary:
        """Return the tables of the finished cases."""
        return summarize(self.frame, self.truth, self.units, given_noise=self.given_noise)


class Batch(HtmlTableMixin):
    """The identifications of a study's ``[batch]``, and the folder of their rows.

    Parameters
    ----------
    study : Study or path-like
        With ``[batch]``.
    folder : path-like
        Made where needed. Its finished cases of the same batch are kept.
    scheduler : str, optional
        Address of a Dask scheduler, as ``tcp://host:8786``; default: workers of this machine.
    workers : int, optional
        Number of workers of this machine; default: one a core.
    max_cases : int
        Limit of the number of cases.
    isolated : bool
        Run FMUs in processes of their own: a crash costs one simulation.

    Raises
    ------
    InputError
        If the study has no ``[batch]``, it is wrong, or it has more than `max_cases` cases.

    Examples
    --------
    >>> words = fmuid.datasets.coil().study | {"batch": {"monte_carlo": {"realizations": 3, "std": 0.01}}}
    >>> fmuid.Batch(fmuid.Study.of(words, "coil.toml"), "out", workers=1).run()
    BatchResult(3 of 3 cases, 'out')
    """

    def __init__(
        self,
        study: Study | str | Path,
        folder: str | Path,
        *,
        scheduler: str | None = None,
        workers: int | None = None,
        max_cases: int = MAX_CASES,
        isolated: bool = True,
    ) -> None:
        self.study = study if isinstance(study, Study) else Study.read(study)
        self.folder = Path(folder)
        self.cases = CaseList.of(self.study)
        if len(self.cases) > max_cases:
            many = f"{self.study.path}: batch: {len(self.cases)} cases exceed the limit of {max_cases}"
            raise InputError(f"{many}. Check the axes, or pass --max-cases {len(self.cases)}.")
        if workers is not None and workers < 1:
            raise InputError(f"--workers must be a whole number above 0, not {workers}")
        if workers is not None and scheduler is not None:
            raise InputError("--workers and --scheduler exclude each other. Keep one.")
        self._scheduler, self._workers, self._isolated = scheduler, workers, isolated
        self._columns: Mapping[str, str] = CaseRunner(self.study).columns
        self.dataset = Dataset(self.folder, self._columns, len(self.cases))

    def __repr__(self) -> str:
        return f"Batch({len(self.cases)} cases over {', '.join(self.cases.columns)}, {str(self.folder)!r})"

    @property
    def pending(self) -> Indices:
        """The unfinished cases in the folder, in order; only `run` checks their batch."""
        return np.flatnonzero(~self.dataset.finished())

    def run(self, progress: Progress | None = None, *, resume: bool = True) -> BatchResult:
        """Run the cases that are not finished yet.

        Parameters
        ----------
        progress : callable, optional
            Called with a `fmuid.events.BatchStep` some times a second.
        resume : bool
            Keep the finished cases in the folder; else remove them.

        Raises
        ------
        InputError
            If the folder has another batch, is in use or not writable, or the scheduler or its workers do not fit.
        FmuidError
            If the disk is full or the scheduler lost; finished cases are kept.
        """
        bundle = BatchStudy(self.study, isolated=self._isolated, versions=versions())
        with self.dataset.locked():
            lost = self._begin(bundle, resume)
            pending = self.pending
            interrupted = pending.size > 0 and self._work(bundle, pending, progress)
            if not interrupted:
                self.dataset.compact()
            names = tuple(dict.fromkeys([*self.cases.names, *self.cases.settings.swept]))
            units = parameter_units(self.study.system, names)
            outputs = tuple(dict.fromkeys(name for given in self.study.experiments for name in given.output_names))
            return BatchResult(
                self.dataset,
                int(self.dataset.finished().sum()),
                len(self.cases),
                truth_of(self.study),
                {name: unit or "" for name, unit in zip(names, units, strict=True)},
                self.folder,
                bool(np.isfinite(self.study.noise.known(outputs)).all()),
                interrupted,
                lost,
            )

    def _begin(self, bundle: BatchStudy, resume: bool) -> tuple[Path, ...]:
        """Check or write the manifest; return the damaged parts of the earlier run."""
        path = self.folder / MANIFEST
        if resume and self.dataset.parts():
            if not path.exists():
                raise InputError(f"{self.folder}: cases without {MANIFEST}. {_REMEDY}")
            found = changes(object_of(path, _REMEDY), bundle.manifest())
            if found:
                raise InputError(f"{self.folder}: cases of another batch ({'; '.join(found)}). {_REMEDY}")
            return self.dataset.repair()
        self.dataset.clear()
        told = {"cases": len(self.cases), "begun": datetime.now(UTC).isoformat(timespec="seconds")}
        self.dataset.write_manifest(bundle.manifest() | told | {"truth": truth_of(self.study)})
        return ()

    def _work(self, bundle: BatchStudy, pending: Indices, progress: Progress | None) -> bool:
        """Run cases; return True if Ctrl-C ended it."""
        record = lru_cache(maxsize=1)(bundle.record)  # cases of one record follow each other
        writer = _Writer(self.dataset)
        counter = _Counter(len(self.cases), self.dataset.read(["status"])["status"])
        try:
            with crew(self._scheduler, self._workers) as there, contextlib.closing(writer):
                if there.dashboard:
                    known = object_of(self.folder / MANIFEST, _REMEDY)
                    self.dataset.write_manifest(known | {"dashboard": there.dashboard})
                results = there.run(bundle.parcel, pending, lambda case: record(self.cases.table_of(case)))
                with contextlib.closing(results):
                    for result in results:
                        if result is not None:
                            rows = [*result.rows, *(self._given_up(case) for case in result.given_up)]
                            for case, text in result.logs.items():
                                self.dataset.log(case, text)
                            writer.rows += rows
                            counter.add([row["status"] for row in rows])
                        writer.write_if_due()
                        if progress is not None:
                            progress(counter.step(there.threads))
        except KeyboardInterrupt:  # what is done so far is written below, and said to be interrupted
            return True
        return False

    def _given_up(self, case: int) -> dict[str, Any]:
        """Return the row of a case that ended its worker repeatedly."""
        empty: dict[str, Any] = {"int64": 0, "float64": math.nan, "bool": False}
        row = {name: empty.get(kind, "") for name, kind in self._columns.items()}
        row |= {"case": case, **self.cases[case].settings, "status": "failed", "finished": datetime.now(UTC)}
        return row | {"message": "the worker process ended repeatedly, for example for lack of memory"}


class _Writer:
    """Collects rows and writes them a part at a time."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self.rows: list[Mapping[str, Any]] = []
        self._due = time.monotonic() + WRITE_SECONDS

    def write_if_due(self) -> None:
        if time.monotonic() >= self._due:
            self.close()

    def close(self) -> None:
        """Write all collected rows."""
        began = time.monotonic()
        if self.rows:
            self._dataset.append(self.rows)
            self.rows = []
        now = time.monotonic()
        self._due = now + max(WRITE_SECONDS, WRITE_SHARE * (now - began))


class _Counter:
    """Counts finished cases and their rate since the first results."""

    def __init__(self, total: int, statuses: Iterable[str]) -> None:
        self._total, self._counts = total, Counter(statuses)
        self._since: tuple[float, int] | None = None

    def add(self, statuses: Iterable[str]) -> None:
        self._counts.update(statuses)
        self._since = self._since or (time.monotonic(), self._counts.total())

    def step(self, threads: int) -> BatchStep:
        done, total = self._counts.total(), self._total
        since, then = self._since or (math.inf, done)
        rate = (done - then) / max(time.monotonic() - since, 1e-9)
        left = (total - done) / rate if rate else math.inf
        failed = self._counts["failed"]
        return BatchStep(done=done, total=total, failed=failed, rate=rate, left=left, threads=threads)
