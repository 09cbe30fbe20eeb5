"""One path for predictions of a result: its study, the records, scores, files and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import files
from fmuid.data import record_files
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.identification import CONFIDENCE_LEVEL, Prediction, ResidualAnalysis
from fmuid.progress import Progress
from fmuid.reports.identification_run import stacked
from fmuid.reports.messages.prediction import fold_words, prediction_words
from fmuid.reports.provenance import made_from
from fmuid.runs import Fold, cross_validate, notes_of, predict_with, records_like, result_path, study_of
from fmuid.studies import SourceWarning, Study


@dataclass(frozen=True, eq=False)
class PredictionRun:
    """What a result predicts.

    Attributes
    ----------
    predictions : tuple of Prediction
        One a record.
    folds : tuple of Fold
        Of a cross-validation, whose predictions these are; empty otherwise.
    notes : tuple of SourceWarning
        What is to be known of the result.
    seen : tuple of str
        Records that the result was made from.
    origin : mapping
        What they were made from (`fmuid.reports.provenance.made_from`).
    """

    predictions: tuple[Prediction, ...]
    folds: tuple[Fold, ...] = ()
    notes: tuple[SourceWarning, ...] = ()
    seen: tuple[str, ...] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scores(self) -> pd.DataFrame:
        """The content of ``scores.csv``: a row for each output of each record."""
        return pd.DataFrame(
            {"record": each.fit.experiment, **vars(score), "ratio": score.ratio}
            for each in self.predictions
            for score in each.scores
        )

    @property
    def correlations(self) -> pd.DataFrame:
        """The content of ``prediction-correlations.csv``: of residuals with themselves and with inputs."""
        return ResidualAnalysis(
            tuple(one for each in self.predictions for one in each.residuals.series), {}
        ).correlations

    @property
    def words(self) -> tuple[str, ...]:
        """What is to be said of all this, in sentences."""
        said = [words for each in self.predictions for words in prediction_words(each)]
        return tuple([*said, fold_words(self.predictions)] if self.folds else said)

    def to_json_dict(self) -> dict[str, Any]:
        """Return the content of ``prediction.json``."""
        records = [each.to_json_dict() | {"seen": each.fit.experiment in self.seen} for each in self.predictions]
        content: dict[str, Any] = {"words": list(self.words), "records": records, **self.origin}
        if self.folds:
            content["folds"] = [
                {
                    "left_out": [each.fit.experiment for each in fold.predictions],
                    "outcome": fold.result.outcome,
                    "parameters": dict(zip(fold.result.names, fold.result.values.tolist(), strict=True)),
                }
                for fold in self.folds
            ]
        return content

    def write(self, folder: Path) -> tuple[Path, ...]:
        """Write ``prediction.json`` and the tables of records, scores and correlations, and return their paths."""
        table = stacked([each.fit.experiment for each in self.predictions], [each.table for each in self.predictions])
        return (
            files.write_json(folder / "prediction.json", self.to_json_dict()),
            files.write_table(folder / "prediction.csv", table),
            files.write_table(folder / "scores.csv", self.scores),
            files.write_table(folder / "prediction-correlations.csv", self.correlations),
        )


def run_prediction(
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

    ``fmuid predict`` is this, with a folder and figures.

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

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> _ = fmuid.run_study(fmuid.Study.of(coil.study, "coil.toml"), "results")
    >>> fmuid.run_prediction("results", [coil.path]).scores["output"].tolist()
    ['i']
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
        parts = cross_validate(study, folds, free=free, level=level, progress=progress)
        order = {given.name: k for k, given in enumerate(study.experiments)}
        found = sorted((p for fold in parts for p in fold.predictions), key=lambda p: order[p.fit.experiment])
        return PredictionRun(tuple(found), parts, notes, origin=made_from(study, [path]))
    records = records_like(study, [Path(table) for table in tables], like)
    seen = tuple(each.name for each in records if estimates.made_from(each))
    predictions = tuple(predict_with(study, estimates, each, free=free, level=level) for each in records)
    return PredictionRun(
        predictions, (), notes, seen, made_from(study, [path, *record_files([Path(table) for table in tables])])
    )
