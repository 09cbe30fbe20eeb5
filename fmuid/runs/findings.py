"""Findings of each command, typed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from fmuid.codec import Layout
from fmuid.display_mixins import PlotMixin
from fmuid.estimation import Result, TerminationReason, Verdict, optima_table
from fmuid.identification import Assessment, ModelError, ResidualStretch, residual_stretch
from fmuid.runs.study_changes import StudyChange
from fmuid.simulation import OutputFit

if TYPE_CHECKING:
    from fmuid.diagnosis import Alarm, BaselineSource, Diagnosis, Rule, SkippedWindow
    from fmuid.identification import ModelComparison, Prediction
    from fmuid.studies import SourceWarning


@dataclass(frozen=True)
class StudySource:
    """Study of a finding.

    Attributes
    ----------
    file : str
        Its name; of an identification its path from the folder of the result.
    digest : str
        SHA-256 of the file.
    text : str
        Text of the file.
    changed : bool
        True if values were replaced, as by ``--set``.
    content : mapping or None
        Its content, so that a result can be used without the file.
    """

    file: str
    digest: str
    text: str
    changed: bool
    content: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Provenance:
    """Origin of findings.

    Attributes
    ----------
    version : str
        Version of fmuid.
    date : str
        ISO 8601, UTC.
    title : str
        Title of the study.
    study : StudySource or None
    files : mapping of str to str
        SHA-256 of each existing model, table and result by its path from the study.
    """

    version: str
    date: str
    title: str = ""
    study: StudySource | None = None
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PreprocessedTable:
    """Preprocessing of the table of an experiment.

    Attributes
    ----------
    experiment : str
    words : mapping
        Settings of ``[experiments.preprocess]`` that are not defaults.
    units : mapping of str to str
        Units of its columns, where the table has them.
    table : DataFrame
        Changed and new columns, thinned for figures: ``experiment``, ``column``, ``stage`` (before or after), ``time``
        (s),
        ``value``.
    """

    experiment: str
    words: Mapping[str, Any]
    units: Mapping[str, str]
    table: pd.DataFrame = field(default_factory=pd.DataFrame)

    json_layout: ClassVar = Layout(omitted={"table"})


def at_minimum(result: Result) -> bool:
    """Return True if the optimization ended at a minimum."""
    return result.converged or result.outcome is TerminationReason.UNDETERMINED


@dataclass(frozen=True, eq=False)
class IdentificationRun(PlotMixin):
    """Findings of an identification so far.

    Attributes
    ----------
    result : Result
    fits : tuple of OutputFit
        One an experiment.
    assessment : Assessment
        Checks of the result; empty if the search was interrupted before any fit.
    files : tuple of Path
        Written files, each once.
    origin : Provenance or None
    prepared : tuple of PreprocessedTable
        Tables that were preprocessed.
    dropouts : mapping of str to tuple of float
        Experiments with missing rows: the times before, s.
    change : StudyChange or None
        The change of the study that should gain most.

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
    change: StudyChange | None = None

    json_layout: ClassVar = Layout(omitted={"files"}, inlined={"result"}, derived=("intervals", "residual_stretches"))

    def __repr__(self) -> str:
        return f"Findings({self.result!r})"

    @property
    def succeeded(self) -> bool:
        """True if result and assessment passed."""
        return self.result.converged and self.assessment.succeeded

    @property
    def has_prior(self) -> bool:
        """True if any parameter has a prior."""
        return bool(np.isfinite(self.result.estimates.prior_mean).any())

    @property
    def intervals(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Intervals of each parameter by kind: local, profile, posterior; NaN without one."""
        table = self.assessment.intervals(self.result)
        return {
            str(kind): {str(name): (float(low), float(high)) for name, low, high in table[kind].itertuples()}
            for kind in dict.fromkeys(table.columns.get_level_values(0))
        }

    @property
    def residual_stretches(self) -> tuple[ResidualStretch, ...]:
        """Short stretches of experiments with half of the squared residual."""
        found = map(residual_stretch, self.fits)
        return tuple(each for each in found if each is not None)

    @property
    def estimates(self) -> pd.DataFrame:
        """The content of ``estimates.csv``."""
        return self.result.to_frame(self.assessment.level).reset_index()

    @property
    def optima(self) -> pd.DataFrame:
        """The content of ``optima.csv``: a row for each optimum of a global search."""
        return optima_table(self.result.names, self.result.history.optima)

    @property
    def unit_of(self) -> dict[str, str | None]:
        """The unit of each parameter."""
        return {name: self.result.estimates.units.get(name) for name in self.result.names}

    @property
    def output_units(self) -> dict[str, str | None]:
        """The unit of each output."""
        return {output: unit for fit in self.fits for output, unit in zip(fit.outputs, fit.units, strict=True)}


@dataclass(frozen=True, eq=False)
class DiagnosisRun:
    """Findings of a diagnosis."""

    diagnosis: Diagnosis
    units: Mapping[str, str | None] = field(default_factory=dict)  # of each output
    prepared: tuple[PreprocessedTable, ...] = ()
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()  # written files

    json_layout: ClassVar = Layout(omitted={"files"}, inlined={"diagnosis"}, types={"Diagnosis": "fmuid.diagnosis"})

    @property
    def healthy(self) -> bool:
        """True if there is no fault."""
        return self.diagnosis.kind == "healthy"


@dataclass(frozen=True, eq=False)
class MonitoringRun:
    """Findings of monitoring so far."""

    table: pd.DataFrame  # a row a window, as in ``monitoring.csv``
    alarms: tuple[Alarm, ...]
    rule: Rule
    undetermined: tuple[str, ...]  # faults that no window determines
    sizes: Mapping[str, tuple[str, ...]]  # columns of the table that are sizes of each fault
    common: tuple[str, ...]  # columns that are parameters of the healthy machine
    units: Mapping[str, str]  # of these columns
    basis: BaselineSource  # source of the baseline
    gaps: tuple[SkippedWindow, ...] = ()  # skipped windows; not kept in a file
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()  # written files

    json_layout: ClassVar = Layout(
        omitted={"table", "gaps", "files"},
        types=dict.fromkeys(("Alarm", "Rule", "BaselineSource", "SkippedWindow"), "fmuid.diagnosis"),
    )

    @property
    def healthy(self) -> bool:
        """True if there is no alarm, and no fault stays undetermined."""
        return not self.alarms and not self.undetermined


@dataclass(frozen=True, eq=False)
class Fold:
    """A part of a cross-validation: its experiments, and the result of the other parts."""

    result: Result
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PredictionRun:
    """Predictions of a result."""

    predictions: tuple[Prediction, ...]  # one a record
    folds: tuple[Fold, ...] = ()  # parts of a cross-validation; empty otherwise
    notes: tuple[SourceWarning, ...] = ()  # warnings on the result; not kept in a file
    seen: tuple[str, ...] = ()  # records that the result was made from
    corrected: Mapping[str, float] = field(default_factory=dict)  # fixed values, as the result has corrected them
    freed: tuple[ModelError, ...] = ()  # other freed errors of the result, which predictions do not have
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()  # written files

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
    """Prediction of common tables: RMSE of each output, and mean fit.

    `fit`, %, is 100 less the root mean square of each fit's distance to 100 over outputs and records. Outputs that are
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
    """Findings of a comparison."""

    comparison: ModelComparison | None  # by likelihoods; None where compared on common tables alone
    # By the name of the result; empty without common tables.
    tables: Mapping[str, CommonTables] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)  # of the outputs of the common tables
    apart: str = ""  # reason why likelihoods were not compared, "" where they were
    estimates: tuple[ComparedEstimate, ...] = ()
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)  # of each result
    origin: Provenance | None = None
    files: tuple[Path, ...] = ()  # written files

    json_layout: ClassVar = Layout(omitted={"files"}, types={"ModelComparison": "fmuid.identification"})

    @property
    def table(self) -> pd.DataFrame:
        """A row for each result: information criteria, RMSE of each output, mean fit, %."""
        rows: dict[str, dict[str, Any]] = {}
        for rank in () if self.comparison is None else self.comparison.ranks:
            rows[rank.name] = dict(vars(rank))
        for name, found in self.tables.items():
            rows[name] = rows.get(name, {"name": name}) | {f"rmse.{key}": rmse for key, rmse in found.rmse.items()}
            rows[name]["fit"] = found.fit
        for name, verdict in self.verdicts.items():
            rows[name]["verdict"] = verdict.grade.value
        return pd.DataFrame(rows.values())
