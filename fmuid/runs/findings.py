"""What each command finds, typed: what a run yields, a folder keeps, and reports show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from fmuid.codec import Layout
from fmuid.display_mixins import PlotMixin
from fmuid.estimation import Result, TerminationReason, optima_table
from fmuid.identification import Assessment
from fmuid.simulation import OutputFit

if TYPE_CHECKING:
    from fmuid.diagnosis import Alarm, BaselineSource, Diagnosis, Rule, SkippedWindow
    from fmuid.identification import (
        ModelComparison,
        Prediction,
    )
    from fmuid.studies import SourceWarning


@dataclass(frozen=True)
class StudySource:
    """The study that something was found with.

    Attributes
    ----------
    file : str
        Its name; of an identification its path from the folder of the result.
    digest : str
        SHA-256 of the file.
    text : str
        Of the file.
    changed : bool
        Whether values of it were replaced, as by ``--set``.
    content : mapping or None
        With which it was run, so that a result can be used without it.
    """

    file: str
    digest: str
    text: str
    changed: bool
    content: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Provenance:
    """Where findings come from.

    Attributes
    ----------
    version : str
        Of fmuid.
    date : str
        ISO 8601, UTC.
    title : str
        Of the study.
    study : StudySource or None
    files : mapping of str to str
        SHA-256 of each model, table and result by its path from the study; of files that are gone nothing.
    """

    version: str
    date: str
    title: str = ""
    study: StudySource | None = None
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PreprocessedTable:
    """What was done with the table of an experiment.

    Attributes
    ----------
    experiment : str
    words : mapping
        Those of ``[experiments.prepare]`` that are not its defaults.
    units : mapping of str to str
        Of its columns, where the table says them.
    table : DataFrame
        The columns that it changed or made: ``experiment``, ``column``, ``stage`` (before or after), ``time`` (s) and
        ``value``, thinned for figures; a column that it made has nothing before.
    """

    experiment: str
    words: Mapping[str, Any]
    units: Mapping[str, str]
    table: pd.DataFrame = field(default_factory=pd.DataFrame)

    json_layout: ClassVar = Layout(omitted={"table"})


def at_minimum(result: Result) -> bool:
    """Return whether a search has ended where more can be asked of the criterion, sure or not."""
    return result.converged or result.outcome is TerminationReason.UNDETERMINED


@dataclass(frozen=True, eq=False)
class IdentificationRun(PlotMixin):
    """All that an identification has found so far.

    Attributes
    ----------
    result : Result
    fits : tuple of OutputFit
        One an experiment.
    assessment : Assessment
        What the result is worth; of a search that was interrupted before any fit nothing.
    files : tuple of Path
        Those that were written, each once.
    origin : Provenance or None
        What it was made from, where it was written.
    prepared : tuple of PreprocessedTable
        What was done with tables first, where something was.
    dropouts : mapping of str to tuple of float
        Experiments whose tables lack rows that the inputs go on over: the times before, s.

    Examples
    --------
    >>> found = fmuid.run(fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml"))
    >>> found.succeeded, list(found.estimates["parameter"])
    (True, ['R', 'L'])
    """

    result: Result
    fits: tuple[OutputFit, ...] = ()
    assessment: Assessment = field(default_factory=Assessment)
    files: tuple[Path, ...] = ()
    origin: Provenance | None = None
    prepared: tuple[PreprocessedTable, ...] = ()
    dropouts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    json_layout: ClassVar = Layout(
        omitted={"files"},
        inlined={"result"},
        derived=("intervals",),
        parts={"fit": {"experiments": "fits"}},
    )

    def __repr__(self) -> str:
        return f"Findings({self.result!r})"

    @property
    def succeeded(self) -> bool:
        """Whether all that was asked for is there and can be trusted."""
        return self.result.converged and self.assessment.succeeded

    @property
    def has_prior(self) -> bool:
        """Whether any parameter has a prior."""
        return bool(np.isfinite(self.result.prior_mean).any())

    @property
    def intervals(self) -> dict[str, dict[str, tuple[float, float]]]:
        """The ends of the interval of each parameter by its kind: local, profile, posterior, as far as there are any.

        NaN where there is none.
        """
        table = self.assessment.intervals(self.result)
        return {
            str(kind): {str(name): (float(low), float(high)) for name, low, high in table[kind].itertuples()}
            for kind in dict.fromkeys(table.columns.get_level_values(0))
        }

    @property
    def estimates(self) -> pd.DataFrame:
        """The content of ``estimates.csv``."""
        return self.result.to_frame(self.assessment.level).reset_index()

    @property
    def optima(self) -> pd.DataFrame:
        """The content of ``optima.csv``: a row for each optimum that a search of the whole box has found."""
        return optima_table(self.result.names, self.result.optima)

    @property
    def unit_of(self) -> dict[str, str | None]:
        """The unit of each parameter."""
        return {name: self.result.units.get(name) for name in self.result.names}

    @property
    def output_units(self) -> dict[str, str | None]:
        """The unit of each output."""
        return {output: unit for fit in self.fits for output, unit in zip(fit.outputs, fit.units, strict=True)}


@dataclass(frozen=True, eq=False)
class DiagnosisRun:
    """What a diagnosis has found.

    Attributes
    ----------
    diagnosis : Diagnosis
    units : mapping of str to str
        Of each output.
    prepared : tuple of PreprocessedTable
    origin : Provenance or None
    files : tuple of Path
        Those that were written.
    """

    diagnosis: Diagnosis
    units: Mapping[str, str | None] = field(default_factory=dict)
    prepared: tuple[PreprocessedTable, ...] = ()
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()

    json_layout: ClassVar = Layout(omitted={"files"}, inlined={"diagnosis"}, types={"Diagnosis": "fmuid.diagnosis"})

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong."""
        return self.diagnosis.kind == "healthy"


@dataclass(frozen=True, eq=False)
class MonitoringRun:
    """What monitoring has found so far.

    Attributes
    ----------
    table : DataFrame
        A row a window, as in ``monitoring.csv``.
    alarms : tuple of Alarm
    rule : Rule
    undetermined : tuple of str
        Faults that no window determines.
    sizes : mapping of str to tuple of str
        Columns of the table that are sizes of each fault.
    common : tuple of str
        Columns that are parameters of the healthy machine.
    units : mapping of str to str
        Of these columns.
    basis : BaselineSource
        Where the healthy machine is from.
    gaps : tuple of SkippedWindow
        Windows that were left out; not kept in a file.
    prepared : tuple of PreprocessedTable
        Of the first records.
    origin : Provenance or None
    files : tuple of Path
        Those that were written.
    """

    table: pd.DataFrame
    alarms: tuple[Alarm, ...]
    rule: Rule
    undetermined: tuple[str, ...]
    sizes: Mapping[str, tuple[str, ...]]
    common: tuple[str, ...]
    units: Mapping[str, str]
    basis: BaselineSource
    gaps: tuple[SkippedWindow, ...] = ()
    prepared: tuple[PreprocessedTable, ...] = ()
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()

    json_layout: ClassVar = Layout(
        omitted={"table", "gaps", "files"},
        types=dict.fromkeys(("Alarm", "Rule", "BaselineSource", "SkippedWindow"), "fmuid.diagnosis"),
    )

    @property
    def healthy(self) -> bool:
        """Whether there is no alarm, and no fault stays open."""
        return not self.alarms and not self.undetermined


@dataclass(frozen=True, eq=False)
class Fold:
    """One part of a cross-validation.

    Attributes
    ----------
    result : Result
        Made from the experiments of the other parts.
    left_out : tuple of str
        The experiments of this one.
    """

    result: Result
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PredictionRun:
    """What a result predicts.

    Attributes
    ----------
    predictions : tuple of Prediction
        One a record.
    folds : tuple of Fold
        Of a cross-validation, whose predictions these are; empty otherwise.
    notes : tuple of SourceWarning
        What is to be known of the result; not kept in a file.
    seen : tuple of str
        Records that the result was made from.
    origin : Provenance or None
    files : tuple of Path
        Those that were written.
    """

    predictions: tuple[Prediction, ...]
    folds: tuple[Fold, ...] = ()
    notes: tuple[SourceWarning, ...] = ()
    seen: tuple[str, ...] = ()
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()

    json_layout: ClassVar = Layout(
        omitted={"notes", "files"}, types={"Prediction": "fmuid.identification", "SourceWarning": "fmuid.studies"}
    )

    @property
    def correlations(self) -> pd.DataFrame:
        """Correlations of residuals with themselves and with inputs, as `ResidualAnalysis.correlations`."""
        from fmuid.identification import ResidualAnalysis

        return ResidualAnalysis(
            tuple(one for each in self.predictions for one in each.residuals.series), {}
        ).correlations

    @property
    def scores(self) -> pd.DataFrame:
        """The content of ``scores.csv``: a row for each output of each record."""
        return pd.DataFrame(
            {"record": each.fit.experiment, **vars(score), "ratio": score.ratio}
            for each in self.predictions
            for score in each.scores
        )


@dataclass(frozen=True)
class CommonTables:
    """How well a result predicts the tables that it is compared on.

    Attributes
    ----------
    rmse : mapping of str to float
        Of each output over all records.
    fit : float
        Over all outputs and records, %: 100 less the root mean square of what each is below 100. Outputs that are
        constant in a record are left out; NaN where all are.
    """

    rmse: Mapping[str, float]
    fit: float


@dataclass(frozen=True)
class ComparedEstimate:
    """An estimate of one of the results, with its interval of 95 %."""

    result: str
    parameter: str
    unit: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class ComparisonRun:
    """What a comparison has found.

    Attributes
    ----------
    comparison : ModelComparison or None
        By their likelihoods; None where they were compared on common tables alone.
    tables : mapping of str to CommonTables
        By the name of the result; empty without common tables.
    units : mapping of str to str
        Of the outputs of the common tables.
    apart : str
        Why likelihoods were not compared, "" where they were.
    estimates : tuple of ComparedEstimate
    origin : Provenance or None
    files : tuple of Path
        Those that were written.
    """

    comparison: ModelComparison | None
    tables: Mapping[str, CommonTables] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    apart: str = ""
    estimates: tuple[ComparedEstimate, ...] = ()
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()

    json_layout: ClassVar = Layout(omitted={"files"}, types={"ModelComparison": "fmuid.identification"})

    @property
    def table(self) -> pd.DataFrame:
        """A row for each result: criteria, and over the common tables the RMSE of each output and the mean fit, %."""
        rows: dict[str, dict[str, Any]] = {}
        for rank in () if self.comparison is None else self.comparison.ranks:
            rows[rank.name] = dict(vars(rank))
        for name, found in self.tables.items():
            rows[name] = rows.get(name, {"name": name}) | {f"rmse.{key}": rmse for key, rmse in found.rmse.items()}
            rows[name]["fit"] = found.fit
        return pd.DataFrame(rows.values())
