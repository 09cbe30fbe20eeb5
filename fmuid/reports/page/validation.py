"""The parts of a report that predictions, comparisons, excitations and sensitivities make up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.formatting import fit_text, listed, with_unit
from fmuid.reports.interactive import comparison
from fmuid.reports.interactive.style import MAX_EXPERIMENTS
from fmuid.reports.messages.prediction import LEAST_RATIO
from fmuid.reports.page.contents import read_table
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.fits import fit_sections, residual_section
from fmuid.reports.page.provenance import origin
from fmuid.reports.page.saved import read_json
from fmuid.reports.page.verdict import ReportStatement
from fmuid.simulation import OutputFit

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
    content, whole = read_json(folder / "prediction.json"), read_table(folder / "prediction.csv")
    try:
        records = content["records"]
        said = [ReportStatement(str(text), "prediction") for text in content["words"]]
        scores = [{"record": each["experiment"], **score} for each in records for score in each["outputs"]]
        found = {str(each["experiment"]): _predicted(each, whole, len(records)) for each in records}
        seen = [str(each["experiment"]) for each in records if each.get("seen")]
        rows = _scores(scores)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"{folder} has no whole results of fmuid predict ({error}): predict again") from None
    ratios = [score["ratio"] for score in scores if score.get("ratio") is not None]
    good = all(ratio <= LEAST_RATIO for ratio in ratios)
    state = "seen before" if seen else "predicted" if not ratios else "carries over" if good else "worse than expected"
    if seen:
        said.append(ReportStatement(f"The result was made from {listed(seen)}: this is no prediction", doubtful=True))
    fits = [fit for fit, _, _ in found.values()]
    bands = {name: (half, level) for name, (_, half, level) in found.items()}
    sections = fit_sections("prediction", "Predicted", PREDICTED, fits, bands)
    path = folder / "prediction-correlations.csv"
    sections += [residual_section(fits, read_table(path))] if is_file(path) else []
    return Part("Prediction", state, good and not seen, said, rows, sections, origin(content))


def _predicted(record: dict[str, Any], whole: pd.DataFrame, count: int) -> tuple[OutputFit, Floats | None, float]:
    """Return measured and predicted outputs, the half widths of the bands and their level."""
    rows = whole[whole["experiment"] == record["experiment"]] if count > 1 else whole
    outputs = [str(name).removeprefix("simulated.") for name in rows.columns if str(name).startswith("simulated.")]
    units = {score["output"]: score["unit"] or None for score in record["outputs"]}
    measured, simulated, upper = (
        rows[[f"{kind}.{name}" for name in outputs]].to_numpy(np.float64) for kind in ("measured", "simulated", "upper")
    )
    times, told = rows["time"].to_numpy(np.float64), tuple(units.get(name) for name in outputs)
    found = OutputFit(record["experiment"], times, tuple(outputs), told, measured, simulated, np.isfinite(measured))
    half = upper - simulated
    return found, half if np.isfinite(half).any() else None, float(record["level"])


def _scores(scores: list[dict[str, Any]]) -> str:
    columns = {
        "output": [str(each["output"]) for each in scores],
        "record": [str(each["record"]) for each in scores],
        "fit": [fit_text(each["fit"]) for each in scores],
        "RMSE": [with_unit(each["rmse"], each["unit"]) for each in scores],
        "expected": [_number(each["expected"]) for each in scores],
        "ratio": [_number(each["ratio"], 3) for each in scores],
        "in the band": ["" if each["inside"] is None else f"{100 * each['inside']:.3g} %" for each in scores],
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
    return origin(read_json(path)) if is_file(path) else ""


def part_of_sensitivities(folder: Path) -> Part:
    """Return the part on the sensitivities in a folder; units are those of its ``result.json``, where there is one.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    whole, result = read_table(folder / "sensitivities.csv"), folder / "result.json"
    known = read_json(result).get("experiments", []) if is_file(result) else []
    units = {name: unit for each in known for name, unit in each["outputs"].items()}
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
