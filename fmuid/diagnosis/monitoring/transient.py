"""Whether a simulation forgets in time what it starts from, and how fast: starts before windows against early ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.diagnosis.change_detection.change_transient import OVER, ChangeTransient
from fmuid.diagnosis.monitoring.windows import Window, part_of
from fmuid.errors import InputError

# Simulations from an early and from a late start agree after the transient to this share of the noise's deviation.
TRANSIENT_SHARE = 0.2
# So many windows have a start of their own.
MOST_COMPARED = 8


def build_up_of(
    made: BaselineComparator, record: Experiment, windows: Sequence[Window], transient: float, point: Floats
) -> tuple[ChangeTransient, Flags]:
    """Return how a change builds up in the outputs, by what is left of other starts before some windows, and of what.

    A change whose column is the same from the start on needs no state: it shows at once.

    Parameters
    ----------
    made : BaselineComparator
    record : Experiment
    windows : sequence of Window
        Two or more, one after the other.
    transient : float
        What is simulated before each, s.
    point : (N,) array
        Where the machine is simulated.

    Returns
    -------
    build_up : ChangeTransient
    slow : (N,) array of bool
        Whose changes build up.

    Raises
    ------
    InputError
        If the transient lasts longer.
    SimulationError
        If a simulation fails.
    """
    compared = windows[: MOST_COMPARED + 1]
    whole = part_of(record, compared, transient)
    early, columns = made.machine(whole).linearise(point)
    std = np.array([made.healthy.whitening.std(name) for name in record.output_names])
    left, late = [], []
    for each in compared[1:]:
        part = part_of(record, [each], transient)
        rows = slice(each.lead - compared[0].lead, each.stop - compared[0].lead)
        outputs, started = made.machine(part).linearise(point)
        late.append(((started - columns[rows]) / std[:, None]) ** 2)
        off = np.abs(outputs - early[rows]) / std
        left.append(np.sum(off**2, axis=1))
        most = off[part.counted].max(initial=0.0)
        if most > TRANSIENT_SHARE:
            raise InputError(
                f"{record.source}: the transient lasts longer than {transient:g} s: what a simulation "
                f"starts from still shows then, by {most:.2g} standard deviations of the noise; "
                "give a longer transient, and windows longer than that"
            )
    length = min(each.size for each in left)
    step, slow = float(np.median(np.diff(whole.times))), made.coordinates.slow
    states, seen = np.mean([each[:length] for each in left], axis=0), columns / std[:, None]

    def built() -> ChangeTransient:
        return ChangeTransient.of(states, seen[:, :, slow].reshape(len(seen), -1), step)

    first = 1 + round(built().lasts / step)
    differs = np.mean([each[:first].sum(axis=(0, 1)) for each in late], axis=0)
    slow = slow & (differs > OVER**2 * first * np.mean(np.sum(seen**2, axis=1), axis=0))
    return built(), slow
