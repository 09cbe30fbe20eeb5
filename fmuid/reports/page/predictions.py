"""The part of a report that predictions make up."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fmuid.errors import InputError
from fmuid.reports.interactive import fit
from fmuid.reports.page.contents import read_json, read_table
from fmuid.reports.page.document import Part, Section, table
from fmuid.reports.page.verdict import Said
from fmuid.reports.words.result import capitalised
from fmuid.simulation import Fit
from fmuid.text import has_unit

CAPTION = (
    "Dots were measured, the line is simulated with the estimates, which this record was not used for, the residual "
    "is below."
)


def part(folder: Path) -> Part:
    """Return the part of a report on the predictions in a folder.

    Raises
    ------
    InputError
        If a file in it cannot be read.
    """
    content, rows = read_json(folder / "prediction.json"), read_table(folder / "prediction.csv")
    try:
        records = list(content["records"])
        several = len(records) > 1
        parts = [rows[rows["experiment"] == str(each["experiment"])] if several else rows for each in records]
        fits = [_fit(each, frame) for each, frame in zip(records, parts, strict=True)]
        said = [Said(capitalised(str(text)), "fit") for text in content["words"]]
        scores = _scores(records)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder} has no whole results of fmuid predict ({error}): predict again") from None
    sections = [
        Section("fit" if k == 0 else f"fit-{k + 1}", f"Predicted: {each.experiment}", CAPTION, [fit.fit(each)], 1)
        for k, each in enumerate(fit.worst(fits))
    ]
    return Part("Prediction", f"{len(records)} record{'s' if several else ''}", True, said, scores, sections)


def _fit(given: Mapping[str, Any], frame: pd.DataFrame) -> Fit:
    names = tuple(str(each["output"]) for each in given["outputs"])
    units = tuple(each.get("unit") for each in given["outputs"])
    measured, simulated = (
        frame[[f"{kind}.{name}" for name in names]].to_numpy(np.float64) for kind in ("measured", "simulated")
    )
    times = frame["time"].to_numpy(np.float64)
    return Fit(str(given["experiment"]), times, names, units, measured, simulated, np.isfinite(measured))


def _scores(records: list[Mapping[str, Any]]) -> str:
    columns: dict[str, list[str]] = {key: [] for key in ("record", "output", "unit", "RMSE", "fit (%)")}
    for record in records:
        for each in record["outputs"]:
            columns["record"].append(str(record["experiment"]))
            columns["output"].append(str(each["output"]))
            columns["unit"].append(str(each["unit"]) if has_unit(each["unit"]) else "")
            columns["RMSE"].append(f"{each['rmse']:.4g}")
            columns["fit (%)"].append(f"{each['fit']:.4g}")
    return table(columns, numbers=("RMSE", "fit (%)"))
