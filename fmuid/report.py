"""What a run says and leaves behind: words and numbers for people, and the files of the output folder."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid.errors import InputError
from fmuid.parameters import ParameterSet
from fmuid.result import Result

if TYPE_CHECKING:
    from fmuid.experiment import Experiment
    from fmuid.system import System


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
    units = tuple(experiment.units.get(name, system.variables[name].unit) for name in names)
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


def estimates_frame(result: Result, units: Sequence[str | None]) -> pd.DataFrame:
    """Return ``estimates.csv``: the result's estimates with units and the limits of their 95 % intervals."""
    intervals = result.intervals()
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


def write_result(folder: Path, result: Result, units: Sequence[str | None], experiments: Sequence[str]) -> list[Path]:
    """Write ``result.json`` and the tables of a result, and return their paths.

    Parameters
    ----------
    folder
        Made where needed; files of an earlier run are replaced.
    result
        What to write.
    units
        Of the parameters.
    experiments
        Names of the experiments.
    """
    path = folder / "result.json"
    with replacing(path) as draft:
        draft.write_text(json.dumps(result.to_json_dict(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return [
        path,
        write_table(folder / "estimates.csv", estimates_frame(result, units)),
        write_table(folder / "trace.csv", result.trace),
        write_table(folder / "fit.csv", stacked(experiments, result.fit)),
    ]


def rounded(value: float, std: float) -> str:
    """Return `value` to the second significant digit of its standard deviation, to six digits where it has none."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(std))
    if -3 < decimals < 10:
        return f"{value:.{max(0, decimals)}f}"
    size = max(abs(value), std)  # else too many zeros to read
    return f"{value:.{max(1, math.floor(math.log10(size)) + decimals)}e}"


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
