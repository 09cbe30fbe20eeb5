"""Conventions of measured responses: signs, and the unit of phases.

A response that fits badly is fitted again with each other convention; the one with which it fits is named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from fmuid.array_types import Floats
from fmuid.data import DEGREE, Experiment, FrequencyExperiment, Response, response_of
from fmuid.errors import FmuidError
from fmuid.estimation import Evaluator, LeastSquares, Marquardt, Result
from fmuid.identification.data_defects import DefectKind
from fmuid.models import System
from fmuid.simulation import fit_of

Changed = Callable[[Sequence[Experiment]], LeastSquares]
"""Problem with other experiments."""


@dataclass(frozen=True)
class ConventionSettings:
    """Limits of the comparison of conventions."""

    poor: float = 50.0  # fit, %, below which other conventions are tried
    better: float = 0.2  # largest relative error with another convention, over that of now


SETTINGS = ConventionSettings()


def find_conventions(
    system: System, experiments: Sequence[Experiment], result: Result, changed: Changed
) -> Iterator[tuple[str, str, str, float]]:
    """Yield responses that fit otherwise: convention, response, experiment and fit, %."""

    def fits_of(experiment: Experiment, simulated: Floats) -> dict[str, float]:
        fit = fit_of(system, experiment, simulated)
        return {response_of(name): each for name, each in zip(fit.outputs, fit.fit, strict=True)}

    def trials(number: int, experiment: FrequencyExperiment, name: str) -> Iterator[tuple[float, str]]:
        for kind, other in _alternatives(experiment, name):
            trial = changed([other if k == number else each for k, each in enumerate(experiments)])
            try:
                found = Marquardt().search(Evaluator(trial))
            except FmuidError:  # such as a model that fails there: no remedy
                continue
            yield fits_of(other, found.fit.simulated[number])[name], kind.value

    for number, experiment in enumerate(experiments):
        if isinstance(experiment, FrequencyExperiment):
            for name, now in fits_of(experiment, result.fit.simulated[number]).items():
                if not now >= SETTINGS.poor:
                    fit, kind = max(trials(number, experiment, name), default=(-math.inf, ""))
                    if 100.0 - fit <= SETTINGS.better * (100.0 - now):
                        yield kind, name, experiment.name, fit


def _alternatives(experiment: FrequencyExperiment, name: str) -> Iterator[tuple[DefectKind, FrequencyExperiment]]:
    own = experiment.responses[name]

    def as_(response: Response) -> FrequencyExperiment:
        return replace(experiment, outputs=(), responses={**experiment.responses, name: response})

    if {"imaginary", "phase"} & own.columns.keys():
        yield DefectKind.CONJUGATE, as_(replace(own, conjugate=not own.conjugate))
    if set(own.columns) - {"magnitude", "decibel"}:
        yield DefectKind.SIGN, as_(replace(own, of=own.reversed_ratio))
    if own.phase is not None:
        column = experiment.columns[f"{name}.phase"]
        radians = experiment.frame.assign(**{column: experiment.frame[column] / DEGREE})
        yield DefectKind.RADIANS, replace(experiment, outputs=(), frame=radians)
