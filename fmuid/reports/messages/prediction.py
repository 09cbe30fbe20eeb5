"""What is to be said of predictions of records that a result was not made from, and of comparisons of results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from fmuid.formatting import fit_text, listed, two_digits, with_unit
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import CONSTANT, ENDS

if TYPE_CHECKING:
    from fmuid.identification import Comparison, LikelihoodRatio, OutputScore, Prediction

# Residuals that are larger than expected by this factor are an error of the model rather than chance.
LEAST_RATIO = 1.25


def prediction_words(found: Prediction) -> tuple[str, ...]:
    """Return what is to be known of a prediction, in sentences: how good it is first."""
    said = [_score_words(found, score) for score in found.scores]
    if found.undetermined:
        said.append(f"The result leaves {listed(found.undetermined)} undetermined: the band is that of the noise alone")
    if found.estimated is not None and not found.estimated.converged:
        names = listed(found.estimated.names)
        said.append(f"Estimated again on this record, {names}: {ENDS[found.estimated.outcome]}")
    units = dict(zip(found.fit.outputs, found.fit.units, strict=True))
    return *said, *residual_words(found.residuals, units)


def _score_words(found: Prediction, score: OutputScore) -> str:
    said, error = f"{score.output} in {found.fit.experiment} is predicted", with_unit(score.rmse, score.unit)
    if math.isnan(score.fit):
        said += f" with an RMSE of {error} ({CONSTANT})"
    else:
        said += f" with a fit of {score.fit:.4g} % (RMSE {error})"
    if math.isnan(score.expected):
        return f"{said}; the result was not made from such an output, so nothing says how large the residual should be"
    band = f"{100 * score.inside:.3g} % of {score.samples} samples lie in the {100 * found.level:.4g} % band"
    if score.ratio <= LEAST_RATIO:
        return f"{said}, as noise and estimates let expect ({with_unit(score.expected, score.unit)}): {band}"
    return (
        f"{said}, {two_digits(score.ratio)} times what noise and estimates let expect "
        f"({with_unit(score.expected, score.unit)}): {band}; the record shows an error of the model, or the machine "
        "has changed"
    )


def fold_words(predictions: Sequence[Prediction]) -> str:
    """Return what a cross-validation says of a model, by all its predictions."""
    ratios = [score.ratio for found in predictions for score in found.scores if not math.isnan(score.ratio)]
    if not ratios:
        return "Nothing says how large the residuals should be"
    worst = max(ratios)
    if worst <= LEAST_RATIO:
        return (
            "Left out in turn, the experiments are predicted as noise and estimates let expect "
            f"({two_digits(worst)} times)"
        )
    return (
        f"Left out in turn, experiments are predicted up to {two_digits(worst)} times worse than noise and "
        "estimates let expect: what is identified from the others does not carry over to all of them"
    )


# --- comparisons -------------------------------------------------------------------------

# Criteria of Akaike's that differ by less than the first are as good as each other, by more than the second they tell
# clearly (Burnham and Anderson, section 2.6).
ALIKE_AIC, CLEAR_AIC = 2.0, 10.0
# A smaller model that chance rejects this rarely is rejected.
SIGNIFICANT = 0.01
# Samples that depend on each other more than this make what takes them for independent too sure.
DEPENDENT = 1.25
# Errors, 100 % − fit, that differ by less than this share say nothing of which is better.
AS_NEAR = 0.05


def comparison_words(found: Comparison | None, fits: Mapping[str, float]) -> tuple[str, ...]:
    """Return what follows from a comparison: which result the criteria and the common tables speak for.

    Parameters
    ----------
    found : Comparison or None
        By likelihoods.
    fits : mapping of str to float
        Of each result over the common tables, %; empty without, NaN where measured outputs are constant.
    """
    said = [] if found is None else _by_likelihood(found)
    return (*said, _by_fit(fits)) if fits else tuple(said)


def _by_likelihood(found: Comparison) -> list[str]:
    best, *rest = found.ranks
    near = [rank for rank in rest if rank.behind < ALIKE_AIC]
    second = rest[0].behind
    if near:
        names, less = listed([best.name, *(rank.name for rank in near)]), f"differs by less than {ALIKE_AIC:g}"
        said = [f"The data do not tell {names} apart (Akaike's criterion {less}): prefer the simplest"]
    else:
        how = "clearly the best" if second >= CLEAR_AIC else "the best, not clearly,"
        said = [f"{best.name} is {how} by Akaike's criterion: {rest[0].name} is {second:.3g} behind"]
    by_bic = min(found.ranks, key=lambda rank: rank.corrected_bic)
    if by_bic is not best:
        said.append(f"Schwarz's criterion, which charges more for parameters, prefers {by_bic.name}")
    said += [_ratio(test) for test in found.tests]
    if found.dependence > DEPENDENT:
        said.append(
            f"The residuals are coloured: {found.samples} samples are worth {found.samples / found.dependence:.0f} "
            f"independent ones, and log-likelihoods are divided by {found.dependence:.3g} for that; the uncorrected "
            "criteria would be too sure"
        )
    if found.with_priors:
        said.append(f"Priors cost {listed(found.with_priors)} likelihood: a criterion with priors is too large")
    return said


def _ratio(test: LikelihoodRatio) -> str:
    freed = listed(test.freed)
    if test.probability < SIGNIFICANT:
        chance = "less than 1e-6" if test.probability < 1e-6 else f"{test.probability:.2g}"
        return (
            f"{test.smaller} is rejected against {test.larger}: were it right, freeing {freed} would gain as much with "
            f"a probability of {chance}"
        )
    return (
        f"{test.smaller} is not rejected against {test.larger}: freeing {freed} gains no more than chance would "
        f"(probability {test.probability:.2g})"
    )


def _by_fit(fits: Mapping[str, float]) -> str:
    if not any(map(math.isfinite, fits.values())):
        return "On the common tables no fit has a meaning: compare the RMSE"
    order = sorted(fits, key=lambda name: -fits[name] if math.isfinite(fits[name]) else math.inf)
    best, rest = order[0], order[1:]
    near = [name for name in rest if 100.0 - fits[name] <= (1.0 + AS_NEAR) * (100.0 - fits[best])]
    others = listed([f"{fit_text(fits[name])} ({name})" for name in rest])
    most = f"a fit of {fit_text(fits[best])}"
    if near:
        return f"On the common tables {listed([best, *near])} do as well as each other: {most} ({best}) and {others}"
    return f"On the common tables {best} is the best: {most} against {others}"
