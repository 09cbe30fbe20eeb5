"""One fault model, fitted: how large its fault is, and how likely that is by chance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from scipy import special

from fmuid.codec import from_json
from fmuid.diagnosis.fault_fits import FitSolverCheck
from fmuid.diagnosis.hypothesis_tests import NullDistribution
from fmuid.errors import InputError
from fmuid.estimation import Result, TerminationReason, WeakDirection, check_level
from fmuid.identification import VarianceTest

Estimate = tuple[float, float]
"""Value and standard deviation."""

# What a file has as it is.
_PLAIN_KEYS = (
    "statistic",
    "probability",
    "adjusted",
    "threshold",
    "information",
    "colour",
    "active",
    "criterion",
    "mismatch",
    "ended",
)

# A model that without its fault fits worse or better than the healthy one by more than this has another healthy machine
# in it; differences of the simulations alone are smaller.
SAME_CRITERION = 1.0


@dataclass(frozen=True)
class FaultSize:
    """How large a fault is.

    Attributes
    ----------
    name : str
    value, std : float
        Estimate and standard deviation, corrected for the colour of the residual; infinite where not determined.
    unit : str
        "" without.
    probability : float
        That without a fault the estimate is as far from zero.
    min, max : float
        Bounds.
    angle : str
        The parameter that locates the fault, "" without; it means something where the size is significant.
    angle_value, angle_std, period : float
        NaN without.
    """

    name: str
    value: float
    std: float
    unit: str
    probability: float
    min: float = -math.inf
    max: float = math.inf
    angle: str = ""
    angle_value: float = math.nan
    angle_std: float = math.nan
    period: float = math.nan

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval, cut at the bounds.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level)
        half = float(special.ndtri(0.5 + level / 2.0)) * self.std
        return max(self.value - half, self.min), min(self.value + half, self.max)


@dataclass(frozen=True)
class BaselineDeviation:
    """A nominal parameter that has left what was foreseen.

    Attributes
    ----------
    name : str
    distance : float
        From the prior to the data's optimum, in standard deviations of the two together.
    """

    name: str
    distance: float


@dataclass(frozen=True, eq=False)
class FaultHypothesis:
    """One fault model, fitted.

    Attributes
    ----------
    name : str
    sizes : tuple of FaultSize
    common : dict of str to (value, std)
        The nominal parameters beside the fault.
    statistic : float
        D, by how much the fault lowers the compound criterion (1.68), divided by the square of `colour`.
    reference : NullDistribution
        The distribution of D without a fault.
    probability : float
        That D is as large without a fault.
    colour : float
        By how much the residual's colour makes the fault parameters scatter more than white noise would.
    active : int
        Fault parameters that are not at their bound, those that the information criterion counts.
    criterion : float
        J_C with the fault.
    ended : bool
        Whether both searches ended at a minimum.
    undetermined : tuple of WeakDirection
        What leaves the fault open.
    prior_determined : tuple of WeakDirection
        What would leave it open without the healthy record.
    mismatch : float
        By how much the criterion of this model without its fault differs from the healthy machine's.
    outcome : TerminationReason
        How the search ended.
    adjusted : float
        `probability`, adjusted for the number of hypotheses.
    threshold : float
        What D must exceed at the chosen level.
    information : float
        Bayesian information criterion against no fault, k ln n − D; less is better.
    strain : BaselineDeviation or None
        The nominal parameter that has left what was foreseen; not kept in a file.
    variances : tuple of VarianceTest
        Not kept in a file.
    result : Result or None
        The fit; not kept in a file.
    checked : FitSolverCheck
        What the error of the simulation does to it.
    """

    name: str
    sizes: tuple[FaultSize, ...]
    common: Mapping[str, Estimate]
    statistic: float
    reference: NullDistribution
    probability: float
    colour: float
    active: int
    criterion: float
    ended: bool
    undetermined: tuple[WeakDirection, ...]
    prior_determined: tuple[WeakDirection, ...]
    mismatch: float
    outcome: TerminationReason
    adjusted: float = math.nan
    threshold: float = math.nan
    information: float = math.nan
    strain: BaselineDeviation | None = None
    variances: tuple[VarianceTest, ...] = ()
    result: Result | None = None
    checked: FitSolverCheck = field(default_factory=FitSolverCheck)

    def judged(self, adjusted: float, threshold: float, information: float) -> FaultHypothesis:
        """Return the hypothesis with what follows from comparing it with the others."""
        return replace(self, adjusted=adjusted, threshold=threshold, information=information)

    @property
    def determined(self) -> bool:
        """Whether all sizes are determined."""
        return not self.undetermined

    @property
    def healthy_at_zero(self) -> bool:
        """Whether the model without its fault fits as the healthy machine does."""
        return abs(self.mismatch) <= SAME_CRITERION

    def __getitem__(self, name: str) -> FaultSize:
        """Return one size."""
        for each in self.sizes:
            if each.name == name:
                return each
        raise InputError(f"fault {self.name!r} has no size {name!r}; it has {', '.join(s.name for s in self.sizes)}")

    def significant(self, level: float) -> tuple[FaultSize, ...]:
        """Return the sizes that are significant by themselves, the most first; the most likely one where none is."""
        order = sorted(self.sizes, key=lambda each: each.probability)
        return tuple(each for each in order if each.probability <= level / len(order)) or tuple(order[:1])

    def to_json_dict(self, level: float) -> dict[str, Any]:
        """Return what ``diagnosis.json`` has of it; angles are left out whose sizes are not significant at a level."""
        sizes = {}
        for size in self.sizes:
            sizes[size.name] = asdict(size)
            if not self.located(size, level):
                sizes[size.name] |= {"angle_value": None, "angle_std": None}
        return {
            **{key: getattr(self, key) for key in _PLAIN_KEYS},
            "outcome": self.outcome,
            "undetermined": self.undetermined,
            "prior_determined": self.prior_determined,
            "sizes": sizes,
            "common": {name: {"value": value, "std": std} for name, (value, std) in self.common.items()},
            "reference": self.reference,
            "accuracy": self.checked.to_json_dict(),
        }

    def located(self, size: FaultSize, level: float) -> bool:
        """Return whether the angle of a size means anything: fault and size are significant."""
        return self.adjusted <= level and size.probability <= level

    @classmethod
    def of_json(cls, name: str, data: Mapping[str, Any]) -> FaultHypothesis:
        """Return a hypothesis of a ``diagnosis.json``.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the data are not of one.
        """
        sizes = []
        for each in data["sizes"].values():
            located = {key: number(each[key], math.nan) for key in ("angle_value", "angle_std", "period")}
            bounds = {"min": number(each["min"], -math.inf), "max": number(each["max"], math.inf)}
            sizes.append(FaultSize(**each | located | bounds | {"std": number(each["std"], math.inf)}))
        reference = data["reference"]
        return cls(
            name=name,
            sizes=tuple(sizes),
            common=estimates_of(data["common"]),
            reference=NullDistribution(
                int(reference["free"]), tuple(reference["weights"]), number(reference["freedom"], math.inf)
            ),
            outcome=TerminationReason(data["outcome"]),
            undetermined=tuple(map(_direction, data["undetermined"])),
            prior_determined=tuple(map(_direction, data["prior_determined"])),
            checked=FitSolverCheck.of_json(data.get("accuracy")),
            **{key: data[key] for key in _PLAIN_KEYS},
        )


def number(value: float | None, missing: float) -> float:
    """Return a number of a file, `missing` where it was not finite."""
    return missing if value is None else float(value)


def estimates_of(data: Mapping[str, Any]) -> dict[str, Estimate]:
    """Return values and standard deviations of a file."""
    return {name: (number(each["value"], math.nan), number(each["std"], math.inf)) for name, each in data.items()}


def _direction(data: Mapping[str, Any]) -> WeakDirection:
    return from_json(WeakDirection, {**data, "std": "inf" if data["std"] is None else data["std"]})
