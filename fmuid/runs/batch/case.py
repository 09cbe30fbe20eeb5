"""One case of a batch to a row of its table."""

from __future__ import annotations

import json
import logging
import math
import os
import platform
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import as_json, from_json
from fmuid.data import Experiment
from fmuid.errors import FmuidError, warnings_to
from fmuid.estimation import Cache, Evaluator, Result, TerminationReason, WeakDirection
from fmuid.identification import Assessment, Problem, find_data_defects, find_model_errors, identify, judge
from fmuid.runs.batch.case_list import Case, CaseList, noise
from fmuid.runs.batch.case_problem import problem_of, truth_simulators, truth_values
from fmuid.runs.findings import at_minimum
from fmuid.simulation import executor_of, fit_of, nrmse_fit, root_mean_square
from fmuid.studies import MonteCarloSection, Study, Value

# Columns that differ from run to run; all others are the same bit for bit.
VOLATILE = ("checked", "elapsed_s", "finished", "worker")
# Tables, and simulations of the truth, that are kept for later cases.
SYSTEMS_KEPT = 4
# Errors that fail a case, beside those of this package.
CASE_ERRORS = MemoryError, ArithmeticError, np.linalg.LinAlgError
WHOLE, NUMBER, TEXT, FLAG, TIMESTAMP = "int64", "float64", "string", "bool", "datetime64[us, UTC]"


def tests_cases(study: Study) -> bool:
    """Return True if a study asks for directed tests of each case."""
    given = study.data.get("estimation")
    return isinstance(given, dict) and given.get("model_error", "off") != "off"


@dataclass(frozen=True)
class CaseOutcome:
    """Row of a case, and its log: FMU output and warnings."""

    row: dict[str, object]
    log: str


class CaseRunner:
    """Runs the cases of a study in any order: ``runner(i)``; for one thread.

    FMU instances are kept from case to case, a row depends on its case alone. Tables may be missing: their cases fail.
    """

    def __init__(self, study: Study, originals: Mapping[str, str] | None = None) -> None:
        self.study, self.cases = study, CaseList(study)
        self._originals = originals or {}  # the user's names of copied files, for messages
        self._drawn, self._seed = self.cases.settings.monte_carlo, self.cases.settings.seed
        self._outputs = tuple(dict.fromkeys(name for given in study.experiments for name in given.output_names))
        self._tables = lru_cache(SYSTEMS_KEPT)(self._read)
        self._truths = lru_cache(SYSTEMS_KEPT)(self._simulated_truth)
        self._before: tuple[object, Problem] | None = None  # what the case before had to be simulated, and its problem
        self._cache = Cache(problems=self._alike())
        self._worker = f"{platform.node()}:{os.getpid()}"
        self._system = study.system
        for model in self._system.components.values():
            model.fmu.path = Path(self._original(model.fmu.file))
        self.columns = self._all_columns()

    @single_threaded
    def __call__(self, index: int) -> CaseOutcome:
        """Run a case; one that fails has a row with the reason."""
        case, began = self.cases[index], time.perf_counter()
        records = list[logging.LogRecord]()
        with warnings_to(records.append):
            found = self._found(case)
        warnings = [each.getMessage() for each in records if each.thread == threading.get_ident()]
        elapsed, printed = time.perf_counter() - began, executor_of(self._system).printed()
        volatile = {"elapsed_s": elapsed, "finished": datetime.now(UTC), "worker": self._worker}
        row = dict.fromkeys(self.columns, math.nan) | {"case": case.index, **case.settings, **found, **volatile}
        return CaseOutcome(row, "\n".join([*warnings, *([printed] if printed else [])]))

    def _found(self, case: Case) -> dict[str, object]:
        """Run a case; return its columns with a value."""
        evaluator: Evaluator[Problem] | None = None
        words: dict[str, object] = {"status": "failed", "undetermined": "", "verdict": "not_usable", "reasons": ""}
        try:
            evaluator = Evaluator(self.problem(case), self._cache)
            words = self._identify(evaluator)
        except FmuidError as error:
            words["message"] = str(error)
        except CASE_ERRORS as error:
            words["message"] = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        counted = {} if evaluator is None else {"simulations": evaluator.simulations, "rejected": evaluator.failures}
        none = dict.fromkeys(("iterations", "simulations", "rejected", "finer", "checked"), 0)
        return {**none, "accuracy": "", **counted, **words}

    def problem(self, case: Case) -> Problem:
        """Return the problem of a case, with measured or simulated data."""
        experiments = self._tables(case.table)
        if case.draw is not None and self._drawn is not None:
            experiments = self._disturbed(case, case.draw, self._drawn, experiments)
        key = case.table, case.free, tuple(case.held.items())
        like = self._before[1] if self._before and self._before[0] == key else None
        problem = problem_of(self.study, experiments, case.free, case.held, case.starts, like)
        self._before = key, problem
        return problem

    def _alike(self) -> int:
        """Return the number of cases that differ in their noise alone."""
        study, settings = self.study, self.cases.settings
        if self._drawn is None or settings.starting_points is not None or settings.combine != "product":
            return 1
        return 1 if study.estimator.whole_box or study.model.choices else self._drawn.realizations

    def _identify(self, evaluator: Evaluator[Problem]) -> dict[str, object]:
        """Identify the parameters of a case; return the columns of the result."""
        study = self.study
        result = identify(evaluator, study.estimator, solver_check=study.estimation.solver_check, restart=False)
        if result.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        own = result.accuracy is not None and result.accuracy.simulations > 0
        scores = _scores(evaluator.problem, result)
        fits: dict[tuple[str, ...], float] = {(name,): scores[f"fit.{name}"] for name in self._outputs}
        verdict = judge(result, self._tested(evaluator.problem, result), fits)
        reasons = " ".join(each.value for each in verdict.reasons)
        judged = {"verdict": verdict.grade.value, "reasons": reasons, "checked": int(own)}
        return _words_of(result) | scores | judged

    def _tested(self, problem: Problem, result: Result) -> Assessment | None:
        """Return the directed tests of a case, if asked for."""
        if not tests_cases(self.study) or not at_minimum(result):
            return None
        errors = find_model_errors(problem.as_in(result), result)
        return Assessment(model_errors=errors, data_defects=find_data_defects(problem, result))

    def _read(self, table: Path | None) -> tuple[Experiment, ...]:
        """Read tables; simulated outputs need not be in them."""
        paths = [(given, table or given.data) for given in self.study.experiments]
        measured = self._drawn is None
        return tuple(given.read_experiment(path, self._original(path), measured=measured) for given, path in paths)

    def _original(self, path: Path) -> str:
        return self._originals.get(str(path), str(path))

    def _disturbed(
        self, case: Case, draw: int, drawn: MonteCarloSection, experiments: tuple[Experiment, ...]
    ) -> tuple[Experiment, ...]:
        """Return the experiments with simulated truth and a noise realization as measurements."""
        clean = self._truths(case.table, tuple(truth_values(self.study, case.held).items()))
        found = []
        for number, (experiment, outputs) in enumerate(zip(experiments, clean, strict=True)):
            exact = experiment.with_outputs(np.where(np.isfinite(outputs), outputs, np.nan))
            values = outputs + drawn.levels(exact) * noise(self._seed, case.record, draw, number, outputs.shape)
            there = experiment.counted | ~np.isnan(experiment.output_values)
            found.append(experiment.with_outputs(np.where(there, values, np.nan)))
        return tuple(found)

    def _simulated_truth(self, table: Path | None, truth: tuple[tuple[str, Value], ...]) -> tuple[Floats, ...]:
        """Return the outputs of each experiment (K, outputs) at the true values."""
        simulators = truth_simulators(self.study, self._tables(table), dict(truth))
        return tuple(run(theta) for run, theta in simulators)

    def _all_columns(self) -> dict[str, str]:
        kinds = {bool: FLAG, int: WHOLE, float: NUMBER, str: TEXT}
        types = {name: kinds[type(value)] for name, value in self.cases[0].settings.items()}
        names, outputs = self.cases.names, self._outputs
        return {
            "case": WHOLE,
            **{name: types[name] for name in self.cases.columns},
            **dict.fromkeys(("status", "message", "undetermined", "verdict", "reasons"), TEXT),
            **{f"chosen.{name}": TEXT for name in self.study.model.choices},
            **{f"{word}.{name}": NUMBER for word in ("value", "std") for name in names},
            **{f"{word}.{name}": NUMBER for word in ("noise", "fit", "rmse") for name in outputs},
            **{"cost": NUMBER, "iterations": WHOLE, "simulations": WHOLE, "rejected": WHOLE},
            **{"accuracy": TEXT, "shift": NUMBER, "finer": WHOLE, "checked": WHOLE},
            **{"elapsed_s": NUMBER, "finished": TIMESTAMP, "worker": TEXT},
        }


