"""The noise of the measurements: given, or to be estimated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fmuid.arrays import Floats
from fmuid.errors import InputError
from fmuid.text import nearest

# With larger variances, or smaller ones than its inverse, squares of residuals overflow.
LARGEST_VARIANCE = 1e100


@dataclass(frozen=True)
class Noise:
    """The variance of the measurement noise of each output, R_b of (1.37).

    Parameters
    ----------
    variance : "estimate", float, or mapping of output to float
        A number holds for every output. What is not given is estimated from the residual, and the search repeated
        until it settles (docs/method.md section 7). With a robust loss that estimate is robust too: Huber's proposal 2
        (`fmuid.data.losses.robust_variance`), because the loss is measured in standard deviations of the noise proper.
    start : float or mapping of output to float, optional
        Initial variance of that iteration; default: that of the residual at the start of the search.

    Raises
    ------
    InputError
        If a variance is not a positive number.
    """

    variance: Literal["estimate"] | float | Mapping[str, float] = "estimate"
    start: float | Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        for word, given in (("variance", self.variance), ("start", self.start)):
            if given is None or (word == "variance" and isinstance(given, str) and given == "estimate"):
                continue
            for output, value in given.items() if isinstance(given, Mapping) else [("", given)]:
                of = f" of output {output!r}" if output else ""
                if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
                    choice = 'a positive number or "estimate"' if word == "variance" else "a positive number"
                    raise InputError(f"the noise {word}{of} must be {choice}, not {value!r}")
                if not (math.isfinite(value) and value > 0):
                    raise InputError(f"the noise {word}{of} must be positive and finite, not {value:g}")
                if not 1.0 / LARGEST_VARIANCE < value < LARGEST_VARIANCE:
                    raise InputError(
                        f"the noise {word}{of} is {value:g}, too extreme to calculate with; change the unit"
                    )

    def known(self, outputs: Sequence[str]) -> Floats:
        """Return the given variance of each output, NaN where it is to be estimated."""
        return _by_output("noise.variance", None if isinstance(self.variance, str) else self.variance, outputs)

    def first(self, outputs: Sequence[str]) -> Floats:
        """Return the variance that each output starts from, NaN where the residual at the start decides."""
        return _by_output("noise.start", self.start, outputs)


def _by_output(word: str, given: float | Mapping[str, float] | None, outputs: Sequence[str]) -> Floats:
    if not isinstance(given, Mapping):
        return np.full(len(outputs), np.nan if given is None else float(given))
    for output in given:
        if output not in outputs:
            raise InputError(f"{word} names {output!r}, which is no measured output{nearest(output, outputs)}")
    return np.array([float(given.get(output, np.nan)) for output in outputs])
