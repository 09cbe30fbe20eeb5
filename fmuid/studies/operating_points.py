"""Keys of ``[[experiments]]`` about the data file and its kind."""

from __future__ import annotations

from typing import Annotated, Any

import pandas as pd

from fmuid.data import Experiment, FrequencyExperiment, Response, RotatingFrame, SteadyExperiment
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import Settings, StudySection, entry
from fmuid.units import TIME_UNITS

KINDS = ("time", "steady", "frequency")
OF_TIME = ("time", "time_unit", "model_time_unit", "sample_rate", "clocks", "interpolation", "warmup", "observation")
"""Keys that need a time."""
OF_KIND = {"steady": ("frame", "guess"), "frequency": ("frequency", "responses", "point")}  # keys of each other kind
Responses = Annotated[dict[str, Annotated[Response, Settings()]], kinds.Entries("{ name = section }")]


class DataSection(StudySection):
    """Data file, how it is read, and its kind."""

    data: kinds.File = entry(..., "data file")
    time: kinds.NameOrPlace = entry("time", "time column, by name or number from 1")
    time_unit: Annotated[str, kinds.one_of(TIME_UNITS)] | None = entry(
        None, "unit of the time column; default: that of the file, else s"
    )
    model_time_unit: Annotated[str, kinds.one_of(TIME_UNITS)] = entry(
        "s", "unit in which the FMU counts time; times of the data are converted", "h"
    )
    sample_rate: kinds.Positive | None = entry(None, "samples per second, for data without times or with coarse ones")
    sheet: kinds.NameOrPlace | None = entry(None, "sheet, by name or number from 1; default: the first with data")
    missing: kinds.Marks | None = entry(
        None, "texts and numbers that stand for no sample; [] accepts values far beyond all others", ["OL", -9999]
    )
    clocks: kinds.Texts = entry({}, "time columns of columns, { column = time column }, of tables with several")
    kind: Annotated[str, kinds.one_of(KINDS)] = entry(
        "time", '"steady": rows are operating points; "frequency": rows are frequencies', "steady"
    )
    frame: Annotated[RotatingFrame | None, Settings()] = entry(
        None, 'supply of an AC machine: columns or numbers, with kind = "steady"'
    )
    guess: kinds.Finites = entry({}, 'states where the search for a steady state begins, with kind = "steady"')

    frequency: kinds.Text = entry("frequency", 'column of the frequency, Hz, with kind = "frequency"')
    responses: Responses = entry({}, 'complex responses by name, with kind = "frequency"')
    point: kinds.Finites = entry({}, 'inputs at the operating point, with kind = "frequency"; default: start values')

    @property
    def in_time(self) -> bool:
        """True if rows have a time."""
        return self.kind == "time"

    @property
    def supply_columns(self) -> tuple[str, ...]:
        """Columns of the supply, and of the frequency."""
        given = {} if self.frame is None else self.frame.given
        found = tuple(each for each in given.values() if isinstance(each, str))
        return (*found, self.frequency) if self.kind == "frequency" else found

    @property
    def response_columns(self) -> dict[str, str]:
        """Parts of responses, with their columns."""
        found = {name: each.columns.items() for name, each in self.responses.items()}
        return {f"{name}.{part}": column for name, some in found.items() for part, column in some}

    def check_keys(self, by_rows: bool) -> None:
        """Refuse keys of other kinds; `by_rows` says whether preprocessing needs no order of rows."""
        given = self.model_fields_set
        for kind, keys in OF_KIND.items():
            for key in keys if kind != self.kind else ():
                if key in given:
                    raise self.error(f'needs kind = "{kind}". Set it or remove {key}.', key)
        if self.in_time:
            return
        for key in (each for each in OF_TIME if each in given):
            raise self.error(f'kind = "{self.kind}" has no time. Remove {key}.', key)
        for key in (each for each in ("inputs", "outputs") if self.kind == "frequency" and each in given):
            raise self.error(f'kind = "frequency" has responses. Remove {key}.', key)
        if not by_rows:
            raise self.error(f'with kind = "{self.kind}", only computed_columns and park by angle work.', "preprocess")

    def experiment_of_rows(self, frame: pd.DataFrame, roles: dict[str, Any]) -> Experiment:
        """Return the experiment of a frame without a time."""
        if self.kind == "frequency":
            own = {name: value for name, value in roles.items() if name not in ("inputs", "outputs")}
            own |= {"frequency": self.frequency, "responses": self.responses, "point": self.point}
            return FrequencyExperiment(frame, **own)
        return SteadyExperiment(frame, **roles, supply=self.frame, guess=self.guess)
