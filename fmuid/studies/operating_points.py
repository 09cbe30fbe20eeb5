"""Keys of experiments without a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from fmuid.data import RotatingFrame
from fmuid.studies import value_kinds as kinds
from fmuid.studies.section import Settings, StudySection, entry

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.data import Experiment

KINDS = ("time", "steady")
OF_TIME = ("time", "time_unit", "sample_rate", "interpolation", "warmup", "observation")
"""Keys that need a time."""
OF_KIND = {"steady": ("frame", "guess")}
"""Keys of each other kind."""


class KindSection(StudySection):
    """Kind of an experiment, and what only one kind has."""

    kind: Annotated[str, kinds.one_of(KINDS)] = entry(
        "time", '"steady": each row is an operating point, without a time', "steady"
    )
    frame: Annotated[RotatingFrame | None, Settings()] = entry(
        None, 'supply of an AC machine: columns or numbers, with kind = "steady"'
    )
    guess: kinds.Finites = entry({}, 'states where the search for a steady state begins, with kind = "steady"')

    @property
    def in_time(self) -> bool:
        """True if rows have a time."""
        return self.kind == "time"

    @property
    def supply_columns(self) -> tuple[str, ...]:
        """Columns of the supply."""
        given = {} if self.frame is None else self.frame.given
        return tuple(each for each in given.values() if isinstance(each, str))

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
        if not by_rows:
            raise self.error(f'with kind = "{self.kind}", only computed_columns and park by angle work.', "preprocess")

    def experiment_of_rows(self, frame: pd.DataFrame, roles: dict[str, Any]) -> Experiment:
        """Return the experiment of a frame without a time."""
        from fmuid.data import SteadyExperiment

        return SteadyExperiment(frame, **roles, supply=self.frame, guess=self.guess)
