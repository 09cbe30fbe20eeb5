"""What `fmuid predict` prints: how well each output of each record is predicted, and what that means."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fmuid.formatting import fit_text, unit_text, with_std
from fmuid.reports.console.layout import console, show_notes, show_sentences, table_of_rows
from fmuid.reports.messages.prediction import fold_words, prediction_words
from fmuid.reports.messages.result import source_words

if TYPE_CHECKING:
    from fmuid.runs import PredictionRun


def show_predictions(found: PredictionRun) -> None:
    """Print a table, a row for each output of each record, and what is to be said of them."""
    show_notes(map(source_words, found.notes))
    show_notes(f"the result was made from {name}: this is no prediction" for name in found.seen)
    heads = ["record", "output", "RMSE", "fit", "expected", "in the band", "mean", "samples"]
    rows = []
    for each in found.predictions:
        for score in each.scores:
            unit = unit_text(score.unit)
            cells = [each.fit.experiment, score.output, f"{score.rmse:.4g} {unit}".strip(), fit_text(score.fit)]
            known = not math.isnan(score.expected)
            cells += [f"{score.expected:.4g}", f"{100 * score.inside:.3g} %"] if known else ["not known", ""]
            rows.append([*cells, f"{score.mean:.3g}", str(score.samples)])
    console().print(table_of_rows("Predicted against measured", heads, rows, right=heads[2:]))
    for each in found.predictions:
        if each.estimated is not None:
            triples = zip(each.estimated.names, each.estimated.values, each.estimated.std, strict=True)
            values = ", ".join(f"{name} = {with_std(float(value), float(std))}" for name, value, std in triples)
            show_sentences([f"Estimated again on {each.fit.experiment}: {values}"])
        show_sentences(prediction_words(each))
    if found.folds:
        show_sentences([fold_words(found.predictions)])
