"""One path for a comparison of results: likelihoods on their own data, errors on common tables, files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid import files
from fmuid.data import record_files
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import as_json, content_of
from fmuid.identification import (
    CONFIDENCE_LEVEL,
    IncomparableError,
    ModelCandidate,
    ModelComparison,
    Prediction,
    compare_models,
)
from fmuid.reports.predictions import run_prediction
from fmuid.reports.provenance import digests, made_now
from fmuid.runs import RESULT_FILE, result_path, study_of
from fmuid.studies import Study


@dataclass(frozen=True, eq=False)
class ComparisonRun:
    """What a comparison has found.

    Attributes
    ----------
    comparison : ModelComparison or None
        By their likelihoods; None where they were compared on common tables alone.
    predictions : mapping of str to tuple of Prediction
        Of the common tables, by the name of the result; empty without.
    apart : str
        Why likelihoods were not compared, "" where they were.
    estimates : tuple of dict
        ``result``, ``parameter``, ``unit``, ``value``, and ``lower`` and ``upper`` of its interval of 95 %.
    origin : mapping
        What it was made from: ``version``, ``date``, and ``files``, SHA-256 of each result, its study and the tables.
    """

    comparison: ModelComparison | None
    predictions: Mapping[str, tuple[Prediction, ...]]
    apart: str = ""
    estimates: tuple[Mapping[str, Any], ...] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def table(self) -> pd.DataFrame:
        """A row for each result: criteria, and over the common tables the RMSE of each output and the mean fit, %."""
        rows = {} if self.comparison is None else {rank.name: vars(rank) for rank in self.comparison.ranks}
        for name, found in self.predictions.items():
            errors = pooled(found)
            rows[name] = rows.get(name, {"name": name}) | {f"rmse.{output}": rmse for output, rmse in errors.items()}
            rows[name]["fit"] = mean_fit(found)
        return pd.DataFrame(rows.values())

    @property
    def units(self) -> dict[str, str]:
        """The unit of each output of the common tables."""
        found = [score for each in self.predictions.values() for record in each for score in record.scores]
        return {score.output: score.unit for score in found}

    def write(self, folder: Path) -> list[Path]:
        """Write ``comparison.json`` and ``comparison.csv``, and return their paths."""
        content: dict[str, Any] = {"results": self.table.to_dict("records")}
        content |= {"units": self.units, "estimates": list(self.estimates), **self.origin}
        if self.comparison is not None:
            content |= {"tests": self.comparison.tests, "dependence": self.comparison.dependence}
        return [
            files.write_json(folder / "comparison.json", as_json(content)),
            files.write_table(folder / "comparison.csv", self.table),
        ]


def pooled(found: Sequence[Prediction]) -> dict[str, float]:
    """Return the RMSE of each output over all records."""
    sums: dict[str, tuple[float, int]] = {}
    for score in (score for each in found for score in each.scores):
        squares, samples = sums.get(score.output, (0.0, 0))
        sums[score.output] = squares + score.samples * score.rmse**2, samples + score.samples
    return {output: math.sqrt(squares / samples) for output, (squares, samples) in sums.items()}


def mean_fit(found: Sequence[Prediction]) -> float:
    """Return the fit over all outputs and records, %: 100 less the root mean square of what each is below 100.

    Outputs that are constant in a record are left out; NaN where all are.
    """
    errors = [100.0 - score.fit for each in found for score in each.scores if not math.isnan(score.fit)]
    return 100.0 - math.hypot(*errors) / math.sqrt(len(errors)) if errors else math.nan


def run_comparison(
    results: Sequence[Path | str],
    tables: Sequence[Path | str] = (),
    *,
    free: Sequence[str] = (),
    isolated: bool = False,
) -> ComparisonRun:
    """Compare results by their likelihoods where they were made from the same data, and on common tables.

    ``fmuid compare`` is this, with a folder.

    Parameters
    ----------
    results : sequence of path
        ``result.json`` files, or the folders that have them.
    tables : sequence of path
        Records, and folders of records, that all results predict.
    free : sequence of str
        Variables that are estimated again on each record, such as initial states.
    isolated : bool
        Run the FMUs in a process of their own.

    Raises
    ------
    InputError
        If there are fewer than two results, they were made from different data and there are no tables, or results,
        studies and records do not fit together.
    SimulationError
        If a simulation fails.

    Examples
    --------
    >>> study = fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml")
    >>> for name in ("first", "second"):
    ...     _ = fmuid.run_study(study, name)
    >>> fmuid.run_comparison(["first", "second"]).table["name"].tolist()
    ['first', 'second']
    """
    paths = [result_path(Path(each)) for each in results]
    candidates = [_candidate(path, name) for path, name in zip(paths, _names(paths), strict=True)]
    comparison, apart = None, ""
    try:
        comparison = compare_models(candidates)
    except IncomparableError as error:
        if not tables:
            raise
        apart = error.reason
    predictions = {}
    for each, path in zip(candidates, paths if tables else (), strict=bool(tables)):
        study = study_of(path, isolated=isolated, in_place=Path(tables[0]))
        predictions[each.name] = run_prediction(path, tables, study=study, free=free).predictions
    return ComparisonRun(
        comparison,
        predictions,
        apart,
        tuple(row for each in candidates for row in estimate_rows(each.name, each.result)),
        {**made_now(), "files": digests([*paths, *record_files([Path(table) for table in tables])], Path.cwd())},
    )


def estimate_rows(result: str, found: Result) -> list[dict[str, Any]]:
    """Return a row for each estimate of a result of that name, as in `ComparisonRun.estimates`."""
    ends = found.intervals(CONFIDENCE_LEVEL).itertuples(index=False)
    return [
        {"result": result, "parameter": name, "unit": found.units.get(name, ""), "value": value}
        | {"lower": end.lower, "upper": end.upper}
        for name, value, end in zip(found.names, found.values.tolist(), ends, strict=True)
    ]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return names that tell paths apart: of their folders, with as much of the way to them as that takes."""
    ways = [path.resolve() for path in paths]
    for path, way in zip(paths, ways, strict=True):
        if ways.count(way) > 1:
            raise InputError(f"{path} is given twice: give each result once")
    parts = [way.parent.parts if way.name == RESULT_FILE else way.parts for way in ways]
    names: list[str] = []
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            break
    return names


def _candidate(path: Path, name: str) -> ModelCandidate:
    result = Result.from_json(path)
    with content_of(path, "the result.json of an identification", "run fmuid identify again") as content:
        rows = content.get("diagnostics", {}).get("residuals", [])
        samples = sum(int(row["samples"]) for row in rows)
        worth = sum(int(row["samples"]) / max(1.0, float(row.get("correlation_samples") or 1.0)) for row in rows)
    dependence = samples / worth if worth else math.nan
    study: Study | None = None
    if "study" in content:
        study = study_of(path)
    return ModelCandidate(name, result, dependence, None if study is None else study.model.values)
