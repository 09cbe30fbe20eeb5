"""Statistics over the cases of a batch: repetitions, and spread against stated standard deviations."""

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


@dataclass(frozen=True)
class StatisticsSettings:
    """Numbers of the statistics of a batch."""

    level: float = 0.95  # of the counted intervals
    same_stds: float = 0.3  # distance of estimates of one optimum, as in `fmuid.estimation.global_search`
    same_fraction: float = 1e-4  # the same, as a fraction of the magnitude
    outside: float = 0.05  # two-sided probability outside the limits of a binomial fraction
    false_warning: float = 0.01  # probability of any false warning over all tests of a table
    min_ratio: float = 1.05  # of spread and stated std: smaller ones leave a coverage of 94.3 %
    min_bias: float = 0.15  # in stated std: smaller ones leave a coverage of 94.8 %
    min_coverage_error: float = 0.01


SETTINGS = StatisticsSettings()
# Half the width of the counted intervals, in standard deviations.
INTERVAL_STDS = float(special.ndtri(0.5 + SETTINGS.level / 2.0))


class EstimateWarning(Enum):
    """Significant defects of a parameter's estimates."""

    STD_TOO_SMALL = "std too small"  # the spread is larger than the stated standard deviation
    STD_TOO_LARGE = "std too large"
    BIASED = "biased"  # the mean is not the true value
    COVERAGE_OFF = "coverage off"  # 95 % intervals contain the true value in another fraction of cases


@dataclass(frozen=True)
class BatchColumns:
    """Columns of a batch's frame by their role."""

    parameters: tuple[str, ...]  # names of columns ``value.<name>``
    outputs: tuple[str, ...]  # names of columns ``noise.<name>``
    starts: tuple[str, ...]  # columns ``start.<parameter>``
    design: tuple[str, ...]  # another experiment: ``set.<variable>``, ``free``
    repeats: tuple[str, ...]  # other data of an experiment: ``table``, ``draw``

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
        """The columns that identify a data set."""
        return [*self.repeats, *self.design]


