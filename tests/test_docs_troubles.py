"""Rows of docs/troubleshooting.md: the trouble is made, what the page says of it is seen, and its remedy helps.

Rows about FMUs that do not run and about runs that end early are tested with the commands.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import fmuid
from fmuid import Document, Experiment, InputError, Noise, Parameter, Problem, Simulator, identify
from fmuid.array_types import Floats
from fmuid.data import Preprocessing
from fmuid.simulation.instance import _missing_library
from tests.support.coil_study import COIL
from tests.support.docs_rows import RowChecks, rows
from tests.support.fmu_texts import FMI2, write_fmu
from tests.support.paths import FMUS

row = ROWS = RowChecks()
STEP, N = 0.01, 200
TRUTH = {"R": 4.0, "L": 0.1}
FREE = {"R": Parameter(3.0, min=0.0), "L": Parameter(0.2, min=1e-3)}
WITH_STATE = {"L": FREE["L"], "i_start": Parameter(0.0, nominal=1.0)}
NOISE = 0.006  # above the root mean square of the noise of `recorded`


def recorded(offset: float = 0.0, begin: float = 0.0, noise: float = 0.005) -> pd.DataFrame:
    """Return data of a coil with a held voltage, in closed form (1.69)."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-10.0, 10.0], N // 10), 10)
    decay = np.exp(-TRUTH["R"] / TRUTH["L"] * STEP)
    i = lfilter([0.0, (1 - decay) / TRUTH["R"]], [1.0, -decay], u) + begin * decay ** np.arange(N)
    return pd.DataFrame({"time": STEP * np.arange(N), "u": u, "i": i + offset + noise * rng.standard_normal(N)})


def experiment(table: pd.DataFrame, interpolation: str = "zoh", warmup: float = 0.0) -> Experiment:
    return Experiment(table, ["u"], ["i"], interpolation=interpolation, warmup=warmup)


def residual(given: Experiment, free: Mapping[str, Parameter] = FREE, **held: float) -> Floats:
    """Return the residual of the best fit at the scored samples."""
    result = identify(
        Problem(COIL, given, free, values=held, noise=Noise(delay_std=0.0)), solver_check="off", restart=False
    )
    left = given.output_values[:, 0] - Simulator(COIL, given, list(free), values=held)(result.values)[:, 0]
    return np.asarray(left[given.counted[:, 0]])


def size(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_rows_are_on_the_page() -> None:
    assert ROWS.keys() <= {cells[0] for cells in rows("troubleshooting.md", 2)}


@pytest.mark.parametrize("head", ROWS)
def test_row(head: str, tmp_path: Path) -> None:
    ROWS[head](tmp_path)


@row("`needs the shared library` …")
def _(_: Path) -> None:
    told = _missing_library(fmuid.FMU(COIL), "libgfortran.so.3: cannot open shared object file: No such file")
    assert told is not None
    assert "needs the shared library libgfortran.so.3" in told


@row("my parameter is not listed")
def _(folder: Path) -> None:
    fmu = write_fmu(folder / "Motor.fmu", FMI2)
    table = pd.DataFrame({"time": [0.0, 1.0], "u": 1.0, "i": 1.0})
    with pytest.raises(InputError, match=r"'tau' cannot be set .*calculatedParameter"):
        Simulator(fmu, Experiment(table, ["u"], ["i"]), ["tau"])


@row("follows the edges of an input")
def _(_: Path) -> None:
    table = recorded()
    edge = np.flatnonzero(np.diff(table["u"])) + 1
    left = residual(experiment(table, "linear"))
    assert size(left[edge]) > 3 * size(np.delete(left, [*edge, *(edge - 1), *(edge[:-1] + 1)]))
    late = table.assign(u=table["u"].shift(1, fill_value=0.0))  # a row has the input that led to it
    for given in (experiment(table), experiment(late, "zoh-next")):
        assert size(residual(given)) < NOISE < 0.05 < size(residual(experiment(late)))


@row("starts large and dies out")
def _(_: Path) -> None:
    table = recorded(begin=1.0)
    left = residual(experiment(table))
    assert np.abs(left[:3]).max() > 20 * size(left[N // 2 :])
    assert size(residual(experiment(table), FREE | WITH_STATE)) < NOISE
    assert size(residual(experiment(table, warmup=0.3))) < NOISE


@row("a smaller copy of the signal")
def _(_: Path) -> None:
    given = experiment(recorded())
    left = residual(given, {"L": FREE["L"]}, R=5.0)
    assert np.corrcoef(left, given.output_values[:, 0])[0, 1] > 0.95
    assert size(residual(given)) < NOISE < size(left) < size(given.output_values)


@row("has a mean")
def _(_: Path) -> None:
    given = experiment(recorded(offset=0.1, noise=0.2))
    problem = Problem(COIL, given, WITH_STATE, values={"R": 4.0})
    found = str(Document.of(fmuid.analyze_residuals(problem, identify(problem, solver_check="off", restart=False))))
    assert re.search(r"Residual of i has an offset of 0\.10", found)
    assert abs(np.mean(residual(fmuid.data.preprocess(given, Preprocessing(detrend="mean")), WITH_STATE, R=4.0))) < 0.05


@row("grows with time")
def _(_: Path) -> None:
    t, force, mass = np.arange(200) * 0.01, 10.0, 95.0
    table = pd.DataFrame({"time": t, "v": force / 35.15, "q": force / mass * t**2 / 2})
    values = {"Fv": 0.0, "Fc": 0.0, "offset": 0.5, "M": mass}  # a force that is not there
    drive = Simulator(FMUS / "PositionDrive/PositionDrive.fmu", Experiment(table, ["v"], ["q"]), values=values)
    left = np.abs(table["q"] - drive([])[:, 0])
    assert left.iloc[-1] > 3 * left.iloc[100] > 9 * left.iloc[50] > 0


@row("equals the whole signal")
def _(_: Path) -> None:
    simulator = Simulator(COIL, Experiment(recorded(), [], ["i"]))
    assert simulator.unfed_inputs == ("u",)  # `fmuid simulate` says it
    np.testing.assert_array_equal(simulator([]), 0.0)
