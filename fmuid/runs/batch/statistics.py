"""Statistics over the cases of a batch: which of them are repetitions, and whether they spread as they state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from fmuid.array_types import Floats

# Of the intervals that are counted, and half their width in standard deviations.
INTERVAL_LEVEL = 0.95
INTERVAL_STDS = float(special.ndtri(0.5 + INTERVAL_LEVEL / 2.0))
# Searches end at the same optimum where no estimate differs by more than this share of its standard deviation, or of
# its own size where that is more; as in `fmuid.estimation.global_search`.
SAME_STDS, SAME_SHARE = 0.3, 1e-4
# Two-sided probability behind the limits of a binomial share.
OUTSIDE_PROBABILITY = 0.05
# Probability, over all that is tested, of a doubt where there is nothing.
FALSE_DOUBT_PROBABILITY = 0.01
# Less than this is not worth a doubt, however many cases there are: of spread against stated std, and of the bias in
# stated std (coverage falls from 95 to 94.3 %, and to 94.8 %).
WORTH_RATIO, WORTH_BIAS, WORTH_COVERAGE = 1.05, 0.15, 0.01


class EstimateWarning(Enum):
    """What is surely not as stated of a parameter's estimates."""

    STD_TOO_SMALL = "std too small"
    """They spread more than their stated standard deviation says."""
    STD_TOO_LARGE = "std too large"
    """They spread less."""
    BIASED = "biased"
    """Their mean is not the truth."""
    COVERAGE_OFF = "coverage off"
    """Their 95 % intervals hold the truth in another share of the cases."""


@dataclass(frozen=True)
class BatchColumns:
    """What the columns of a batch's frame stand for.

    Attributes
    ----------
    parameters, outputs : tuple of str
        Names of the parameters (``value.<name>``) and of the outputs (``noise.<name>``).
    starts : tuple of str
        The columns ``start.<parameter>``.
    design : tuple of str
        The columns that make another experiment of a case: ``set.<variable>`` and ``free``.
    repeats : tuple of str
        The columns that give the same experiment other data: ``table`` and ``draw``.
    """

    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    starts: tuple[str, ...]
    design: tuple[str, ...]
    repeats: tuple[str, ...]

    @classmethod
    def of(cls, frame: pd.DataFrame) -> BatchColumns:
        """Read them off a frame."""
        names = [str(name) for name in frame.columns]

        def after(prefix: str) -> tuple[str, ...]:
            return tuple(name.removeprefix(prefix) for name in names if name.startswith(prefix))

        return cls(
            parameters=after("value."),
            outputs=after("noise."),
            starts=tuple(f"start.{name}" for name in after("start.")),
            design=(*(f"set.{name}" for name in after("set.")), *(name for name in names if name == "free")),
            repeats=tuple(name for name in names if name in ("table", "draw")),
        )

    @property
    def data(self) -> list[str]:
        """The columns that tell one data set from another; cases that share them differ in their starts at most."""
        return [*self.repeats, *self.design]


