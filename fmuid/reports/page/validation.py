"""The parts of a report that predictions, comparisons, excitations and sensitivities make up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.files import is_file
from fmuid.formatting import fit_text, listed, with_unit
from fmuid.identification import ResidualAnalysis
from fmuid.reports.interactive import comparison
from fmuid.reports.interactive.style import MAX_EXPERIMENTS
from fmuid.reports.messages.prediction import LEAST_RATIO, predicted_words
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.fits import fit_sections, residual_section
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.verdict import ReportStatement
from fmuid.runs import (
    PredictionRun,
    read_identification,
    read_origin,
    read_prediction,
    read_table,
)

PREDICTED = (
    "Dots were measured, the line is simulated with the values of the result; the residual is below. "
    "In the band a new measurement is expected, by the noise and by how well the parameters are known: about as many "
    "dots lie in it as its level says, where the model carries over."
)
WORST = "The shorter, the better: the largest of the parameters' relative standard deviations, the best excitation red."
FOUND = "The shorter, the better: the smallest size of the fault that is found, over its magnitude; the best is red."
SENSITIVITIES = (
    "What a relative change of a parameter does to each output, θ ∂y/∂θ. A parameter whose line is small is hardly "
    "determined by this excitation; two whose lines look alike are hardly told apart."
)


HEADS = {
    "name": "result",
    "log_likelihood": "log-likelihood",
    "aic": "AIC",
    "bic": "BIC",
    "corrected_aic": "corrected AIC",
    "corrected_bic": "corrected BIC",
    "duration": "duration (s)",
    "log_determinant": "log-determinant",
}
"""What columns of ``comparison.csv`` and ``design.csv`` are called."""


def part_of_prediction(folder: Path) -> Part:
    """Return the part on the predictions in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    found = read_prediction(folder)
    said = [ReportStatement(text, "prediction") for text in predicted_words(found)]
    ratios = [score.ratio for each in found.predictions for score in each.scores if math.isfinite(score.ratio)]
    good = all(ratio <= LEAST_RATIO for ratio in ratios)
    state = "predicted" if not ratios else "carries over" if good else "worse than expected"
    state = "seen before" if found.seen else state
    if found.seen:
        said.append(
            ReportStatement(f"The result was made from {listed(found.seen)}: this is no prediction", doubtful=True)
        )
    fits = [each.fit for each in found.predictions]
    bands = {
        each.fit.experiment: (each.half_width if np.isfinite(each.half_width).any() else None, each.level)
        for each in found.predictions
    }
    sections = fit_sections("prediction", "Predicted", PREDICTED, fits, bands)
    correlations = ResidualAnalysis(
        tuple(one for each in found.predictions for one in each.residuals.series), {}
    ).correlations
    sections.append(residual_section(fits, correlations))
    good = good and not found.seen
    return Part("Prediction", state, good, said, _scores(found), sections, origin(found.origin))


def _scores(found: PredictionRun) -> str:
    pairs = [(each.fit.experiment, score) for each in found.predictions for score in each.scores]
    columns = {
        "output": [score.output for _, score in pairs],
        "record": [record for record, _ in pairs],
        "fit": [fit_text(score.fit) for _, score in pairs],
        "RMSE": [with_unit(score.rmse, score.unit) for _, score in pairs],
        "expected": [_number(score.expected) for _, score in pairs],
        "ratio": [_number(score.ratio, 3) for _, score in pairs],
        "in the band": ["" if math.isnan(score.inside) else f"{100 * score.inside:.3g} %" for _, score in pairs],
    }
    return table(columns, numbers=[name for name in columns if name not in ("output", "record")])


def part_of_design(folder: Path) -> Part:
    """Return the part on the excitations in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    rows = read_table(folder / "design.csv")
    names, accuracy = [str(name) for name in rows["excitation"]], "log_determinant" in rows
    text, caption = ("largest relative std", WORST) if accuracy else ("smallest fault found / its magnitude", FOUND)
    worst = 100.0 * rows["worst"].to_numpy(np.float64)
    what = "leaves no relative std above" if accuracy else "shows faults from this share of their magnitude on:"
    one = f"{names[0]} is the best of {len(names)} excitations: it" if len(names) > 1 else names[0]
    said = [ReportStatement(f"{one} {what} {worst[0]:.3g} %", "excitations")]
    columns = {HEADS.get(str(key), str(key)): [_cell(each) for each in rows[key]] for key in rows}
    shown = table(columns, numbers=list(columns)[1:])
    section = Section(
        "excitations", "Excitations, the best first", caption, [comparison.bars(names, worst, f"{text} (%)")], 1
    )
    return Part("Design", f"best: {names[0]}", True, said, shown, [section], _origin_beside(folder / "design.json"))


def _origin_beside(path: Path) -> str:
    return origin(read_origin(path)) if is_file(path) else ""


def part_of_sensitivities(folder: Path) -> Part:
    """Return the part on the sensitivities in a folder; units are those of its ``result.json``, where there is one.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    whole, result = read_table(folder / "sensitivities.csv"), folder / "result.json"
    units = read_identification(folder).output_units if is_file(result) else {}
    groups = list(whole.groupby("experiment", sort=False)) if "experiment" in whole else [("", whole)]
    sections = []
    for k, (each, rows) in enumerate(groups[:MAX_EXPERIMENTS]):
        name = str(each)
        heading = f"Sensitivities: {name}" if name else "Sensitivities"
        anchor, caption = ("sensitivities", SENSITIVITIES) if k == 0 else (f"sensitivities-{k + 1}", "")
        sections.append(Section(anchor, heading, caption, [comparison.sensitivities(rows, units)], 1))
    said = [
        ReportStatement("What relative changes of the parameters do to the outputs at their starts", "sensitivities")
    ]
    return Part(
        "Sensitivities",
        f"{len(groups)} experiment{'s' * (len(groups) > 1)}",
        True,
        said,
        "",
        sections,
        _origin_beside(folder / "sensitivities.json"),
    )


def _cell(value: Any) -> str:
    return _number(value) if isinstance(value, float) else str(value)


def _number(value: float | None, digits: int = 4) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"
