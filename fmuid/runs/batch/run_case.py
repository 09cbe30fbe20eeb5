"""One case of a batch after the other, each to a row of the batch's table."""

from __future__ import annotations

import json
import logging
import math
import os
import platform
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import as_json, from_json
from fmuid.data import Experiment
from fmuid.errors import FmuidError
from fmuid.estimation import Cache, Evaluator, Result, SolverCheck, TerminationReason, WeakDirection
from fmuid.identification import Problem, identify_by
from fmuid.runs.batch.case_problem import problem_of, truth_simulators, truth_values
from fmuid.runs.batch.cases import Case, CaseList
from fmuid.runs.batch.random_draws import noise
from fmuid.runs.batch.study_package import CopiedFiles
from fmuid.simulation import executor_of, nrmse_fit, root_mean_square
from fmuid.studies import ExperimentSettings, MonteCarloSection, Study, Value

Key = TypeVar("Key")
Item = TypeVar("Item")

VOLATILE = ("checked", "elapsed_s", "finished", "worker")
"""The columns that differ from run to run; all others are the same bit for bit."""

SYSTEMS_KEPT = 4
"""Tables, and simulations of the truth, that are kept for the cases that follow."""

CASE_ERRORS = MemoryError, ArithmeticError, np.linalg.LinAlgError
"""What fails a case, beside errors of this package."""

WHOLE, NUMBER, TEXT, FLAG, TIMESTAMP = "int64", "float64", "string", "bool", "datetime64[us, UTC]"


@dataclass(frozen=True)
class CaseOutcome:
    """What became of a case.

    Attributes
    ----------
    row : dict
        The columns `CaseRunner.columns`.
    log : str
        What the FMU printed and the warnings that were given meanwhile; empty where there was nothing.
    """

    row: dict[str, object]
    log: str


