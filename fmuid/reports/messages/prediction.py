"""What is to be said of predictions of records that a result was not made from, and of comparisons of results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from fmuid.formatting import listed, two_digits, with_unit
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import CONSTANT, ENDS

if TYPE_CHECKING:
    from fmuid.identification import OutputScore, Prediction
    from fmuid.runs import PredictionRun

# Residuals that are larger than expected by this factor are an error of the model rather than chance.
LEAST_RATIO = 1.25


def prediction_words(found: Prediction) -> tuple[str, ...]:
    """Return what is to be known of a prediction, in sentences: how good it is first."""
    said = [_score_words(found, score) for score in found.scores]
    if found.undetermined:
        said.append(f"The result leaves {listed(found.undetermined)} undetermined: the band is that of the noise alone")
    if found.estimated is not None and not found.estimated.converged:
        names = listed(found.estimated.names)
        said.append(f"Estimated again on this record, {names}: {ENDS[found.estimated.outcome]}")
    units = dict(zip(found.fit.outputs, found.fit.units, strict=True))
    return *said, *residual_words(found.residuals, units)


def _score_words(found: Prediction, score: OutputScore) -> str:
    said, error = f"{score.output} in {found.fit.experiment} is predicted", with_unit(score.rmse, score.unit)
    if math.isnan(score.fit):
        said += f" with an RMSE of {error} ({CONSTANT})"
    else:
        said += f" with a fit of {score.fit:.4g} % (RMSE {error})"
    if math.isnan(score.expected):
        return f"{said}; the result was not made from such an output, so nothing says how large the residual should be"
    band = f"{100 * score.inside:.3g} % of {score.samples} samples lie in the {100 * found.level:.4g} % band"
    if score.ratio <= LEAST_RATIO:
        return f"{said}, as noise and estimates let expect ({with_unit(score.expected, score.unit)}): {band}"
    return (
        f"{said}, {two_digits(score.ratio)} times what noise and estimates let expect "
        f"({with_unit(score.expected, score.unit)}): {band}; the record shows an error of the model, or the machine "
        "has changed"
    )


def fold_words(predictions: Sequence[Prediction]) -> str:
    """Return what a cross-validation says of a model, by all its predictions."""
    ratios = [score.ratio for found in predictions for score in found.scores if not math.isnan(score.ratio)]
    if not ratios:
        return "Nothing says how large the residuals should be"
    worst = max(ratios)
    if worst <= LEAST_RATIO:
        return (
            "Left out in turn, the experiments are predicted as noise and estimates let expect "
            f"({two_digits(worst)} times)"
        )
    return (
        f"Left out in turn, experiments are predicted up to {two_digits(worst)} times worse than noise and "
        "estimates let expect: what is identified from the others does not carry over to all of them"
    )


def predicted_words(found: PredictionRun) -> tuple[str, ...]:
    """Return what is to be said of predictions, and of a cross-validation."""
    said = [words for each in found.predictions for words in prediction_words(each)]
    return tuple([*said, fold_words(found.predictions)] if found.folds else said)
