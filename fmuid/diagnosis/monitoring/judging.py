"""What is new in the windows up to now: since when, and by what the windows after that say, which cause."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fmuid.diagnosis.coordinates import Coordinates
from fmuid.diagnosis.evidence.causes import Cause
from fmuid.diagnosis.evidence.naming import weighed
from fmuid.diagnosis.evidence.onset import Dated, Shape, dated
from fmuid.diagnosis.evidence.watch import Watch
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.findings import Explanation, changes


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is new.

    Attributes
    ----------
    explanations : tuple of Explanation
        The best one first.
    columns : tuple of int
        The coordinates of the best one.
    when : Dated
        Of its first cause.
    shape : Shape
    since : float
        From when on whole windows have it, s of all that was seen; infinite where none has yet.
    """

    explanations: tuple[Explanation, ...]
    columns: tuple[int, ...]
    when: Dated
    shape: Shape
    since: float


def judged(
    watch: Watch, coordinates: Coordinates, faults: Mapping[str, Fault], level: float, model_error: float
) -> Judgement:
    """Say what is new, once there is an alarm.

    Parameters
    ----------
    watch : Watch
    coordinates : Coordinates
    faults : mapping of str to Fault
    level, model_error : float
        As for `fmuid.diagnosis.evidence.naming.name`.
    """
    causes = coordinates.causes
    every = {shape: watch.onsets(causes, shape) for shape in Shape}
    dates = [(dated(each, watch.end), each.cause, shape) for shape, found in every.items() for each in found]
    when, cause, shape = max(dates, key=lambda each: each[0].log_evidence + math.log(each[1].probability))
    for _ in range(2):  # the name may be another one than that by which it was dated
        apart = watch.apart(*when.between)
        news, since = (watch.news(when.clock), math.inf) if apart is None else apart
        _, likely = weighed(news, causes, level, model_error)
        best: Cause = likely[0].causes[0]
        if best is cause or cause in likely[0].causes:
            break
        mine = [each for each in dates if each[1] is best]
        when, cause, shape = max(mine, key=lambda each: each[0].log_evidence)
    said = tuple(Explanation(changes(each.causes, each.fit, coordinates, faults), each.odds) for each in likely)
    columns = tuple(i for each in likely[0].causes for i in each.columns)
    return Judgement(said, columns, when, shape, since)
