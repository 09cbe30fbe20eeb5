"""What an alarm says: which cause, and since when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fmuid.diagnosis.cause_ranking import rank_with_model_error
from fmuid.diagnosis.cause_results import Explanation, changes
from fmuid.diagnosis.causes import ChangeParameterSet
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.onset import OnsetEstimate, OnsetShape, estimate_onset
from fmuid.diagnosis.onset_tracker import OnsetTracker


@dataclass(frozen=True, eq=False)
class AlarmDecision:
    """What is new.

    Attributes
    ----------
    explanations : tuple of Explanation
        The best one first.
    columns : tuple of int
        The coordinates of the best one.
    when : OnsetEstimate
        Of its first cause.
    since : float
        From when on whole windows have it, s of all that was seen; infinite where none has yet.
    """

    explanations: tuple[Explanation, ...]
    columns: tuple[int, ...]
    when: OnsetEstimate
    since: float


def decide_alarm(
    watch: OnsetTracker, coordinates: ChangeParameterSet, faults: Mapping[str, Fault], level: float, model_error: float
) -> AlarmDecision:
    """Say what is new, once there is an alarm.

    Parameters
    ----------
    watch : OnsetTracker
    coordinates : ChangeParameterSet
    faults : mapping of str to Fault
    level, model_error : float
        As for `fmuid.diagnosis.cause_ranking.name`.
    """
    causes = coordinates.causes
    every = zip(*(watch.onsets(causes, shape) for shape in OnsetShape), strict=True)
    dates = [estimate_onset(each, watch.end) for each in every]
    when = max(dates, key=lambda each: each.log_evidence + math.log(each.cause.probability))
    for _ in range(2):  # the name may be another one than that by which it was dated
        apart = watch.apart(*when.between)
        news, since = (watch.news(when.clock), math.inf) if apart is None else apart
        _, likely = rank_with_model_error(news, causes, level, model_error)
        if when.cause in likely[0].causes:
            break
        when = next(each for each in dates if each.cause is likely[0].causes[0])
    said = tuple(Explanation(changes(each.causes, each.fit, coordinates, faults), each.odds) for each in likely)
    columns = tuple(i for each in likely[0].causes for i in each.columns)
    return AlarmDecision(said, columns, when, since)
