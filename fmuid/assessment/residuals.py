"""What the residuals say of the model and of the stated uncertainty: whiteness, inputs, distribution, in words.

Output errors are unbiased whatever the colour of the noise (1.29), but their covariance (1.31) takes the
samples for independent. Where the residual is correlated over time with ρ(τ), the estimates scatter as
(JᵀJ)⁻¹ JᵀΓJ (JᵀJ)⁻¹, Γ_kl = ρ(k − l) (Morelli and Klein): what counts is the residual's colour as the sensitivities see
it, parameter by parameter, and not its correlation time alone. `Diagnostics.inflation` is the ratio of both standard
deviations. Each output's residual in each experiment is taken as a stationary series unrelated to the others; where it
is an error of the model that comes back with every cycle of the experiment, the ratio is rather a lower limit.

With thousands of samples the slightest imperfection is significant: words tell what is unlikely by chance and large
enough to matter from what is significant but slight. Where nothing is, they say what was tested: an error of the model
that its parameters make up for leaves a residual in which no test finds anything.

References
----------
E. A. Morelli, V. Klein, "Accuracy of aerodynamic model parameters estimated from flight test data", J. of Guidance,
Control, and Dynamics 20 (1), 1997; H. White, "Maximum likelihood estimation of misspecified models", Econometrica 50
(1), 1982; L. Ljung, "System Identification: Theory for the User", 2nd ed., 1999, section 16.6 (residual analysis); and
those of `fmuid.assessment.series`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from fmuid.arrays import Floats
from fmuid.assessment.residual_series import OUTLYING, InputCorrelation, ResidualSeries, examine_output
from fmuid.assessment.series import coloured_gram
from fmuid.errors import InputError
from fmuid.estimation import LeastSquares, Result
from fmuid.text import listed

# What is said in words is less likely by chance than this, over all residuals and inputs together ...
SIGNIFICANT = 0.01
# ... and matters: an autocorrelation this large, and one that is far from white,
COLOURED, FAR_FROM_WHITE = 0.1, 0.5
# standard deviations that are wrong by this factor,
WRONG_STD = 1.25
# a correlation with an input: it explains a hundredth of the residual's variance,
RELATED = 0.1
# a mean in standard deviations, and a skewness and excess kurtosis beyond which noise no longer looks normal.
OFFSET, SKEWED, TAILED = 0.1, 0.5, 1.0


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """All residuals of a result.

    Attributes
    ----------
    series : tuple of ResidualSeries
        Experiment by experiment, output by output.
    inflation : dict of str to float
        For each parameter, by which factor the colour of the residuals makes its estimate scatter more than its stated
        standard deviation says; NaN where it has none.
    """

    series: tuple[ResidualSeries, ...]
    inflation: dict[str, float]

    @property
    def words(self) -> tuple[str, ...]:
        """What is to be known of the residuals, in sentences; one at least."""
        several = len({each.experiment for each in self.series}) > 1
        names = [f"{each.output} in {each.experiment}" if several else each.output for each in self.series]
        said: list[str] = []
        for each, name in zip(self.series, names, strict=True):
            said += [text for text in (_whiteness(each, name, len(self.series)),) if text]
        level = SIGNIFICANT / max(len(self.series), 1)
        coloured = any(each.whiteness_probability <= level for each in self.series)
        said += _uncertainty(self.inflation) if said else _doubt(self.inflation, coloured=coloured)
        for each, name in zip(self.series, names, strict=True):
            said += _offset(each, name, len(self.series)) + _inputs(each, name, self.series)
            said += _distribution(each, name, len(self.series))
        return tuple(said + _summary(self.series, names, said))

    def gram(self, columns: Floats) -> Floats:
        """Return Xᵀ Γ X (k, k), Γ (n, n) the correlation of the whitened noise over the rows of X (n, k)."""
        total = np.zeros((columns.shape[1], columns.shape[1]))
        for each in self.series:
            total += coloured_gram(columns[each.rows], each.places, each.noise_correlation)
        return total

    @property
    def table(self) -> pd.DataFrame:
        """One row a residual; times in s, of the inputs the one whose correlation is least likely by chance."""
        return pd.DataFrame([each.row() for each in self.series])

    @property
    def inputs(self) -> pd.DataFrame:
        """One row for each residual and input: experiment, output, input, lag (s), correlation, band, probability."""
        names = ["input", "lag", "correlation", "band", "probability"]
        rows = [
            {"experiment": each.experiment, "output": each.output, **{name: getattr(one, name) for name in names}}
            for each in self.series
            for one in each.inputs
        ]
        return pd.DataFrame(rows, columns=["experiment", "output", *names])

    def to_json_dict(self) -> dict[str, Any]:
        """Return ``diagnostics`` of ``result.json``; what is not a finite number is None."""
        rows = []
        for each in self.series:
            row = {name: value for name, value in each.row().items() if not name.startswith("input")}
            inputs = self.inputs[
                (self.inputs["experiment"] == each.experiment) & (self.inputs["output"] == each.output)
            ]
            row["inputs"] = inputs.drop(columns=["experiment", "output"]).to_dict("records")
            rows.append(_plain(row))
        return {"words": list(self.words), "inflation": _plain(self.inflation), "residuals": rows}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def examine_residuals(problem: LeastSquares, result: Result) -> Diagnostics:
    """Examine the residuals of a result; nothing is simulated.

    Parameters
    ----------
    problem : LeastSquares
        That the result was found for.
    result : Result
        As `fmuid.identify` returns it.

    Raises
    ------
    InputError
        If the result was read from a file, which has no residuals.
    """
    if result.local is None:
        raise InputError("a result read from a file has no residuals to examine; identify the study again")
    series: list[ResidualSeries] = []
    first = 0
    for experiment, fit in zip(problem.experiments, result.fit, strict=True):
        counted = np.flatnonzero(experiment.counted)
        for column, output in enumerate(experiment.output_names):
            rows = first + np.flatnonzero(counted % len(experiment.output_names) == column)
            if rows.size:
                simulated = fit[f"simulated.{output}"].to_numpy(np.float64)
                series.append(examine_output(experiment, column, simulated, rows))
        first += counted.size
    white = Diagnostics(tuple(series), {})
    local = result.local
    columns = local.noisy(local.jacobian @ local.root)
    coloured, stated = (np.diag(local.covariance_with(spread)) for spread in (white.gram(columns), columns.T @ columns))
    ratio = np.sqrt(coloured / stated)
    return Diagnostics(white.series, dict(zip(result.names, ratio.tolist(), strict=True)))


# --- words ------------------------------------------------------------------------------


def _whiteness(series: ResidualSeries, name: str, tests: int) -> str:
    """Return a sentence on a residual that is not white, "" of one that is or nearly is."""
    if not series.whiteness_probability <= SIGNIFICANT / tests:
        return ""
    lag, largest = _largest_autocorrelation(series)
    if abs(largest) < COLOURED:
        return ""
    far = "far from white" if abs(largest) >= FAR_FROM_WHITE else "not white"
    return (
        f"The residual of {name} is {far} (autocorrelation {largest:.2f} at a lag of {_count(lag, 'sample')}): "
        "the model or the noise has dynamics of its own"
    )


def _largest_autocorrelation(series: ResidualSeries) -> tuple[int, float]:
    """Return the lag, in samples, at which the autocorrelation is largest, and its value there."""
    tested = np.nan_to_num(series.autocorrelation[: series.tested_lags + 1])
    lag = 1 + int(np.argmax(np.abs(tested[1:])))
    return lag, float(tested[lag])


def _uncertainty(inflation: dict[str, float]) -> list[str]:
    """Say by how much the stated standard deviations are wrong, where the residuals are not white."""
    known = {name: factor for name, factor in inflation.items() if math.isfinite(factor)}
    too_small = _too_small(known)
    if too_small:
        of, about = too_small
        return [
            f"Since neighbouring samples are not independent, the stated standard deviations{of} are too small, "
            f"by a factor of {about}"
        ]
    if known and max(known.values()) <= 1.0 / WRONG_STD:
        return [
            "Since neighbouring samples tend to cancel, the stated standard deviations are too large, "
            f"by a factor of {1.0 / max(known.values()):.2g} or more"
        ]
    return ["For the estimates this makes little difference: the stated standard deviations hold"]


def _doubt(inflation: dict[str, float], *, coloured: bool) -> list[str]:
    """Say what is wrong with the stated standard deviations where no autocorrelation is large enough to be said.

    Small ones over many lags matter too; they may be chance unless the residuals are significantly `coloured`.
    """
    too_small = _too_small({name: factor for name, factor in inflation.items() if math.isfinite(factor)})
    if too_small is None or coloured:
        return _uncertainty(inflation) if too_small else []
    of, about = too_small
    return [
        "Neighbouring samples of the residual look correlated, if not strongly enough to rule out chance: the stated "
        f"standard deviations{of} may be too small, by a factor of {about}"
    ]


def _too_small(known: dict[str, float]) -> tuple[str, str] | None:
    """Return which standard deviations are too small, and by what factor; None where none are."""
    small = {name: factor for name, factor in known.items() if factor >= WRONG_STD}
    if not small:
        return None
    low, high = min(small, key=small.__getitem__), max(small, key=small.__getitem__)
    about = f"about {small[high]:.2g}"
    if small[high] > WRONG_STD * small[low]:
        about = f"{small[low]:.2g} ({low}) to {small[high]:.2g} ({high})"
    return "" if len(small) == len(known) else f" of {listed(tuple(small))}", about


def _offset(series: ResidualSeries, name: str, tests: int) -> list[str]:
    if not (series.mean_probability < SIGNIFICANT / tests and abs(series.mean) > OFFSET * series.std):
        return []
    return [
        f"The residual of {name} has the mean {series.mean:.3g}, {abs(series.mean) / series.std:.2g} of its standard "
        "deviation: a sensor's offset, or something constant that the model lacks"
    ]


def _inputs(series: ResidualSeries, name: str, all_series: tuple[ResidualSeries, ...]) -> list[str]:
    tests = sum(len(each.inputs) for each in all_series)
    related = [one for one in series.inputs if one.probability < SIGNIFICANT / tests and abs(one.correlation) > RELATED]
    return [
        f"The residual of {name} is correlated with the input {one.input} ({one.correlation:+.2f}, {_delay(one)}; "
        f"by chance within {one.band:.2g}): part of how {one.input} acts is not in the model"
        for one in related
    ]


def _delay(one: InputCorrelation) -> str:
    return f"{one.lag:.3g} s later" if one.lag > 0 else "at the same time"


def _distribution(series: ResidualSeries, name: str, tests: int) -> list[str]:
    if not series.normality_probability < SIGNIFICANT / tests:
        return []
    traits = [(abs(series.skewness) > SKEWED, "is lopsided"), (abs(series.kurtosis) > TAILED, _tails(series))]
    found = [trait for there, trait in traits if there]
    if not found:
        return []
    sentence = (
        f"The residual of {name} {listed(found)}, unlike normal noise (skewness {series.skewness:.2g}, "
        f"excess kurtosis {series.kurtosis:.2g}, {_count(series.outliers, 'sample')} beyond {OUTLYING:g} standard "
        "deviations)"
    )
    return [sentence + (": look for outliers, or use a robust loss" if series.kurtosis > TAILED else "")]


def _tails(series: ResidualSeries) -> str:
    return "has heavy tails" if series.kurtosis > 0 else "has light tails"


def _summary(series: tuple[ResidualSeries, ...], names: list[str], said: list[str]) -> list[str]:
    """Say where there was nothing to examine and, where nothing else is to be said, what was tested."""
    idle = [name for each, name in zip(series, names, strict=True) if not each.examined]
    lines = [f"The residual of {listed(idle)} is too short, or nothing but rounding, to be examined"] if idle else []
    quiet = [(each, name) for each, name in zip(series, names, strict=True) if each.examined]
    if said or not quiet:
        return lines
    slight = [(name, found) for each, name in quiet if (found := _slight(each, series))]
    lines += [f"The residual of {name} has {listed(found)}: significant, but slight" for name, found in slight]
    which = f"residual of {quiet[0][1]} looks"
    if len(quiet) > 1:
        which = f"residuals of {listed([name for _, name in quiet])} look"
    like = "otherwise like" if slight else "like"
    return [
        *lines,
        f"The {which} {like} white normal noise that has nothing to do with the inputs, as far as was tested: "
        f"{_tested([each for each, _ in quiet])}; nothing more was tested, and an error of the model that the "
        "parameters make up for does not show there",
    ]


def _slight(series: ResidualSeries, all_series: tuple[ResidualSeries, ...]) -> list[str]:
    """Return what is significant in a residual of which nothing is large enough to be said by itself."""
    level = SIGNIFICANT / len(all_series)
    found = []
    if series.whiteness_probability <= level:
        lag, largest = _largest_autocorrelation(series)
        found.append(f"an autocorrelation of {largest:.2g} at a lag of {_count(lag, 'sample')}")
    if series.mean_probability < level:
        found.append(f"a mean of {series.mean / series.std:.2g} standard deviations")
    tests = sum(len(each.inputs) for each in all_series)
    related = [one for one in series.inputs if one.probability < SIGNIFICANT / tests]
    found += [f"a correlation of {one.correlation:+.2g} with the input {one.input}" for one in related]
    if series.normality_probability < level:
        found.append(f"a skewness of {series.skewness:.2g} and an excess kurtosis of {series.kurtosis:.2g}")
    return found


def _tested(series: list[ResidualSeries]) -> str:
    """Return in words what `examine_output` tests, of how many samples and at what level."""
    inputs = list(dict.fromkeys(one.input for each in series for one in each.inputs))
    lags, samples = _range([each.tested_lags for each in series]), _range([each.samples for each in series])
    crossed = [f"correlation with {listed(inputs)}"] if inputs else []
    tests = listed([f"whiteness (Ljung–Box over {lags} lags)", "mean", *crossed, "normality (Jarque–Bera)"])
    return f"{tests}, each at a level of {100 * SIGNIFICANT:g} %, with {samples} samples"


def _range(numbers: list[int]) -> str:
    return f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
