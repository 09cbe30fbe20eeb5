"""Tables before and after ``[experiments.preprocess]``, thinned for figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import UNITS, column_of, extremes, numeric_column, time_name
from fmuid.files import write_table
from fmuid.runs.findings import PreprocessedTable

if TYPE_CHECKING:
    from fmuid.data import Experiment
    from fmuid.studies import ExperimentSettings, Study

BEFORE, AFTER = "before", "after"
# Rows that are kept of a column, as many as a figure can show.
MAX_ROWS = 4000
_READ_BY = ("data", "time", "time_unit", "sample_rate", "sheet")


def prepared(study: Study) -> tuple[PreprocessedTable, ...]:
    """Return the preprocessing of each experiment; tables are read again."""
    found: list[PreprocessedTable] = []
    read: tuple[list[Any], pd.DataFrame] | None = None
    for given, experiment in zip(study.experiments, study.tables, strict=True):
        if not changed(given.preprocess):
            continue
        key = [getattr(given, name) for name in _READ_BY]
        if read is None or read[0] != key:  # pieces of a record follow each other
            read = None  # two records at once may be more than there is room for
            read = key, given.read_frame(given.data)
        units = dict(experiment.frame.attrs.get(UNITS, {}))
        columns = prepared_columns(given, experiment, read[1])
        found.append(PreprocessedTable(given.name, changed(given.preprocess), units, columns))
    return tuple(found)


def write_some(path: Path, tables: Iterable[pd.DataFrame]) -> list[Path]:
    """Write tables below each other; without rows an earlier file goes."""
    some = [each for each in tables if len(each)]
    path.unlink(missing_ok=True)
    return [write_table(path, pd.concat(some, ignore_index=True))] if some else []


def changed(settings: Any) -> dict[str, Any]:
    """Return the settings that are not defaults."""
    left: dict[str, Any] = {}
    for each in fields(settings):
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if getattr(settings, each.name) != default:
            left[each.name] = getattr(settings, each.name)
    return {name: list(map(changed, value)) if name == "park" else value for name, value in left.items()}


def prepared_columns(
    given: ExperimentSettings, experiment: Experiment, raw: pd.DataFrame, *, whole: bool = False
) -> pd.DataFrame:
    """Return columns before and after, where they differ or if `whole`."""
    parts = list(_changes(given, experiment, raw, whole=whole))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def _changes(
    given: ExperimentSettings, experiment: Experiment, raw: pd.DataFrame, *, whole: bool
) -> Iterator[pd.DataFrame]:
    time = time_name(given.time)
    words, after = given.preprocess, experiment.frame
    names = [*experiment.columns.values(), *words.computed_columns, *words.fill_missing]
    names += [name for each in words.park for name in each.target]
    names += list(words.detrend) if isinstance(words.detrend, dict) else []
    there = [[str(each) for each in frame.columns] for frame in (raw, after)]
    for name in dict.fromkeys(names):
        old, new = (column_of(known, name) for known in there)
        if new is None:  # of a column that resampling has left out
            continue
        later = _line(after, time, new, experiment.source)
        known = old is not None and pd.api.types.is_numeric_dtype(raw[old].dtype)
        earlier = _line(raw, time, str(old), experiment.source) if known else None
        if earlier is not None and np.array_equal(earlier, later, equal_nan=True) and not whole:
            continue
        for stage, line in ((BEFORE, earlier), (AFTER, later)):
            if line is not None:
                times, values = line[:, extremes(line[1][:, None], MAX_ROWS)]
                named = {"experiment": given.name, "column": new, "stage": stage}
                yield pd.DataFrame({**named, "time": times, "value": values})


def _line(frame: pd.DataFrame, time: str, column: str, source: str) -> Floats:
    """Return times and values (2, K)."""
    return np.stack([numeric_column(frame, time, source), numeric_column(frame, column, source)])
