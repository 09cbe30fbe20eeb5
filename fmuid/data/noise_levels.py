"""What `Noise` says of each counted sample of some experiments, whichever form it is given in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.data.clock import column_of, missing_column
from fmuid.data.data_file import UNITS, numeric_column
from fmuid.data.experiment import Experiment
from fmuid.data.noise import Noise
from fmuid.data.predictors import Measurements
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.units import parse_unit


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """The standard deviation of each counted sample's noise: scale · √variance of its output.

    Attributes
    ----------
    variance : (n_outputs,) array
        The mean variance of the output's samples where it is given, NaN where it is estimated.
    first : (n_outputs,) array
        Where its estimation starts, NaN where the residual decides.
    scale : (n,) array or None
        Of mean square 1 over each output; None: 1 throughout.
    share : (n_outputs,) array
        Estimated variances of one pool are in these proportions.
    pools : tuple of arrays of int
        The outputs that have an estimated variance in common.
    """

    variance: Floats
    first: Floats
    scale: Floats | None
    share: Floats
    pools: tuple[Indices, ...]

    def pooled(self, sums: Floats, free: Floats | Indices) -> Floats:
        """Return sums of squares (..., n_outputs) with those of a pool shared out as their common variance has them.

        Parameters
        ----------
        sums : (..., n_outputs) array
        free : (n_outputs,) array
            How many samples, or degrees of freedom, each output brings: sums over them are the variances.
        """
        if not self.pools:
            return sums
        found = np.array(sums)
        for pool in self.pools:
            common = (sums[..., pool] / self.share[pool]).sum(axis=-1) / free[pool].sum()
            found[..., pool] = common[..., None] * self.share[pool] * free[pool]
        return found


def noise_levels(noise: Noise, experiments: Sequence[Measurements], outputs: Sequence[str]) -> NoiseLevels:
    """Return the noise of all counted samples, experiment by experiment, sample by sample.

    Raises
    ------
    InputError
        If a name is unknown, an output has two forms of noise, is given in one experiment and estimated in another, or
        what is given is not a positive number for each counted sample.
    """
    noise.check_names(outputs)
    names = [each.name for each in experiments]
    for name, own in noise.experiments.items():
        if name not in names:
            raise InputError(f"noise is given of {name!r}, which is no experiment{nearest(name, names)}")
        own.check_names(experiments[names.index(name)].output_names)
    forms: dict[str, list[str]] = {}  # of each output in each of its experiments
    found: list[list[Any]] = []
    for each in experiments:
        said = [_variances(noise, experiments, each, output) for output in each.output_names]
        found.append([level for level, _ in said])
        for output, (_, word) in zip(each.output_names, said, strict=True):
            forms.setdefault(output, []).append(word)
    given = np.array([_is_given(output, forms[output]) for output in outputs])
    share, scale = _proportions(experiments, found, outputs)
    pool = np.array([_is_pooled(noise, output, forms[output]) for output in outputs])
    if pool.sum() == 1 and scale is None and "weights" in forms[alone := outputs[int(np.argmax(pool))]]:
        raise InputError(
            f"noise.weights are of output {alone!r} alone and the same for all its samples, which weighs nothing: "
            "give weights of other outputs, or a column"
        )
    pools = (np.flatnonzero(pool),) if pool.sum() > 1 else ()
    return NoiseLevels(np.where(given, share, math.nan), noise.first(outputs), scale, share, pools)


def _variances(
    noise: Noise, experiments: Sequence[Measurements], experiment: Measurements, output: str
) -> tuple[Any, str]:
    """Return the variance of an output's samples in an experiment, of weights their proportions, and the form."""
    own = noise.experiments.get(experiment.name, Noise())
    word, level = own.form(output)
    among = [experiment]
    if not word:
        word, level = noise.form(output)
        among = [each for each in experiments if output in each.output_names]
    if word == "variance":
        return level, word
    if word == "relative_std":
        return (level * _spread(among, output)) ** 2, word
    if not word:
        return 1.0, ""
    values = level if isinstance(level, float) else _samples(experiment, output, word, level)
    with np.errstate(divide="ignore"):
        return (values**2 if word == "std" else 1.0 / values), word


def _spread(experiments: Sequence[Measurements], output: str) -> float:
    """Return the standard deviation of the counted samples of an output about their mean."""
    columns = [each.output_names.index(output) for each in experiments]
    parts = [each.output_values[:, j][each.counted[:, j]] for each, j in zip(experiments, columns, strict=True)]
    values = np.concatenate(parts)
    spread = float(np.std(values)) if values.size else math.nan
    if spread == 0.0:
        raise InputError(
            f"output {output!r} is the same in all samples: a share of its spread is no noise; give noise.std"
        )
    return spread


