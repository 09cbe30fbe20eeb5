"""What a run says and leaves behind: words and numbers for people, and the files of the output folder."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.errors import InputError
from fmuid.estimators.marquardt import Status
from fmuid.parameters import ParameterSet
from fmuid.result import Result
from fmuid.uncertainty import LEVEL

if TYPE_CHECKING:
    from fmuid.criterion_map import CriterionMap
    from fmuid.estimators.global_search import GlobalResult
    from fmuid.experiment import Experiment
    from fmuid.reading import Reading
    from fmuid.residuals import Diagnostics
    from fmuid.system import System
    from fmuid.uncertainty import Uncertainty

# Tables that not every run writes: those of an earlier run would be taken for this one's.
_SOMETIMES = ("reading.csv", "optima.csv", "profiles.csv", "posterior.csv", "map-*.csv")


@dataclass(frozen=True, eq=False)
class Fit:
    """Measured against simulated outputs of one experiment.

    Attributes
    ----------
    experiment : str
        Its name.
    times : ndarray (K,)
        Time, s.
    outputs, units : tuple of str
        Output variables and the units of what is compared, those of the table.
    measured, simulated : ndarray (K, n_outputs)
        NaN where an output was not measured.
    counted : ndarray of bool (K, n_outputs)
        The samples that take part in the criterion.
    """

    experiment: str
    times: npt.NDArray[np.float64]
    outputs: tuple[str, ...]
    units: tuple[str | None, ...]
    measured: npt.NDArray[np.float64]
    simulated: npt.NDArray[np.float64]
    counted: npt.NDArray[np.bool_]

    @property
    def misfit(self) -> tuple[float, ...]:
        """‖measured − simulated‖ / ‖measured‖ of each output over the counted samples; NaN without any."""
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable simulation: infinite
            error = np.where(self.counted, self.measured - self.simulated, 0.0)
            size = np.linalg.norm(np.where(self.counted, self.measured, 0.0), axis=0)
            ratios = np.linalg.norm(error, axis=0) / np.where(size > 0, size, np.nan)
        return tuple(float(ratio) for ratio in ratios)

    def simulated_frame(self) -> pd.DataFrame:
        """Return the columns ``time`` and each output."""
        return pd.DataFrame({"time": self.times, **dict(zip(self.outputs, self.simulated.T, strict=True))})


def fit_of(system: System, experiment: Experiment, simulated: npt.NDArray[np.float64]) -> Fit:
    """Set the outputs (K, n_outputs) that a system gives in an experiment beside the measured ones."""
    names = experiment.output_names
    units = tuple(experiment.units.get(name, system.unit(name)) for name in names)
    return Fit(experiment.name, experiment.times, names, units, experiment.output_values, simulated, experiment.counted)


def result_fits(system: System, experiments: Sequence[Experiment], result: Result) -> tuple[Fit, ...]:
    """Return the fits at the estimate, one an experiment."""
    return tuple(
        fit_of(system, experiment, frame[[f"simulated.{name}" for name in experiment.output_names]].to_numpy())
        for experiment, frame in zip(experiments, result.fit, strict=True)
    )


def resumed_start(path: Path, parameters: ParameterSet) -> npt.NDArray[np.float64]:
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


def make_folder(folder: Path) -> None:
    """Make the output folder, so that what is wrong with it shows before the work and not after.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made a folder: {error.strerror}; choose another with --output") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} cannot be written to; choose another folder with --output")


def stacked(names: Sequence[str], frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the experiments' frames below each other, after a column ``experiment`` where there are several."""
    if len(frames) == 1:
        return frames[0]
    marked = [frame.assign(experiment=name) for name, frame in zip(names, frames, strict=True)]
    together = pd.concat(marked, ignore_index=True)
    return together[["experiment", *together.columns.drop("experiment")]]


def estimates_frame(result: Result, units: Sequence[str | None], level: float = LEVEL) -> pd.DataFrame:
    """Return ``estimates.csv``: the result's estimates with units and the limits of their intervals."""
    intervals = result.intervals(level)
    frame = result.estimates
    frame.insert(3, "lower", intervals["lower"].to_numpy())
    frame.insert(4, "upper", intervals["upper"].to_numpy())
    frame["unit"] = [unit or "" for unit in units]
    return frame


def parameter_units(system: System, names: Sequence[str]) -> tuple[str | None, ...]:
    """Return the unit of each parameter; one per experiment is named ``variable[experiment]``."""
    variables = system.variables
    return tuple(variables[name if name in variables else name.rpartition("[")[0]].unit for name in names)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path beside `path` to write to, and put it in place of `path` when all of it is written.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            yield draft
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written: {error.strerror or error}; choose another folder with --output"
        ) from None


def write_table(path: Path, frame: pd.DataFrame) -> Path:
    """Write a CSV table whose numbers read back exactly, and return its path."""
    with replacing(path) as draft:
        frame.to_csv(draft, index=False)
    return path


def at_minimum(result: Result, search: GlobalResult | None) -> bool:
    """Return whether a search has ended where more can be asked of the criterion, sure or not."""
    unfinished = tuple(status.value for status in Status if not status.converged)
    interrupted = search is not None and search.interrupted
    return not interrupted and not result.status.startswith(unfinished)


