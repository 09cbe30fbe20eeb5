"""Uncertainty beyond the local covariance: profiles, cost maps, samples of the posterior."""

from __future__ import annotations

import math

import numpy as np

from fmuid.estimation import Result
from fmuid.formatting import rounded, unit_text, with_std
from fmuid.identification import (
    LARGEST_R_HAT,
    Assessment,
    CostMap,
    EndKind,
    Posterior,
    Profile,
    ProfileEndNote,
    SamplingWarning,
    better_point,
)
from fmuid.reports.document import Section, table_of
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.termination import ENDS

# A chain that is advised is longer than what is foreseen to suffice by this factor.
STEPS_MARGIN = 1.2


def uncertainty_words(found: Assessment) -> tuple[str, ...]:
    """Return the remarks on intervals, maps and samples."""
    said = [line for each in found.profiles for line in profile_words(each)]
    said += [line for chart in found.maps for line in _map_words(chart)]
    if found.posterior is not None and not found.posterior.converged:
        said.append(f"posterior: {posterior_words(found.posterior)}")
    return tuple(said)


def profile_words(profile: Profile) -> tuple[str, ...]:
    """Return the remarks on the ends of a profile."""
    said = [_remark_words(profile, remark) for remark in profile.remarks]
    return *said, *([f"interrupted: the profile of {profile.name} is not complete"] if profile.interrupted else [])


def _remark_words(profile: Profile, remark: ProfileEndNote) -> str:
    name, value, end = profile.name, f"{remark.value:.6g}", "upper" if remark.upper else "lower"
    risen = (
        f"the criterion has risen by only {max(remark.rise, 0.0):.2g} of the {profile.threshold:.3g} "
        f"that {100.0 * profile.level:.4g} % need"
    )
    if remark.kind is EndKind.BOUND:
        return f"the {end} end of {name} is its bound {remark.value:g}, where {risen}"
    if remark.kind is EndKind.FLAT:
        return f"{name} has no {end} end: even at {value} {risen}"
    if remark.kind is EndKind.FAILING:
        return (
            f"the {end} end of {name} is not known: beyond {value}, where {risen}, the simulations fail; "
            "give a bound within which the model is sound"
        )
    if remark.outcome is not None:
        return (
            f"at {name} = {value} the search for the other parameters did not converge ({ENDS[remark.outcome]}): "
            "the criterion there may be lower than found"
        )
    if remark.other is not None:
        return f"at the {end} end of {name}, {remark.other.name} is at its bound {remark.other.value:g}"
    if remark.kind is EndKind.LOWER:
        return (
            f"no interval of {name}: at {value} the criterion is lower than at the estimate, by {-remark.rise:.3g}; "
            "identify again from the table's row of that value"
        )
    return f"the end of {name} near {value} could not be found more precisely"


def _map_words(chart: CostMap) -> list[str]:
    better = better_point(chart)
    if better is None:
        return []
    (first, second), (x, y, by) = chart.names, better
    return [
        f"the criterion over {first} and {second} is lower at {first} = {x:.6g}, {second} = {y:.6g} than at the "
        f'estimate, by {by:.3g}: there is a better optimum; start there, or search with method = "multi-start"'
    ]


def posterior_words(found: Posterior) -> str:
    """Return the convergence of the samples, and the remedy."""
    words = [f"interrupted after {len(found.chain)} steps"] if found.interrupted else []
    words.append(_doubt_words(found))
    if len(found.optima) > 1:
        others = (", ".join(f"{n} = {v:.4g}" for n, v in zip(found.names, at, strict=True)) for at in found.optima[1:])
        words.append(f"beside the estimate there are other optima of like probability: {'; '.join(others)}")
    words += [
        f"{direction_words(each)}: along this the samples show priors and bounds, not data"
        for each in found.undetermined
    ]
    return "; ".join(words)


def _doubt_words(found: Posterior) -> str:
    length, name = len(found.chain), found.doubtful
    i = found.names.index(name) if name else int(np.argmin(found.effective_size))
    if found.doubt is SamplingWarning.RUNAWAY:
        return f"nothing holds {name}, the samples run away: give a prior or bounds, or measure more"
    if found.doubt is SamplingWarning.TOO_SHORT:
        return f"{length} steps are too few to judge: raise steps, or let it go on"
    if found.doubt is SamplingWarning.STUCK:
        return (
            f"the walkers hardly move, {found.acceptance:.1%} of the proposals are accepted: look for several "
            "optima and for simulations that fail, and narrow the bounds around what is meant"
        )
    if found.doubt is SamplingWarning.DISAGREEING:
        return (
            f"not converged: the walkers do not agree on {name} (R-hat {found.r_hat[i]:.3f}, {LARGEST_R_HAT} is the "
            f"most) after {length} steps: raise steps; if that does not help, the data leave it open or there are "
            "several optima, so give a prior or narrower bounds"
        )
    worth = float(found.effective_size[i])
    if found.doubt is SamplingWarning.TOO_FEW:
        return (
            f"not enough: the samples of {name} are worth {worth:.0f} independent ones instead of {found.wanted}: "
            f"raise steps to about {math.ceil(STEPS_MARGIN * found.wanted / worth * length)}"
        )
    return (
        f"converged: at least {worth:.0f} independent samples of each parameter, R-hat at most {found.r_hat.max():.3f}"
    )


def interval_section(found: Assessment, result: Result) -> Section:
    """Return the intervals side by side: local, profile and posterior."""
    limits, posterior = found.intervals(result), found.posterior
    columns: dict[str, list[str]] = {"parameter": list(result.names)}
    for kind in dict.fromkeys(limits.columns.get_level_values(0)):
        ends = limits[kind].to_numpy().tolist()
        columns[kind] = [
            _interval(low, high, value) for (low, high), value in zip(ends, result.values.tolist(), strict=True)
        ]
    if posterior is not None and posterior.doubt is not SamplingWarning.RUNAWAY:
        pairs = zip(posterior.mean.tolist(), posterior.std.tolist(), strict=True)
        columns["posterior mean"] = [with_std(mean, std) for mean, std in pairs]
    columns["unit"] = [unit_text(result.estimates.units.get(name)) for name in result.names]
    table = table_of(columns, columns, ("unit", "posterior mean"))
    return Section("intervals", f"Intervals at {100 * found.level:.4g} %", table=table)


def _interval(lower: float, upper: float, value: float) -> str:
    if math.isnan(lower) or math.isnan(upper):
        return ""
    if math.isinf(lower) and math.isinf(upper):
        return "not determined"
    # about the standard deviation to which an interval of 95 % belongs
    if math.isinf(upper):
        return f"above {rounded(lower, 0.5 * (value - lower))}"
    if math.isinf(lower):
        return f"below {rounded(upper, 0.5 * (upper - value))}"
    width = 0.25 * (upper - lower)
    return f"{rounded(lower, width)} to {rounded(upper, width)}"
