"""Samples of the posterior, their diagnostics, and the settings of the sampler.

R-hat and effective sample size are those of Vehtari, Gelman, Simpson, Carpenter, Bürkner, Bayesian Analysis 16, 2021,
whose equations are cited; pairs of autocorrelations end as by Geyer, Stat. Science 7, 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from annotated_types import Ge, Gt, Lt
from scipy import special

from fmuid.array_types import Floats
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import WeakDirection, check_level

LARGEST_R_HAT = 1.01  # of chains that agree (section 4)


@dataclass(frozen=True)
class ChainSettings:
    """Numbers of the diagnostics."""

    least_length: int = 8  # diagnostics of shorter chains are meaningless
    least_acceptance: float = 0.05  # walkers with a smaller share of accepted moves are stuck
    longer: float = 0.02  # relative; intervals at a bound may be so much longer than the shortest


SETTINGS = ChainSettings()


@dataclass(frozen=True)
class SamplerSettings:
    """Settings of the sampler.

    Raises
    ------
    InputError
        If a setting is out of range.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> settings = fmuid.identification.SamplerSettings(walkers=8, max_steps=40, effective_size=10)
    >>> fmuid.sample_posterior(problem, result, settings).chain.shape
    (40, 8, 2)
    """

    walkers: Annotated[int, Gt(0)] | None = None
    """even number, at least 2 per parameter; default: 4 per parameter, at least 16"""
    max_steps: Annotated[int, Gt(0)] = 20_000
    """length of the longest chain; it stops when it has converged"""
    # 2000 give means to 2 % and the ends of 95 % intervals to 6 % of a standard deviation
    effective_size: int = field(default=2000, metadata={"key": False})
    """smallest effective sample size of a parameter"""
    burn_in: Annotated[float, Ge(0), Lt(1)] = 0.25
    """fraction of the chain that is discarded at its start"""
    seed: Annotated[int, Ge(0)] = 0
    """seed of the random numbers"""

    def __post_init__(self) -> None:
        for name, least in (("walkers", 4), ("max_steps", 10), ("effective_size", 1), ("seed", 0)):
            value = getattr(self, name)
            if name == "walkers" and value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name}: must be a whole number from {least} on, not {value!r}.")
        if self.walkers is not None and self.walkers % 2:
            raise InputError(f"walkers: must be even, not {self.walkers}.")
        if isinstance(self.burn_in, bool) or not isinstance(self.burn_in, int | float) or not 0.0 <= self.burn_in < 1:
            raise InputError(f"burn_in: must be a fraction from 0 to below 1, not {self.burn_in!r}.")


class SamplingWarning(Enum):
    """Reason to distrust samples."""

    RUNAWAY = "runaway"  # a parameter grows without limit
    TOO_SHORT = "too_short"  # the chain is too short for diagnostics
    STUCK = "stuck"  # hardly any proposal is accepted
    DISAGREEING = "disagreeing"  # the walkers differ in a parameter
    TOO_FEW = "too_few"  # the effective sample size of a parameter is too small


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples of the posterior with their diagnostics.

    Attributes
    ----------
    runaway : str
        A parameter without limit, "" for none.
    interrupted : bool
    wanted : int
        The effective sample size asked for.
    undetermined : tuple of WeakDirection
        Along these the samples show priors and bounds only.
    optima : (m, N) array
        Origins of the walkers: the estimate and other optima.
    names : tuple of str
    lower, upper : (N,) arrays
        Bounds, infinite without.
    chain : (steps, walkers, N) array
        All steps, the first `burn` ones included.
    log_density : (steps, walkers) array
        Without its constant.
    burn : int
        Discarded steps at the start.
    acceptance : float
        Share of accepted moves.
    simulations : int
    elapsed_s : float
    """

    runaway: str
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
    acceptance: float
    simulations: int
    elapsed_s: float

    json_layout: ClassVar = Layout(
        omitted={"chain", "log_density"},
        derived=(
            *("converged", "doubt", "doubtful", "mean", "std", "covariance", "effective_size", "r_hat"),
            *("steps", "walkers"),
        ),
    )

    def first(self, count: int) -> Posterior:
        """Return the samples of the first parameters."""
        parts = {name: getattr(self, name)[:count] for name in ("names", "lower", "upper")}
        return replace(self, **parts, chain=self.chain[..., :count], optima=self.optima[:, :count])

    @property
    def steps(self) -> int:
        """Steps of each walker, the discarded ones included."""
        return len(self.chain)

    @property
    def walkers(self) -> int:
        """Number of walkers."""
        return int(self.chain.shape[1])

    @cached_property
    def effective_size(self) -> Floats:
        """Effective sample sizes (N,)."""
        return np.array([effective_size(column) for column in self.chain[self.burn :].transpose(2, 0, 1)])

    @cached_property
    def r_hat(self) -> Floats:
        """R-hat (N,), 1 where all walkers agree."""
        return np.array([r_hat(column) for column in self.chain[self.burn :].transpose(2, 0, 1)])

    @cached_property
    def _warning(self) -> tuple[SamplingWarning | None, str]:
        if self.runaway:
            return SamplingWarning.RUNAWAY, self.runaway
        if np.isnan(self.r_hat).any() or np.isnan(self.effective_size).any():
            return SamplingWarning.TOO_SHORT, ""
        if self.acceptance < SETTINGS.least_acceptance:
            return SamplingWarning.STUCK, ""
        worst = int(np.argmax(self.r_hat))
        if self.r_hat[worst] > LARGEST_R_HAT:
            return SamplingWarning.DISAGREEING, self.names[worst]
        worst = int(np.argmin(self.effective_size))
        if self.effective_size[worst] < self.wanted:
            return SamplingWarning.TOO_FEW, self.names[worst]
        return None, ""

    @property
    def doubt(self) -> SamplingWarning | None:
        """Reason to distrust the samples, None for good ones."""
        return self._warning[0]

    @property
    def doubtful(self) -> str:
        """Parameter of the doubt, "" for all."""
        return self._warning[1]

    @property
    def converged(self) -> bool:
        """True for good samples."""
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
        """Compute the highest-density interval of each parameter, columns ``lower`` and ``upper``.

        An interval that ends at a bound is preferred if hardly longer; all is left if a parameter runs away.

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
        """Mean, std, median, 95 % interval and diagnostics of each parameter."""
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
                "autocorrelation_time": len(self.samples) / self.effective_size,
                "r_hat": self.r_hat,
            }
        )

    def to_arviz(self) -> Any:
        """Convert to ArviZ: an ``xarray.DataTree``, a chain a walker, without the burn-in.

        ``posterior`` has a variable a parameter, ``sample_stats`` the log density ``lp``.

        Raises
        ------
        InputError
            If the extra dependency is missing.
        """
        try:
            from arviz_base import from_dict
        except ImportError:
            raise InputError("arviz-base is missing. Run pip install 'fmuid[arviz]'.") from None
        chains = np.swapaxes(self.chain[self.burn :], 0, 1)  # to (walkers, steps, N)
        groups = {
            "posterior": {name: chains[:, :, i] for i, name in enumerate(self.names)},
            "sample_stats": {"lp": self.log_density[self.burn :].T},
        }
        return from_dict(groups)


def _densest(samples: Floats, level: float, lower: float, upper: float) -> tuple[float, float]:
    """Return the shortest interval with a share of sorted samples (n,)."""
    reach = min(max(1, round(level * samples.size)), samples.size - 1)
    first = int(np.argmin(samples[reach:] - samples[: samples.size - reach]))
    shortest = float(samples[first]), float(samples[first + reach])
    # at a bound the density ends abruptly, and which interval is shortest is chance
    ending = [(lower, float(samples[reach])), (float(samples[samples.size - 1 - reach]), upper)]
    near = [(b - a, a, b) for a, b in ending if b - a <= (1.0 + SETTINGS.longer) * (shortest[1] - shortest[0])]
    return min(near)[1:] if near else shortest


def r_hat(draws: Floats) -> float:
    """Return R-hat of draws (n, chains); of plain or folded ranks (eqs 1–6, 14–17); NaN for too few or identical."""
    if len(draws) < SETTINGS.least_length:
        return math.nan
    split = _split(draws)
    return max(_ratio(_normalised(split)), _ratio(_normalised(np.abs(split - np.median(split)))))


def effective_size(draws: Floats) -> float:
    """Return the effective size of draws (n, chains); of bulk or tails (eqs 10–13); NaN for too few or identical."""
    if len(draws) < SETTINGS.least_length:
        return math.nan
    split = _split(draws)
    tails = [(split <= end).astype(np.float64) for end in np.quantile(split, [0.05, 0.95])]
    return min(_size(part) for part in (_normalised(split), *tails))


def _split(draws: Floats) -> Floats:
    half = len(draws) // 2
    return np.concatenate([draws[:half], draws[len(draws) - half :]], axis=1)


def _normalised(draws: Floats) -> Floats:
    """Replace draws by the normal quantiles of their ranks (eq 14)."""
    from scipy.stats import rankdata  # slow to import

    ranks = rankdata(draws).reshape(draws.shape)
    return np.asarray(special.ndtri((ranks - 0.375) / (draws.size + 0.25)), dtype=np.float64)


def _variances(draws: Floats) -> tuple[float, float]:
    """Return the variance within chains, and overall (eqs 1–3)."""
    within = float(draws.var(axis=0, ddof=1).mean())
    return within, within * (1.0 - 1.0 / len(draws)) + float(draws.mean(axis=0).var(ddof=1))


def _ratio(draws: Floats) -> float:
    within, overall = _variances(draws)
    return math.sqrt(overall / within) if within > 0 else math.nan


def _size(draws: Floats) -> float:
    """Return the effective size by autocorrelations with positive pairs."""
    count = len(draws)
    within, overall = _variances(draws)
    if not overall > 0:
        return math.nan
    spectrum = np.abs(np.fft.rfft(draws - draws.mean(axis=0), 2 * count, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, axis=0)[:count].mean(axis=1) / count
    correlation = 1.0 - (within - covariance) / overall
    correlation[0] = 1.0
    pairs = correlation[: count - count % 2].reshape(-1, 2).sum(axis=1)
    positive = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else pairs.size
    length = -1.0 + 2.0 * float(np.minimum.accumulate(pairs[:positive]).sum())
    return draws.size / max(length, 1.0 / math.log10(draws.size))
