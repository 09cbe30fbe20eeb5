"""Results folders, written and read: JSON by class, long tables as CSV."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from fmuid import codec
from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.estimation import RESULT_SCHEMA
from fmuid.files import file_name, with_formulas, write_table
from fmuid.identification import ModelErrors
from fmuid.runs.findings import ComparisonRun, DiagnosisRun, IdentificationRun, MonitoringRun, PredictionRun
from fmuid.runs.preprocessing import write_some
from fmuid.simulation import OutputFit

RESULT_FILE = "result.json"
DIAGNOSIS_FILE = "diagnosis.json"
MONITORING_FILE, MONITORING_SCHEMA = "monitoring.json", "fmuid/monitoring/2"
PREDICTION_FILE, PREDICTION_SCHEMA = "prediction.json", "fmuid/prediction/2"
COMPARISON_FILE, COMPARISON_SCHEMA = "comparison.json", "fmuid/comparison/2"
PREPARED_FILE = "diagnosis-preparation.csv"  # what was done with the tables of a diagnosis, as in ``preparation.csv``
RESIDUALS_FILE = "diagnosis-residuals.csv"  # residuals of the first experiment, of the healthy model and with the fault
# Tables of an identification: those of an earlier run would be taken for this one's.
_TABLES = ("trace", "fit", "diagnostics", "optima", "preparation", "profiles", "posterior", "map-*")
# Columns of texts, which pandas would take for numbers or missing values where they look like it.
_TEXTS = ("experiment", "record", "significant", "alarm")
AGAIN = "run fmuid identify again"  # remedy for a damaged result


ShortFindings = TypeVar("ShortFindings", bound=PredictionRun | ComparisonRun)


def stacked(names: Sequence[str], frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Stack frames; several get a column ``experiment``."""
    if len(frames) == 1:
        return frames[0]
    marked = [frame.assign(experiment=name) for name, frame in zip(names, frames, strict=True)]
    together = pd.concat(marked, ignore_index=True)
    return together[["experiment", *together.columns.drop("experiment")]]


def tables_of(found: IdentificationRun) -> dict[str, pd.DataFrame]:
    """Return the CSV tables of an identification by name."""
    tables = {"estimates": found.estimates}
    checks = found.assessment
    if not found.fits or checks.residuals is None:
        return tables
    frames = [fit.frame() for fit in found.fits]
    tables |= {"trace": found.result.trace, "fit": stacked([fit.experiment for fit in found.fits], frames)}
    tables["diagnostics"] = checks.residuals.table
    if found.result.history.optima:
        tables["optima"] = found.optima
    if changed := [each.table for each in found.prepared if len(each.table)]:
        tables["preparation"] = pd.concat(changed, ignore_index=True)
    tables |= {f"map-{file_name('-'.join(chart.names))}": chart.table for chart in checks.maps}
    tables |= {"profiles": checks.profile_table} if checks.profiles else {}
    tables |= {} if checks.posterior is None else {"posterior": checks.posterior.table}
    return tables


def write_identification(folder: Path, found: IdentificationRun) -> list[Path]:
    """Write ``result.json`` and tables; return their paths. Tables of an earlier run go."""
    written = [codec.write(folder / RESULT_FILE, RESULT_SCHEMA, found)]
    written += [write_table(folder / f"{name}.csv", frame) for name, frame in tables_of(found).items()]
    for old in (old for name in _TABLES for old in folder.glob(f"{name}.csv")):
        if old not in written:
            old.unlink()
    return written


def read_model_errors(path: Path) -> ModelErrors:
    """Return the directed tests of a ``result.json``, empty without."""
    errors = codec.content_of(path, RESULT_SCHEMA, AGAIN).get("assessment", {}).get("model_errors")
    return codec.decoded(path, errors, ModelErrors, AGAIN, "assessment.model_errors") if errors else ModelErrors((), ())


def read_fits(folder: Path) -> tuple[OutputFit, ...]:
    """Return the fits of an identification, with their samples."""
    path = folder / RESULT_FILE
    fits = codec.content_of(path, RESULT_SCHEMA, AGAIN).get("fits", [])
    codec.decoded(path, fits, tuple[OutputFit, ...], AGAIN, "fits")  # its own errors first
    table = path.with_name("fit.csv")
    if not table.is_file():
        return ()
    with _fitting(path, AGAIN):
        _fill_fits(fits, read_table(table))
    return codec.decoded(path, fits, tuple[OutputFit, ...], AGAIN, "fits")


