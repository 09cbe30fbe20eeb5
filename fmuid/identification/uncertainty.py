"""Uncertainty beyond the local covariance: maps of the criterion, profiles, samples of the posterior.

One call computes them all, the quick ones first, and keeps what is complete when the keyboard interrupts it. The
modules of each are imported when it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd

from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.estimation import LeastSquares, Result, check_level
from fmuid.progress import Event, MapStep, Progress

if TYPE_CHECKING:
    from fmuid.identification.cost_map import CostMap
    from fmuid.identification.profile import Profile
    from fmuid.identification.sampling.posterior import Posterior, SamplerSettings

CONFIDENCE_LEVEL = 0.95
# A criterion on a map lower than at the estimate by more than this shows another optimum; less may be rounding, or
# what the search left.
LOWER_CRITERION = 0.1


@dataclass(frozen=True)
class UncertaintySettings:
    """The table ``[uncertainty]`` of a study.

    Parameters
    ----------
    level : float
        Of all intervals, between 0 and 1.
    profile : tuple of str
        Parameters whose profile is computed.
    posterior : SamplerSettings, optional
        How the posterior is sampled, where it is.
    maps : tuple of (str, str)
        Pairs of parameters over which the criterion is mapped.

    Raises
    ------
    InputError
        If the level is not between 0 and 1.
    """

    level: float = CONFIDENCE_LEVEL
    profile: tuple[str, ...] = ()
    posterior: SamplerSettings | None = None
    maps: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        check_level(self.level)

    @property
    def any(self) -> bool:
        """Whether anything is asked for."""
        return bool(self.profile or self.posterior or self.maps)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The results of `explore`.

    Attributes
    ----------
    level : float
        Of all intervals.
    maps : tuple of CostMap
        Around the estimate.
    box_maps : tuple of CostMap
        Over all of the bounds.
    profiles : tuple of Profile
    posterior : Posterior or None
    interrupted : bool
        Whether the keyboard ended it before all was done.
    """

    level: float
    maps: tuple[CostMap, ...] = ()
    box_maps: tuple[CostMap, ...] = ()
    profiles: tuple[Profile, ...] = ()
    posterior: Posterior | None = None
    interrupted: bool = False

    json_layout: ClassVar = Layout(
        derived=("succeeded",),
        types=dict.fromkeys(("CostMap", "Profile", "Posterior"), "fmuid.identification"),
    )

    @property
    def succeeded(self) -> bool:
        """Whether all is done, no better optimum has shown, and the samples of the posterior can be trusted."""
        ends = [end for each in self.profiles for end in (each.lower, each.upper)]
        better = bool(np.isnan(ends).any()) or any(better_point(chart) for chart in (*self.maps, *self.box_maps))
        return not self.interrupted and not better and (self.posterior is None or self.posterior.converged)

    def intervals(self, result: Result) -> pd.DataFrame:
        """Return the intervals side by side: a row a parameter, columns ``lower`` and ``upper`` of each kind.

        The columns are pairs of the kind (``local``, ``profile``, ``posterior``, as far as there are any) and the side.
        """
        kinds: dict[str, pd.DataFrame] = {"local": result.intervals(self.level)}
        if self.profiles:
            ends = {each.name: (each.lower, each.upper) for each in self.profiles}
            kinds["profile"] = pd.DataFrame.from_dict(ends, orient="index", columns=["lower", "upper"])
        if self.posterior is not None:
            kinds["posterior"] = self.posterior.intervals(self.level)
        return pd.concat(kinds, axis=1).reindex(list(result.names))

    @property
    def profile_table(self) -> pd.DataFrame:
        """All points of all profiles: the parameter profiled, the values of all, and the criterion."""
        return pd.concat([each.table.assign(profiled=each.name) for each in self.profiles], ignore_index=True)[
            ["profiled", *self.profiles[0].table.columns]
        ]


def better_point(chart: CostMap) -> tuple[float, float, float] | None:
    """Return where a map shows a lower criterion than the estimate has, and by how much; None where it does not."""
    points = chart.table[[*chart.names, "criterion"]].to_numpy()
    values = np.where(np.isnan(points[:, 2]), np.inf, points[:, 2])
    x, y, least = points[int(np.argmin(values))]
    return (float(x), float(y), float(chart.criterion - least)) if least < chart.criterion - LOWER_CRITERION else None


@single_threaded
def explore(
    problem: LeastSquares,
    result: Result,
    settings: UncertaintySettings,
    progress: Progress | None = None,
    *,
    box: bool = False,
) -> Uncertainty:
    """Compute what the settings ask for around a result.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    settings : UncertaintySettings
    progress : callable, optional
        Called before the first task, before every map, after every point of a profile and every step of the sampler
        (`fmuid.progress`).
    box : bool
        Also map the criterion over all of the bounds, for pairs of parameters that have them, as after a search of the
        whole box.

    Returns
    -------
    Uncertainty
        Interrupted from the keyboard: the results up to then.

    Raises
    ------
    InputError
        If the result is another problem's, or a name is unknown.
    SimulationError
        If the simulation fails at the result.
    """
    return _Explorer(problem, result, settings, progress, box=box).run()


class _Explorer:
    """Carries out one task after the other and keeps the results."""

    def __init__(
        self,
        problem: LeastSquares,
        result: Result,
        settings: UncertaintySettings,
        progress: Progress | None,
        *,
        box: bool,
    ) -> None:
        self.problem, self.result, self.settings, self.progress = problem, result, settings, progress
        self.box = box
        self.maps: list[CostMap] = []
        self.box_maps: list[CostMap] = []
        self.profiles: tuple[Profile, ...] = ()
        self.posterior: Posterior | None = None

    def run(self) -> Uncertainty:
        try:
            self._tell(Event(task="uncertainty", share=0.0))
            finished = self._map() and self._profile() and self._sample()
        except KeyboardInterrupt:
            finished = False
        maps, box_maps = tuple(self.maps), tuple(self.box_maps)
        level = self.settings.level
        return Uncertainty(level, maps, box_maps, self.profiles, self.posterior, interrupted=not finished)

    def _tell(self, event: Event) -> None:
        if self.progress is not None:
            self.progress(event)

    def _map(self) -> bool:
        for k, (first, second) in enumerate(self.settings.maps):
            from fmuid.identification.cost_map import map_cost

            self._tell(MapStep(share=k / len(self.settings.maps), first=first, second=second))
            self.maps.append(map_cost(self.problem, self.result, first, second))
            if self.box and self._bounded(first) and self._bounded(second):
                self.box_maps.append(map_cost(self.problem, self.result, first, second, ranges="bounds"))
        return True

    def _bounded(self, name: str) -> bool:
        parameters = self.problem.parameters
        i = parameters.index(name)
        return bool(np.isfinite([parameters.lower[i], parameters.upper[i]]).all())

    def _profile(self) -> bool:
        names = self.settings.profile
        if not names:
            return True
        from fmuid.identification.profile import profile_likelihood

        level = self.settings.level
        self.profiles = profile_likelihood(self.problem, self.result, names, level=level, progress=self.progress)
        complete = len(self.profiles) == len(names)
        return complete and not self.profiles[-1].interrupted

    def _sample(self) -> bool:
        if self.settings.posterior is None:
            return True
        from fmuid.identification.sampling.sampler import sample_posterior

        self.posterior = sample_posterior(self.problem, self.result, self.settings.posterior, self.progress)
        return not self.posterior.interrupted
