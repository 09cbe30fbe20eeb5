"""Measurement noise: given or estimated, per output and sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from fmuid.array_types import Floats, Indices
from fmuid.data.column_lookup import column_of, missing_column
from fmuid.data.data_file import UNITS, numeric_column
from fmuid.data.experiment import Experiment
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.units import parse_unit

# With larger variances, or smaller ones than its inverse, squares of residuals overflow.
LARGEST_VARIANCE = 1e100
# Words of which an output has one at most, and those that may name a column or give all samples.
FORMS, BY_SAMPLE = ("variance", "std", "relative_std", "reading_std", "weights"), ("std", "weights")

READINGS = "readings"  # form of an estimated fraction of each reading
ESTIMATED = ("variance", "reading_std")
"""Words with "estimate" as value."""


@dataclass(frozen=True)
class UsualNoise:
    """What is assumed where nothing is given."""

    delay_std: float = 0.29  # samples: a delay that is uniform within ±½ sample


USUAL = UsualNoise()
Positive = Annotated[float, Gt(0)]
Level = Positive | str | Sequence[float]
"""A number, the column of the experiment's table that has one for each row, or all of them, (K,)."""


@dataclass(frozen=True)
class Noise:
    """Measurement noise of each output, R_b of (1.37), diagonal.

    Per output, give one of `variance`, `std`, `relative_std`, `reading_std` and `weights`, in units of the data.
    Without them, the variance is estimated from the residual (docs/method/noise-variances.md); a robust loss uses
    `robust_variance`. In Python, `std` and `weights` may also hold all samples, (K,).

    Raises
    ------
    InputError
        If a number is not positive and finite.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, coil.parameters, noise=fmuid.Noise(variance={"i": 1e-4}))
    >>> fmuid.identify(problem).fit.given_variance
    {'i': 0.0001}
    """

    variance: Literal["estimate"] | Positive | Mapping[str, Positive] = "estimate"
    """noise variance of the outputs"""
    initial_variance: Positive | Mapping[str, Positive] | None = None
    """initial guess of an estimated variance, in [noise] only; default: from the residual"""
    std: Level | Mapping[str, Level] | None = None
    """noise level: a number, or a column with one per sample"""
    relative_std: Positive | Mapping[str, Positive] | None = None
    """noise level as a fraction of the standard deviation of the output"""
    reading_std: Literal["estimate"] | Positive | Mapping[str, Positive] | None = None
    """noise level as a fraction of each reading, or "estimate"; default of frequency responses"""
    weights: Level | Mapping[str, Level] | None = None
    """column of weights w: variance σ²/w, with one estimated σ² for all weighted outputs"""
    shared_variance: bool | Sequence[str] = False
    """outputs with one common variance, in [noise] only"""
    excitation_period: Positive | None = None
    """period of the excitation, s, for periodic model errors; default: from the inputs"""
    delay_std: Annotated[float, Ge(0)] | None = None
    """σ of an unknown delay of outputs behind inputs, samples; 0: synchronous; default: ±½ sample, uniform"""
    experiments: Mapping[str, Noise] = field(default_factory=dict, metadata={"key": False})
    """noise of single experiments by name; without initial and shared variance"""

    def __post_init__(self) -> None:
        for word in (*FORMS, "initial_variance", "excitation_period"):
            given = getattr(self, word)
            if isinstance(given, Mapping):
                given = {output: _checked(word, output, value) for output, value in given.items()}
            elif given is not None and not (word in ESTIMATED and isinstance(given, str) and given == "estimate"):
                given = _checked(word, "", given)
            object.__setattr__(self, word, given)
        if self.delay_std is not None and not 0 <= self.delay_std < math.inf:
            raise InputError(f"noise.delay_std must be zero or positive, not {self.delay_std!r}.")
        for name, own in self.experiments.items():
            if own.initial_variance is not None or own.shared_variance or own.experiments:
                words = ", ".join((*FORMS, "excitation_period", "delay_std"))
                raise InputError(f"noise of experiment {name!r}: only {words} are allowed. Set other keys in [noise].")

    def form(self, output: str) -> tuple[str, Any]:
        """Return the form of noise of an output and its value; "" and None if not given."""
        said = [(word, level) for word in FORMS if (level := _of(getattr(self, word), output)) is not None]
        said = [(word, level) for word, level in said if word != "variance" or not isinstance(level, str)]
        if len(said) > 1:
            raise InputError(f"noise: {said[0][0]} and {said[1][0]} of output {output!r} are both given. Keep one.")
        return said[0] if said else ("", None)

    def period_in(self, experiment: str) -> float | None:
        """Return the given excitation period of an experiment, s."""
        own = self.experiments.get(experiment)
        return self.excitation_period if own is None or own.excitation_period is None else own.excitation_period

    def delay_in(self, experiment: str) -> float:
        """Return σ of the unknown delay in an experiment, samples."""
        own = self.experiments.get(experiment)
        found = self.delay_std if own is None or own.delay_std is None else own.delay_std
        return USUAL.delay_std if found is None else found

    def among(self, experiments: Sequence[str]) -> Noise:
        """Return the noise of some experiments, by name."""
        return replace(self, experiments={name: own for name, own in self.experiments.items() if name in experiments})

    def given_variance(self) -> float | Mapping[str, float] | None:
        """Return the given variance, None if it is estimated; other forms are refused."""
        for word in (*FORMS[1:], "shared_variance", "excitation_period", "experiments"):
            if getattr(self, word):
                raise InputError(f"noise.{word}: not supported by diagnosis. Use noise.variance.")
        return None if isinstance(self.variance, str) else self.variance

    def check_names(self, outputs: Sequence[str]) -> None:
        """Check that all names are measured outputs."""
        for word in (*FORMS, "initial_variance", "shared_variance"):
            given = getattr(self, word)
            listed = word == "shared_variance" and not isinstance(given, bool)
            for output in given if listed or isinstance(given, Mapping) else ():
                if output not in outputs and output not in map(response_of, outputs):
                    raise InputError(f"noise.{word}: {output!r} is no measured output{nearest(output, outputs)}.")

    def known(self, outputs: Sequence[str]) -> Floats:
        """Return the variances given as numbers, else NaN, (n_outputs,)."""
        self.check_names(outputs)
        found = np.full(len(outputs), math.nan)
        for j, output in enumerate(outputs):
            word, level = self.form(output)
            if word in ("variance", "std") and isinstance(level, float):
                found[j] = level if word == "variance" else level**2
        return found

    def first(self, outputs: Sequence[str]) -> Floats:
        """Return the initial variance of each output, NaN if not given."""
        return np.array([_of(self.initial_variance, output) for output in outputs], dtype=np.float64)  # None is NaN


