"""What the residuals say of the model and of the stated uncertainty, in words; where they say nothing, what was tested.

An error of the model that its parameters make up for leaves a residual in which no test finds anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from fmuid.formatting import listed, two_digits, unit_text
from fmuid.identification import LEAST_STD_FACTOR, RESIDUAL_LEVEL, RESIDUAL_SETTINGS, ResidualDefect

if TYPE_CHECKING:
    from fmuid.identification import ResidualAnalysis, ResidualFinding, ResidualSeries

# An autocorrelation from which on a residual is called far from white.
FAR_FROM_WHITE = 0.5


def residual_words(found: ResidualAnalysis, units: Mapping[str, str | None] | None = None) -> tuple[str, ...]:
    """Return what is to be known of the residuals, in sentences, one at least; with the units of the outputs."""
    large = [each for each in found.findings if each.large]
    coloured = [each for each in large if each.trait is ResidualDefect.COLOURED]
    said = [_large(found, each, units or {}) for each in coloured]
    said += _widening(found, coloured=bool(coloured))
    said += [_large(found, each, units or {}) for each in large if each.trait is not ResidualDefect.COLOURED]
    said += _off_grid(found)
    said += _returning(found)
    quiet = not said
    return tuple(said + _slow(found) + _long(found) + _summary(found, quiet=quiet))


def _name(found: ResidualAnalysis, output: str, *experiments: str) -> str:
    """Return an output's name, with its experiments where there are others."""
    several = len({each.experiment for each in found.series}) > 1
    return f"{output} in {listed(experiments)}" if several else output


def _series_name(found: ResidualAnalysis, series: ResidualSeries) -> str:
    return _name(found, series.output, series.experiment)


def _large(found: ResidualAnalysis, finding: ResidualFinding, units: Mapping[str, str | None]) -> str:
    """Return a sentence on what is large enough to be said by itself."""
    series, name = finding.series, _series_name(found, finding.series)
    if finding.trait is ResidualDefect.COLOURED:
        lag, largest = series.whiteness.strongest
        far = "far from white" if abs(largest) >= FAR_FROM_WHITE else "not white"
        return (
            f"The residual of {name} is {far} (autocorrelation {largest:.2f} at a lag of {_count(lag, 'sample')}): "
            "the model or the noise has dynamics of its own"
        )
    if finding.trait is ResidualDefect.OFFSET:
        mean = f"{series.mean:.3g} {unit_text(units.get(series.output))}".rstrip()
        return (
            f"The residual of {name} has the mean {mean}, {abs(series.mean) / series.std:.2g} of its standard "
            "deviation: a sensor's offset, or something constant that the model lacks"
        )
    if finding.input is not None:
        one = finding.input
        delay = f"{one.lag:.3g} s later" if one.lag > 0 else "at the same time"
        return (
            f"The residual of {name} is correlated with the input {one.input} ({one.correlation:+.2f}, {delay}; "
            f"by chance within {one.band:.2g}): part of how {one.input} acts is not in the model"
        )
    shape = series.normality
    traits = ["is lopsided"] if series.is_lopsided else []
    traits += [f"has {'heavy' if shape.kurtosis > 0 else 'light'} tails"] if series.is_tailed else []
    remedy = ": look for outliers, or use a robust loss" if shape.kurtosis > RESIDUAL_SETTINGS.large_kurtosis else ""
    return (
        f"The residual of {name} {listed(traits)}, unlike normal noise (skewness {two_digits(shape.skewness)}, "
        f"excess kurtosis {two_digits(shape.kurtosis)}, {_count(series.outliers, 'sample')} beyond "
        f"{RESIDUAL_SETTINGS.outlier_stds:g} standard deviations){remedy}"
    )


def _widening(found: ResidualAnalysis, *, coloured: bool) -> list[str]:
    """Say how the standard deviations allow for the colour of the residuals, where that is worth it."""
    known = {name: factor for name, factor in found.widening.items() if math.isfinite(factor)}
    other = {name: f for name, f in known.items() if not 1.0 / LEAST_STD_FACTOR < f < LEAST_STD_FACTOR}
    if not other:
        here = "For the estimates this makes little difference; their standard deviations allow for it"
        return [here] if coloured and known else []
    low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
    about = f"{two_digits(known[high])} times"
    if known[high] > LEAST_STD_FACTOR * known[low]:
        about = f"{two_digits(known[low])} ({low}) to {two_digits(known[high])} times ({high})"
    sure = any(each.trait is ResidualDefect.COLOURED for each in found.findings)
    why = "Since neighbouring samples are not independent, the"
    if not sure:
        why = "Neighbouring samples of the residual look correlated, if not strongly enough to rule out chance: the"
    return [f"{why} standard deviations are {about} those that white noise of this size would give"]


