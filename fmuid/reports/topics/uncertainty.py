"""Uncertainty beyond the local covariance: profiles, cost maps, samples of the posterior."""

from __future__ import annotations

import math

import numpy as np

from fmuid.estimation import Result
from fmuid.formatting import listed, rounded, unit_text, with_std
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
from fmuid.reports.document import Message, Remark, Section, doubt, plain, table_of
from fmuid.reports.topics.termination import ENDS


class UncertaintyMessage(Message, section="profiles"):
    """Profile likelihoods, cost maps and samples of the posterior."""

    END_AT_BOUND = doubt(
        "The {end} end of {name} is its bound {value}: cost rises only {rise} of {threshold}.",
        remedy="Widen the bound, or take it as the limit.",
    )
    NO_END = doubt(
        "{name} has no {end} end: up to {value} the cost rises only {rise} of {threshold}.",
        remedy="Add a bound or a prior, or measure more.",
    )
    END_FAILS = doubt(
        "The {end} end of {name} is unknown: simulations fail beyond {value}.",
        remedy="Add a bound within which the model is valid.",
    )
    END_NOT_CONVERGED = doubt("At {name} = {value} the other parameters did not converge ({reason}).")
    OTHER_BOUND = doubt("At the {end} end of {name}, {other} is at its bound {bound}.")
    BETTER = doubt(
        "No interval of {name}: at {value} the cost is lower by {fall}.",
        remedy="Identify again from the row of that value in `profiles.csv`.",
    )
    ROUGH_END = doubt("End of {name} near {value} is not precise.")
    PROFILE_INTERRUPTED = doubt("Interrupted: profile of {name} is incomplete.")
    BETTER_ON_MAP = doubt(
        "Cost is lower by {fall} at {first} = {x}, {second} = {y}.",
        remedy='Use that initial guess, or set `method = "multi-start"`.',
    )
    SAMPLED = plain("Posterior converged: at least {samples} independent samples, R-hat at most {r_hat}.")
    SAMPLING_INTERRUPTED = doubt("Sampling interrupted after {steps} steps.")
    RUNAWAY = doubt("Posterior is unbounded in {name}.", remedy="Add a prior or bounds, or measure more.")
    TOO_SHORT = doubt(
        "{steps} steps are too few to judge the posterior.", remedy="Raise `max_steps`, or continue with `--resume`."
    )
    STUCK = doubt(
        "Walkers are stuck: {acceptance} of proposals are accepted.",
        "several optima, or simulations that fail",
        "Narrow the bounds to the region of interest.",
    )
    DISAGREEING = doubt(
        "Posterior of {name} has not converged (R-hat {r_hat}, limit {limit}) after {steps} steps.",
        "several optima, or a direction that is not identifiable",
        "Raise `max_steps`; if that does not help, add a prior or narrower bounds.",
    )
    TOO_FEW = doubt(
        "{name} has {samples} independent samples instead of {wanted}.", remedy="Raise `max_steps` to about {more}."
    )
    OTHER_OPTIMUM = doubt(
        "Another optimum is similarly probable: {values}.", remedy="Narrow the bounds or add a prior."
    )
    PRIOR_ONLY = doubt("{names}: along this direction the samples show priors and bounds only.")


def uncertainty_remarks(found: Assessment) -> list[Remark]:
    """Return the remarks on intervals, maps and samples."""
    said = [each for profile in found.profiles for each in _profile(profile)]
    said += [each for chart in found.maps for each in _map(chart)]
    return said + ([] if found.posterior is None else posterior_remarks(found.posterior))


def _profile(profile: Profile) -> list[Remark]:
    said = [_end(profile, remark) for remark in profile.remarks]
    return [*said, *([UncertaintyMessage.PROFILE_INTERRUPTED.said(name=profile.name)] if profile.interrupted else [])]


def _end(profile: Profile, remark: ProfileEndNote) -> Remark:
    kinds = {
        EndKind.BOUND: UncertaintyMessage.END_AT_BOUND,
        EndKind.FLAT: UncertaintyMessage.NO_END,
        EndKind.FAILING: UncertaintyMessage.END_FAILS,
        EndKind.LOWER: UncertaintyMessage.BETTER,
    }
    message = kinds.get(remark.kind, UncertaintyMessage.ROUGH_END)
    values = {"name": profile.name, "value": f"{remark.value:.6g}", "end": "upper" if remark.upper else "lower"}
    values |= {"rise": f"{max(remark.rise, 0.0):.2g}", "fall": f"{-remark.rise:.3g}"}
    values["threshold"] = f"{profile.threshold:.3g}"
    if remark.kind in (EndKind.BOUND, EndKind.FLAT, EndKind.FAILING):
        return message.said(**values)
    if remark.outcome is not None:
        return UncertaintyMessage.END_NOT_CONVERGED.said(**values, reason=ENDS[remark.outcome])
    if remark.other is not None:
        return UncertaintyMessage.OTHER_BOUND.said(**values, other=remark.other.name, bound=f"{remark.other.value:g}")
    return message.said(**values)


def _map(chart: CostMap) -> list[Remark]:
    if (better := better_point(chart)) is None:
        return []
    (first, second), (x, y, fall) = chart.names, better
    values = {"first": first, "second": second, "x": f"{x:.6g}", "y": f"{y:.6g}", "fall": f"{fall:.3g}"}
    return [UncertaintyMessage.BETTER_ON_MAP.said("maps", **values)]


def posterior_remarks(found: Posterior) -> list[Remark]:
    """Return the convergence of the samples, other optima, and directions without data."""
    steps = len(found.chain)
    said = [UncertaintyMessage.SAMPLING_INTERRUPTED.said("posterior", steps=steps)] if found.interrupted else []
    i = found.names.index(found.doubtful) if found.doubtful else int(np.argmin(found.effective_size))
    samples = float(found.effective_size[i])
    values: dict[str, object] = {"name": found.doubtful, "steps": steps, "wanted": found.wanted, "limit": LARGEST_R_HAT}
    values |= {"acceptance": f"{100 * found.acceptance:.1f} %", "samples": f"{samples:.0f}"}
    values["r_hat"] = f"{found.r_hat.max() if found.doubt is None else found.r_hat[i]:.3f}"
    if found.doubt is SamplingWarning.TOO_FEW:  # with a reserve of a fifth
        values["more"] = math.ceil(1.2 * found.wanted / samples * steps)
    message = UncertaintyMessage.SAMPLED if found.doubt is None else UncertaintyMessage[found.doubt.name]
    said.append(message.said("posterior", **values))
    for at in found.optima[1:]:
        others = ", ".join(f"{name} = {value:.4g}" for name, value in zip(found.names, at, strict=True))
        said.append(UncertaintyMessage.OTHER_OPTIMUM.said("posterior", values=others))
    only = (UncertaintyMessage.PRIOR_ONLY.said("posterior", names=listed(each.names)) for each in found.undetermined)
    return [*said, *only]


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
    return Section("intervals", f"{100 * found.level:.4g} % intervals", table=table)


def _interval(lower: float, upper: float, value: float) -> str:
    if math.isnan(lower) or math.isnan(upper):
        return ""
    if math.isinf(lower) and math.isinf(upper):
        return "not identifiable"
    # about the standard deviation to which an interval of 95 % belongs
    if math.isinf(upper):
        return f"above {rounded(lower, 0.5 * (value - lower))}"
    if math.isinf(lower):
        return f"below {rounded(upper, 0.5 * (upper - value))}"
    width = 0.25 * (upper - lower)
    return f"{rounded(lower, width)} to {rounded(upper, width)}"
