"""What is new in the windows up to now: since when, and by what the windows after that say, which cause."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fmuid.diagnosis.cause_results import Explanation, changes
from fmuid.diagnosis.change_detection.cause_ranking import rank_with_model_error
from fmuid.diagnosis.change_detection.onset import OnsetEstimate, OnsetShape, estimate_onset
from fmuid.diagnosis.change_detection.onset_tracker import OnsetTracker
from fmuid.diagnosis.change_parameters import ChangeParameterSet
from fmuid.diagnosis.faults import Fault


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
        As for `fmuid.diagnosis.change_detection.cause_ranking.name`.
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
