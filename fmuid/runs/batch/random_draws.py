"""What a batch draws: starts, points of a space-filling design, noise. Each has random numbers of its own.

A generator is seeded by the batch's seed, a number for the purpose, and the entry drawn, so that an entry has the same
numbers whatever else is drawn, in whichever order and process.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Parameter, ParameterSet
from fmuid.estimation import spans_decades
from fmuid.studies import SpaceFillingSection

# Purposes of random numbers.
FOR_STARTS, FOR_SAMPLE, FOR_NOISE = 1, 2, 3
# Where bounds do not say how far starts may lie: so many standard deviations from the prior's mean, or this share of
# its magnitude from the parameter's own start.
START_STDS, START_SHARE = 3.0, 0.5


def generator(seed: int, purpose: int, *numbers: int) -> np.random.Generator:
    """Return the generator of random numbers for an entry of a purpose."""
    return np.random.default_rng(np.random.SeedSequence([seed, purpose, *numbers]))


def noise(seed: int, record: str | None, draw: int, experiment: int, shape: tuple[int, ...]) -> Floats:
    """Return a draw of white noise, standard normal; it is the same whatever is simulated.

    Parameters
    ----------
    seed : int
    record : str or None
        Different records have different noise, also where others come and go.
    draw : int
    experiment : int
        Number of the experiment in the study.
    shape : tuple of int
    """
    words = [] if record is None else np.frombuffer(hashlib.sha256(record.encode()).digest()[:16], "<u4").tolist()
    return generator(seed, FOR_NOISE, draw, experiment, *words).standard_normal(shape)


def design(sample: SpaceFillingSection, seed: int) -> Floats:
    """Return the points (count, n) of a space-filling design within its ranges.

    Those of `scipy.stats.qmc`: a scrambled Sobol sequence, or a Latin hypercube. Of a sequence whose length is no power
    of two the balance of the points is lost; the first so many of the next power are taken.
    """
    from scipy.stats import qmc  # slow to import

    rng, n = generator(seed, FOR_SAMPLE), len(sample.ranges)
    if sample.method == "sobol":
        units = qmc.Sobol(n, rng=rng).random_base2(math.ceil(math.log2(sample.points)))[: sample.points]
    else:
        units = qmc.LatinHypercube(n, rng=rng).random(sample.points)
    low, high = np.array(list(sample.ranges.values())).T
    return np.asarray(qmc.scale(units, low, high), dtype=np.float64)


class StartRanges:
    """Where starts are drawn.

    A parameter with two finite bounds anywhere between them, by orders of magnitude where that is a positive range of a
    decade or more; any other one within its bounds and 3 standard deviations of its prior's mean or, without a prior,
    half of its magnitude (nominal, else start) from its start.

    Parameters
    ----------
    parameters : mapping of str to Parameter
    known : ParameterSet
        The same ones with their priors, for all experiments; a parameter per experiment has one start for all.
    """

    def __init__(self, parameters: Mapping[str, Parameter], known: ParameterSet) -> None:
        self._parameters = dict(parameters)
        _, columns = known.for_experiment(0)
        ranges = [
            _range(each, float(known.prior_mean[i]), float(known.prior_std[i]))
            for each, i in zip(self._parameters.values(), columns, strict=True)
        ]
        self._low, self._high = np.array(ranges).T
        self._logarithmic = np.array([spans_decades(low, high) for low, high in ranges])
        for ends in (self._low, self._high):
            ends[self._logarithmic] = np.log(ends[self._logarithmic])

    def draw(self, seed: int, entry: int) -> dict[str, float]:
        """Return the starts of a number, of all parameters: those of one do not depend on what else is free."""
        drawn = generator(seed, FOR_STARTS, entry).uniform(self._low, self._high)
        drawn[self._logarithmic] = np.exp(drawn[self._logarithmic])
        return {
            name: min(max(value, each.min), each.max)  # exp(log(x)) is not always x
            for (name, each), value in zip(self._parameters.items(), drawn.tolist(), strict=True)
        }


def _range(parameter: Parameter, mean: float, std: float) -> tuple[float, float]:
    if math.isfinite(parameter.max - parameter.min):
        return parameter.min, parameter.max
    middle, reach = mean, START_STDS * std
    if math.isnan(mean):
        middle, reach = parameter.start, START_SHARE * (parameter.nominal or abs(parameter.start))
    return max(parameter.min, middle - reach), min(parameter.max, middle + reach)