def converged(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the cases that converged."""
    return frame[frame["status"] == "converged"]


def fit_cost(frame: pd.DataFrame, *, given_noise: bool) -> Floats:
    """Return the cost of each case (n,), infinite where unknown.

    (1.37) where all noise variances are given, else Σ ln σ̂² over the outputs (docs/method/noise-variances.md).
    """
    if given_noise:
        badness = frame["cost"].to_numpy(np.float64)
    else:
        noise = frame[[f"noise.{name}" for name in BatchColumns.of(frame).outputs]].to_numpy(np.float64)
        badness = np.log(np.maximum(noise, np.finfo(np.float64).tiny)).sum(axis=1)
    return np.where(np.isfinite(badness), badness, np.inf)


def estimates(frame: pd.DataFrame, *, given_noise: bool) -> pd.DataFrame:
    """Return the best converged case of every data set."""
    found, columns = converged(frame), BatchColumns.of(frame)
    if not columns.starts:
        return found
    ranked = found.iloc[np.argsort(fit_cost(found, given_noise=given_noise), kind="stable")]
    best = ranked.drop_duplicates(columns.data) if columns.data else ranked.iloc[:1]
    return best.sort_values("case")


def is_repetition(frame: pd.DataFrame, columns: BatchColumns) -> bool:
    """Return True if the cases repeat one experiment."""
    return all(len(frame[name].unique()) <= 1 for name in columns.design)


def statistics(values: Floats, stds: Floats, truth: float, *, repeated: bool) -> dict[str, float]:
    """Return the statistics of one parameter over cases.

    `values` and `stds` are (n,); those without a finite std count as undetermined. `truth` is NaN where unknown. Tests
    need `repeated` cases. Keys: ``cases``, ``undetermined``, ``mean``, ``median``, ``spread`` (standard deviation over
    cases), ``stated_std`` (root mean square), their ``ratio``, ``ratio_p``. Against the truth: ``truth``, ``bias``,
    ``bias_std``, ``bias_p``, ``rms_error``. ``coverage`` is of the intervals value ± 1.96 std; ``coverage_lower`` and
    ``coverage_upper`` are its 95 % limits (Clopper and Pearson, Biometrika 26, 1934). All ``_p`` are two-sided.
    """
    there = np.isfinite(values)
    known = there & np.isfinite(stds)
    x, s = values[known], stds[known]
    n = x.size
    mean, spread = _mean(x), _spread(x)
    stated = math.sqrt(_mean(s**2)) if n else math.nan
    ratio = spread / stated if repeated and n > 1 and stated > 0 else math.nan
    found = {"cases": n, "undetermined": int(there.sum()) - n, "mean": mean}
    found |= {"median": float(np.median(x)) if n else math.nan, "spread": spread, "stated_std": stated}
    found |= {"ratio": ratio, "ratio_p": _spread_probability(ratio, s), "truth": truth}
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
    """Return the two-sided probability of a ratio for normal estimates.

    ratio² follows F. Its numerator has n − 1 degrees of freedom, fewer for unequal std (Satterthwaite, Biometrics
    Bulletin 2, 1946). Those of the denominator follow from the scatter of the stated variances.
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
    lower = float(special.betaincinv(held, n - held + 1, SETTINGS.outside / 2.0)) if held else 0.0
    upper = float(special.betaincinv(held + 1, n - held, 1.0 - SETTINGS.outside / 2.0)) if held < n else 1.0
    return lower, upper


def _binomial_probability(held: int, n: int) -> float:
    at_most = float(special.bdtr(held, n, SETTINGS.level))
    at_least = float(special.bdtrc(held - 1, n, SETTINGS.level)) if held else 1.0
    return min(1.0, 2.0 * min(at_most, at_least))


def doubted(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `statistics` with a column ``doubts``; more tests need surer doubts."""
    tested = [name for name in table if str(name).endswith("_p")]
    tests = max(1, int(table[tested].notna().to_numpy().sum()))
    found = [_doubts(row, tests) for row in table.to_dict("records")]
    return table.assign(doubts=pd.Series(found, table.index, dtype=object))


def _doubts(row: Mapping[Any, Any], tests: int) -> tuple[EstimateWarning, ...]:
    """Return the significant and relevant defects of one parameter."""

    def sure(name: str) -> bool:
        return bool(row.get(name, math.nan) * tests < SETTINGS.false_warning)

    ratio, found = row["ratio"], []
    if sure("ratio_p") and max(ratio, 1.0 / ratio if ratio else math.inf) > SETTINGS.min_ratio:
        found.append(EstimateWarning.STD_TOO_SMALL if ratio > 1.0 else EstimateWarning.STD_TOO_LARGE)
    if sure("bias_p") and abs(row["bias"]) > SETTINGS.min_bias * row["stated_std"]:
        found.append(EstimateWarning.BIASED)
    if sure("coverage_p") and abs(row["coverage"] - SETTINGS.level) > SETTINGS.min_coverage_error:
        found.append(EstimateWarning.COVERAGE_OFF)
    return tuple(found)


def optimum_numbers(frame: pd.DataFrame, *, given_noise: bool) -> NDArray[np.int64]:
    """Return the optimum of each case (n,): 1 best, 0 not converged."""
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
    """Return the optima's numbers for one data set's cases, best first."""
    numbers = np.zeros(len(values), np.int64)
    count = 0
    while (left := np.flatnonzero(numbers == 0)).size:
        best, count = left[0], count + 1
        reach = np.fmax(SETTINGS.same_stds * stds[best], SETTINGS.same_fraction * np.abs(values[best]))
        # a parameter that is not free in this data set is NaN in all of its cases
        far = np.abs(values[left] - values[best]) > reach
        numbers[left[~far.any(axis=1)]] = count
    return numbers
