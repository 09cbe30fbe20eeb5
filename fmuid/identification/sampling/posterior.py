"""Samples of the posterior, and the settings of the sampler (`fmuid.identification.sampling.sampler`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import WeakDirection, check_level

# Steps of the longest chain.
MAX_STEPS = 20_000
# So many independent samples give means to 2 % and the ends of 95 % intervals to 6 % of a standard deviation.
EFFECTIVE_SIZE = 2000
# The share of the chain, at its start, that is not used.
BURN_SHARE = 0.25
# An interval that ends at a bound is taken where it is longer than the shortest one by no more than this share.
LONGER = 0.02
# Largest R-hat of chains that agree (Vehtari et al., section 4).
LARGEST_R_HAT = 1.01


@dataclass(frozen=True)
class SamplerSettings:
    """Settings of the sampler.

    Parameters
    ----------
    walkers : int, optional
        An even number, at least twice the number of parameters; default four a parameter, 16 at least.
    steps : int
        Of the longest chain; sampling ends earlier when the chain is long enough and converged.
    effective_size : int
        The effective sample size that every parameter must reach.
    burn : float
        The share of the chain, at its start, that is discarded.
    seed : int
        Of the random numbers: the same seed gives the same samples.

    Raises
    ------
    InputError
        If a setting is out of range.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> settings = fmuid.SamplerSettings(walkers=8, steps=40, effective_size=10)
    >>> fmuid.sample_posterior(problem, result, settings).chain.shape
    (40, 8, 2)
    """

    walkers: int | None = None
    steps: int = MAX_STEPS
    effective_size: int = EFFECTIVE_SIZE
    burn: float = BURN_SHARE
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("walkers", 4), ("steps", 10), ("effective_size", 1), ("seed", 0)):
            value = getattr(self, name)
            if name == "walkers" and value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(
                    f"the setting {name} of the sampler must be a whole number from {least} on, not {value!r}"
                )
        if self.walkers is not None and self.walkers % 2:
            raise InputError(f"the setting walkers of the sampler must be even, not {self.walkers}")
        if isinstance(self.burn, bool) or not isinstance(self.burn, int | float) or not 0.0 <= self.burn < 1.0:
            raise InputError(f"the setting burn of the sampler must be a share from 0 to below 1, not {self.burn!r}")


class SamplingWarning(Enum):
    """Why samples cannot be trusted."""

    RUNAWAY = "runaway"
    """Nothing holds a parameter."""
    TOO_SHORT = "too_short"
    """The chain is too short to judge."""
    STUCK = "stuck"
    """Hardly any proposal is accepted."""
    DISAGREEING = "disagreeing"
    """The walkers do not tell the same of a parameter."""
    TOO_FEW = "too_few"
    """The samples of a parameter are worth fewer independent ones than were asked for."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples of the posterior with their diagnostics.

    Attributes
    ----------
    doubt : SamplingWarning or None
        Why the samples cannot be trusted; None where they can.
    doubtful : str
        The parameter that the doubt is about, "" where it is about all of them.
    interrupted : bool
        Whether the keyboard ended it.
    wanted : int
        How many independent samples were asked for.
    undetermined : tuple of WeakDirection
        Along which the samples show priors and bounds, not data.
    optima : (m, N) array
        Where the walkers set out: the estimate, and other optima that hold a share of the posterior.
    names : tuple of str
    lower, upper : (N,) arrays
        The bounds, infinite where there are none.
    chain : (steps, walkers, N) array
        Every step of every walker, the first `burn` ones included.
    log_density : (steps, walkers) array
        Without its constant.
    burn : int
        Number of discarded steps at the start.
    effective_size : (N,) array
        Effective sample sizes (`fmuid.identification.sampling.chains.effective_size`).
    autocorrelation_time : (N,) array
        Integrated, in samples.
    r_hat : (N,) array
        1 where all walkers agree (`fmuid.identification.sampling.chains.r_hat`).
    acceptance : float
        Share of the moves that were accepted.
    simulations : int
    elapsed_s : float
    """

    doubt: SamplingWarning | None
    doubtful: str
    interrupted: bool
    wanted: int
    undetermined: tuple[WeakDirection, ...]
    optima: Floats
    names: tuple[str, ...]
    lower: Floats
    upper: Floats
    chain: Floats
    log_density: Floats
    burn: int
    effective_size: Floats
    autocorrelation_time: Floats
    r_hat: Floats
    acceptance: float
    simulations: int
    elapsed_s: float

    json_layout: ClassVar = Layout(
        omitted={"chain", "log_density"}, derived=("converged", "mean", "std", "covariance", "steps", "walkers")
    )

    @property
    def steps(self) -> int:
        """Of each walker, the discarded ones included."""
        return len(self.chain)

    @property
    def walkers(self) -> int:
        """How many there are."""
        return int(self.chain.shape[1])

    @property
    def converged(self) -> bool:
        """Whether the samples can be trusted."""
        return self.doubt is None

    @property
    def samples(self) -> Floats:
        """All samples (n, N)."""
        return self.chain[self.burn :].reshape(-1, len(self.names))

    @property
    def mean(self) -> Floats:
        """Means (N,)."""
        return np.asarray(self.samples.mean(axis=0))

    @property
    def covariance(self) -> Floats:
        """Covariance (N, N)."""
        return np.atleast_2d(np.cov(self.samples.T))

    @property
    def std(self) -> Floats:
        """Standard deviations (N,)."""
        return np.asarray(self.samples.std(axis=0, ddof=1))

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return the interval of highest density of each parameter, columns ``lower`` and ``upper``.

        The shortest one that holds so much of the samples; where one that ends at a bound is hardly longer, that one.
        All that the bounds leave where nothing holds a parameter: samples that run away tell nothing of any.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level)
        if self.doubt is SamplingWarning.RUNAWAY:
            return pd.DataFrame({"lower": self.lower, "upper": self.upper}, index=list(self.names))
        columns = zip(np.sort(self.samples, axis=0).T, self.lower, self.upper, strict=True)
        ends = np.array([_densest(own, level, lower, upper) for own, lower, upper in columns])
        return pd.DataFrame(ends, columns=["lower", "upper"], index=list(self.names))

    @property
    def table(self) -> pd.DataFrame:
        """The samples, a column a parameter."""
        return pd.DataFrame(self.samples, columns=list(self.names))

    @property
    def summary(self) -> pd.DataFrame:
        """A row a parameter: mean, std, median, the 95 % interval, and the diagnostics."""
        ends = self.intervals()
        return pd.DataFrame(
            {
                "parameter": list(self.names),
                "mean": self.mean,
                "std": self.std,
                "median": np.median(self.samples, axis=0),
                "lower": ends["lower"].to_numpy(),
                "upper": ends["upper"].to_numpy(),
                "effective_size": self.effective_size,
                "autocorrelation_time": self.autocorrelation_time,
                "r_hat": self.r_hat,
            }
        )

    def to_arviz(self) -> Any:
        """Return the samples as ArviZ takes them: an ``xarray.DataTree``, a chain a walker, without the burn-in.

        Group ``posterior`` has a variable a parameter, ``sample_stats`` the log density as ``lp``.

        Raises
        ------
        InputError
            If the extra dependency is missing.
        """
        try:
            from arviz_base import from_dict
        except ImportError:
            raise InputError("samples for ArviZ need 'arviz-base': pip install 'fmuid[arviz]'") from None
        chains = np.swapaxes(self.chain[self.burn :], 0, 1)  # to (walkers, steps, N)
        groups = {
            "posterior": {name: chains[:, :, i] for i, name in enumerate(self.names)},
            "sample_stats": {"lp": self.log_density[self.burn :].T},
        }
        return from_dict(groups)


def _densest(samples: Floats, level: float, lower: float, upper: float) -> tuple[float, float]:
    """Return the shortest interval that holds a share of sorted samples (n,), which lie between two bounds."""
    reach = min(max(1, round(level * samples.size)), samples.size - 1)
    widths = samples[reach:] - samples[: samples.size - reach]
    first = int(np.argmin(widths))
    found = [(float(samples[first]), float(samples[first + reach]))]
    # at a bound the density ends abruptly, and which interval is shortest is chance
    if math.isfinite(lower):
        found.append((lower, float(samples[reach])))
    if math.isfinite(upper):
        found.append((float(samples[samples.size - 1 - reach]), upper))
    length = [b - a for a, b in found]
    near = [k for k in range(1, len(found)) if length[k] <= (1.0 + LONGER) * length[0]]
    return found[min(near, key=lambda k: length[k], default=0)]
