"""Messages that topics share: identifiability."""

from __future__ import annotations

from collections.abc import Sequence

from fmuid.estimation import IdentifiabilityLevel, WeakDirection
from fmuid.formatting import listed
from fmuid.reports.document import Message, Remark, bad, doubt, plain

_FIX = "Fix one of them, add a prior, or use another excitation."
_FINER = "Reduce the solver `tolerance` or `step_size`, add a prior, or fix {names}."
_LONGER = "Use a longer or stronger excitation."


class IdentifiabilityMessage(Message, section="correlation"):
    """Parameters that the data determine poorly or not at all."""

    NO_EFFECT = bad(
        "{names} is not identifiable: it has no effect on any output.",
        "the excitation does not reach it",
        "Fix {names}, add a prior, or measure an output that {names} affects.",
    )
    HIDDEN = bad("{names} is not identifiable: its effect is below the solver error.", remedy=_FINER)
    COMBINATION = bad("{names} are not identifiable; only {combinations} {verb}.", remedy=_FIX)
    HIDDEN_COMBINATION = bad(
        "{names} are not identifiable within the solver error; only {combinations} {verb}.", remedy=_FINER
    )
    PRACTICALLY = bad(
        "{names} is practically non-identifiable: σ is {std} × its scale.",
        "its effect is ten times smaller than the noise",
        _LONGER,
    )
    PRACTICALLY_COMBINATION = bad(
        "{names} are practically non-identifiable (σ is {std} × scale); only {combinations} {verb}.", remedy=_FIX
    )
    WEAK = doubt("{names} is weakly identifiable: σ is {std}.", "σ is between one and ten times its scale", _LONGER)
    WEAK_COMBINATION = doubt(
        "{names} are weakly identifiable (σ is {std} of scale); {combinations} {verb} identifiable.",
        remedy="Use the combination, or a longer or stronger excitation.",
    )
    CHANGE = plain("No output changes along {change}.")
    PRIOR = doubt("{names} {verb} identifiable only through the prior.")
    CORRELATED = plain(
        "{one} and {other} are strongly correlated ({correlation}).",
        "|correlation| is above 0.95",
        "Use their joint confidence region.",
    )


def direction_remark(direction: WeakDirection) -> Remark:
    """Return the identifiability of a direction."""
    names, kind, std = direction.names, IdentifiabilityMessage, f"{direction.std:.3g}"
    alone = len(names) == 1
    match direction.level:
        case IdentifiabilityLevel.NOT:
            message = kind.NO_EFFECT if alone else kind.COMBINATION
        case IdentifiabilityLevel.HIDDEN:
            message = kind.HIDDEN if alone else kind.HIDDEN_COMBINATION
        case IdentifiabilityLevel.NOT_IN_EFFECT:
            message = kind.PRACTICALLY if alone else kind.PRACTICALLY_COMBINATION
        case _ if alone and direction.std > 10.0:  # it happens to lie near zero, as at a bound
            message, std = kind.WEAK, f"{direction.std * abs(direction.coefficients[0]):.3g}, far above its value"
        case _:
            message = kind.WEAK if alone else kind.WEAK_COMBINATION
            std = f"{100 * direction.std:.0f} %" + " of its scale" * alone
    verb = "is" if len(names) == 2 else "are"
    return message.said(names=listed(names), combinations=_combinations(direction), verb=verb, std=std)


def prior_remark(direction: WeakDirection) -> Remark:
    """Return the parameters that only the prior determines."""
    verb = "is" if len(direction.names) == 1 else "are"
    return IdentifiabilityMessage.PRIOR.said(names=listed(direction.names), verb=verb)


def open_words(determined: IdentifiabilityLevel, names: Sequence[str]) -> str:
    """Return the parameters that are not identifiable, without numbers."""
    how = "practically non-identifiable" if determined is IdentifiabilityLevel.NOT_IN_EFFECT else "not identifiable"
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'} {how}"


def change_remark(direction: WeakDirection) -> Remark:
    """Return the changes of at least three parameters that change no output."""
    names = direction.names
    pairs = list(zip(direction.values, direction.magnitudes, strict=True))
    sizes = [abs(value) if abs(value) > 0.5 * scale else scale for value, scale in pairs]
    shares = [c / size for c, size in zip(direction.coefficients, sizes, strict=True)]
    largest = max(map(abs, shares))
    first = next(i for i, share in enumerate(shares) if abs(share) >= 0.99 * largest)
    steps = [  # a percentage of a negative value, or of one near zero, would mislead
        f"{name} {share / shares[first]:+.3g} %" + ("" if value >= size else f" of its scale {size:.3g}")
        for name, share, value, size in zip(names, shares, direction.values, sizes, strict=True)
    ]
    ordered = ", ".join([steps[first], *steps[:first], *steps[first + 1 :]])
    return IdentifiabilityMessage.CHANGE.said(change=ordered)


def _combinations(direction: WeakDirection) -> str:
    """Return the identifiable combinations θ_i − (v_i/v_last) θ_last."""
    if len(direction.names) == 1:
        return ""
    last = direction.coefficients[-1]
    said = []
    for name, coefficient in zip(direction.names[:-1], direction.coefficients[:-1], strict=True):
        factor = f"{abs(coefficient / last):.3g} ".removeprefix("1 ")
        said.append(f"{name} {'-' if -coefficient / last < 0 else '+'} {factor}{direction.names[-1]}")
    return listed(said)