class CaseRunner:
    """Runs the cases of a study, in any order: ``runner(i)``.

    The instances of the FMUs are kept from case to case. What a case gives depends on nothing but the case; what
    ``[uncertainty]`` asks for is left out. For one thread.

    Parameters
    ----------
    study : Study
        With a ``[batch]``. Its tables may be missing, for which their cases fail.
    copies : CopiedFiles, optional
        Files of the study that are copies and go by the names of the originals in messages.

    Attributes
    ----------
    study : Study
    cases : CaseList
    columns : dict of str to str
        All columns of a row in order, and their types as pandas calls them.

    Raises
    ------
    InputError
        As `CaseList`, or if an FMU cannot be read.
    """

    def __init__(self, study: Study, copies: CopiedFiles | None = None) -> None:
        self.study, self.cases = study, CaseList(study)
        self._copies = copies or CopiedFiles(Path(), {})
        self._drawn, self._seed = self.cases.settings.monte_carlo, self.cases.settings.seed
        self._outputs = tuple(dict.fromkeys(name for given in study.experiments for name in given.outputs))
        self._tables: _BoundedCache[Path | None, tuple[Experiment, ...]] = _BoundedCache()
        self._before: tuple[object, Problem] | None = None  # what the case before had to be simulated, and its problem
        self._truths: _BoundedCache[object, tuple[Floats, ...]] = _BoundedCache()
        self._cache = Cache(problems=self._alike())
        self._worker = f"{platform.node()}:{os.getpid()}"
        self._system = study.system
        for model in self._system.components.values():
            model.fmu.path = self._copies.original(model.fmu.file)
        self.columns = self._all_columns()

    @single_threaded
    def __call__(self, index: int) -> CaseOutcome:
        """Run a case; one that fails has a row that says why.

        Raises
        ------
        KeyboardInterrupt
            If that ends the case.
        """
        case, began = self.cases[index], time.perf_counter()
        with _warnings_of_this_thread() as warnings:
            found = self._found(case)
        elapsed, printed = time.perf_counter() - began, executor_of(self._system).printed()
        volatile = {"elapsed_s": elapsed, "finished": datetime.now(UTC), "worker": self._worker}
        row = dict.fromkeys(self.columns, math.nan) | {"case": case.index, **case.settings, **found, **volatile}
        return CaseOutcome(row, "\n".join([*warnings, *([printed] if printed else [])]))

    def _found(self, case: Case) -> dict[str, object]:
        """Return the columns that a case finds out, those of values that there are not left out."""
        evaluator: Evaluator[Problem] | None = None
        try:
            evaluator = Evaluator(self.problem(case), self._cache)
            words = self._identify(evaluator)
        except FmuidError as error:
            words = _failure(str(error))
        except CASE_ERRORS as error:
            words = _failure(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
        counted = {} if evaluator is None else {"simulations": evaluator.simulations, "rejected": evaluator.failures}
        none = dict.fromkeys(("iterations", "simulations", "rejected", "finer", "checked"), 0)
        return {**none, "accuracy": "", **counted, **words}

    def problem(self, case: Case) -> Problem:
        """Return the problem of a case: its measurements, read or simulated and disturbed, and what is identified.

        Raises
        ------
        InputError
            If a table cannot be read or does not fit.
        SimulationError
            If the truth cannot be simulated.
        """
        read = experiments = self._tables.get(case.table, lambda: self._read(case.table))
        drawn = self._drawn
        if case.draw is not None and drawn is not None:
            experiments = self._disturbed(case, case.draw, drawn, read)
        key = case.table, case.free, tuple(case.held.items())
        like = self._before[1] if self._before and self._before[0] == key else None
        problem = problem_of(self.study, experiments, case.free, case.held, case.starts, like)
        self._before = key, problem
        return problem

    def _alike(self) -> int:
        """Return how many cases differ in their noise alone."""
        study, settings = self.study, self.cases.settings
        if self._drawn is None or settings.starting_points is not None or settings.combine != "product":
            return 1
        return 1 if study.estimator.whole_box or study.model.choices else self._drawn.realizations

    def _identify(self, evaluator: Evaluator[Problem]) -> dict[str, object]:
        """Identify the parameters of a case and return the columns that this fills."""
        study = self.study
        result = identify_by(evaluator, study.estimator, accuracy=study.accuracy, remedies=False)
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        own = result.accuracy is not None and result.accuracy.simulations > 0
        return _words_of(result) | _scores(evaluator.problem, result) | {"checked": int(own)}

    # --- tables and noise

    def _read(self, table: Path | None) -> tuple[Experiment, ...]:
        return tuple(self._experiment(given, table or given.data) for given in self.study.experiments)

    def _experiment(self, given: ExperimentSettings, table: Path) -> Experiment:
        """Read a table; the outputs need not be in it where they are simulated."""
        return given.read_experiment(table, str(self._copies.original(table)), measured=self._drawn is None)

    def _disturbed(
        self, case: Case, draw: int, drawn: MonteCarloSection, experiments: tuple[Experiment, ...]
    ) -> tuple[Experiment, ...]:
        """Return the experiments with the simulated truth and a draw of noise as measurements, where there were any."""
        truth = truth_values(self.study, case.held)
        key = case.table, tuple(truth.items())
        clean = self._truths.get(key, lambda: self._simulate(experiments, truth))
        found = []
        for number, (experiment, outputs) in enumerate(zip(experiments, clean, strict=True)):
            std = np.array([drawn.std_of(name) for name in experiment.output_names])
            values = outputs + std * noise(self._seed, case.record, draw, number, outputs.shape)
            there = experiment.counted | ~np.isnan(experiment.output_values)
            found.append(experiment.with_outputs(np.where(there, values, np.nan)))
        return tuple(found)

    def _simulate(self, experiments: tuple[Experiment, ...], truth: Mapping[str, Value]) -> tuple[Floats, ...]:
        return tuple(simulator(theta) for simulator, theta in truth_simulators(self.study, experiments, truth))

    # --- rows

    def _all_columns(self) -> dict[str, str]:
        types = {name: _type_of(value) for name, value in self.cases[0].settings.items()}
        names, outputs = self.cases.names, self._outputs
        return {
            "case": WHOLE,
            **{name: types[name] for name in self.cases.columns},
            "status": TEXT,
            "message": TEXT,
            "undetermined": TEXT,
            **{f"chosen.{name}": TEXT for name in self.study.model.choices},
            **{f"{word}.{name}": NUMBER for word in ("value", "std") for name in names},
            **{f"{word}.{name}": NUMBER for word in ("noise", "fit", "rmse") for name in outputs},
            "criterion": NUMBER,
            "iterations": WHOLE,
            "simulations": WHOLE,
            "rejected": WHOLE,
            "accuracy": TEXT,
            "shift": NUMBER,
            "finer": WHOLE,
            "checked": WHOLE,
            "elapsed_s": NUMBER,
            "finished": TIMESTAMP,
            "worker": TEXT,
        }


def _words_of(result: Result) -> dict[str, object]:
    """Return the columns that a result fills."""
    std = np.where(np.isfinite(result.std), result.std, np.nan)
    return {
        "status": "converged" if result.converged else "not converged",
        "message": result.outcome.value,
        "undetermined": directions_text(result.undetermined),
        **{f"chosen.{name}": str(value) for name, value in result.chosen.items()},
        **{f"value.{name}": value for name, value in zip(result.names, result.values.tolist(), strict=True)},
        **{f"std.{name}": value for name, value in zip(result.names, std.tolist(), strict=True)},
        **{f"noise.{name}": value for name, value in result.noise_variance.items()},
        "criterion": result.criterion,
        "iterations": result.iterations,
        **_accuracy_of(result.accuracy),
    }


def _scores(problem: Problem, result: Result) -> dict[str, object]:
    """Return the fit, %, and the RMSE of each output over the counted samples of all experiments of a case."""
    assert result.history is not None, "of a search that has just ended"
    pairs: dict[str, list[tuple[Floats, Floats]]] = {name: [] for name in problem.output_names}
    for experiment, simulated in zip(problem.experiments, result.history.simulated, strict=True):
        for j, name in enumerate(experiment.output_names):
            counted = experiment.counted[:, j]
            pairs[name].append((experiment.output_values[counted, j], simulated[counted, j]))
    errors = {name: [np.concatenate(each) for each in zip(*own, strict=True)] for name, own in pairs.items()}
    found: dict[str, object] = {f"fit.{name}": nrmse_fit(own) for name, own in pairs.items()}
    return found | {f"rmse.{name}": root_mean_square(*both) for name, both in errors.items()}


def directions_text(directions: Sequence[WeakDirection]) -> str:
    """Return directions as the JSON that ``result.json`` has of them; nothing where there are none."""
    return json.dumps(as_json(directions)) if directions else ""


def directions_of(text: str) -> tuple[WeakDirection, ...]:
    """Return the directions of a row's ``undetermined``."""
    return tuple(from_json(WeakDirection, each) for each in json.loads(text)) if text else ()


def _accuracy_of(found: SolverCheck | None) -> dict[str, object]:
    if found is None:
        return {}
    return {"accuracy": found.outcome.value, "shift": found.largest, "finer": len(found.switches)}


def _failure(message: str) -> dict[str, object]:
    return {"status": "failed", "message": message, "undetermined": ""}


def _type_of(value: object) -> str:
    return {bool: FLAG, int: WHOLE, float: NUMBER, str: TEXT}[type(value)]


class _BoundedCache(Generic[Key, Item]):
    """The last few things that were made, by what they were made of; an error that came of it comes again."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, Item | FmuidError] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Item]) -> Item:
        """Return what was made of a key, made now if need be."""
        if key not in self._kept:
            try:
                self._kept[key] = make()
            except FmuidError as error:
                self._kept[key] = error.with_traceback(None)  # which holds on to what was being made
            while len(self._kept) > SYSTEMS_KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        item = self._kept[key]
        if isinstance(item, FmuidError):
            raise item.with_traceback(None)
        return item


class _ThreadWarnings(logging.Handler):
    """Keeps the warnings that one thread gives."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._thread = threading.get_ident()
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning if it is of the thread."""
        if record.thread == self._thread:
            self.said.append(record.getMessage())


@contextmanager
def _warnings_of_this_thread() -> Iterator[list[str]]:
    """Collect the warnings that fmuid gives meanwhile."""
    listener, log = _ThreadWarnings(), logging.getLogger("fmuid")
    log.addHandler(listener)
    try:
        yield listener.said
    finally:
        log.removeHandler(listener)