@contextmanager
def _fitting(path: Path, again: str) -> Iterator[None]:
    """Turn errors of tables that contradict a JSON file into one sentence."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path.parent}: tables contradict {path.name} ({error}); {again}") from None


def _fill_fits(fits: Sequence[dict[str, Any]], whole: pd.DataFrame) -> list[pd.DataFrame]:
    """Put the samples of a table into fits; return their rows."""
    parts = [whole[whole["experiment"] == each["experiment"]] for each in fits] if len(fits) > 1 else [whole]
    for each, part in zip(fits, parts, strict=True):
        timed = each.get("kind", "time") == "time"
        each["times"] = part["time"].to_numpy(np.float64) if timed else np.arange(1.0, len(part) + 1.0)
        each["measured"], each["simulated"] = (
            _values(part, kind, each["outputs"]) for kind in ("measured", "simulated")
        )
        if inputs := each.get("inputs"):
            inputs["values"] = _values(part, "input", inputs["names"])
        first = math.inf if each["counted_from"] is None else each["counted_from"]
        each["counted"] = np.isfinite(each["measured"]) & (each["times"] >= first)[:, np.newaxis]
    return parts


def _values(rows: pd.DataFrame, kind: str, names: Sequence[str]) -> Floats:
    return rows[[f"{kind}.{name}" for name in names]].to_numpy(np.float64)


def write_diagnosis(folder: Path, found: DiagnosisRun) -> list[Path]:
    """Write ``diagnosis.json`` and the tables of a diagnosis; return their paths."""
    from fmuid.diagnosis import DIAGNOSIS_SCHEMA  # and all that decides

    written = [codec.write(folder / DIAGNOSIS_FILE, DIAGNOSIS_SCHEMA, found)]
    written.append(write_table(folder / "diagnosis.csv", found.diagnosis.table))
    written += write_some(folder / PREPARED_FILE, (each.table for each in found.prepared))
    residuals = found.diagnosis.residuals if found.diagnosis.evidence.explanations else None
    return written + write_some(folder / RESIDUALS_FILE, [] if residuals is None else [residuals])


def read_monitoring(folder: Path) -> MonitoringRun:
    """Read the files of a monitoring."""
    path, again = folder / MONITORING_FILE, "run fmuid monitor again"
    content = codec.content_of(path, MONITORING_SCHEMA, again)
    content["table"] = read_table(folder / "monitoring.csv") if content.get("windows") else pd.DataFrame()
    return codec.decoded(path, content, MonitoringRun, again)


def write_findings(folder: Path, found: ShortFindings) -> ShortFindings:
    """Write a prediction or comparison, JSON and tables; return it with its files."""
    if isinstance(found, ComparisonRun):
        name, schema, tables = COMPARISON_FILE, COMPARISON_SCHEMA, {"comparison": found.table}
    else:
        name, schema, parts = PREDICTION_FILE, PREDICTION_SCHEMA, found.predictions
        records = stacked([each.fit.experiment for each in parts], [each.table for each in parts])
        tables = {"prediction": records, "scores": found.scores}
    written = [write_table(folder / f"{each}.csv", table) for each, table in tables.items()]
    return replace(found, files=(codec.write(folder / name, schema, found), *written))


def read_prediction(folder: Path) -> PredictionRun:
    """Read the files of a prediction."""
    path, again = folder / PREDICTION_FILE, "run fmuid predict again"
    content = codec.content_of(path, PREDICTION_SCHEMA, again)
    table = read_table(folder / "prediction.csv")
    with _fitting(path, again):
        fits = [each["fit"] for each in content["predictions"]]
        for each, rows in zip(content["predictions"], _fill_fits(fits, table), strict=True):
            fit = each["fit"]
            each["std"] = _values(rows, "std", fit["outputs"])
            each["half_width"] = _values(rows, "upper", fit["outputs"]) - fit["simulated"]
    return codec.decoded(path, content, PredictionRun, again)


def read_table(path: Path) -> pd.DataFrame:
    """Return a CSV table of fmuid; raise InputError if it cannot be read."""
    try:
        names = pd.read_csv(path, nrows=0).columns
        texts = dict.fromkeys(names.intersection(list(_TEXTS)), str)
        return with_formulas(pd.read_csv(path, converters=texts))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no readable table of results: {error}") from None