def converged(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the cases that converged."""
    return frame[frame["status"] == "converged"]


def fit_cost(frame: pd.DataFrame, *, given_noise: bool) -> Floats:
    """Return how badly each case fits (n,), to rank cases of the same data; infinite where that is not known.

    The criterion (1.37) where all noise variances are given. Where they are estimated, each case weighs its residual by
    variances of its own and criteria do not compare: Σ ln σ̂² over the outputs is the likelihood's measure then
    (docs/method.md section 7), up to a factor and to what a prior adds.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    given_noise : bool
        Whether the study gives the noise variance of every output.
    """
    if given_noise:
        badness = frame["criterion"].to_numpy(np.float64)
    else:
        noise = frame[[f"noise.{name}" for name in BatchColumns.of(frame).outputs]].to_numpy(np.float64)
        badness = np.log(np.maximum(noise, np.finfo(np.float64).tiny)).sum(axis=1)
    return np.where(np.isfinite(badness), badness, np.inf)


def estimates(frame: pd.DataFrame, *, given_noise: bool) -> pd.DataFrame:
    """Return one converged case for every data set, that of its starts which fits best, in the order of the cases.

    Searches from several starts see the same noise: as cases of their own they would make everything look surer.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    given_noise : bool
        See `fit_cost`.
    """
    found, columns = converged(frame), BatchColumns.of(frame)
    if not columns.starts:
        return found
    ranked = found.iloc[np.argsort(fit_cost(found, given_noise=given_noise), kind="stable")]
    best = ranked.drop_duplicates(columns.data) if columns.data else ranked.iloc[:1]
    return best.sort_values("case")


def is_repetition(frame: pd.DataFrame, columns: BatchColumns) -> bool:
    """Return whether the cases of a frame repeat one experiment, so that their spread can be held against their std."""
    return all(len(frame[name].unique()) <= 1 for name in columns.design)


# --- one parameter


def statistics(values: Floats, stds: Floats, truth: float, *, repeated: bool) -> dict[str, float]:
    """Return the statistics of one parameter over cases.

    Parameters
    ----------
    values, stds : (n,) arrays
        Estimates and their stated standard deviations; those without a finite one are not determined and left out.
    truth : float
        NaN where it is not known.
    repeated : bool
        Whether the cases repeat one experiment; if not, nothing is tested.

    Returns
    -------
    dict
        ``cases``, ``undetermined``, ``mean``, ``median``, ``spread`` (standard deviation over the cases, NaN of one),
        ``stated_std`` (root mean square of the stated ones: what the spread is where they are right), ``ratio`` of the
        two and ``ratio_p``; ``truth``, ``bias``, ``bias_std``, ``bias_p``, ``rms_error``, ``coverage`` (share of
        the intervals value ± 1.96 std that hold the truth), its 95 % limits ``coverage_lower`` and ``coverage_upper``
        by Clopper and Pearson (Biometrika 26, 1934), and ``coverage_p``. The ``_p`` are two-sided probabilities that
        chance alone takes a figure as far from 1, from 0, or from 95 %.
    """
    there = np.isfinite(values)
    known = there & np.isfinite(stds)
    x, s = values[known], stds[known]
    n = x.size
    mean, spread = _mean(x), _spread(x)
    stated = math.sqrt(_mean(s**2)) if n else math.nan
    ratio = spread / stated if repeated and n > 1 and stated > 0 else math.nan
    found = {
        "cases": n,
        "undetermined": int(there.sum()) - n,
        "mean": mean,
        "median": float(np.median(x)) if n else math.nan,
        "spread": spread,
        "stated_std": stated,
        "ratio": ratio,
        "ratio_p": _spread_probability(ratio, s),
        "truth": truth,
    }
    return found | _against_truth(x, s, truth, spread, repeated)


def _against_truth(x: Floats, s: Floats, truth: float, spread: float, repeated: bool) -> dict[str, float]:
    n = x.size
    bias = _mean(x) - truth
    bias_std = spread / math.sqrt(n) if repeated and n > 1 else math.nan
    judged = n if math.isfinite(truth) else 0
    held = int((np.abs(x - truth) <= INTERVAL_STDS * s).sum()) if judged else 0
    limits = _binomial_limits(held, judged) if repeated and judged else (math.nan, math.nan)
    return {
        "bias": bias,
        "bias_std": bias_std,
        "bias_p": 2.0 * float(special.stdtr(n - 1, -abs(bias / bias_std))) if bias_std > 0 else math.nan,
        "rms_error": math.sqrt(_mean((x - truth) ** 2)) if judged else math.nan,
        "coverage": held / judged if judged else math.nan,
        "coverage_lower": limits[0],
        "coverage_upper": limits[1],
        "coverage_p": _binomial_probability(held, judged) if repeated and judged else math.nan,
    }


def _mean(x: Floats) -> float:
    return float(x.mean()) if x.size else math.nan


def _spread(x: Floats) -> float:
    return float(x.std(ddof=1)) if x.size > 1 else math.nan


def _spread_probability(ratio: float, s: Floats) -> float:
    """Return the probability of a ratio as far from 1 where the estimates are normal with the stated std.

    ratio² follows F. The degrees of freedom above are n − 1 for equal std and, by Satterthwaite's rule (Biometrics
    Bulletin 2, 1946), fewer for unequal ones; those below are of the mean of the stated variances, from their scatter.
    """
    if math.isnan(ratio):
        return math.nan
    n, squares = s.size, (s / s.max()) ** 2
    above = squares.sum() ** 2 / (squares**2).sum() * (n - 1) / n
    scatter = float(squares.var(ddof=1))
    below = min(2.0 * n * float(squares.mean()) ** 2 / scatter, 1e9) if scatter > 0 else 1e9
    tails = special.fdtr(above, below, ratio**2), special.fdtrc(above, below, ratio**2)
    return min(1.0, 2.0 * float(min(tails)))


def _binomial_limits(held: int, n: int) -> tuple[float, float]:
    lower = float(special.betaincinv(held, n - held + 1, OUTSIDE_PROBABILITY / 2.0)) if held else 0.0
    upper = float(special.betaincinv(held + 1, n - held, 1.0 - OUTSIDE_PROBABILITY / 2.0)) if held < n else 1.0
    return lower, upper


def _binomial_probability(held: int, n: int) -> float:
    at_most = float(special.bdtr(held, n, INTERVAL_LEVEL))
    at_least = float(special.bdtrc(held - 1, n, INTERVAL_LEVEL)) if held else 1.0
    return min(1.0, 2.0 * min(at_most, at_least))


def doubted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of statistics with a last column ``doubts``, a tuple of `EstimateWarning` for each row.

    Parameters
    ----------
    table : DataFrame
        With the figures of `statistics` as columns; the more of its rows are tested, the surer each doubt must be.
    """
    tested = [name for name in table if str(name).endswith("_p")]
    tests = max(1, int(table[tested].notna().to_numpy().sum()))
    found = [_doubts(row, tests) for row in table.to_dict("records")]
    return table.assign(doubts=pd.Series(found, table.index, dtype=object))


