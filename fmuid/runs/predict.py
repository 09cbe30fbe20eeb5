"""Predictions, cross-validation and comparison of results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmuid import codec
from fmuid.data import Experiment, Parameter, is_quantity, record_files
from fmuid.errors import InputError, check_kind
from fmuid.estimation import RESULT_SCHEMA, Result
from fmuid.events import Progress
from fmuid.formatting import nearest
from fmuid.identification import (
    CONFIDENCE_LEVEL,
    ErrorKind,
    IncomparableError,
    ModelCandidate,
    ModelErrors,
    ModelReference,
    Prediction,
    compare_models,
    estimates_for,
    judge,
    predict_by_model,
    refinement_of,
)
from fmuid.models import FMU, System
from fmuid.runs.findings import CommonTables, ComparedEstimate, ComparisonRun, Fold, IdentificationRun, PredictionRun
from fmuid.runs.folder import AGAIN, RESULT_FILE, read_model_errors
from fmuid.runs.provenance import digests, made_from, made_now, result_path, study_of
from fmuid.simulation import OutputFit, Value, finer_simulator, fit_of, simulator_of
from fmuid.studies import PriorSource, SourceWarning, Study


def records_like(
    study: Study, paths: Sequence[Path], like: str | None = None, known: Sequence[str] = ()
) -> Iterator[Experiment]:
    """Read records with an experiment's settings."""
    names = [given.name for given in study.experiments]
    if like is not None and like not in names:
        raise InputError(f"{study.path}: unknown experiment {like!r}{nearest(like, names)}. Choose {', '.join(names)}.")
    given = study.experiments[0 if like is None else names.index(like)]
    for path in record_files(paths):
        if path.stem in known:
            continue
        try:
            record = given.model_copy(update={"name": path.stem}).read_experiment(path)
        except InputError as error:
            of = f"experiment {given.name!r} of {study.path}"
            raise InputError(f"{error} (inputs and outputs are those of {of})") from None
        yield record


def predict_with(
    study: Study,
    result: Result,
    experiment: Experiment,
    *,
    free: Sequence[str] = (),
    level: float = CONFIDENCE_LEVEL,
    errors: ModelErrors | None = None,
) -> Prediction:
    """Simulate a result over a record, with freed errors."""
    known = _of(study)
    again = _free(known, result, free)
    taken = {name for name in result.names if name in study.system.variables or is_quantity(name)}
    taken |= {name.rpartition("[")[0] for name in result.names if name not in taken}
    for name in study.parameters:
        if name not in taken and name not in again:
            lacking = f"{study.path}: parameters.{name}: the result has no value"
            raise InputError(f"{lacking}. Estimate it on each record (--refit {name}), or set it in model.fixed.")
    return predict_by_model(known, result, experiment, free=again, level=level, errors=errors)


def fits_at(study: Study, result: Result) -> tuple[OutputFit, ...]:
    """Return the fits of a study at estimates, else at initial guesses."""
    found = []
    for table in study.tables:
        known = estimates_for(result, study.system, table, ())
        values = {name: parameter.start for name, parameter in study.parameters.items()}
        values |= {variable: result[name] for variable, name in known.items()}
        held = {name: value for name, value in study.model.values.items() if name not in values}
        simulator = simulator_of(study.system, table, tuple(values), held)
        simulator = finer_simulator(simulator, study.system, refinement_of(result))
        found.append(fit_of(study.system, table, simulator(list(values.values()))))
    return tuple(found)


def predict(
    result: Result,
    experiment: Experiment,
    model: System | FMU | str | Path | None = None,
    *,
    values: Mapping[str, Value] | None = None,
    free: Sequence[str] | Mapping[str, Parameter] = (),
    level: float = CONFIDENCE_LEVEL,
) -> Prediction:
    """Predict an experiment with a result, and compare with its measurements.

    Parameters
    ----------
    result : Result
    experiment : Experiment
        Validation data.
    model : System, FMU or path, optional
        Default: the model of the result, also if read from a ``result.json`` that names its study.
    values : mapping of str to float, int, bool or str, optional
        Fixed FMU variables of the given model, or beside those of the result; estimates come first.
    free : sequence of str, or mapping of str to Parameter
        Values to refit on this experiment alone, such as initial states.
    level : float
        Confidence level of the band.

    Raises
    ------
    InputError
        If no model is known, experiment, model and result do not fit together, or the level is not between 0 and 1.
    SimulationError
        If the simulation fails.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> fmuid.predict(fmuid.identify(coil.problem()), coil.experiment).fit.outputs
    ('i',)
    """
    check_kind(result, Result, "result must be a fmuid.Result")
    known = ModelReference(System.of(model), {}) if model is not None else _known(result)
    again = free if isinstance(free, Mapping) else _free(known, result, [free] if isinstance(free, str) else free)
    check_kind(values or {}, Mapping, "values must be a mapping of variables to what they are held at")
    known = replace(known, values={**known.values, **(values or {})})
    return predict_by_model(known, result, experiment, free=again, level=level)


