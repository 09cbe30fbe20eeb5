"""The noise of the measurements: given in one of several forms, or to be estimated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.formatting import nearest

# With larger variances, or smaller ones than its inverse, squares of residuals overflow.
LARGEST_VARIANCE = 1e100
# Words of which an output has one at most, and those that may name a column or give all samples.
FORMS, BY_SAMPLE = ("variance", "std", "relative_std", "weights"), ("std", "weights")

Positive = Annotated[float, Gt(0)]
Level = Positive | str | Sequence[float]
"""A number, the column of the experiment's table that has one for each row, or all of them, (K,)."""


@dataclass(frozen=True)
class Noise:
    """The measurement noise of each output, R_b of (1.37), which is diagonal.

    Each output has its noise by one of `variance`, `std`, `relative_std` and `weights`, in the units of its table; what
    none of them says is estimated from the residual, and the search repeated until it settles (docs/method.md section
    7). With a robust loss that estimate is robust too: Huber's proposal 2 (`fmuid.data.losses.robust_variance`),
    because the loss is measured in standard deviations of the noise proper. In Python `std` and `weights` may also be
    all samples, (K,).

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

    variance: Literal["estimate"] | Positive | Mapping[str, Positive] = "estimate"
    """of the outputs; or a number for all, or one for each: { output = number }"""
    initial_variance: Positive | Mapping[str, Positive] | None = None
    """of [noise] alone: where the estimation of the variance starts; default: from the residual"""
    std: Level | Mapping[str, Level] | None = None
    """standard deviation: a number, a column of the data with one for each sample, or { output = either }"""
    relative_std: Positive | Mapping[str, Positive] | None = None
    """standard deviation as a fraction of the output's spread, the standard deviation of its counted samples: over all
    experiments, or over the one that says it"""
    weights: Level | Mapping[str, Level] | None = None
    """a sample of weight w has the variance σ²/w, with one σ², estimated, for all outputs that have weights"""
    shared_variance: bool | Sequence[str] = False
    """of [noise] alone: outputs that share one estimated variance, a list of names; true: all of them"""
    excitation_period: Positive | None = None
    """s after which the excitation repeats, as errors of the model then do; default: what the inputs show"""
    experiments: Mapping[str, Noise] = field(default_factory=dict, metadata={"key": False})
    """what holds in an experiment of that name in place of all this; without initial and shared variance"""

    def __post_init__(self) -> None:
        for word in (*FORMS, "initial_variance", "excitation_period"):
            given = getattr(self, word)
            if given is None or (word == "variance" and isinstance(given, str) and given == "estimate"):
                continue
            entries = given.items() if isinstance(given, Mapping) else [("", given)]
            found = {output: _checked(word, output, value) for output, value in entries}
            object.__setattr__(self, word, found if isinstance(given, Mapping) else found[""])
        for name, own in self.experiments.items():
            if own.initial_variance is not None or own.shared_variance or own.experiments:
                words = ", ".join((*FORMS, "excitation_period"))
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
        return self.excitation_period if own is None or own.excitation_period is None else own.excitation_period

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
        for word in ("std", "relative_std", "weights", "shared_variance", "excitation_period", "experiments"):
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
        for word in (*FORMS, "initial_variance", "shared_variance"):
            given = getattr(self, word)
            names = (
                given
                if isinstance(given, Mapping) or (word == "shared_variance" and not isinstance(given, bool))
                else ()
            )
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
        starts = [_of(self.initial_variance, output) for output in outputs]
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
