"""What a run says and leaves behind: words and numbers for people, and the files of the output folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import ParameterSet
from fmuid.display_mixins import PlotMixin
from fmuid.errors import InputError
from fmuid.estimation import Result, TerminationReason, optima_table
from fmuid.files import file_name, write_json, write_table
from fmuid.identification import Assessment
from fmuid.reports.downsampling import evenly
from fmuid.reports.messages.prior_and_data import reading_words
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import dropout_words, ending, remarks
from fmuid.reports.messages.uncertainty import uncertainty_words
from fmuid.reports.preprocessing import PreprocessedTable
from fmuid.simulation import OutputFit, fit_of

if TYPE_CHECKING:
    from fmuid.data import Experiment
    from fmuid.identification import CostMap, Posterior
    from fmuid.models import System

# Tables that a run may write: those of an earlier run would be taken for this one's.
_TABLES = (
    *("trace.csv", "rounds.csv", "fit.csv", "diagnostics.csv", "correlations.csv", "reading.csv", "optima.csv"),
    *("preparation.csv", "profiles.csv", "posterior.csv", "walkers.csv", "map-*.csv"),
)
# Of the paths of a sampling: more cannot be told apart.
MOST_WALKERS, MOST_STEPS = 24, 200


def result_fits(system: System, experiments: Sequence[Experiment], result: Result) -> tuple[OutputFit, ...]:
    """Return the fits at the estimate, one an experiment."""
    return tuple(
        fit_of(system, experiment, frame[[f"simulated.{name}" for name in experiment.output_names]].to_numpy())
        for experiment, frame in zip(experiments, result.fit, strict=True)
    )


def resumed_start(path: Path, parameters: ParameterSet) -> Floats:
    """Return the estimates of an earlier ``result.json`` as a start (N,); parameters new since then keep their own.

    Raises
    ------
    InputError
        If the file is no result or has none of the parameters.
    """
    earlier = Result.from_json(path)
    shared = [name for name in parameters.names if name in earlier.names]
    if not shared:
        raise InputError(
            f"{path} is of another study: its parameters are {', '.join(earlier.names)}, "
            f"not {', '.join(parameters.names)}"
        )
    start = parameters.start.copy()
    for name in shared:
        start[parameters.index(name)] = earlier[name]
    return start


def stacked(names: Sequence[str], frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the experiments' frames below each other, after a column ``experiment`` where there are several."""
    if len(frames) == 1:
        return frames[0]
    marked = [frame.assign(experiment=name) for name, frame in zip(names, frames, strict=True)]
    together = pd.concat(marked, ignore_index=True)
    return together[["experiment", *together.columns.drop("experiment")]]


def at_minimum(result: Result) -> bool:
    """Return whether a search has ended where more can be asked of the criterion, sure or not."""
    return result.converged or result.outcome is TerminationReason.UNDETERMINED


