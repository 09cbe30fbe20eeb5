"""Where the simulation of a model has been checked, for many searches on like data.

What a search gives must not depend on those before it, so that the error of the simulation is kept by cells of the
parameters' space, each simulated at its own centre: whoever comes first, it is the same.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import numpy as np

from fmuid.array_types import Floats
from fmuid.estimation import SwitchCause
from fmuid.identification.problem import Problem
from fmuid.simulation import Refinement

# Cells are so wide, as a share of the parameters or of their magnitudes, whatever is larger: an error that grows with
# the fourth power of a parameter is known there within a factor of 1.6.
CELL_WIDTH = 0.25
# Cells whose errors are kept, the last ones.
MOST_CELLS = 64

Verdict = tuple[SwitchCause, float] | None


class CheckedRegion:
    """The cells in which the simulation of one model over one set of experiments has been checked.

    Parameters
    ----------
    scale : (N,) array
        Magnitudes of the parameters.
    one_start : bool
        Whether all searches set out from the same point.

    Attributes
    ----------
    checks : int
        How often something had to be simulated for it.
    """

    def __init__(self, scale: Floats, *, one_start: bool) -> None:
        self.scale, self.one_start, self.checks = scale, one_start, 0
        self._errors: OrderedDict[tuple[Refinement, bytes], Floats] = OrderedDict()
        self._start: list[Verdict] = []

    def error(self, problem: Problem, finer: Refinement, theta: Floats) -> Floats:
        """Return what a finer simulation gives less the one in use (n,), at the centre of the cell of theta (N,).

        It counts as no simulation of the problem; NaN where one of the two fails.
        """
        cell = np.round(np.arcsinh(theta / self.scale) / CELL_WIDTH)
        key = finer, cell.tobytes()
        if key not in self._errors:
            lower, upper = problem.parameters.lower, problem.parameters.upper
            centre = np.clip(self.scale * np.sinh(CELL_WIDTH * cell), lower, upper)
            self.checks += 1
            with problem.uncounted():
                self._errors[key] = problem.predict_by(finer, centre) - problem.predict(centre[None])[0]
            while len(self._errors) > MOST_CELLS:
                self._errors.popitem(last=False)
        self._errors.move_to_end(key)
        return self._errors[key]

    def start(self, problem: Problem, compare: Callable[[], Verdict]) -> Verdict:
        """Return what is wrong with the simulation of the start, compared once; it counts as no simulation."""
        if not self._start:
            self.checks += 1
            with problem.uncounted():
                self._start.append(compare())
        return self._start[0]