def _words_of(result: Result) -> dict[str, object]:
    std, check = np.where(np.isfinite(result.std), result.std, np.nan), result.accuracy
    return {
        "status": "converged" if result.converged else "not converged",
        "message": result.outcome.value,
        "undetermined": directions_text(result.identifiability.non_identifiable),
        **{f"chosen.{name}": str(value) for name, value in result.chosen.items()},
        **{f"value.{name}": value for name, value in zip(result.names, result.values.tolist(), strict=True)},
        **{f"std.{name}": value for name, value in zip(result.names, std.tolist(), strict=True)},
        **{f"noise.{name}": value for name, value in result.fit.noise_variance.items()},
        "cost": result.fit.cost,
        "iterations": result.history.iterations,
        **({} if check is None else {"accuracy": check.outcome.value, "shift": check.largest}),
        **({} if check is None else {"finer": len(check.switches)}),
    }


def _scores(problem: Problem, result: Result) -> dict[str, float]:
    """Return fit, %, and RMSE of each output over all experiments."""
    assert result.history is not None, "of a search that has just ended"
    pairs: dict[str, list[tuple[Floats, Floats]]] = {name: [] for name in problem.output_names}
    responses = dict[str, float]()
    for experiment, simulated in zip(problem.experiments, result.fit.simulated, strict=True):
        if experiment.kind == "frequency":
            own = fit_of(problem.system, experiment, simulated)
            for name, fit in zip(own.outputs, own.fit, strict=True):
                responses[f"fit.{name}"] = min(fit, responses.get(f"fit.{name}", np.inf))
        for j, name in enumerate(experiment.output_names):
            counted = experiment.counted[:, j]
            pairs[name].append((experiment.output_values[counted, j], simulated[counted, j]))
    errors = {name: [np.concatenate(each) for each in zip(*own, strict=True)] for name, own in pairs.items()}
    found = {f"fit.{name}": nrmse_fit(each) for name, each in pairs.items()}
    return found | responses | {f"rmse.{name}": root_mean_square(*both) for name, both in errors.items()}


def directions_text(directions: Sequence[WeakDirection]) -> str:
    """Return directions as JSON; nothing where there are none."""
    return json.dumps(as_json(directions)) if directions else ""


def directions_of(text: str) -> tuple[WeakDirection, ...]:
    """Return the directions of the ``undetermined`` of a row."""
    return tuple(from_json(WeakDirection, each) for each in json.loads(text)) if text else ()