def _samples(experiment: Measurements, output: str, word: str, level: str | tuple[float, ...]) -> Floats:
    """Return the standard deviations or weights (K,) of an output's samples."""
    counted = experiment.counted[:, experiment.output_names.index(output)]
    what = f"noise.{word} of output {output!r}"
    if isinstance(level, str):
        if isinstance(experiment, Experiment) and not experiment.measured:
            return np.full(len(counted), math.nan)
        values, where = _column(experiment, output, what, level, convert=word == "std")
    else:
        values, where = np.array(level), what
        if values.size != len(counted):
            raise InputError(
                f"{what} has {values.size} values for {len(counted)} samples of experiment {experiment.name!r}"
            )
    bad = np.flatnonzero(counted & ~((values > 0) & np.isfinite(values)))
    if bad.size:
        found = "has no value" if np.isnan(values[bad[0]]) else f"is {values[bad[0]]:g}"
        raise InputError(
            f"{where} {found} in row {bad[0] + 1} (t = {experiment.times[bad[0]]:.9g} s), where the output counts: "
            "give a positive number, or leave the output's cell empty"
        )
    return np.where(counted, values, 1.0)


def _column(experiment: Measurements, output: str, what: str, column: str, *, convert: bool) -> tuple[Floats, str]:
    """Return a column of an experiment's table, in the unit of the output's, and what messages call it."""
    if not isinstance(experiment, Experiment):
        raise InputError(f"{what} is the column {column!r}, and there is no table: give its values")
    frame, source = experiment.frame, experiment.source
    name = column_of([str(each) for each in frame.columns], column) or column
    if name not in frame.columns:
        raise InputError(f"{source}: {missing_column('noise', column, frame.columns)}")
    values = np.array(numeric_column(frame, name, source))
    mine, its = frame.attrs.get(UNITS, {}).get(name), experiment.units.get(output)
    if convert and mine and its and mine != its:
        one, other = parse_unit(mine), parse_unit(its)
        if one is None or other is None or one.exponents != other.exponents:
            raise InputError(f"{source}: the noise column {name!r} is in {mine}, and output {output!r} in {its}")
        values *= one.factor / other.factor
    return values, f"{source}: the noise column {name!r}"


def _is_given(output: str, forms: Sequence[str]) -> bool:
    """Return whether the variance of an output is given, in all its experiments or none."""
    found = {form in ("variance", "std", "relative_std") for form in forms}
    if len(found) > 1:
        raise InputError(
            f"the noise of output {output!r} is given in one experiment and to be estimated in another: "
            "give it in all of them, or weights"
        )
    return found.pop()


def _is_pooled(noise: Noise, output: str, forms: Sequence[str]) -> bool:
    """Return whether an output has its estimated variance in common with others."""
    common = noise.shared_variance if isinstance(noise.shared_variance, bool) else output in noise.shared_variance
    if common and not isinstance(noise.shared_variance, bool) and _is_given(output, forms):
        raise InputError(
            f"noise.shared_variance names output {output!r}, whose noise is given: leave one of the two out"
        )
    return (common or "weights" in forms) and not _is_given(output, forms)


def _proportions(
    experiments: Sequence[Measurements], levels: Sequence[Sequence[Any]], outputs: Sequence[str]
) -> tuple[Floats, Floats | None]:
    """Return the mean variance of each output (n_outputs,), and the square roots of the samples' shares of it (n,).

    The levels are those of each output of each experiment, a number or one a sample.
    """
    pairs = [
        pair for each, own in zip(experiments, levels, strict=True) for pair in zip(each.output_names, own, strict=True)
    ]
    last = dict(pairs)
    if all(np.ndim(level) == 0 for _, level in pairs) and all(level == last[output] for output, level in pairs):
        return np.array([last[output] for output in outputs]), None
    blocks, groups = [], []
    for each, own in zip(experiments, levels, strict=True):
        blocks.append(np.stack(np.broadcast_arrays(*own, each.times)[:-1], axis=1)[each.counted])
        columns = np.array([outputs.index(name) for name in each.output_names], dtype=np.intp)
        groups.append(np.broadcast_to(columns, each.counted.shape)[each.counted])
    rows, group = np.concatenate(blocks), np.concatenate(groups)
    scale, mean = np.ones(rows.size), np.full(len(outputs), math.nan)  # NaN of what is not measured yet
    for j in range(len(outputs)):
        own_rows = rows[group == j]
        if own_rows.size and np.isfinite(own_rows).all():
            same = bool((own_rows == own_rows[0]).all())
            mean[j] = own_rows[0] if same else own_rows.mean()
            scale[group == j] = 1.0 if same else np.sqrt(own_rows / mean[j])
    return mean, None if (scale == 1.0).all() else scale