def _of(study: Study) -> ModelReference:
    return ModelReference(study.system, study.model.values, study.parameters)


def _known(result: Result) -> ModelReference:
    remedy = "Pass model=."
    if isinstance(result.setup.made_with, ModelReference):
        return result.setup.made_with
    if not isinstance(result.setup.made_with, Path):
        raise InputError(f"No model recorded in this result. {remedy}")
    try:
        return _of(study_of(result.setup.made_with, in_place=result.setup.made_with))
    except InputError as error:
        raise InputError(f"{error}, or pass model=") from None


def _free(known: ModelReference, result: Result, names: Sequence[str]) -> dict[str, Parameter]:
    """Return variables to estimate again: from their known value, within their bounds."""
    found: dict[str, Parameter] = {}
    for name in names:
        variable = known.system.variable(name, "parameter")
        given = known.parameters.get(name)
        if given is not None:
            start = result[name] if name in result.names else given.start
            nominal = given.nominal or abs(given.start)
            found[name] = replace(given, start=min(max(start, given.min), given.max), nominal=nominal)
            continue
        value = result[name] if name in result.names else known.values.get(name, variable.start or 0.0)
        if isinstance(value, bool | str):
            raise InputError(f"{name!r} is fixed at {value!r}, not a number. Only numbers can be refitted.")
        found[name] = Parameter(float(value), nominal=variable.nominal or abs(float(value)) or 1.0)
    return found


def cross_validate(
    study: Study,
    folds: int,
    *,
    free: Sequence[str] = (),
    level: float = CONFIDENCE_LEVEL,
    progress: Progress | None = None,
) -> tuple[tuple[Fold, ...], tuple[Prediction, ...]]:
    """Predict each part of the experiments by a result of the others."""
    experiments = study.tables
    if not 2 <= folds <= len(experiments):
        few = "; one experiment cannot be cross-validated" if len(experiments) == 1 else ""
        wrong = f"{folds} folds of {len(experiments)} experiments"
        raise InputError(f"{study.path}: {wrong}. Give between 2 and the number of experiments{few}.")
    again = dict.fromkeys([*(name for name, p in study.parameters.items() if p.per_experiment), *free])
    found, predictions = [], dict[str, Prediction]()
    for part in range(folds):
        left_out = experiments[part::folds]
        kept = tuple(each for each in experiments if each not in left_out)
        result = study.search(study.problem(kept), progress)
        found.append(Fold(result, tuple(each.name for each in left_out)))
        for each in left_out:
            predictions[each.name] = predict_with(study, result, each, free=tuple(again), level=level)
    return tuple(found), tuple(predictions[each.name] for each in experiments)


def notes_of(study: Study, path: Path, result: Result) -> list[SourceWarning]:
    """Return warnings on the use of a result with a study."""
    variables: Mapping[str, object] = study.system.variables
    own = [name for name in result.names if name in variables or not is_quantity(name)]
    names = tuple(dict.fromkeys(name if name in variables else name.rpartition("[")[0] for name in own))
    for name in names:
        study.system.variable(name, "parameter")
    return PriorSource(str(study.path), path, result, names).compare(study.system)


def predicted_by(
    result: Path | str,
    tables: Sequence[Path | str],
    *,
    study: Study | None = None,
    free: Sequence[str] = (),
    like: str | None = None,
    level: float = CONFIDENCE_LEVEL,
) -> PredictionRun:
    """Predict records that a result was not made from."""
    if not tables:
        raise InputError("no data to predict. Name data files, or cross-validate with --folds.")
    path = result_path(Path(result))
    estimates = Result.from_json(path)
    study = study or study_of(path, in_place=Path(tables[0]))
    errors = read_model_errors(path)
    corrected = errors.corrected
    if corrected:
        study = replace(study, model=replace(study.model, values={**study.model.values, **corrected}))
    notes = tuple(notes_of(study, path, estimates))
    paths = [Path(table) for table in tables]
    records = list(records_like(study, paths, like))
    seen = tuple(each.name for each in records if estimates.made_from(each))
    predictions = tuple(predict_with(study, estimates, each, free=free, level=level, errors=errors) for each in records)
    origin = made_from(study, [path, *record_files(paths)])
    common = set(errors.freed).intersection(*(each.errors for each in predictions))
    left = tuple(each for each in errors.freed if each not in common and not each.kinds <= {ErrorKind.FIXED})
    return PredictionRun(predictions, (), notes, seen, corrected, left, origin)


