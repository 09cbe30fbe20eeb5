"""The baseline of a diagnosis: what is known of the healthy machine, and what may change without being a fault."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from fmuid.data import Experiment, Noise, Parameter
from fmuid.diagnosis.baseline.stored_baseline import StoredBaseline
from fmuid.diagnosis.faults import common_mode
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.identification import refinement_of
from fmuid.simulation import Refinement


@dataclass(frozen=True, eq=False)
class Baseline:
    """The healthy machine, as records are compared with it.

    Parameters
    ----------
    result : Result
        Of the healthy machine.
    inflate : float or mapping of str to float
        Factor on the standard deviations of its estimates for variations that are no fault (1.67); infinite for
        parameters that may be anything.
    noise_variance : float or mapping of output to float, optional
        Default: that of the result.
    parameters : mapping of str to Parameter
        Nominal parameters with bounds, or of which the result knows nothing.
    values : mapping
        Variables of the nominal model held at a value; fault models have their own.
    records : sequence of Experiment
        The healthy records, with the inputs and outputs of those to be diagnosed. With them errors of sensors and
        supply are told from faults, and those that the machine always had are no news; four or more at different
        operating points show the healthy model's own error, too.
    trials : mapping of str to sequence of Experiment
        Cause to records in which it alone is new: they show the fault models' error.
    shown : StoredBaseline, optional
        What the healthy records showed when the healthy machine was identified: taken where it is of the same machine,
        faults and records, or none are given.

    Attributes
    ----------
    common : dict of str to Parameter
        The nominal parameters with what the healthy machine showed as their prior.

    Raises
    ------
    InputError
        If the result has nothing to say, a factor is not positive, a parameter has a second prior, or trials
        have no records beside them.

    Examples
    --------
    >>> result = fmuid.identify(fmuid.datasets.coil().problem())
    >>> healthy = fmuid.Baseline(result, inflate={"R": 10.0})
    >>> round(healthy.common["R"].prior.std / result["R"].std, 1)
    10.2
    """

    result: Result
    inflate: float | Mapping[str, float] = 1.0
    noise_variance: float | Mapping[str, float] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    values: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    records: Sequence[Experiment] = ()
    trials: Mapping[str, Sequence[Experiment]] = field(default_factory=dict)
    shown: StoredBaseline | None = None
    common: dict[str, Parameter] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.trials and not self.beside:
            raise InputError("trials are compared with healthy records: name the tables of the healthy machine, too")
        object.__setattr__(self, "common", common_mode(self.result, self.inflate, self.parameters, self.values))

    @classmethod
    def of(cls, given: Self | Result | str | Path) -> Self:
        """Return a baseline: the one given, or that of a result or of its ``result.json`` with nothing else known.

        Raises
        ------
        InputError
            If the file cannot be read, or as the class.
        """
        if isinstance(given, cls):
            return given
        return cls(given if isinstance(given, Result) else Result.from_json(given))  # type: ignore[arg-type]

    @property
    def beside(self) -> bool:
        """Whether healthy records say what the sensors and the supply are like, too."""
        return bool(self.records) or self.shown is not None

    @property
    def refinement(self) -> Refinement:
        """How much finer than asked for the healthy machine was simulated: what is compared with it must be, too."""
        return refinement_of(self.result)

    @property
    def freedom(self) -> float:
        """Degrees of freedom behind the noise variances; infinite where they are given."""
        return float(self.result.degrees_of_freedom) if self.noise_variance is None else math.inf

    def variance(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the noise variance of each output.

        Raises
        ------
        InputError
            If that of one of them is not known.
        """
        if self.noise_variance is not None:
            given = dict(zip(outputs, Noise(self.noise_variance).known(tuple(outputs)).tolist(), strict=True))
            for name, value in given.items():
                if math.isnan(value):
                    raise InputError(f"noise.variance has none of {name!r}, and a diagnosis needs it: give it too")
            return given
        known = self.result.variance
        for name in outputs:
            if name not in known:
                raise InputError(
                    f"the healthy result has no noise variance of {name!r}, only of {', '.join(known)}: "
                    "measure the same outputs, or give noise.variance"
                )
        return {name: known[name] for name in outputs}

    @property
    def variances(self) -> Mapping[str, float]:
        """The noise variances that are known, by output."""
        if isinstance(self.noise_variance, Mapping):
            return self.noise_variance
        known = self.result.variance
        return known if self.noise_variance is None else dict.fromkeys(known, self.noise_variance)
