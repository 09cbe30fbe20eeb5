"""Predictions of validation data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fmuid.formatting import fit_text, listed, two_digits, unit_text, with_std, with_unit
from fmuid.identification import ModelError, OutputScore, Prediction
from fmuid.reports.document import (
    Document,
    Message,
    Remark,
    Section,
    Table,
    Tone,
    doubt,
    origin_of,
    plain,
    table_of_rows,
)
from fmuid.reports.topics.assumptions import error_names, size_text
from fmuid.reports.topics.fit import CONSTANT, Band, fit_sections
from fmuid.reports.topics.residual_analysis import residual_remarks, residual_section
from fmuid.reports.topics.study_notes import source_remark
from fmuid.runs import PredictionRun

CAPTION = (
    "Dots: measured. Line: simulated with the values of the result. Below: residual. The band is where a new "
    "measurement is expected, from noise and uncertainty of the parameters."
)


class PredictionMessage(Message, section="prediction"):
    """Quality of predictions."""

    SEEN = doubt(
        "The result was estimated from {names}; this is no validation.",
        remedy="Predict data that the result was not estimated from.",
    )
    CORRECTED = plain(
        "Fixed values as the result corrected them: {values}.",
        remedy="Free them in the study, or on each record with --refit.",
    )
    ADDED = plain("{record}: predicted with freed errors: {errors}.", "the result was estimated beside them")
    FREED = doubt(
        "Freed errors are not in predictions: {errors}.",
        remedy="Correct them in the data, or model them, and identify again.",
    )
    OPEN = plain("{record}: {output} predicted ({size}); its expected RMSE is unknown.")
    AS_EXPECTED = plain("{record}: {output} predicted as expected ({size}).")
    WORSE = doubt(
        "{record}: {output} predicted {times} × worse than expected ({size}).",
        "errors above 1.25 σ, and more than chance: model error, or a changed machine",
        "Compare the residual with the inputs, or estimate with both data files.",
    )
    COVERAGE = plain("{record}: {inside} of {samples} samples of {output} are in the {level} band.")
    UNDETERMINED = plain("{names} not identifiable: the band contains noise only.")
    REFITTED = plain("{record}: estimated again: {values}.")
    REFIT_ENDED = doubt("Not converged: {names} on {record} ({end}).")
    FOLDS_OPEN = plain("Cross-validation: expected RMSE unknown.")
    FOLDS = plain("Cross-validation: experiments predicted as expected ({times} ×).")
    FOLDS_WORSE = plain(
        "Cross-validation: experiments predicted up to {times} × worse than expected.",
        remedy="Check the model and the operating points of the experiments.",
    )


def prediction_document(found: PredictionRun) -> Document:
    """Return the document of predictions."""
    predictions = found.predictions
    ratios = [score.ratio for each in predictions for score in each.scores if math.isfinite(score.ratio)]
    good = not any(score.is_worse for each in predictions for score in each.scores)
    seen = bool(found.seen)
    state = "no validation" if seen else "predicted" if not ratios else "as expected" if good else "worse than expected"
    tone: Tone = "good" if good and not seen else "bad"
    said = list(map(source_remark, found.notes))
    said += [PredictionMessage.SEEN.said("", names=listed(found.seen))] if seen else []
    values = ", ".join(f"{name} = {value:.6g}" for name, value in found.corrected.items())
    said += [PredictionMessage.CORRECTED.said("", values=values)] if values else []
    said += [PredictionMessage.FREED.said("", errors=_sizes(found.freed))] if found.freed else []
    said += [each for prediction in predictions for each in prediction_remarks(prediction)]
    said += [fold_remark(predictions)] if found.folds else []
    sections = (
        Section("scores", "Predicted and measured", table=_scores(predictions)),
        *prediction_fits(found),
        residual_section([each.fit for each in predictions], found.correlations),
    )
    return Document("prediction", "Prediction", state, tone, tuple(said), sections, **origin_of(found.origin))


def prediction_fits(found: PredictionRun) -> list[Section]:
    """Return measured and predicted outputs with their band."""
    bands: dict[str, Band] = {}
    for each in found.predictions:
        if np.isfinite(each.half_width).any():
            bands[each.fit.experiment] = each.half_width, each.level
    return fit_sections([each.fit for each in found.predictions], "Predicted", CAPTION, bands, "prediction")


def prediction_remarks(found: Prediction) -> list[Remark]:
    """Return the remarks on a prediction, its errors first."""
    record = found.fit.experiment
    remarks = [each for score in found.scores for each in _score_remarks(found, score)]
    if found.errors:
        remarks.append(PredictionMessage.ADDED.said(record=record, errors=_sizes(found.errors)))
    if found.undetermined:
        remarks.append(PredictionMessage.UNDETERMINED.said(names=listed(found.undetermined)))
    if (again := found.estimated) is not None:
        triples = zip(again.names, again.values.tolist(), again.std.tolist(), strict=True)
        values = ", ".join(f"{name} = {with_std(value, std)}" for name, value, std in triples)
        remarks.append(PredictionMessage.REFITTED.said(record=record, values=values))
        if not again.converged:
            end = again.outcome.value.replace("_", " ")
            remarks.append(PredictionMessage.REFIT_ENDED.said(record=record, names=listed(again.names), end=end))
    units = dict(zip(found.fit.outputs, found.fit.units, strict=True))
    return [*remarks, *residual_remarks(found.residuals, units)]


def _sizes(errors: Sequence[ModelError]) -> str:
    """Return errors with their sizes."""
    tests = [each.test for each in errors]
    return listed([f"{error_names(each.direction)} {size_text(each.direction, each.size, each.std)}" for each in tests])


def _score_remarks(found: Prediction, score: OutputScore) -> Iterator[Remark]:
    """Yield the size of a residual, and the samples in the band."""
    fit = f"fit {fit_text(score.fit)}, " if math.isfinite(score.fit) else ""
    constant = "" if fit else f"; {CONSTANT}"
    size = f"{fit}RMSE {with_unit(score.rmse, score.unit)}{constant}"
    given = {"record": found.fit.experiment, "output": score.output}
    if math.isnan(score.expected):
        yield PredictionMessage.OPEN.said(**given, size=size)
        return
    if not score.is_worse:
        yield PredictionMessage.AS_EXPECTED.said(**given, size=size)
    else:
        size += f", expected {with_unit(score.expected, score.unit)}"
        yield PredictionMessage.WORSE.said(**given, size=size, times=two_digits(score.ratio))
    inside, level = f"{100 * score.inside:.3g} %", f"{100 * found.level:.4g} %"
    yield PredictionMessage.COVERAGE.said(**given, inside=inside, samples=score.samples, level=level)


def fold_remark(predictions: Sequence[Prediction]) -> Remark:
    """Return the verdict of a cross-validation."""
    known = [score for found in predictions for score in found.scores if not math.isnan(score.ratio)]
    if not known:
        return PredictionMessage.FOLDS_OPEN.said()
    is_worse = any(score.is_worse for score in known)
    how = PredictionMessage.FOLDS_WORSE if is_worse else PredictionMessage.FOLDS
    return how.said(times=two_digits(max(score.ratio for score in known)))


def _scores(predictions: Sequence[Prediction]) -> Table:
    heads = ("experiment", "output", "RMSE", "fit", "expected RMSE", "ratio", "in band", "mean", "samples")
    rows = []
    for each in predictions:
        for score in each.scores:
            known = not math.isnan(score.expected)
            expected = f"{score.expected:.4g}" if known else "unknown"
            ratio = f"{score.ratio:.3g}" if math.isfinite(score.ratio) else ""
            cells = [each.fit.experiment, score.output, f"{score.rmse:.4g} {unit_text(score.unit)}".strip()]
            cells += [fit_text(score.fit), expected, ratio, f"{100 * score.inside:.3g} %" if known else ""]
            rows.append([*cells, f"{score.mean:.3g}", str(score.samples)])
    return table_of_rows(heads, rows, ("output",), ("mean", "ratio"))
