"""Predictions of a study: a result of it simulated over other records, and over each of its own in turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fmuid.data import Experiment, Parameter, record_files
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.formatting import nearest
from fmuid.identification import CONFIDENCE_LEVEL, ModelReference, Prediction, estimates_for, predict, refinement_of
from fmuid.models import FMU, System
from fmuid.progress import Progress
from fmuid.runs.findings import Fold, PredictionRun
from fmuid.runs.provenance import made_from
from fmuid.runs.result_study import result_path, study_of
from fmuid.simulation import OutputFit, Simulator, Value, fit_of, refined
from fmuid.studies import ExperimentSettings, PriorSource, SourceWarning, Study


def records_like(study: Study, paths: Sequence[Path], like: str | None = None) -> tuple[Experiment, ...]:
    """Read records with the words of one of a study's experiments.

    Parameters
    ----------
    study : Study
    paths : sequence of Path
        Tables, and folders whose tables are taken in the order of their names.
    like : str, optional
        Name of the experiment; default: the first one.

    Raises
    ------
    InputError
        If there is no such experiment, or a table cannot be read or has other columns.
    """
    given = _words(study, like)
    records = []
    for path in record_files(paths):
        try:
            records.append(given.model_copy(update={"name": path.stem}).read_experiment(path))
        except InputError as error:
            of = f"experiment {given.name!r} of {study.path}"
            raise InputError(f"{error} (inputs and outputs are those of {of})") from None
    return tuple(records)


def _words(study: Study, like: str | None) -> ExperimentSettings:
    names = [given.name for given in study.experiments]
    if like is None:
        return study.experiments[0]
    if like not in names:
        raise InputError(f"{study.path} has no experiment {like!r}{nearest(like, names)}: it has {', '.join(names)}")
    return study.experiments[names.index(like)]


def predict_with(
    study: Study, result: Result, experiment: Experiment, *, free: Sequence[str] = (), level: float = CONFIDENCE_LEVEL
) -> Prediction:
    """Simulate a result over a record with the model of a study (`fmuid.predict`).

    Parameters
    ----------
    study : Study
        Its model and the values that it holds; those that the result has an estimate of take that.
    result : Result
    experiment : Experiment
    free : sequence of str
        Variables that are estimated again on the record: parameters of the study, or others of the model.
    level : float
        Of the band.

    Raises
    ------
    InputError
        If record, model and result do not fit together, or the study has a parameter of which the result has no value.
    SimulationError
        If the simulation fails.
    """
    again = _free(_of(study), result, free)
    taken = {name for name in result.names if name in study.system.variables}
    taken |= {name.rpartition("[")[0] for name in result.names if name not in taken}
    for name in study.parameters:
        if name not in taken and name not in again:
            raise InputError(
                f"{study.path} has the parameter {name!r}, of which the result has no value: have it estimated again "
                f"on each record (--refit {name}), or hold it at a value under [model.fixed]"
            )
    return predict(study.system, result, experiment, values=study.model.values, free=again, level=level)


def fits_at(study: Study, result: Result) -> tuple[OutputFit, ...]:
    """Simulate every experiment of a study at the estimates of a result and set the measurements beside.

    Parameters of which the result has no value are at their starts.

    Raises
    ------
    InputError
        If the result is of another model, or has no value for an experiment of a parameter per experiment.
    SimulationError
        If a simulation fails.
    """
    found = []
    for table in study.tables:
        known = estimates_for(result, study.system, table, ())
        values = {name: parameter.start for name, parameter in study.parameters.items()}
        values |= {variable: result[name] for variable, name in known.items()}
        held = {name: value for name, value in study.model.values.items() if name not in values}
        simulator = Simulator(study.system, table, tuple(values), values=held)
        simulator = refined(simulator, study.system, refinement_of(result))
        found.append(fit_of(study.system, table, simulator(list(values.values()))))
    return tuple(found)


def predict_experiments(
    result: Result,
    experiment: Experiment,
    model: System | FMU | str | Path | None = None,
    *,
    values: Mapping[str, Value] | None = None,
    free: Sequence[str] | Mapping[str, Parameter] = (),
    level: float = CONFIDENCE_LEVEL,
) -> Prediction:
    """Simulate a result over a record by what it was made with, as `Result.predict` says."""
    known = ModelReference(System.of(model), {}) if model is not None else _known(result)
    again = free if isinstance(free, Mapping) else _free(known, result, [free] if isinstance(free, str) else free)
    held = {**known.values, **(values or {})}
    return predict(known.system, result, experiment, values=held, free=again, step_size=known.step_size, level=level)


def _of(study: Study) -> ModelReference:
    return ModelReference(study.system, study.model.values, study.parameters)


def _known(result: Result) -> ModelReference:
    remedy = "give the model: result.predict(experiment, model)"
    if isinstance(result.made_with, ModelReference):
        return result.made_with
    if not isinstance(result.made_with, Path):
        raise InputError(f"the result does not know what it was made with: {remedy}")
    try:
        return _of(study_of(result.made_with, in_place=result.made_with))
    except InputError as error:
        raise InputError(f"{error}, or {remedy}") from None


def _free(known: ModelReference, result: Result, names: Sequence[str]) -> dict[str, Parameter]:
    """Return how variables are estimated again on a record: from the value that is known, within the bounds there were.

    Raises
    ------
    InputError
        If the model has no such variable, or its value is no number.
    """
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
            raise InputError(f"{name!r} is held at {value!r}, which is no number: it cannot be estimated again")
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
    """Identify the parameters from all experiments but those of one part, and predict those; part after part.

    Parameters
    ----------
    study : Study
    folds : int
        How many parts; as many as there are experiments leaves out one at a time.
    free : sequence of str
        As for `predict_with`; parameters per experiment are estimated again in any case, there is no value of them for
        an experiment that was left out.
    level : float
        Of the bands.
    progress : callable, optional
        Called with every step of the searches.

    Raises
    ------
    InputError
        If there are not as many experiments, or as `predict_with`.
    """
    experiments = study.tables
    if not 2 <= folds <= len(experiments):
        raise InputError(
            f"{study.path}: {folds} folds of {len(experiments)} experiments: give at least 2, and at most one for each"
            + ("; a study of one experiment has nothing to leave out" if len(experiments) == 1 else "")
        )
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
    """Return what is to be known of a result before its predictions are trusted.

    Raises
    ------
    InputError
        If it is one of another model.
    """
    variables: Mapping[str, object] = study.system.variables
    names = tuple(dict.fromkeys(n if n in variables else n.rpartition("[")[0] for n in result.names))
    for name in names:
        study.system.variable(name, "parameter")
    return PriorSource(str(study.path), path, result, names).compare(study.system)


def predicted_by(
    result: Path | str,
    tables: Sequence[Path | str] = (),
    *,
    study: Study | None = None,
    free: Sequence[str] = (),
    like: str | None = None,
    folds: int | None = None,
    level: float = CONFIDENCE_LEVEL,
    progress: Progress | None = None,
) -> PredictionRun:
    """Predict records that a result was not made from, or each part of its own study's from the others.

    Parameters
    ----------
    result : path
        A ``result.json``, or the folder that has it.
    tables : sequence of path
        Records, and folders of records.
    study : Study, optional
        Whose model and words for tables serve; default: the one that the result was made by.
    free : sequence of str
        Variables that are estimated again on each record, such as initial states.
    like : str, optional
        The experiment of the study whose words the records are read with; default: the first one.
    folds : int, optional
        Instead of tables: into how many parts the study's experiments are divided, each predicted from the others.
    level : float
        Of the bands.
    progress : callable, optional
        Called with every step of searches.

    Raises
    ------
    InputError
        If there are neither tables nor folds or both, or result, study and records do not fit together.
    SimulationError
        If a simulation fails.
    """
    if (folds is None) == (not tables):
        raise InputError(
            "name the tables to predict, or give --folds to predict each experiment of the study from the others"
            if folds is None
            else "with --folds the experiments of the study are predicted: leave the tables out"
        )
    path = result_path(Path(result))
    estimates = Result.from_json(path)
    study = study or study_of(path, in_place=Path(tables[0]) if tables else None)
    notes = tuple(notes_of(study, path, estimates))
    if folds is not None:
        parts, predictions = cross_validate(study, folds, free=free, level=level, progress=progress)
        return PredictionRun(predictions, parts, notes, origin=made_from(study, [path]))
    paths = [Path(table) for table in tables]
    records = records_like(study, paths, like)
    seen = tuple(each.name for each in records if estimates.made_from(each))
    predictions = tuple(predict_with(study, estimates, each, free=free, level=level) for each in records)
    return PredictionRun(predictions, (), notes, seen, made_from(study, [path, *record_files(paths)]))
