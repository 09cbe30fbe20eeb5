"""Assessment: all checks of a result, the quick ones first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.estimation import LeastSquares, Result, check_level
from fmuid.events import Event, MapStep, Progress
from fmuid.identification.contributions import Contributions, find_contributions
from fmuid.identification.data_defects import DataDefect, find_data_defects
from fmuid.identification.directed_tests import find_model_errors
from fmuid.identification.model_errors import ModelErrors
from fmuid.identification.prior_and_data import PriorDataComparison, compare_prior_and_data
from fmuid.identification.residual_analysis import ResidualAnalysis, analyze_residuals

if TYPE_CHECKING:
    from fmuid.identification.cost_map import CostMap
    from fmuid.identification.posterior import Posterior, SamplerSettings
    from fmuid.identification.profile_likelihood import Profile

CONFIDENCE_LEVEL = 0.95
LOWER_COST = 0.1  # cost below that of the estimate that shows another optimum; less may be rounding


@dataclass(frozen=True)
class AssessmentSettings:
    """Checks to make: the section ``[uncertainty]`` of a study, and known noise.

    Parameters
    ----------
    level : float
        Confidence level of all intervals, between 0 and 1.
    profile : tuple of str
        Parameters for profile likelihoods.
    posterior : SamplerSettings, optional
        Default: no samples.
    maps : tuple of (str, str)
        Pairs of parameters for cost maps.
    search_data : bool
        As for `compare_prior_and_data`.
    known_variance : mapping of str to float, optional
        Known noise variance of each output; default those given to the problem.

    Raises
    ------
    InputError
        If the level is not between 0 and 1.
    """

    level: float = CONFIDENCE_LEVEL
    profile: tuple[str, ...] = ()
    posterior: SamplerSettings | None = None
    maps: tuple[tuple[str, str], ...] = ()
    search_data: bool = False
    known_variance: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        check_level(self.level)

    @property
    def explores(self) -> bool:
        """True if a check needs simulations."""
        return bool(self.profile or self.posterior or self.maps)


@dataclass(frozen=True, eq=False)
class Assessment:
    """Checks of a result.

    Attributes
    ----------
    level : float
        Confidence level of all intervals.
    residuals, prior_and_data : ResidualAnalysis, PriorDataComparison, or None
        None of a result read from a file.
    model_errors : ModelErrors or None
        Directed tests; None where there is nothing to test.
    data_defects : tuple of DataDefect
    contributions : Contributions or None
        What each experiment brings; None of one experiment in time.
    maps : tuple of CostMap
    profiles : tuple of Profile
    posterior : Posterior or None
    interrupted : bool
    """

    level: float = CONFIDENCE_LEVEL
    residuals: ResidualAnalysis | None = None
    prior_and_data: PriorDataComparison | None = None
    model_errors: ModelErrors | None = None
    data_defects: tuple[DataDefect, ...] = ()
    contributions: Contributions | None = None
    maps: tuple[CostMap, ...] = ()
    profiles: tuple[Profile, ...] = ()
    posterior: Posterior | None = None
    interrupted: bool = False

    json_layout: ClassVar = Layout(
        derived=("succeeded",), types=dict.fromkeys(("CostMap", "Profile", "Posterior"), "fmuid.identification")
    )

    @property
    def is_explored(self) -> bool:
        """True if there are maps, profiles or samples, or an interruption."""
        return bool(self.maps or self.profiles or self.posterior or self.interrupted)

    @property
    def succeeded(self) -> bool:
        """True if complete, without better optimum, with converged samples."""
        ends = [end for each in self.profiles for end in (each.lower, each.upper)]
        better = bool(np.isnan(ends).any()) or any(better_point(chart) for chart in self.maps)
        return not self.interrupted and not better and (self.posterior is None or self.posterior.converged)

    def intervals(self, result: Result) -> pd.DataFrame:
        """Return all intervals by parameter: columns (kind, ``lower`` or ``upper``)."""
        kinds: dict[str, pd.DataFrame] = {"local": result.intervals(self.level)}
        if self.profiles:
            ends = {each.name: (each.lower, each.upper) for each in self.profiles}
            kinds["profile"] = pd.DataFrame.from_dict(ends, orient="index", columns=["lower", "upper"])
        if self.posterior is not None:
            kinds["posterior"] = self.posterior.intervals(self.level)
        return pd.concat(kinds, axis=1).reindex(list(result.names))

    @property
    def profile_table(self) -> pd.DataFrame:
        """All points of all profiles: parameter profiled, values, and cost."""
        return pd.concat([each.table.assign(profiled=each.name) for each in self.profiles], ignore_index=True)[
            ["profiled", *self.profiles[0].table.columns]
        ]


def better_point(chart: CostMap) -> tuple[float, float, float] | None:
    """Return point and cost reduction of a better optimum on a map."""
    points = chart.table[[*chart.names, "cost"]].to_numpy()
    values = np.where(np.isnan(points[:, 2]), np.inf, points[:, 2])
    x, y, least = points[int(np.argmin(values))]
    return (float(x), float(y), float(chart.cost - least)) if least < chart.cost - LOWER_COST else None


@single_threaded
def assess(
    problem: LeastSquares,
    result: Result,
    asked: AssessmentSettings | None = None,
    progress: Progress | None = None,
    earlier: Assessment | None = None,
) -> Assessment:
    """Assess a result: residuals, prior and data, and the checks asked for.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    asked : AssessmentSettings, optional
        Default: checks without simulations.
    progress : callable, optional
        Called before each map, and after each point of a profile and step of the sampler (`fmuid.events`).
    earlier : Assessment, optional
        Of the same result: its residuals, prior and data, and directed tests are taken over.

    Returns
    -------
    Assessment
        After an interruption the complete checks.

    Raises
    ------
    InputError
        If the result is of another problem, or a name is unknown.
    SimulationError
        If the simulation fails at the result.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> found = fmuid.assess(problem, fmuid.identify(problem))
    >>> found.succeeded, len(found.residuals.series)
    (True, 1)
    """
    asked = asked or AssessmentSettings()
    found = Assessment(asked.level)
    if earlier is not None:
        found = replace(earlier, level=asked.level, maps=(), profiles=(), posterior=None, interrupted=False)
    if found.residuals is None and result.fit.linearization is not None:
        residuals = analyze_residuals(problem, result)
        reading = compare_prior_and_data(
            problem, result, search_data=asked.search_data, healthy=asked.known_variance, diagnostics=residuals
        )
        errors = find_model_errors(problem.as_in(result), result) if earlier is None else earlier.model_errors
        if errors is not None:
            errors = replace(errors, process_noise=problem.process_noise(result))
        defects = find_data_defects(problem, result)
        brought = find_contributions(problem, result)
        found = replace(found, residuals=residuals, prior_and_data=reading, model_errors=errors)
        found = replace(found, data_defects=defects, contributions=brought)
    try:
        for explored in _explored(problem, result, asked, progress or (lambda _: None), found):
            found = explored
    except KeyboardInterrupt:
        return replace(found, interrupted=True)
    return found


def _explored(
    problem: LeastSquares, result: Result, asked: AssessmentSettings, progress: Progress, found: Assessment
) -> Iterator[Assessment]:
    """Yield the assessment after each task with simulations."""
    if not asked.explores:
        return
    problem = problem.as_in(result)
    progress(Event(task="uncertainty", share=0.0))
    for k, (first, second) in enumerate(asked.maps):
        from fmuid.identification.cost_map import map_cost

        progress(MapStep(share=k / len(asked.maps), first=first, second=second))
        found = replace(found, maps=(*found.maps, map_cost(problem, result, first, second)))
        yield found
    if asked.profile:
        from fmuid.identification.profile_likelihood import profile_likelihood

        profiles = profile_likelihood(problem, result, asked.profile, level=asked.level, progress=progress)
        found = replace(found, profiles=profiles)
        yield found
        if len(profiles) < len(asked.profile) or profiles[-1].interrupted:
            raise KeyboardInterrupt
    if asked.posterior is not None:
        from fmuid.identification.sampler import sample_posterior

        posterior = sample_posterior(problem, result, asked.posterior, progress)
        yield replace(found, posterior=posterior)
        if posterior.interrupted:
            raise KeyboardInterrupt