def _of(given: Any, output: str) -> Any:
    """Return the value of a key for an output, if any."""
    if isinstance(given, Mapping):
        return given.get(output, given.get(response_of(output)))
    return given


def response_of(output: str) -> str:
    """Return the complex response of an output such as ``Z.real``."""
    return output.rpartition(".")[0]


def _checked(word: str, output: str, value: Any) -> Any:
    """Return a checked number as float, samples as tuple, a column unchanged."""
    of = f" of output {output!r}" if output else ""
    if word in BY_SAMPLE and isinstance(value, str):
        return value
    if word in BY_SAMPLE and isinstance(value, Sequence | np.ndarray):
        try:
            return tuple(np.asarray(value, dtype=np.float64).ravel().tolist())
        except (TypeError, ValueError):
            raise InputError(f"noise.{word}{of} must be numbers.") from None
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        also = ' or "estimate"' if word in ESTIMATED else " or a column" if word in BY_SAMPLE else ""
        raise InputError(f"noise.{word}{of} must be a positive number{also}, not {value!r}.")
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"noise.{word}{of} must be positive and finite, not {value:g}.")
    if not 1.0 / LARGEST_VARIANCE < value ** (2 if word == "std" else 1) < LARGEST_VARIANCE:
        raise InputError(f"noise.{word}{of} = {value:g} is too extreme. Change the unit.")
    return float(value)


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Standard deviation of each scored sample: scale · √variance of its output.

    `variance` and `first` (n_outputs,) are given and initial variances, else NaN. `scale` (n,) has mean square 1 over
    each output; None is 1 throughout. `pools` are outputs with one variance, in the proportions `share` (n_outputs,).
    """

    variance: Floats
    first: Floats
    scale: Floats | None
    share: Floats
    pools: tuple[Indices, ...]

    def pooled(self, sums: Floats, free: Floats | Indices) -> Floats:
        """Return sums of squares (..., n_outputs), shared out in each pool; `free` are degrees of freedom."""
        if not self.pools:
            return sums
        found = np.array(sums)
        for pool in self.pools:
            common = (sums[..., pool] / self.share[pool]).sum(axis=-1) / free[pool].sum()
            found[..., pool] = common[..., None] * self.share[pool] * free[pool]
        return found


def noise_levels(noise: Noise, experiments: Sequence[Experiment], outputs: Sequence[str]) -> NoiseLevels:
    """Return the noise of all scored samples.

    Raises
    ------
    InputError
        If a name is unknown, forms of noise conflict, or a level is not positive.
    """
    noise.check_names(outputs)
    names = [each.name for each in experiments]
    for name, own in noise.experiments.items():
        if name not in names:
            raise InputError(f"noise: {name!r} is no experiment{nearest(name, names)}.")
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
        why = f"constant weights of output {alone!r} alone have no effect"
        raise InputError(f"noise.weights: {why}. Add weights of other outputs, or a column.")
    pools = ((np.flatnonzero(pool),) if pool.sum() > 1 else ()) + _responses(outputs, forms)
    return NoiseLevels(np.where(given, share, math.nan), noise.first(outputs), scale, share, pools)


def _variances(noise: Noise, experiments: Sequence[Experiment], experiment: Experiment, output: str) -> tuple[Any, str]:
    """Return variances (weights: their inverse) of an output in an experiment, and the form."""
    own = noise.experiments.get(experiment.name, Noise())
    word, level = own.form(output)
    among = [experiment]
    if not word:
        word, level = noise.form(output)
        among = [each for each in experiments if output in each.output_names]
    if not word and experiment.kind == "frequency":
        word, level = "reading_std", "estimate"
    if word == "variance":
        return level, word
    if word == "relative_std":
        return (level * _spread(among, output)) ** 2, word
    if word == "reading_std":
        readings = _readings(experiment, output)
        if not isinstance(level, str):
            return (level * readings) ** 2, word
        return readings**2, READINGS if experiment.kind == "frequency" else ""
    if not word:
        return 1.0, ""
    values = level if isinstance(level, float) else _samples(experiment, output, word, level)
    with np.errstate(divide="ignore"):
        return (values**2 if word == "std" else 1.0 / values), word


def _readings(experiment: Experiment, output: str) -> Floats:
    """Return the magnitude (K,) of each reading."""
    counted = experiment.counted[:, experiment.output_names.index(output)]
    found = np.where(counted, experiment.readings(output), 1.0)
    zero = np.flatnonzero(found == 0.0)
    if zero.size:
        why = f"output {output!r} is 0 in row {zero[0] + 1}"
        raise InputError(f"noise.reading_std: {why}. Use std, or leave the cell empty.")
    return found


def _spread(experiments: Sequence[Experiment], output: str) -> float:
    """Return the standard deviation of an output's scored samples."""
    columns = [each.output_names.index(output) for each in experiments]
    parts = [each.output_values[:, j][each.counted[:, j]] for each, j in zip(experiments, columns, strict=True)]
    values = np.concatenate(parts)
    spread = float(np.std(values)) if values.size else math.nan
    if spread == 0.0:
        raise InputError(f"noise.relative_std: output {output!r} is constant. Use noise.std.")
    return spread