def _slow(found: ResidualAnalysis) -> list[str]:
    """Say where the standard deviations allow for weak slow noise."""
    return [
        f"In the residual of {_name(found, each.output, *each.experiments)} there is slow noise "
        f"beneath the rest ({two_digits(100 * each.share)} % of its variance, with a time constant of about "
        f"{each.time_constant:.1g} s), for which the standard deviations allow; one white residual in a hundred looks "
        "so by chance"
        for each in found.slow
    ]


def _long(found: ResidualAnalysis) -> list[str]:
    """Say where noise is so slow that the record hardly tells how slow."""
    return [
        f"The noise of {_name(found, each.output, *each.experiments)} is slow for its record (a "
        f"time constant of about {each.time_constant:.1g} s, in {each.record:.3g} s): how slow is hardly told, and the "
        "standard deviations that it acts on are uncertain themselves; a longer record tells more"
        for each in found.long_memory
    ]


def _returning(found: ResidualAnalysis) -> list[str]:
    """Say where the standard deviations allow for what comes back with each cycle of the excitation."""
    return [
        f"In the residual of {_name(found, each.output, each.experiment)} something comes back with each "
        f"cycle of the excitation, every {each.period:.3g} s ({two_digits(100 * each.share)} % of its variance): an "
        "error of the model, which no number of cycles averages out; the standard deviations allow for it"
        for each in found.returning
    ]


def _off_grid(found: ResidualAnalysis) -> list[str]:
    if not found.off_grid:
        return []
    names = [_name(found, output, experiment) for experiment, output in found.off_grid]
    return [
        f"The samples of {listed(names)} stand on no grid: how neighbouring ones depend on each other is judged as if "
        "they were equally spaced"
    ]


def _summary(found: ResidualAnalysis, *, quiet: bool) -> list[str]:
    """Say where there was nothing to examine and, where nothing else is to be said, what was tested."""
    idle = [_series_name(found, each) for each in found.series if not each.is_tested]
    lines = [f"The residual of {listed(idle)} is too short, or nothing but rounding, to be examined"] if idle else []
    examined = [each for each in found.series if each.is_tested]
    if not quiet or not examined:
        return lines
    slight = {
        _series_name(found, each): [_slight(one) for one in found.findings if one.series is each] for each in examined
    }
    slight = {name: traits for name, traits in slight.items() if traits}
    said = "significant, but slight"
    lines += [f"The residual of {name} has {listed(traits)}: {said}" for name, traits in slight.items()]
    names = [_series_name(found, each) for each in examined]
    which = f"residual of {names[0]} looks" if len(names) == 1 else f"residuals of {listed(names)} look"
    like = "otherwise like" if slight or found.slow else "like"
    return [
        *lines,
        f"The {which} {like} white normal noise that has nothing to do with the inputs, as far as was tested: "
        f"{_tested(examined)}; nothing more was tested: an error of the model that the parameters make up for does "
        "not show there, nor does slow noise too weak for so many samples",
    ]


def _slight(finding: ResidualFinding) -> str:
    """Return what is significant, but not large enough to be said by itself."""
    series = finding.series
    if finding.trait is ResidualDefect.COLOURED:
        lag, largest = series.whiteness.strongest
        return f"an autocorrelation of {largest:.2g} at a lag of {_count(lag, 'sample')}"
    if finding.trait is ResidualDefect.OFFSET:
        return f"a mean of {series.mean / series.std:.2g} standard deviations"
    if finding.input is not None:
        return f"a correlation of {finding.input.correlation:+.2g} with the input {finding.input.input}"
    shape = series.normality
    return f"a skewness of {two_digits(shape.skewness)} and an excess kurtosis of {two_digits(shape.kurtosis)}"


def _tested(series: list[ResidualSeries]) -> str:
    """Return what was tested, of how many samples and at what level."""
    inputs = list(dict.fromkeys(one.input for each in series for one in each.inputs))
    lags, samples = _range([each.whiteness.lags for each in series]), _range([each.samples for each in series])
    crossed = [f"correlation with {listed(inputs)}"] if inputs else []
    tests = listed([f"whiteness (Ljung–Box over {lags} lags)", "mean", *crossed, "normality (Jarque–Bera)"])
    return f"{tests}, each at a level of {100 * RESIDUAL_LEVEL:g} %, with {samples} samples"


def _range(numbers: list[int]) -> str:
    return f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
