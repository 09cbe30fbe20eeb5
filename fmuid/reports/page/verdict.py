"""What a report says first: sentences, each with the figure that proves it, and whether it is a doubt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fmuid.formatting import fit_text, listed, with_unit
from fmuid.identification import SIGNIFICANCE_LEVEL, Deviation
from fmuid.reports.messages.accuracy import accuracy_words, passed_words
from fmuid.reports.messages.prior_and_data import reading_words
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import (
    capitalised,
    dependence_words,
    dropout_words,
    ending,
    fit_words,
    observer_words,
    start_words,
)
from fmuid.reports.messages.uncertainty import uncertainty_words

if TYPE_CHECKING:
    from fmuid.estimation import Result
    from fmuid.runs import IdentificationRun
    from fmuid.simulation import OutputFit

# Of more outputs than this, the sentence on the fit has the least only.
MOST_FITS = 4


@dataclass(frozen=True)
class ReportStatement:
    """A sentence of a report.

    Attributes
    ----------
    text : str
    figure : str
        The section of the page that proves it, "" for none.
    doubtful : bool
        Whether it is a doubt, with what would help, and not a part of the verdict.
    """

    text: str
    figure: str = ""
    doubtful: bool = False


def identification_words(found: IdentificationRun) -> tuple[ReportStatement, ...]:
    """Return what a report of an identification says, the verdict first."""
    result = found.result
    said = [ReportStatement(capitalised(ending(result)), "criterion", not result.converged)]
    said += [ReportStatement(text, "estimates") for text in _precision(result)]
    said += [ReportStatement(text, "fit") for text in _fit(found.fits)]
    said += [ReportStatement(dropout_words(*each), "fit", doubtful=True) for each in found.dropouts.items()]
    said += [
        ReportStatement(capitalised(text, result.names), "criterion", doubtful=True) for text in observer_words(result)
    ]
    said += [
        ReportStatement(capitalised(text, result.names), "criterion", doubtful=True) for text in start_words(result)
    ]
    if result.accuracy is not None:
        said += [
            ReportStatement(capitalised(text, result.names), "accuracy")
            for text in filter(None, [passed_words(result.accuracy)])
        ]
        said += [
            ReportStatement(capitalised(text, result.names), "accuracy", result.accuracy.doubtful)
            for text in accuracy_words(result.names, result.accuracy)
        ]
    said += [
        ReportStatement(capitalised(text, result.names), "correlation", doubtful=True)
        for text in dependence_words(result)
    ]
    return *said, *_checked(found)


def _checked(found: IdentificationRun) -> list[ReportStatement]:
    """Return what is said of residuals, of prior and data, and of the uncertainty."""
    said: list[ReportStatement] = []
    if found.assessment.residuals is not None:
        coloured = any(each.large for each in found.assessment.residuals.findings)
        said += [
            ReportStatement(text, "residuals", coloured)
            for text in residual_words(found.assessment.residuals, found.output_units)
        ]
    if (reading := found.assessment.prior_and_data) is not None:
        agreement = reading.agreement
        odd = agreement is not None and agreement.probability < SIGNIFICANCE_LEVEL
        odd |= any(each.deviation in (Deviation.LARGER, Deviation.SMALLER) for each in reading.variances)
        said += [ReportStatement(text, "belief", odd) for text in reading_words(reading, found.output_units)]
    words = uncertainty_words(found.assessment) if found.assessment.is_explored else ()
    return [
        *said,
        *(ReportStatement(capitalised(text, found.result.names), "profiles", doubtful=True) for text in words),
    ]


def _precision(result: Result) -> list[str]:
    """Say how precisely the parameters are determined, the best and the worst."""
    pairs = zip(result.names, result.values.tolist(), result.std.tolist(), strict=True)
    shares = {name: std / abs(value) for name, value, std in pairs if value and math.isfinite(std)}
    lost = [name for name, std in zip(result.names, result.std.tolist(), strict=True) if math.isinf(std)]
    said = [f"{listed(lost)} {'is' if len(lost) == 1 else 'are'} not determined"] if lost else []
    if not shares:
        return [capitalised(text, result.names) for text in said]
    best, worst = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
    if len(shares) == 1:
        said.append(f"{best} is known to {_percent(shares[best])}")
    else:
        said.append(
            f"{len(shares)} parameters are known to between {_percent(shares[best])} ({best}) and "
            f"{_percent(shares[worst])} ({worst}), one standard deviation"
        )
    return [capitalised(text, result.names) for text in said]


def _fit(fits: Sequence[OutputFit]) -> list[str]:
    """Say how well measured and simulated outputs agree; of many, which agrees least."""
    counts = [(fit, j) for fit in fits for j in np.flatnonzero(fit.counted.any(axis=0)).tolist()]
    known = [(fit, j) for fit, j in counts if math.isfinite(fit.fit[j])]
    if len(counts) > MOST_FITS and known:
        least, j = min(known, key=lambda each: each[0].fit[each[1]])
        named = f"{least.outputs[j]} in {least.experiment}" if len(fits) > 1 else least.outputs[j]
        error = with_unit(least.rmse[j], least.units[j])
        return [f"Least fit (NRMSE): {named} {fit_text(least.fit[j])} (RMSE {error})"]
    said = fit_words(fits)
    return [f"Fit (NRMSE): {said}"] if said else []


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"
