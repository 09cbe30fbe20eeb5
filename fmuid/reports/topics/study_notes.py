"""What is to be known of a study before it is run: earlier results, inputs that nothing feeds, units of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from fmuid.reports.shared_phrases import source_words, time_words

if TYPE_CHECKING:
    from fmuid.simulation import Simulator
    from fmuid.studies import Study

MOST_TIMED = 5
"""Records whose time is compared with the model's time constants: each costs a simulation."""


def source_notes(study: Study) -> list[str]:
    """Return what is to be known of the results that a study takes priors from."""
    return [source_words(each) for each in study.notes]


def input_notes(simulators: Iterable[Simulator]) -> list[str]:
    """Return which inputs keep their start values because nothing feeds them."""
    return [
        f"{each.experiment.source} feeds no {', '.join(each.unfed_inputs)}: kept at the start value"
        for each in simulators
        if each.unfed_inputs
    ]


def time_notes(study: Study, simulators: Sequence[Simulator]) -> list[str]:
    """Return which records last much longer or shorter than what the model does."""
    from fmuid.identification import doubt_of_time

    starts = [parameter.start for parameter in study.parameters.values()]
    doubts = (doubt_of_time(each, starts) for each in simulators[:MOST_TIMED])
    return [time_words(doubt) for doubt in doubts if doubt is not None]
