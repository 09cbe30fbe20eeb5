"""Predictions of validation data."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fmuid.formatting import fit_text, listed, two_digits, unit_text, with_std, with_unit
from fmuid.identification import OutputScore, Prediction, ResidualAnalysis
from fmuid.reports.document import Document, Message, Remark, Section, Table, Tone, origin_of, table_of
from fmuid.reports.topics.fit import CONSTANT, Band, fit_sections
from fmuid.reports.topics.residual_analysis import residual_section, residual_words
from fmuid.reports.topics.study_notes import source_words
from fmuid.reports.topics.termination import ENDS
from fmuid.runs import PredictionRun

LEAST_RATIO = 1.25
"""Residuals that are larger than expected by this factor are an error of the model rather than chance."""
CAPTION = (
    "Dots were measured, the line is simulated with the values of the result; the residual is below. "
    "In the band a new measurement is expected, by the noise and by how well the parameters are known: about as many "
    "dots lie in it as its level says, where the model carries over."
)


class PredictionMessage(Message):
    """How good predictions are."""

    SEEN = (
        "The result was made from {names}: this is no prediction",
        "the fit says nothing of other records",
        "give a file that it has not seen",
    )
    SOURCE = ("{words}", "see earlier results")
    OPEN = (
        "{score}; the result was not made from such an output, so nothing says how large the residual should be",
        "a new sensor",
    )
    AS_EXPECTED = ("{score}, as noise and estimates let expect ({expected}): {band}", "the model carries over")
    WORSE = (
        "{score}, {times} times what noise and estimates let expect ({expected}): {band}; the record shows an error of "
        "the model, or the machine has changed",
        "larger by more than a quarter than it should be",
    )
    UNDETERMINED = ("The result leaves {names} undetermined: the band is that of the noise alone", "it is too narrow")
    AGAIN = ("Estimated again on {record}: {values}", "what `--refit` names, on this record")
    AGAIN_ENDED = (
        "Estimated again on this record, {names}: {end}",
        "the search for what `--refit` names did not end well",
    )
    FOLDS_OPEN = ("Nothing says how large the residuals should be", "cross-validation of an output that is new")
    FOLDS = (
        "Left out in turn, the experiments are predicted as noise and estimates let expect ({times} times)",
        "cross-validation",
    )
    FOLDS_WORSE = (
        "Left out in turn, experiments are predicted up to {times} times worse than noise and estimates let expect: "
        "what is identified from the others does not carry over to all of them",
        "cross-validation",
    )


def prediction_document(found: PredictionRun) -> Document:
    """Return the document of predictions."""
    predictions = found.predictions
    ratios = [score.ratio for each in predictions for score in each.scores if math.isfinite(score.ratio)]
    good = all(ratio <= LEAST_RATIO for ratio in ratios)
    seen = bool(found.seen)
    state = "seen before" if seen else "predicted" if not ratios else "carries over" if good else "worse than expected"
    tone: Tone = "good" if good and not seen else "bad"
    said = [PredictionMessage.SOURCE.said("doubt", words=source_words(each)) for each in found.notes]
    said += [PredictionMessage.SEEN.said("doubt", names=listed(found.seen))] if seen else []
    said += [each for prediction in predictions for each in prediction_remarks(prediction)]
    said += [fold_remark(predictions)] if found.folds else []
    series = tuple(one for each in predictions for one in each.residuals.series)
    sections = (
        Section("scores", "Predicted against measured", table=_scores(predictions)),
        *prediction_fits(found),
        residual_section([each.fit for each in predictions], ResidualAnalysis(series, {}).correlations),
    )
    return Document("prediction", "Prediction", state, tone, tuple(said), sections, **origin_of(found.origin))


def prediction_fits(found: PredictionRun) -> list[Section]:
    """Return measured and predicted outputs with their band."""
    bands: dict[str, Band] = {}
    for each in found.predictions:
        table = each.table
        ends = [table[f"upper.{name}"] - table[f"simulated.{name}"] for name in each.fit.outputs]
        half = np.column_stack([one.to_numpy(np.float64) for one in ends])
        if np.isfinite(half).any():
            bands[each.fit.experiment] = half, each.level
    return fit_sections([each.fit for each in found.predictions], "Predicted", CAPTION, bands, "prediction")


def prediction_remarks(found: Prediction) -> list[Remark]:
    """Return the remarks on a prediction, its errors first."""
    said = [_score_remark(found, score) for score in found.scores]
    if found.undetermined:
        said.append(PredictionMessage.UNDETERMINED.said("plain", "prediction", names=listed(found.undetermined)))
    again = found.estimated
    if again is not None:
        triples = zip(again.names, again.values.tolist(), again.std.tolist(), strict=True)
        values = ", ".join(f"{name} = {with_std(value, std)}" for name, value, std in triples)
        said.append(PredictionMessage.AGAIN.said("plain", "prediction", record=found.fit.experiment, values=values))
        if not again.converged:
            end = {"names": listed(again.names), "end": ENDS[again.outcome]}
            said.append(PredictionMessage.AGAIN_ENDED.said("doubt", "prediction", (), **end))
    units = dict(zip(found.fit.outputs, found.fit.units, strict=True))
    return [*said, *(Remark(text, "plain", "residuals") for text in residual_words(found.residuals, units))]


def _score_remark(found: Prediction, score: OutputScore) -> Remark:
    said, error = f"{score.output} in {found.fit.experiment} is predicted", with_unit(score.rmse, score.unit)
    if math.isnan(score.fit):
        said += f" with an RMSE of {error} ({CONSTANT})"
    else:
        said += f" with a fit of {score.fit:.4g} % (RMSE {error})"
    how = ("plain", "prediction", (score.output,))
    if math.isnan(score.expected):
        return PredictionMessage.OPEN.said(*how, score=said)  # type: ignore[arg-type]
    values = {
        "score": said,
        "expected": with_unit(score.expected, score.unit),
        "band": f"{100 * score.inside:.3g} % of {score.samples} samples lie in the {100 * found.level:.4g} % band",
    }
    if score.ratio <= LEAST_RATIO:
        return PredictionMessage.AS_EXPECTED.said(*how, **values)  # type: ignore[arg-type]
    return PredictionMessage.WORSE.said(*how, **values, times=two_digits(score.ratio))  # type: ignore[arg-type]


def fold_remark(predictions: Sequence[Prediction]) -> Remark:
    """Return the verdict of a cross-validation."""
    ratios = [score.ratio for found in predictions for score in found.scores if not math.isnan(score.ratio)]
    if not ratios:
        return PredictionMessage.FOLDS_OPEN.said("plain", "prediction")
    worst = max(ratios)
    how = PredictionMessage.FOLDS if worst <= LEAST_RATIO else PredictionMessage.FOLDS_WORSE
    return how.said("plain", "prediction", times=two_digits(worst))


def _scores(predictions: Sequence[Prediction]) -> Table:
    heads = ("record", "output", "RMSE", "fit", "expected", "ratio", "in the band", "mean", "samples")
    rows = []
    for each in predictions:
        for score in each.scores:
            known = not math.isnan(score.expected)
            expected = f"{score.expected:.4g}" if known else "not known"
            ratio = f"{score.ratio:.3g}" if math.isfinite(score.ratio) else ""
            cells = [each.fit.experiment, score.output, f"{score.rmse:.4g} {unit_text(score.unit)}".strip()]
            cells += [fit_text(score.fit), expected, ratio, f"{100 * score.inside:.3g} %" if known else ""]
            rows.append([*cells, f"{score.mean:.3g}", str(score.samples)])
    columns = {head: [row[k] for row in rows] for k, head in enumerate(heads)}
    return table_of(columns, ("output",), ("mean", "ratio"))
