"""The noise of the measurements: given in one of several forms, or to be estimated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.formatting import nearest

# With larger variances, or smaller ones than its inverse, squares of residuals overflow.
LARGEST_VARIANCE = 1e100
# Words of which an output has one at most, and those that may name a column or give all samples.
FORMS, BY_SAMPLE = ("variance", "std", "relative", "weights"), ("std", "weights")

Level = float | str | Sequence[float]
"""A number, the column of the experiment's table that has one for each row, or all of them, (K,)."""


@dataclass(frozen=True)
class Noise:
    """The measurement noise of each output, R_b of (1.37), which is diagonal.

    Each output has its noise by one of `variance`, `std`, `relative` and `weights`, in the units of its table; what
    none of them says is estimated from the residual, and the search repeated until it settles (docs/method.md section
    7). With a robust loss that estimate is robust too: Huber's proposal 2 (`fmuid.data.losses.robust_variance`),
    because the loss is measured in standard deviations of the noise proper.

    Parameters
    ----------
    variance : "estimate", float, or mapping of output to float
        A number holds for every output.
    start : float or mapping of output to float, optional
        Initial variance of the estimation; default: that of the residual at the start of the search.
    std : float, str, sequence, or mapping of output to such, optional
        Standard deviations: a number, a column of the table, or one for each sample (K,).
    relative : float or mapping of output to float, optional
        The standard deviation as a share of the output's spread, which is the standard deviation of its counted samples
        about their mean, Σ(y − ȳ)²/K; over all experiments, and of a noise in `experiments` over that one.
    weights : float, str, sequence, or mapping of output to such, optional
        A sample of weight w has the variance σ²/w, with one σ² for all outputs that have weights, which is estimated.
    common : bool or sequence of str
        Outputs (True: all) that share one estimated variance, the σ̂_b² of (1.61), as if each had the weight 1.
    period : float, optional
        After how long, s, the excitation repeats; default: as the inputs show it. Errors of the model that return with
        it are allowed for in the standard deviations.
    experiments : mapping of str to Noise
        What holds in an experiment of that name in place of all this; only the four forms and `period`.

    Raises
    ------
    InputError
        If a number is not positive and finite.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, coil.parameters, noise=fmuid.Noise(variance={"i": 1e-4}))
    >>> fmuid.identify(problem).given_variance
    {'i': 0.0001}
    """

    variance: Literal["estimate"] | float | Mapping[str, float] = "estimate"
    start: float | Mapping[str, float] | None = None
    std: Level | Mapping[str, Level] | None = None
    relative: float | Mapping[str, float] | None = None
    weights: Level | Mapping[str, Level] | None = None
    common: bool | Sequence[str] = False
    period: float | None = None
    experiments: Mapping[str, Noise] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for word in (*FORMS, "start", "period"):
            given = getattr(self, word)
            if given is None or (word == "variance" and isinstance(given, str) and given == "estimate"):
                continue
            entries = given.items() if isinstance(given, Mapping) else [("", given)]
            found = {output: _checked(word, output, value) for output, value in entries}
            object.__setattr__(self, word, found if isinstance(given, Mapping) else found[""])
        for name, own in self.experiments.items():
            if own.start is not None or own.common or own.experiments:
                words = ", ".join((*FORMS, "period"))
                raise InputError(f"the noise of experiment {name!r} has {words} only: say the rest of all")

    def form(self, output: str) -> tuple[str, Any]:
        """Return which of the four forms says the noise of an output, and what it says; "" where none does.

        Raises
        ------
        InputError
            If two of them do.
        """
        found = [(word, _of(getattr(self, word), output)) for word in FORMS]
        said = [(word, level) for word, level in found if level is not None]
        if len(said) > 1:
            raise InputError(f"noise has both {said[0][0]} and {said[1][0]} of output {output!r}: keep one of the two")
        return said[0] if said else ("", None)

    def period_in(self, experiment: str) -> float | None:
        """Return after how long, s, the excitation of an experiment repeats, as far as that is said."""
        own = self.experiments.get(experiment)
        return self.period if own is None or own.period is None else own.period

    def among(self, experiments: Sequence[str]) -> Noise:
        """Return the noise of some experiments, by their names."""
        return replace(self, experiments={name: own for name, own in self.experiments.items() if name in experiments})

    def given_variance(self) -> float | Mapping[str, float] | None:
        """Return `variance` where there is nothing else, None where it is estimated.

        Raises
        ------
        InputError
            If the noise is said in another form.
        """
        for word in ("std", "relative", "weights", "common", "period", "experiments"):
            if getattr(self, word):
                raise InputError(f"a diagnosis takes the noise as noise.variance alone: leave noise.{word} out")
        return None if isinstance(self.variance, str) else self.variance

    def check_names(self, outputs: Sequence[str]) -> None:
        """Check that all names are those of measured outputs.

        Raises
        ------
        InputError
            If one is not.
        """
        for word in (*FORMS, "start", "common"):
            given = getattr(self, word)
            names = given if isinstance(given, Mapping) or (word == "common" and not isinstance(given, bool)) else ()
            for output in names:
                if output not in outputs:
                    raise InputError(
                        f"noise.{word} names {output!r}, which is no measured output{nearest(output, outputs)}"
                    )

    def known(self, outputs: Sequence[str]) -> Floats:
        """Return the variance of each output that is given as a number, NaN of the others."""
        self.check_names(outputs)
        found = np.full(len(outputs), math.nan)
        for j, output in enumerate(outputs):
            word, level = self.form(output)
            if word in ("variance", "std") and isinstance(level, float):
                found[j] = level if word == "variance" else level**2
        return found

    def first(self, outputs: Sequence[str]) -> Floats:
        """Return the variance that each output starts from, NaN where the residual at the start decides."""
        starts = [_of(self.start, output) for output in outputs]
        return np.array([math.nan if value is None else value for value in starts])


def _of(given: Any, output: str) -> Any:
    """Return what a word says of an output, None where nothing."""
    if isinstance(given, Mapping):
        return given.get(output)
    return None if isinstance(given, str) and given == "estimate" else given


def _checked(word: str, output: str, value: Any) -> Any:
    """Return a number as a float, samples as a tuple, a column as it is."""
    of = f" of output {output!r}" if output else ""
    if word in BY_SAMPLE and isinstance(value, str):
        return value
    if word in BY_SAMPLE and isinstance(value, Sequence | np.ndarray):
        try:
            return tuple(np.asarray(value, dtype=np.float64).ravel().tolist())
        except (TypeError, ValueError):
            raise InputError(f"the noise {word}{of} must be numbers") from None
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        also = {"variance": ' or "estimate"', "std": " or a column", "weights": " or a column"}.get(word, "")
        raise InputError(f"the noise {word}{of} must be a positive number{also}, not {value!r}")
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"the noise {word}{of} must be positive and finite, not {value:g}")
    if not 1.0 / LARGEST_VARIANCE < value ** (2 if word == "std" else 1) < LARGEST_VARIANCE:
        raise InputError(f"the noise {word}{of} is {value:g}, too extreme to calculate with; change the unit")
    return float(value)
