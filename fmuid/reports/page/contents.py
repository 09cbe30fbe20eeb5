"""What a folder has of an identification, read back as data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import with_formulas
from fmuid.identification import CostMap
from fmuid.reports.page.saved import read_json
from fmuid.simulation import OutputFit

if TYPE_CHECKING:
    from fmuid.reports.identification_run import IdentificationRun

# Columns of texts, which pandas would take for numbers or missing values where they look like it.
_TEXTS = (
    *("parameter", "unit", "experiment", "output", "with", "moved_by", "profiled", "column"),
    *("record", "significant", "alarm"),
)


@dataclass(frozen=True, eq=False)
class SavedIdentification:
    """What ``fmuid identify`` has left in a folder.

    Attributes
    ----------
    content : mapping
        Of ``result.json``.
    result : Result
    tables : dict of str to DataFrame
        The CSV tables by their names; those that are not there are missing.
    fits : tuple of OutputFit
    maps : tuple of CostMap
    """

    content: Mapping[str, Any]
    result: Result
    tables: dict[str, pd.DataFrame]
    fits: tuple[OutputFit, ...]
    maps: tuple[CostMap, ...]

    @classmethod
    def read(cls, folder: Path) -> SavedIdentification:
        """Read a folder.

        Raises
        ------
        InputError
            If there is no ``result.json``, a file cannot be read, or they do not belong together.
        """
        path = folder / "result.json"
        result = Result.from_json(path)
        content = read_json(path)
        tables = {
            file.stem: read_table(file) for file in sorted(folder.glob("*.csv")) if file.stem.split("-")[0] in _MINE
        }
        try:
            fits = _fits(content, tables)
            maps = _maps([table for name, table in tables.items() if name.startswith("map-")], result)
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f"{folder} has tables that do not go with its result.json ({error}); identify the study again"
            ) from None
        return cls(content, result, tables, fits, maps)

    @classmethod
    def of(cls, found: IdentificationRun) -> SavedIdentification:
        """Return what a folder would have of findings."""
        return cls(found.to_json_dict(), found.result, found.tables(), found.fits, tuple(found.maps().values()))

    @property
    def units(self) -> dict[str, str | None]:
        """The unit of each parameter."""
        if "estimates" not in self.tables:
            return {}
        table = self.tables["estimates"]
        return dict(zip(table["parameter"], (unit or None for unit in table["unit"]), strict=True))

    @property
    def output_units(self) -> dict[str, str | None]:
        """The unit of each output."""
        return {name: unit for fit in self.fits for name, unit in zip(fit.outputs, fit.units, strict=True)}

    @property
    def level(self) -> float:
        """The level of intervals."""
        return float(self.content.get("level", 0.95))


_MINE = (
    *("estimates", "trace", "rounds", "fit", "correlations", "reading", "optima", "profiles", "posterior"),
    *("preparation", "walkers", "map"),
)


def read_table(path: Path) -> pd.DataFrame:
    """Return a CSV table that fmuid wrote.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        names = pd.read_csv(path, nrows=0).columns
        return with_formulas(pd.read_csv(path, converters=dict.fromkeys(names.intersection(list(_TEXTS)), str)))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as a table of results: {error}") from None


def _fits(content: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> tuple[OutputFit, ...]:
    if "fit" not in tables:
        return ()
    whole, given = tables["fit"], content.get("experiments", [])
    parts = [whole[whole["experiment"] == each["name"]] for each in given] if len(given) > 1 else [whole]
    return tuple(_fit(each, part) for each, part in zip(given, parts, strict=False))


def _fit(given: Mapping[str, Any], table: pd.DataFrame) -> OutputFit:
    outputs = tuple(given["outputs"])
    times = table["time"].to_numpy(np.float64)
    measured, simulated = (
        table[[f"{kind}.{name}" for name in outputs]].to_numpy(np.float64) for kind in ("measured", "simulated")
    )
    first = given["counted_from"]
    late = times >= (math.inf if first is None else first)
    counted = np.isfinite(measured) & late[:, np.newaxis]
    return OutputFit(given["name"], times, outputs, tuple(given["outputs"].values()), measured, simulated, counted)


def _maps(tables: list[pd.DataFrame], result: Result) -> tuple[CostMap, ...]:
    """Return the maps; the least of them is at the estimate, whose own criterion may be of other noise variances."""
    least = min((float(table["criterion"].min()) for table in tables), default=math.nan)
    return tuple(_map(table, result, least) for table in tables)


def _map(table: pd.DataFrame, result: Result, least: float) -> CostMap:
    first, second = (str(name) for name in table.columns[:2])
    where = [result.names.index(name) for name in (first, second)]
    sides = [np.unique(table[name].to_numpy(np.float64)) for name in (first, second)]
    return CostMap(
        (first, second),
        table,
        (sides[0].size, sides[1].size),
        (_logarithmic(sides[0]), _logarithmic(sides[1])),
        result.values[where],
        least,
        result.white_covariance[np.ix_(where, where)],
        result.test_scale([first, second]),
        result.test_freedom([first, second]),
        {name: result[name] for name in result.names if name not in (first, second)},
    )


def _logarithmic(places: np.ndarray[Any, np.dtype[np.float64]]) -> bool:
    """Return whether points divide their range in equal ratios, and not in equal steps."""
    if places.size < 3 or places[0] <= 0:
        return False
    steps, ratios = np.diff(places), np.diff(np.log(places))
    return bool(np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean())
