"""Results compared: likelihoods on their own data, errors on common tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fmuid.data import record_files
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.identification import CONFIDENCE_LEVEL, IncomparableError, ModelCandidate, Prediction, compare_models
from fmuid.runs.findings import CommonTables, ComparedEstimate, ComparisonRun
from fmuid.runs.folder import RESULT_FILE, read_identification
from fmuid.runs.predict import predicted_by
from fmuid.runs.provenance import digests, made_now
from fmuid.runs.result_study import result_path, study_of


def pooled(found: Sequence[Prediction]) -> dict[str, float]:
    """Return the RMSE of each output over all records."""
    sums: dict[str, tuple[float, int]] = {}
    for score in (score for each in found for score in each.scores):
        squares, samples = sums.get(score.output, (0.0, 0))
        sums[score.output] = squares + score.samples * score.rmse**2, samples + score.samples
    return {output: math.sqrt(squares / samples) for output, (squares, samples) in sums.items()}


def mean_fit(found: Sequence[Prediction]) -> float:
    """Return the fit over all outputs and records, %: 100 less the root mean square of what each is below 100.

    Outputs that are constant in a record are left out; NaN where all are.
    """
    errors = [100.0 - score.fit for each in found for score in each.scores if not math.isnan(score.fit)]
    return 100.0 - math.hypot(*errors) / math.sqrt(len(errors)) if errors else math.nan


def compared(
    results: Sequence[Path | str],
    tables: Sequence[Path | str] = (),
    *,
    free: Sequence[str] = (),
    isolated: bool = False,
) -> ComparisonRun:
    """Compare results by their likelihoods where they were made from the same data, and on common tables.

    Parameters
    ----------
    results : sequence of path
        ``result.json`` files, or the folders that have them.
    tables : sequence of path
        Records, and folders of records, that all results predict.
    free : sequence of str
        Variables that are estimated again on each record, such as initial states.
    isolated : bool
        Run the FMUs in a process of their own.

    Raises
    ------
    InputError
        If there are fewer than two results, they were made from different data and there are no tables, or results,
        studies and records do not fit together.
    SimulationError
        If a simulation fails.
    """
    paths, records = [result_path(Path(each)) for each in results], [Path(table) for table in tables]
    candidates = [_candidate(path, name) for path, name in zip(paths, _names(paths), strict=True)]
    comparison, apart = None, ""
    try:
        comparison = compare_models(candidates)
    except IncomparableError as error:
        if not tables:
            raise
        apart = error.reason
    scores, units = dict[str, CommonTables](), dict[str, str]()
    for each, path in zip(candidates, paths if tables else (), strict=bool(tables)):
        study = study_of(path, isolated=isolated, in_place=records[0])
        predictions = predicted_by(path, tables, study=study, free=free).predictions
        scores[each.name] = CommonTables(pooled(predictions), mean_fit(predictions))
        units |= {score.output: score.unit for one in predictions for score in one.scores}
    estimates = tuple(row for each in candidates for row in estimate_rows(each.name, each.result))
    origin = made_now(files=digests([*paths, *record_files(records)], Path.cwd()))
    return ComparisonRun(comparison, scores, units, apart, estimates, origin)


def estimate_rows(result: str, found: Result) -> list[ComparedEstimate]:
    """Return each estimate of a result of that name with its interval."""
    ends = found.intervals(CONFIDENCE_LEVEL).to_numpy(np.float64).tolist()
    return [
        ComparedEstimate(result, name, found.units.get(name, ""), value, *end)
        for name, value, end in zip(found.names, found.values.tolist(), ends, strict=True)
    ]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return names that tell paths apart: of their folders, with as much of the way to them as that takes."""
    ways = [path.resolve() for path in paths]
    for path, way in zip(paths, ways, strict=True):
        if ways.count(way) > 1:
            raise InputError(f"{path} is given twice: give each result once")
    parts = [way.parent.parts if way.name == RESULT_FILE else way.parts for way in ways]
    names: list[str] = []
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            break
    return names


def _candidate(path: Path, name: str) -> ModelCandidate:
    kept = read_identification(path)
    series = () if kept.assessment.residuals is None else kept.assessment.residuals.series
    worth = sum(each.samples / max(1.0, np.nan_to_num(each.correlation_samples, nan=1.0)) for each in series)
    dependence = sum(each.samples for each in series) / worth if worth else math.nan
    held = None if kept.origin is None else study_of(path).model.values
    return ModelCandidate(name, kept.result, dependence, held)