def cross_predicted(
    result: Path | str,
    folds: int,
    *,
    study: Study | None = None,
    free: Sequence[str] = (),
    level: float = CONFIDENCE_LEVEL,
    progress: Progress | None = None,
) -> PredictionRun:
    """Predict each part of a study's experiments from the others (`cross_validate`)."""
    path = result_path(Path(result))
    study = study or study_of(path)
    notes = tuple(notes_of(study, path, Result.from_json(path)))
    parts, predictions = cross_validate(study, folds, free=free, level=level, progress=progress)
    return PredictionRun(predictions, parts, notes, origin=made_from(study, [path]))


def _common(found: Sequence[Prediction]) -> CommonTables:
    """Return the RMSE of each output, and the mean fit, %."""
    scores, sums = [score for each in found for score in each.scores], dict[str, tuple[float, int]]()
    for score in scores:
        squares, samples = sums.get(score.output, (0.0, 0))
        sums[score.output] = squares + score.samples * score.rmse**2, samples + score.samples
    errors = [100.0 - score.fit for score in scores if not math.isnan(score.fit)]
    fit = 100.0 - math.hypot(*errors) / math.sqrt(len(errors)) if errors else math.nan
    return CommonTables({output: math.sqrt(squares / samples) for output, (squares, samples) in sums.items()}, fit)


def compared(
    results: Sequence[Path | str],
    tables: Sequence[Path | str] = (),
    *,
    free: Sequence[str] = (),
    isolated: bool = False,
) -> ComparisonRun:
    """Compare results by likelihoods (same data only), and on common tables."""
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
        scores[each.name] = _common(predictions)
        units |= {score.output: score.unit for one in predictions for score in one.scores}
    estimates = tuple(row for each in candidates for row in estimate_rows(each.name, each.result))
    origin = made_now(files=digests([*paths, *record_files(records)], Path.cwd()))
    verdicts = {each.name: each.result.verdict or judge(each.result) for each in candidates}
    return ComparisonRun(comparison, scores, units, apart, estimates, verdicts, origin)


def estimate_rows(result: str, found: Result) -> list[ComparedEstimate]:
    """Return each estimate with its interval, under the result's name."""
    ends = found.intervals(CONFIDENCE_LEVEL).to_numpy(np.float64).tolist()
    return [
        ComparedEstimate(result, name, found.estimates.units.get(name, ""), value, *end)
        for name, value, end in zip(found.names, found.values.tolist(), ends, strict=True)
    ]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the shortest distinct ends of the paths of results."""
    ways = [path.resolve() for path in paths]
    for path, way in zip(paths, ways, strict=True):
        if ways.count(way) > 1:
            raise InputError(f"{path}: given twice. Give each result once.")
    parts = [way.parent.parts if way.name == RESULT_FILE else way.parts for way in ways]
    names: list[str] = []
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            break
    return names


@dataclass(frozen=True)
class _SeriesSize:
    """Size of a residual in a ``result.json``: samples, and those of its correlation time."""

    samples: int
    correlation_samples: float


def _candidate(path: Path, name: str) -> ModelCandidate:
    content = codec.content_of(path, RESULT_SCHEMA, AGAIN)
    kept = codec.decoded(path, content, IdentificationRun, AGAIN)
    sizes = [] if kept.assessment.residuals is None else content["assessment"]["residuals"]["series"]
    series = codec.decoded(path, sizes, tuple[_SeriesSize, ...], AGAIN)
    worth = sum(each.samples / max(1.0, np.nan_to_num(each.correlation_samples, nan=1.0)) for each in series)
    dependence = sum(each.samples for each in series) / worth if worth else math.nan
    held = None if kept.origin is None else study_of(path).model.values
    return ModelCandidate(name, kept.result, dependence, held)
