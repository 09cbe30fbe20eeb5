"""How long the steps of Marquardt's search may be: the length follows the success of the steps before (Moré).

Particular to simulations: a step to a point that cannot be simulated is only too long, and below the noise of the
simulation the criterion says nothing about a step, which is then taken for what its prediction is worth.

References
----------
J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630, 1978;
S. Sun, J. Nocedal, "A trust region method for noisy unconstrained optimization", Math. Program. 202, 2023.
"""

from __future__ import annotations

import math

from fmuid.estimation.marquardt.step import Step

# MINPACK's rules: what counts as success, and what follows from it.
LEAST_GAIN, POOR_GAIN, GOOD_GAIN = 1e-4, 0.25, 0.75
SHRINK_LEAST, SHRINK_MOST, GROW = 0.5, 0.1, 2.0
# A rejected step that is half as long as the one before should miss its prediction by a quarter as much; where it is
# still more than half, and the optimum near, the miss is the noise of the simulation.
NOISY_MISS = 0.5
# The noise measured at the start is believed within this factor.
NOISE_SURPRISE = 10.0


class TrustRegion:
    """The longest ‖D p‖ of the next step.

    Attributes
    ----------
    value : float
    open : float
        The last one before simulations began to fail.
    rejections, failures : int
        Steps refused in a row, and how many of the last ones because their simulation failed.
    learnt_noise : float
        Noise of the criterion that was not seen at the start.
    """

    def __init__(self, value: float) -> None:
        self.value = self.open = value
        self.rejections, self.failures = 0, 0
        self.learnt_noise = 0.0
        self._missed = (0.0, math.inf)  # length of the last rejected step, and by how much it missed its prediction

    def fail(self, length: float) -> None:
        """Shorten the radius after a step of a length to where nothing can be simulated."""
        if not self.failures:
            self.open = self.value
        self.value = POOR_GAIN * min(self.value, length)
        self.rejections, self.failures = self.rejections + 1, self.failures + 1

    def judge(self, step: Step, length: float, fall: float, slope: float, noise: float, *, moved: bool) -> bool:
        """Compare what a step did with what was predicted, set the next radius, and say whether the step is good.

        Parameters
        ----------
        step : Step
        length : float
            Its ‖D p‖.
        fall : float
            Of the criterion.
        slope : float
            Half the derivative of the criterion along the step.
        noise : float
            Standard deviation of the criterion's noise.
        moved : bool
            Whether the step is long enough to change any parameter in double precision.
        """
        self.failures = 0
        # the noise of both values on both sides (Sun and Nocedal): below it, a step is as good as predicted
        gain = (fall + 2.0 * noise) / (step.predicted + 2.0 * noise) if step.predicted + 2.0 * noise > 0 else 0.0
        if gain <= POOR_GAIN:
            bend = -fall - 2.0 * slope
            least = -slope / bend if bend > 0 else SHRINK_LEAST  # of the parabola along the step
            self.value = min(max(least, SHRINK_MOST), SHRINK_LEAST) * min(self.value, length)
        elif gain >= GOOD_GAIN or step.damping == 0.0:
            self.value = GROW * length
        if gain >= LEAST_GAIN and moved:
            self.rejections, self._missed = 0, (0.0, math.inf)
            return True
        self._learn_noise(length, abs(fall - step.predicted), noise)
        self.rejections += 1
        return False

    def _learn_noise(self, length: float, miss: float, noise: float) -> None:
        """Recognise, from steps that are refused at ever shorter lengths, noise that was not seen at the start."""
        shorter, before = length <= self._missed[0] / 2.0, self._missed[1]
        if shorter and NOISY_MISS * before < miss < NOISE_SURPRISE * noise:
            self.learnt_noise = max(self.learnt_noise, miss)
        self._missed = length, miss

    def reopen(self, *, fully: bool) -> None:
        """Undo what the rejections did: the step that was refused may be good with a better Jacobian."""
        self.value = math.inf if fully else self.value / SHRINK_MOST**self.rejections
        self.rejections = 0
