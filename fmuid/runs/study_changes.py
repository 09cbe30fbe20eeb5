"""The study change that gains most, from model errors and residual."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid import codec
from fmuid.estimation import RESULT_SCHEMA
from fmuid.formatting import rounded
from fmuid.identification import Assessment, DirectedTest, Direction, ErrorKind, ResidualStretch
from fmuid.studies import quoted_key, toml_text

if TYPE_CHECKING:
    from fmuid.studies import Study


class ChangeKind(Enum):
    """Kind of a study change; ``change.kind`` in ``result.json``."""

    FREE = "free"  # a fixed parameter
    INTERPOLATION = "interpolation"
    WARMUP = "warmup"
    OFFSET = "offset"  # removed by `computed_columns`


@dataclass(frozen=True)
class StudyChange:
    """Change of a study that should improve the fit.

    Attributes
    ----------
    kind : ChangeKind
    subject : tuple of str
        Parameter, inputs, experiment or output.
    value : str
        New value, or initial guess.
    settings : tuple of str
        Arguments of ``--set``.
    gain : float
        Expected fall of −2 ln L: the squared score.
    """

    kind: ChangeKind
    subject: tuple[str, ...]
    value: str
    settings: tuple[str, ...]
    gain: float


def offered_change(result: Path) -> StudyChange | None:
    """Return the change that a ``result.json`` offers."""
    return codec.read_part(result, RESULT_SCHEMA, "change", StudyChange, "run fmuid identify again")


def best_change(study: Study, found: Assessment, stretches: tuple[ResidualStretch, ...]) -> StudyChange | None:
    """Return the change with the largest expected gain."""
    offered = [*_of_errors(study, found), *_of_stretches(study, stretches)]
    return max(offered, key=lambda each: each.gain, default=None)


def _of_errors(study: Study, found: Assessment) -> Iterator[StudyChange]:
    errors = found.model_errors
    if errors is None:
        return
    for each in (*errors.errors, *errors.freed):
        test = each.test
        gain = test.score**2 if each in errors.errors else (test.size / test.std) ** 2
        for direction in (test.direction, *each.alternatives):
            own = test if direction is test.direction else None
            change = _of_direction(study, direction, own, gain)
            if change is not None:
                yield change
                break


def _of_direction(study: Study, direction: Direction, test: DirectedTest | None, gain: float) -> StudyChange | None:
    """Return the change that removes an error; None without one."""
    match direction.kind:
        case ErrorKind.FIXED:
            name = direction.subject[0]
            setting = f"parameters.{quoted_key(name)}={toml_text({'start': direction.value})}"
            return StudyChange(ChangeKind.FREE, (name,), f"{direction.value:.6g}", (setting,), gain)
        case ErrorKind.INTERPOLATION:
            return _interpolation(study, direction.subject, gain)
        case ErrorKind.OFFSET if test is not None:
            return _offset(study, direction.subject[0], test, gain)
    return None


def _interpolation(study: Study, inputs: tuple[str, ...], gain: float) -> StudyChange | None:
    """Return the other interpolation of inputs."""
    settings, word = [], ""
    for k, each in enumerate(study.experiments):
        own = [name for name in each.inputs if name in inputs]
        given = each.interpolation
        words = dict(given) if isinstance(given, dict) else dict.fromkeys(each.inputs, given)
        before = {words.get(name, "linear") for name in own}
        if not each.in_time or len(before) != 1:
            continue
        word = "zoh" if before == {"linear"} else "linear"
        words |= dict.fromkeys(own, word)
        settings.append(f"experiments.{k}.interpolation={toml_text(word if len(own) == len(each.inputs) else words)}")
    return StudyChange(ChangeKind.INTERPOLATION, inputs, word, tuple(settings), gain) if settings else None


def _offset(study: Study, output: str, test: DirectedTest, gain: float) -> StudyChange | None:
    """Return the column without its offset."""
    settings, value = [], rounded(test.size, test.std)
    for k, each in enumerate(study.experiments):
        column = each.outputs.get(output, "")
        if not column.isidentifier() or not each.in_time or column in each.preprocess.computed_columns:
            return None
        settings.append(f"experiments.{k}.preprocess.computed_columns.{column}={toml_text(f'{column} - ({value})')}")
    return StudyChange(ChangeKind.OFFSET, (output,), value, tuple(settings), gain)


def _of_stretches(study: Study, stretches: tuple[ResidualStretch, ...]) -> Iterator[StudyChange]:
    """Yield a warm-up for each experiment whose residual sits at its beginning."""
    places = {each.name: k for k, each in enumerate(study.experiments)}
    for each in stretches:
        if each.settled > 0.0 and each.experiment in places:
            k = places[each.experiment]
            value = _up(each.settled - float(study.tables[k].times[0]))
            yield StudyChange(
                ChangeKind.WARMUP, (each.experiment,), f"{value:g}", (f"experiments.{k}.warmup={value:g}",), each.excess
            )


def _up(value: float) -> float:
    """Return a time to two digits, not less than it."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit * (1.0 + 1e-9)) * unit
