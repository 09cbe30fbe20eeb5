"""Keys of ``[[experiments]]`` about reading the data file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import StudySection, entry
from fmuid.units import TIME_UNITS

if TYPE_CHECKING:
    import pandas as pd


class DataSection(StudySection):
    """Data file and how it is read."""

    data: kinds.File = entry(..., "data file")
    time: kinds.NameOrPlace = entry("time", "time column, by name or number from 1")
    time_unit: Annotated[str, kinds.one_of(TIME_UNITS)] | None = entry(
        None, "unit of the time column; default: that of the file, else s"
    )
    sample_rate: kinds.Positive | None = entry(None, "samples per second, for data without times or with coarse ones")
    sheet: kinds.NameOrPlace | None = entry(None, "sheet, by name or number from 1; default: the first with data")
    missing: kinds.Marks | None = entry(
        None, "texts and numbers that stand for no sample; [] accepts values far beyond all others", ["OL", -9999]
    )
    clocks: kinds.Texts = entry({}, "time columns of columns, { column = time column }, of tables with several")

    @property
    def in_time(self) -> bool:
        """True if rows have a time."""
        return True

    def read_frame(self, table: Path, source: str | None = None) -> pd.DataFrame:
        """Read a data file before ``[experiments.preprocess]``."""
        from fmuid.data import read_data

        how = {key: getattr(self, key) for key in ("time_unit", "sample_rate", "sheet", "missing", "clocks")}
        return read_data(table, self.time if self.in_time else None, **how, source=source or str(table))