def _samples(experiment: Experiment, output: str, word: str, level: str | tuple[float, ...]) -> Floats:
    """Return standard deviations or weights (K,) of an output."""
    counted = experiment.counted[:, experiment.output_names.index(output)]
    what = f"noise.{word} of output {output!r}"
    if isinstance(level, str):
        if not experiment.measured:
            return np.full(len(counted), math.nan)
        values, where = _column(experiment, output, level, convert=word == "std")
    else:
        values, where = np.array(level), what
        if values.size != len(counted):
            count = f"{values.size} values for {len(counted)} samples"
            raise InputError(f"{what}: {count} of experiment {experiment.name!r}.")
    bad = np.flatnonzero(counted & ~((values > 0) & np.isfinite(values)))
    if bad.size:
        found = "has no value" if np.isnan(values[bad[0]]) else f"is {values[bad[0]]:g}"
        row = f"row {bad[0] + 1} (t = {experiment.times[bad[0]]:.9g} s)"
        raise InputError(f"{where} {found} in {row}. Give a positive number, or leave the cell of the output empty.")
    return np.where(counted, values, 1.0)


def _column(experiment: Experiment, output: str, column: str, *, convert: bool) -> tuple[Floats, str]:
    """Return a noise column in the output's unit, and its name."""
    frame, source = experiment.frame, experiment.source
    name = column_of(frame.columns, column) or column
    if name not in frame.columns:
        raise InputError(f"{source}: {missing_column('noise', column, frame.columns)}")
    values = np.array(numeric_column(frame, name, source))
    mine, its = frame.attrs.get(UNITS, {}).get(name), experiment.units.get(output)
    if convert and mine and its and mine != its:
        one, other = parse_unit(mine), parse_unit(its)
        if one is None or other is None or one.exponents != other.exponents:
            raise InputError(f"{source}: noise column {name!r} is in {mine}, output {output!r} in {its}. Convert one.")
        values *= one.factor / other.factor
    return values, f"{source}: noise column {name!r}"


def _is_given(output: str, forms: Sequence[str]) -> bool:
    found = {form in ("variance", "std", "relative_std", "reading_std") for form in forms}
    if len(found) > 1:
        said = f"noise of output {output!r} is given in some experiments only"
        raise InputError(f"{said}. Give it in all, or use weights.")
    return found.pop()


def _is_pooled(noise: Noise, output: str, forms: Sequence[str]) -> bool:
    common = noise.shared_variance if isinstance(noise.shared_variance, bool) else output in noise.shared_variance
    if common and not isinstance(noise.shared_variance, bool) and _is_given(output, forms):
        raise InputError(f"noise.shared_variance: noise of output {output!r} is given already. Remove one of the two.")
    return (common or "weights" in forms) and not _is_given(output, forms)


def _responses(outputs: Sequence[str], forms: Mapping[str, Sequence[str]]) -> tuple[Indices, ...]:
    """Return the outputs of each complex response: one relative variance."""
    found: dict[str, list[int]] = {}
    for j, output in enumerate(outputs):
        if READINGS in forms[output] and response_of(output):
            found.setdefault(response_of(output), []).append(j)
    return tuple(np.array(each) for each in found.values() if len(each) > 1)


def _proportions(
    experiments: Sequence[Experiment], levels: Sequence[Sequence[Any]], outputs: Sequence[str]
) -> tuple[Floats, Floats | None]:
    """Return mean variances by output, and √proportions (n,) of samples (None: 1)."""
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