def _doubts(row: Mapping[Any, Any], tests: int) -> tuple[EstimateWarning, ...]:
    """Return what is sure of one parameter and large enough to matter."""

    def sure(name: str) -> bool:
        return bool(row.get(name, math.nan) * tests < FALSE_DOUBT_PROBABILITY)

    ratio, found = row["ratio"], []
    if sure("ratio_p") and max(ratio, 1.0 / ratio if ratio else math.inf) > WORTH_RATIO:
        found.append(EstimateWarning.STD_TOO_SMALL if ratio > 1.0 else EstimateWarning.STD_TOO_LARGE)
    if sure("bias_p") and abs(row["bias"]) > WORTH_BIAS * row["stated_std"]:
        found.append(EstimateWarning.BIASED)
    if sure("coverage_p") and abs(row["coverage"] - INTERVAL_LEVEL) > WORTH_COVERAGE:
        found.append(EstimateWarning.COVERAGE_OFF)
    return tuple(found)


# --- optima of several starts


def optimum_numbers(frame: pd.DataFrame, *, given_noise: bool) -> NDArray[np.int64]:
    """Return for each case which optimum of its data set it ended at (n,): 1 is the best; 0 if it did not converge.

    Two cases are at the same optimum if their estimates are the same within a share of their standard deviations.

    Parameters
    ----------
    frame : DataFrame
        Of a batch.
    given_noise : bool
        See `fit_cost`.
    """
    columns = BatchColumns.of(frame)
    numbers = np.zeros(len(frame), np.int64)
    values = frame[[f"value.{name}" for name in columns.parameters]].to_numpy(np.float64)
    stds = frame[[f"std.{name}" for name in columns.parameters]].to_numpy(np.float64)
    badness = fit_cost(frame, given_noise=given_noise)
    done = (frame["status"] == "converged").to_numpy(bool)
    for rows in data_sets(frame, columns):
        of_set = rows[done[rows]]
        ranked = of_set[np.argsort(badness[of_set], kind="stable")]
        numbers[ranked] = _numbered(values[ranked], stds[ranked])
    return numbers


def data_sets(frame: pd.DataFrame, columns: BatchColumns) -> Sequence[NDArray[np.int64]]:
    """Return the row numbers of each data set's cases."""
    if not columns.data:
        return [np.arange(len(frame), dtype=np.int64)]
    labels: Any = frame.groupby(columns.data, sort=False, dropna=False).ngroup().to_numpy(np.int64)
    order = np.argsort(labels, kind="stable").astype(np.int64)
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _numbered(values: Floats, stds: Floats) -> NDArray[np.int64]:
    """Return the numbers of the optima of one data set's cases, which come best first."""
    numbers = np.zeros(len(values), np.int64)
    count = 0
    while (left := np.flatnonzero(numbers == 0)).size:
        best, count = left[0], count + 1
        reach = np.fmax(SAME_STDS * stds[best], SAME_SHARE * np.abs(values[best]))
        # a parameter that is not free in this data set is NaN in all of its cases
        far = np.abs(values[left] - values[best]) > reach
        numbers[left[~far.any(axis=1)]] = count
    return numbers