@dataclass(frozen=True, eq=False)
class Findings:
    """All that a run has found so far.

    Attributes
    ----------
    result : Result
    units : tuple of str or None
        Of the parameters.
    fits : tuple of Fit
        One an experiment.
    diagnostics : Diagnostics
        Of the residuals.
    reading : Reading
        What prior and data say, and whether they agree.
    level : float
        Of intervals.
    search : GlobalResult or None
        Where the whole box was searched.
    uncertainty : Uncertainty or None
        Where more than the local covariance was asked for.
    """

    result: Result
    units: tuple[str | None, ...]
    fits: tuple[Fit, ...]
    diagnostics: Diagnostics
    reading: Reading
    level: float = LEVEL
    search: GlobalResult | None = None
    uncertainty: Uncertainty | None = None

    @property
    def succeeded(self) -> bool:
        """Whether all that was asked for is there and can be trusted."""
        return self.result.converged and (self.uncertainty is None or self.uncertainty.succeeded)

    @property
    def has_prior(self) -> bool:
        """Whether any parameter has a prior."""
        return bool(np.isfinite(self.result.prior_mean).any())

    @property
    def estimates(self) -> pd.DataFrame:
        """The content of ``estimates.csv``."""
        return estimates_frame(self.result, self.units, self.level)

    @property
    def unit_of(self) -> dict[str, str | None]:
        """The unit of each parameter."""
        return dict(zip(self.result.names, self.units, strict=True))

    @property
    def output_units(self) -> dict[str, str | None]:
        """The unit of each output."""
        return {output: unit for fit in self.fits for output, unit in zip(fit.outputs, fit.units, strict=True)}

    def to_json_dict(self) -> dict[str, Any]:
        """Return the content of ``result.json``."""
        content = self.result.to_json_dict()
        content |= {"diagnostics": self.diagnostics.to_json_dict(), "consistency": self.reading.to_json_dict()}
        if self.search is not None:
            content["optima"] = [
                {
                    "criterion": optimum.criterion if math.isfinite(optimum.criterion) else None,
                    "hits": optimum.hits,
                    "converged": optimum.converged,
                    "status": optimum.status,
                    "parameters": dict(zip(self.search.names, optimum.theta.tolist(), strict=True)),
                }
                for optimum in self.search.optima
            ]
        return content | (self.uncertainty.to_json_dict() if self.uncertainty is not None else {})

    def maps(self) -> dict[str, CriterionMap]:
        """Return the maps of the criterion by the names of their files."""
        if self.uncertainty is None:
            return {}
        found = {f"map-{file_name('-'.join(chart.names))}": chart for chart in self.uncertainty.maps}
        return found | {f"map-{file_name('-'.join(chart.names))}-box": chart for chart in self.uncertainty.box_maps}

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the CSV tables by their names."""
        result = self.result
        found = {
            "estimates": self.estimates,
            "trace": result.trace,
            "rounds": result.rounds,
            "fit": stacked([fit.experiment for fit in self.fits], result.fit),
            "diagnostics": self.diagnostics.table,
        }
        if self.has_prior:
            found["reading"] = self.reading.table
        if self.search is not None:
            found["optima"] = self.search.table
        if self.uncertainty is not None:
            found |= {name: chart.table for name, chart in self.maps().items()}
            found |= {"profiles": self.uncertainty.profile_table} if self.uncertainty.profiles else {}
            posterior = self.uncertainty.posterior
            found |= {"posterior": posterior.table} if posterior is not None else {}
        return found

    def write(self, folder: Path) -> list[Path]:
        """Write ``result.json`` and the tables, and return their paths.

        Parameters
        ----------
        folder
            Made where needed; files of an earlier run are replaced.
        """
        path = folder / "result.json"
        with replacing(path) as draft:
            text = json.dumps(self.to_json_dict(), indent=2, ensure_ascii=False)
            draft.write_text(text + "\n", encoding="utf-8")
        written = [path, *(write_table(folder / f"{name}.csv", frame) for name, frame in self.tables().items())]
        for old in (old for pattern in _SOMETIMES for old in folder.glob(pattern)):
            if old not in written:
                old.unlink()
        return written


def file_name(text: str) -> str:
    """Return a name as it can be part of a file's."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text)


def rounded(value: float, std: float) -> str:
    """Return `value` to the second significant digit of its standard deviation, to six digits where it has none."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    if -3 < decimals < 10:
        return f"{value:.{max(0, decimals)}f}"
    size = max(abs(value), std)  # else too many zeros to read
    kept = round(value, decimals)
    return f"{kept:.{max(1, math.floor(math.log10(size)) + decimals)}e}" if kept else "0"


def with_std(value: float, std: float) -> str:
    """Return ``value ± std`` with two significant digits of the latter, `value` alone where there is none."""
    shown = rounded(value, std)
    return f"{shown} ± {rounded(std, std)}" if math.isfinite(std) and std > 0 else shown


def has_unit(unit: str | None) -> bool:
    """Return whether a unit is worth writing: neither missing nor FMI's "1" of what has none."""
    return unit not in (None, "", "1")


def label(name: str, unit: str | None) -> str:
    """Return the text of an axis or a table's head: name and unit."""
    return f"{name} ({unit})" if has_unit(unit) else name
