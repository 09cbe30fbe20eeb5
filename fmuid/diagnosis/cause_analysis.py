"""Analysis of causes: linearize, test and rank, again at the named cause, until the name is stable."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.diagnosis.baseline_statistics import BaselineStatistics, information_of, structure_of
from fmuid.diagnosis.cause_ranking import SETTINGS as CAUSE_RANKING
from fmuid.diagnosis.cause_ranking import CauseRanking, CauseSet, estimate_sizes, log_odds, name
from fmuid.diagnosis.cause_results import ChangeEvidence, explanations, score
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import Cause, CauseKind, ChangeParameterSet
from fmuid.diagnosis.change_detection import MinPDistribution, fit
from fmuid.diagnosis.information_matrix import (
    ChangePrior,
    InformationMatrix,
    ScoreStatistics,
    Whitening,
    is_determined,
)
from fmuid.diagnosis.linearized_machine import LinearizedMachine, residual_and_columns, residual_of
from fmuid.diagnosis.noise_ratios import NoiseChange, NoiseRatios, is_white
from fmuid.diagnosis.rule import MODEL_ERROR
from fmuid.diagnosis.unexplained_residual import (
    NOTHING_LEFT,
    UnexplainedResidual,
)
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.errors import SimulationError


@dataclass(frozen=True)
class AnalysisSettings:
    """Numbers of the analysis."""

    name_steps: int = 10  # linearizations at sizes of causes
    noise_steps: int = 3  # examinations beside larger noise, of which limited innovations show a part
    settled: float = 0.1  # standard deviations; sizes that move by less have settled
    tolerated: float = 3.0  # the largest error of known faults over κ: three standard deviations


SETTINGS = AnalysisSettings()


@dataclass(frozen=True, eq=False)
class Linearization:
    """Statistics of records, linearized at a point."""

    point: Floats  # (N,)
    said: InformationMatrix  # on all coordinates, relative to the healthy ones
    raw: ScoreStatistics
    news: ScoreStatistics  # the same, tempered by the scatter of healthy records
    causes: tuple[Cause, ...]  # those that the records determine beside all that may change
    whitening: Whitening


@dataclass(frozen=True, eq=False)
class Examination:
    """Result of the analysis of records."""

    coordinates: ChangeParameterSet
    evidence: ChangeEvidence
    naming: CauseRanking  # sizes in the order of each explanation's coordinates
    at: Linearization  # the last one
    estimate: ChangePrior  # all coordinates relative to the healthy ones, beside the named causes
    residuals: tuple[Floats, Floats]  # (K, n_outputs) of the first record, without and with the named causes
    white: Mapping[str, Floats]  # (n,) by output, of all records, whitened, with the named causes
    limit: float  # of the smallest probability, at the level


def examine(
    machines: Sequence[LinearizedMachine],
    healthy: BaselineStatistics,
    coordinates: ChangeParameterSet,
    level: float,
    model_error: float = MODEL_ERROR,
) -> Examination:
    """Return the changes in records of one machine at a false-alarm level; κ is `model_error`.

    Beside healthy records, outputs with more noise than theirs have it in a second examination.
    """
    work = _CauseAnalyzer(machines, healthy, coordinates, level, model_error)
    found = _examined(work)
    if healthy.noise is None:
        return found
    share = UNEXPLAINED_RESIDUAL.level_share / len(work.factors)
    for _ in range(SETTINGS.noise_steps):
        larger = {name: new.ratio for name, new in work.noise_of(found).items() if new.is_larger(share * level)}
        if not larger:
            break
        work = replace(work, noise={name: old * larger.get(name, 1.0) for name, old in work.factors.items()})
        found = _examined(work)
    whole = {name: values * math.sqrt(work.factors[name]) for name, values in found.white.items()}
    each = work.noise_of(replace(found, white=whole))
    louder = {name: is_white(found.white[name], level) for name, new in each.items() if new.is_larger(share * level)}
    return replace(found, evidence=found.evidence.with_noise(each, louder, share))


def _examined(work: _CauseAnalyzer) -> Examination:
    """Return the changes in records beside some noise."""
    coordinates, level, model_error = work.coordinates, work.level, work.model_error
    at = work.at(coordinates.healthy)
    for _ in range(CAUSES.null_steps):
        target = work.sound_point(at)
        if at.said.curvature(target - at.point, coordinates.magnitude) < CAUSES.close:
            break
        at = work.at(coordinates.toward(at.point, target))
    chance, null, steady = MinPDistribution.of(at.news, at.causes), at, True
    naming = name(at.news, at.causes, level, chance=chance, model_error=model_error)
    if naming.named:
        naming, at, steady = work.settled(naming, at, chance)

    lead = naming.named[0] if naming.named else None
    own = [] if lead is None else list(map(coordinates.base, lead.causes))
    white = work.white_residual(at, work.sound_point(at) if lead is None else work.named_point(lead, at, own))
    evidence = ChangeEvidence(
        naming.probability,
        naming.alarm,
        explanations(naming.named, coordinates),
        tuple(score(_strongest(own, at.news), at.news, at.causes, coordinates) for own in coordinates.by_name.values()),
        model_error,
        naming.temper,
        work.ratio(white),
        work.ratio(work.white_residual(null, null.point)),
        sum(map(len, white.values())),
        steady,
        work.remainder(at, naming),
        work.healthy.basis,
    )
    first = work.machines[0]
    residuals = [residual_of(first.experiment, first.outputs(point)) for point in (null.point, at.point)]
    estimate = work.estimate(at, naming)
    return Examination(
        coordinates, evidence, naming, at, estimate, (residuals[0], residuals[1]), white, chance.limit(level)
    )


def error_of(
    trial: LinearizedMachine, healthy: BaselineStatistics, coordinates: ChangeParameterSet, name: str, level: float
) -> float:
    """Return κ by a record with one known cause: √(D₂|₁/D₁)/3; NaN without a change."""
    variants = coordinates.by_name[name]
    found = examine([trial], healthy, replace(coordinates, causes=variants), level, model_error=0.0)
    if not found.naming.alarm:
        return math.nan
    news = found.at.news
    cause = _strongest(variants, news)
    plain, own = replace(cause, sign=0), fit(news, (cause,)).statistic
    others = [replace(each, sign=0) for each in coordinates.causes if each.name != name]
    left = [fit(news, (plain, other)).statistic - own - len(other.columns) for other in others]
    return math.sqrt(max(0.0, *left) / own) / SETTINGS.tolerated if left else 0.0


def _strongest(variants: Sequence[Cause], news: ScoreStatistics) -> Cause:
    """Return the variant of a cause that explains most."""
    return max(variants, key=lambda each: fit(news, (each,)).statistic)


@dataclass(frozen=True, eq=False)
class _CauseAnalyzer:
    """Steps of an examination."""

    machines: Sequence[LinearizedMachine]
    healthy: BaselineStatistics
    coordinates: ChangeParameterSet
    level: float
    model_error: float
    noise: Mapping[str, float] = field(default_factory=dict)  # variance over the healthy one, by output; default 1

    @cached_property
    def factors(self) -> dict[str, float]:
        return {**dict.fromkeys(self.healthy.whitening.models, 1.0), **self.noise}

    @cached_property
    def whitening(self) -> Whitening:
        return self.healthy.whitening.louder(self.factors) if self.noise else self.healthy.whitening

    @cached_property
    def known(self) -> ChangePrior:
        return self.healthy.known.drifting(self.healthy.drift)

    def at_details(self, point: Floats) -> ChangePrior:
        """Return what is known with the details of a point: other causes must not change those of a fault."""
        mean, covariance = self.known.mean.copy(), self.known.covariance.copy()
        details = self.coordinates.details
        mean[details] = (point - self.coordinates.healthy)[details]
        covariance[details], covariance[:, details] = 0.0, 0.0
        return ChangePrior(mean, covariance)

    def judged(self, raw: ScoreStatistics) -> ScoreStatistics:
        """Return statistics tempered by the scatter of healthy records."""
        return raw if self.healthy.population is None else self.healthy.population.judged(raw)

    def at(self, point: Floats) -> Linearization:
        """Return the statistics of the records, linearized at a point (N,)."""
        whitening, healthy = self.whitening, self.coordinates.healthy
        first, *others = (information_of(machine, whitening, point, healthy) for machine in self.machines)
        said = sum(others, start=first)
        raw = ScoreStatistics.of(said, self.at_details(point))
        news = self.judged(raw)
        causes = (each for each in self.coordinates.causes if is_determined(news, said, each.columns))
        return Linearization(point, said, raw, news, tuple(causes), whitening)

    def null(self, news: ScoreStatistics, new: Floats | None = None) -> Floats:
        """Return all coordinates beside new changes (N,), relative to the healthy ones."""
        score = news.score if new is None else news.score - news.information @ new
        return np.asarray(self.known.mean + self.known.covariance @ score)

    def estimate(self, at: Linearization, naming: CauseRanking) -> ChangePrior:
        """Return the estimate beside the named causes, relative to the healthy machine."""
        new, columns, spread = np.zeros(at.point.size), list[int](), np.zeros((0, 0))
        if naming.named:
            columns, spread = naming.named[0].columns, naming.named[0].fit.covariance
            new[columns] = naming.named[0].fit.sizes
        shared = self.known.covariance @ at.raw.information[:, columns]
        covariance = self.known.after_also(at.said).covariance
        return ChangePrior(self.null(at.raw, new), covariance + shared @ spread @ shared.T)

    def white_residual(self, at: Linearization, point: Floats) -> dict[str, Floats]:
        """Return the whitened residual (n,) by output at a point, linearized."""
        parts: dict[str, list[Floats]] = {}
        for machine in self.machines:
            columns = residual_and_columns(machine, at.point)
            for output, _, values in at.whitening.of_outputs(machine.experiment, columns):
                parts.setdefault(output, []).append(values @ np.append(1.0, at.point - point))
        return {output: np.concatenate(each) for output, each in parts.items()}

    def noise_of(self, found: Examination) -> dict[str, NoiseChange]:
        """Compare the noise of each output with that of healthy records."""
        assert self.healthy.noise is not None
        new = NoiseRatios.of(found.white, self.healthy.whitening)
        return dict(zip(self.factors, self.healthy.noise.compared(new, found.naming.temper), strict=True))

    def ratio(self, white: Mapping[str, Floats]) -> float:
        """Return the variance of a whitened residual over healthy noise."""
        squares = sum(self.factors[name] * float(values @ values) for name, values in white.items())
        return squares / sum(map(len, white.values()))

    def remainder(self, at: Linearization, naming: CauseRanking) -> UnexplainedResidual:
        """Return the structure beside what is known and the named causes."""
        if self.healthy.structure is None:
            return NOTHING_LEFT
        named = [self.coordinates.base(cause) for one in naming.named[:1] for cause in one.causes]
        known = self.known.drifting(self.coordinates.free(named))
        return self.healthy.structure.test(structure_of(self.machines, at.whitening, at.point), known, naming.temper)

    def sound_point(self, at: Linearization) -> Floats:
        """Return the point (N,) without causes."""
        return self.coordinates.without_faults(self.coordinates.healthy + self.null(at.raw))

    def named_point(self, lead: CauseSet, at: Linearization, before: Collection[Cause]) -> Floats:
        """Return the point (N,) of the named causes; other faults are not there.

        Details are those estimated where their cause was named before, else of the best variant.
        """
        coordinates, new, known = self.coordinates, np.zeros(at.point.size), self.coordinates.healthy.copy()
        named = [i for cause in lead.causes for i in coordinates.base(cause).columns]
        new[named] = lead.fit.sizes
        estimate = known + self.null(ScoreStatistics.of(at.said, self.known), new)
        for cause in lead.causes:
            fault, base = (coordinates.each[each.columns[0]].fault for each in (cause, coordinates.base(cause)))
            for i in coordinates.of(CauseKind.DETAIL, fault=base) if base else ():
                of = coordinates.each[i]
                value = estimate[i] if cause in before else float(coordinates.faults[fault].values[of.variable])
                known[i] = np.clip(value, *coordinates.limits(of))
        point = coordinates.without_faults(estimate, named)
        point[coordinates.details] = known[coordinates.details]
        return point + new

    def ranked(self, own: _OwnPoint, chance: MinPDistribution, without: Container[tuple[str, ...]]) -> CauseRanking:
        """Return the ranking where some causes are linearized at their sizes."""
        # their details are coordinates there, and need no variants
        causes = [each for each in own.at.causes if own.bases.get(each.name, each) == each]
        found = name(own.at.news, causes, self.level, chance=chance, model_error=self.model_error, without=without)
        for first in found.named[:1]:
            if any(self.coordinates.base(cause) in own.bases.values() for cause in first.causes):
                first = replace(first, fit=estimate_sizes(own.whole, first.causes, self.model_error))
                found = replace(found, named=(first, *found.named[1:]))
        return found

    def own_point(self, lead: CauseSet, at: Linearization, before: Collection[Cause]) -> _OwnPoint:
        """Return the records linearized at the sizes of some causes."""
        there = self.at(self.named_point(lead, at, before))
        bases = {cause.name: self.coordinates.base(cause) for cause in lead.causes}
        return _OwnPoint(there, self.judged(ScoreStatistics.of(there.said, self.known)), bases)

    def settled(
        self, naming: CauseRanking, at: Linearization, chance: MinPDistribution
    ) -> tuple[CauseRanking, Linearization, bool]:
        """Linearize at each named cause; return name, linearization at the best one, and whether its name stays.

        Large causes explain more where others are linearized than at their own size: that one decides.
        """
        tried, done = dict[tuple[str, ...], _OwnPoint](), set[tuple[str, ...]]()
        best, before, temper = naming.named[0].names, list[Cause](), naming.temper
        for _ in range(SETTINGS.name_steps):
            lead = next((each for each in naming.named if each.names not in done), None)
            if lead is None:
                break
            try:
                tried[lead.names] = self.own_point(lead, at, before)
            except SimulationError:  # too large a step for the model: what was reached before stays
                done.add(lead.names)
                continue
            evidence = {names: own.evidence(temper) for names, own in tried.items()}
            best = max(evidence, key=lambda names: evidence[names])
            least = evidence[best] - math.log(CAUSE_RANKING.odds)
            found = self.ranked(tried[best], chance, {names for names in tried if evidence[names] < least})
            if not found.named:  # large at the healthy machine, and none where it was said to be
                break
            naming, at, before = found, tried[best].at, list(tried[best].bases.values())
            again = [each.fit for each in found.named if each.names == lead.names == best]
            if lead.names != best or any(each.moved(lead.fit) < SETTINGS.settled for each in again):
                done.add(lead.names)
        return naming, at, naming.named[0].names == best


@dataclass(frozen=True, eq=False)
class _OwnPoint:
    """Records linearized at the sizes of some causes."""

    at: Linearization
    whole: ScoreStatistics  # with the details of faults unknown
    bases: Mapping[str, Cause]  # the causes, with their details as coordinates

    def evidence(self, temper: float) -> float:
        """Return the log evidence of the causes, divided for the models' error."""
        whole = self.whole.tempered(temper)
        return log_odds(whole, list(self.bases.values())) - 0.5 * whole.squares
