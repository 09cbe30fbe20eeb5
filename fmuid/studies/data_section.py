"""Keys of ``[[experiments]]`` about reading the data file."""

from __future__ import annotations

from typing import Annotated

from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import StudySection, entry
from fmuid.units import TIME_UNITS


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