@dataclass(frozen=True, eq=False)
class IdentificationRun(PlotMixin):
    """All that a run has found so far.

    Attributes
    ----------
    result : Result
    fits : tuple of OutputFit
        One an experiment.
    assessment : Assessment
        What the result is worth.
    files : tuple of Path
        Those that were written, each once.
    study : mapping or None
        By which study the result was made (`fmuid.runs.origin_of`), for ``result.json``.
    origin : mapping or None
        What it was made from (`fmuid.reports.provenance.made_from`), likewise.
    prepared : tuple of PreprocessedTable
        What was done with tables first, where something was.
    dropouts : mapping of str to tuple of float
        Experiments whose tables lack rows that the inputs go on over: the times before, s.

    Examples
    --------
    >>> found = fmuid.run_study(fmuid.Study.of(fmuid.datasets.coil().study, "coil.toml"))
    >>> found.succeeded, list(found.estimates["parameter"])
    (True, ['R', 'L'])
    """

    result: Result
    fits: tuple[OutputFit, ...]
    assessment: Assessment
    files: tuple[Path, ...] = ()
    study: Mapping[str, Any] | None = None
    origin: Mapping[str, Any] | None = None
    prepared: tuple[PreprocessedTable, ...] = ()
    dropouts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

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
    def remarks(self) -> tuple[str, ...]:
        """The sentences on tables and estimates that the numbers do not show by themselves."""
        return *(dropout_words(*each) for each in self.dropouts.items()), *remarks(self.result)

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

    def to_json_dict(self) -> dict[str, Any]:
        """Return the content of ``result.json``."""
        content = {"words": [ending(self.result), *self.remarks], **self.result.to_json_dict()}
        content |= {"level": self.assessment.level, "experiments": self._experiments()}
        content |= self.origin or {}
        residuals, reading = self.assessment.residuals, self.assessment.prior_and_data
        if residuals is not None:
            words = list(residual_words(residuals, self.output_units))
            content["diagnostics"] = {"words": words, **residuals.to_json_dict()}
        if reading is not None:
            content["consistency"] = {
                "words": list(reading_words(reading, self.output_units)),
                **reading.to_json_dict(),
            }
        if self.result.optima:
            content["optima"] = [
                {key: getattr(optimum, key) for key in ("criterion", "hits", "converged", "outcome")}
                | {"parameters": dict(zip(self.result.names, optimum.theta, strict=True))}
                for optimum in self.result.optima
            ]
        if self.assessment.is_explored:
            said = uncertainty_words(self.assessment)
            content |= self.assessment.to_json_dict()
            content |= {"uncertainty": {"words": list(said), "succeeded": self.assessment.succeeded}}
            content["words"] += said
        if self.study is not None:
            content["study"] = {**content.get("study", {}), **self.study}
        return content

    def _experiments(self) -> list[dict[str, Any]]:
        done = {each.experiment: {"preparation": each.words, "columns": each.units} for each in self.prepared}
        lost = {name: {"dropouts": list(times)} for name, times in self.dropouts.items()}
        return [_experiment(fit) | done.get(fit.experiment, {}) | lost.get(fit.experiment, {}) for fit in self.fits]

    def maps(self) -> dict[str, CostMap]:
        """Return the maps of the criterion by the names of their files."""
        return {f"map-{file_name('-'.join(chart.names))}": chart for chart in self.assessment.maps}

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the CSV tables by their names."""
        result = self.result
        found = {
            "estimates": self.estimates,
            "trace": result.trace,
            "rounds": result.rounds,
            "fit": stacked([fit.experiment for fit in self.fits], result.fit),
        }
        checks = self.assessment
        if checks.residuals is not None:
            found |= {"diagnostics": checks.residuals.table, "correlations": checks.residuals.correlations}
        if self.has_prior and checks.prior_and_data is not None:
            found["reading"] = checks.prior_and_data.table
        if result.optima:
            found["optima"] = self.optima
        if changed := [each.table for each in self.prepared if len(each.table)]:
            found["preparation"] = pd.concat(changed, ignore_index=True)
        found |= {name: chart.table for name, chart in self.maps().items()}
        found |= {"profiles": checks.profile_table} if checks.profiles else {}
        if (posterior := checks.posterior) is not None:
            found |= {"posterior": posterior.table, "walkers": _paths(posterior)}
        return found

    def write(self, folder: Path) -> list[Path]:
        """Write ``result.json`` and the tables, and return their paths.

        Parameters
        ----------
        folder
            Made where needed; files of an earlier run are replaced.
        """
        return _write(folder, self.to_json_dict(), self.tables())


def _experiment(fit: OutputFit) -> dict[str, Any]:
    """Return what ``fit.csv`` does not say: units, the first time that counts, s, fit (%) and RMSE of each output."""
    counted = np.asarray(fit.counted.any(axis=1))
    first = float(fit.times[int(counted.argmax())]) if counted.any() else None
    units = dict(zip(fit.outputs, fit.units, strict=True))
    scores = {
        "fit": dict(zip(fit.outputs, fit.fit, strict=True)),
        "rmse": dict(zip(fit.outputs, fit.rmse, strict=True)),
    }
    return {"name": fit.experiment, "outputs": units, "counted_from": first, **scores}


def _paths(posterior: Posterior) -> pd.DataFrame:
    """Return the steps of some walkers, those before the samples too, thinned."""
    steps = evenly(len(posterior.chain), MOST_STEPS)
    some = posterior.chain[steps, :MOST_WALKERS].transpose(1, 0, 2)
    walker, step = np.meshgrid(np.arange(1, len(some) + 1), steps + 1, indexing="ij")
    first = {"walker": walker.ravel(), "step": step.ravel(), "counted": step.ravel() > posterior.burn}
    return pd.DataFrame(first | dict(zip(posterior.names, some.reshape(-1, some.shape[2]).T, strict=True)))


def write_point(folder: Path, result: Result) -> list[Path]:
    """Write what is known of a point where a search was interrupted, its values, and return the paths."""
    return _write(folder, result.to_json_dict(), {"estimates": result.to_frame().reset_index()})


def _write(folder: Path, content: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> list[Path]:
    path = write_json(folder / "result.json", content)
    written = [path, *(write_table(folder / f"{name}.csv", frame) for name, frame in tables.items())]
    for old in (old for pattern in _TABLES for old in folder.glob(pattern)):
        if old not in written:
            old.unlink()
    return written
