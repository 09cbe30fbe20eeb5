"""What prior and data contribute to a result and whether they agree, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fmuid.estimation import TerminationReason
from fmuid.formatting import listed, two_digits, with_unit
from fmuid.identification import Deviation
from fmuid.reports.messages.identifiability import direction_words
from fmuid.reports.messages.result import ENDS

if TYPE_CHECKING:
    from fmuid.identification import ExtrapolationReason, PriorDataComparison, PriorDataTest, PriorInfluence


def reading_words(reading: PriorDataComparison, units: Mapping[str, str | None] | None = None) -> tuple[str, ...]:
    """Return what is to be known of it; nothing where there is neither a prior nor a known variance.

    Parameters
    ----------
    reading : PriorDataComparison
    units : mapping of str to str, optional
        Of the outputs.
    """
    said = [] if reading.agreement is None else [_agreement(reading, reading.agreement)]
    said += [_influence(reading, each) for each in reading.influences]
    said += [_bent(reading)] if reading.bent else []
    said += _variances(reading, units or {})
    said += [obstacle_words(reading.obstacle)] if reading.obstacle is not None else []
    return tuple(said)


def _agreement(reading: PriorDataComparison, agreement: PriorDataTest) -> str:
    """Say whether prior and data agree and, where not, on which parameter they disagree most."""
    chance = (
        f"χ² {agreement.statistic:.3g} with {agreement.degrees_of_freedom} degrees of freedom, "
        f"probability {agreement.probability:.2g}"
    )
    if agreement.holds:
        return f"Prior and data agree ({chance})"
    sizes = np.abs(np.nan_to_num(reading.conflict))
    i = int(np.argmax(sizes))
    most = f", most of all on {reading.names[i]}, {sizes[i]:.2g} standard deviations apart" if sizes[i] else ""
    return (
        f"Prior and data disagree ({chance}){most}: the system has changed, the model lacks something, or the prior is "
        "wrong or too sure of itself; the estimate lies between both"
    )


def _influence(reading: PriorDataComparison, found: PriorInfluence) -> str:
    """Say of an estimate that it rests on a prior, or that a prior has moved it."""
    i = reading.names.index(found.name)
    std = float(reading.data_std[i])
    alone = _shown(float(reading.data[i]), std)
    whose = "its own prior" if found.prior == found.name else f"the prior of {found.prior}"
    if found.rests:
        return f"{found.name} rests on {whose}: the data alone say {alone} ± {std:.2g}"
    return (
        f"The prior moved {found.name} from {alone}, which is what the data alone say, to "
        f"{_shown(float(reading.combined[i]), std)}, by {abs(reading.moved[i]):.2g} of its standard "
        f"deviations; {whose} did most of it"
    )


def _bent(reading: PriorDataComparison) -> str:
    i = reading.names.index(reading.bent)
    return (
        f"Between prior and data the model is not linear: their barycentre has {reading.bent} at "
        f"{_shown(float(reading.barycentre[i]), float(reading.combined_std[i]))}, "
        f"{abs(reading.nonlinearity[i]):.2g} standard deviations from its estimate: "
        "the local standard deviations are an order of magnitude; a profile or the posterior tell more"
    )


def _variances(reading: PriorDataComparison, units: Mapping[str, str | None]) -> list[str]:
    """Say which residuals are larger or smaller than the known noise, or that all are as large."""
    blame = "the model or the prior" if np.isfinite(reading.prior_mean).any() else "the model"
    said, outputs = [], [test for test in reading.variances if test.output]
    for test in outputs:
        unit = units.get(test.output)
        levels = " against ".join(with_unit(math.sqrt(each), unit) for each in (test.estimated, test.known))
        if test.deviation is Deviation.LARGER:
            said.append(
                f"The residual of {test.output} is larger than its stated noise level: {levels} (probability "
                f"{test.probability:.2g}): the system has changed, or {blame} is wrong"
            )
        elif test.deviation is Deviation.SMALLER:
            said.append(
                f"The residual of {test.output} is smaller than its stated noise level: {levels}: standard deviations "
                f"follow the stated level and are {two_digits(1.0 / math.sqrt(test.ratio))} times too large"
            )
    if outputs and not said:
        shares = listed([f"{test.ratio:.3g}" for test in outputs])
        which = listed([test.output for test in outputs])
        said.append(
            f"The residual of {which} is as large as the known noise says (variance {shares} times it, probability "
            f"{reading.variances[-1].probability:.2g})"
        )
    return said


def obstacle_words(obstacle: ExtrapolationReason) -> str:
    """Say why the optimum of the data alone is extrapolated."""
    if obstacle.at_bounds:
        return f"The data alone would push {listed(obstacle.at_bounds)} to a bound, so their optimum is extrapolated"
    if obstacle.undetermined:
        what = listed(tuple(map(direction_words, obstacle.undetermined)))
        return f"At the optimum of the data alone {what}, so it is extrapolated"
    if obstacle.outcome is not None:
        why = "interrupted" if obstacle.outcome is TerminationReason.INTERRUPTED else ENDS[obstacle.outcome]
        return f"The search for the optimum of the data alone did not converge, so it is extrapolated: {why}"
    return "With a robust loss the optimum of the data alone is extrapolated"


def _shown(value: float, std: float) -> str:
    """Return a number to the second significant digit of its standard deviation."""
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{decimals}f}" if 0 <= decimals <= 9 else f"{value:.4g}"
