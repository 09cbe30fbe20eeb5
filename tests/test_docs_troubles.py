"""Each row of docs/troubleshooting.md: the trouble is made, what the page says of it is seen, and its remedy helps.

A row whose trouble needs a compiled FMU, or a run of a command, is made where that is tested: its check is named here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import fmuid
from fmuid import Document, Experiment, Normal, Parameter, Problem, Simulator, identify
from fmuid.array_types import Floats
from fmuid.data import Preprocessing
from fmuid.errors import InputError
from fmuid.estimation import LeastSquares
from fmuid.reports.render.console import show_notes
from fmuid.reports.topics.study_notes import input_notes
from fmuid.simulation.instance import _missing_library
from tests.support.coil_study import COIL
from tests.support.docs_rows import rows
from tests.support.fmu_texts import FMI2, write_fmu
from tests.support.paths import FMUS
from tests.support.said import solver_words

Check = Callable[[Path, pytest.CaptureFixture[str]], None]
ROWS: dict[str, Check | str] = {}
STEP, N = 0.01, 200
TRUTH = {"R": 4.0, "L": 0.1}
FREE = {"R": Parameter(3.0, min=0.0), "L": Parameter(0.2, min=1e-3)}


def row(head: str) -> Callable[[Check], None]:
    """Take a function for the check of the row with this first cell."""
    return lambda check: ROWS.update({head: check})


def elsewhere(head: str, test: str) -> None:
    """Name the test that makes the trouble of a row."""
    ROWS[head] = test


def recorded(offset: float = 0.0, begin: float = 0.0, noise: float = 0.005, scale: float = 1.0) -> pd.DataFrame:
    """Return a record of a coil whose voltage holds between samples, in closed form (1.69)."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-10.0, 10.0], N // 10), 10)
    decay = np.exp(-TRUTH["R"] / TRUTH["L"] * STEP)
    i = lfilter([0.0, (1 - decay) / TRUTH["R"]], [1.0, -decay], u) + begin * decay ** np.arange(N)
    i = scale * i + offset + noise * rng.standard_normal(N)
    return pd.DataFrame({"time": STEP * np.arange(N), "u": u, "i": i})


def experiment(table: pd.DataFrame, interpolation: str = "zoh", warmup: float = 0.0) -> Experiment:
    return Experiment(table, ["u"], ["i"], interpolation=interpolation, warmup=warmup)


def residual(given: Experiment, free: Mapping[str, Parameter] = FREE, **held: float) -> Floats:
    """Return what the best fit leaves of the counted samples."""
    result = identify(Problem(COIL, given, free, values=held), solver_check="off", restart=False)
    left = given.output_values[:, 0] - Simulator(COIL, given, list(free), values=held)(result.values)[:, 0]
    return np.asarray(left[given.counted[:, 0]])


def size(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_each_row_is_here() -> None:
    assert [cells[0] for cells in rows("troubleshooting.md", 2)] == list(ROWS)


@pytest.mark.parametrize("head", ROWS)
def test_row(head: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check = ROWS[head]
    if isinstance(check, str):
        assert callable(resolve_name(check))
    else:
        check(tmp_path, capsys)


# --- the FMU does not run -----------------------------------------------------------------

elsewhere("`no binary for` this platform", "tests.apps.cli.test_newcomers:test_fmus_that_are_none")
elsewhere("it asks for a license, or for its tool", "tests.simulation.test_validation:test_faults")
elsewhere("`variable … is declared twice`", "tests.apps.cli.test_bad_fmus:test_two_variables_of_one_name")
elsewhere("it crashes, or hangs", "tests.simulation.test_validation:test_a_hang_is_ended")


@row("`needs the shared library` …")
def _library(_: Path, __: pytest.CaptureFixture[str]) -> None:
    told = _missing_library(fmuid.FMU(COIL), "libgfortran.so.3: cannot open shared object file: No such file")
    assert told is not None
    assert "needs the shared library libgfortran.so.3, which is missing here" in told


@row("it is slow")
def _slow(_: Path, __: pytest.CaptureFixture[str]) -> None:
    given = experiment(recorded())
    one, other = (Simulator(COIL, given, interface=kind)([]) for kind in ("co-simulation", "model-exchange"))
    np.testing.assert_allclose(one, other, atol=1e-6)


@row("my parameter is not listed")
def _not_listed(folder: Path, _: pytest.CaptureFixture[str]) -> None:
    fmu = write_fmu(folder / "Motor.fmu", FMI2)
    table = pd.DataFrame({"time": [0.0, 1.0], "u": 1.0, "i": 1.0})
    with pytest.raises(InputError, match=r"'tau' cannot be set \(causality 'calculatedParameter'"):
        Simulator(fmu, Experiment(table, ["u"], ["i"]), ["tau"])


# --- the fit is bad -----------------------------------------------------------------------


@row("follows the edges of an input")
def _edges(_: Path, __: pytest.CaptureFixture[str]) -> None:
    table = recorded()
    edge = np.flatnonzero(np.diff(table["u"])) + 1
    left = residual(experiment(table, "linear"))
    assert size(left[edge]) > 3 * size(np.delete(left, [*edge, *(edge - 1), *(edge[:-1] + 1)]))
    late = table.assign(u=table["u"].shift(1, fill_value=0.0))  # a row has the input that led to it
    for given in (experiment(table), experiment(late, "zoh-next")):
        assert size(residual(given)) < 0.006 < 0.05 < size(residual(experiment(late)))


@row("starts large and dies out")
def _dies_out(_: Path, __: pytest.CaptureFixture[str]) -> None:
    table = recorded(begin=1.0)
    left = residual(experiment(table))
    assert np.abs(left[:3]).max() > 20 * size(left[N // 2 :])
    free = FREE | {"i_start": Parameter(0.0, nominal=1.0)}
    assert size(residual(experiment(table), free)) < 0.006
    assert size(residual(experiment(table, warmup=0.3))) < 0.006


@row("a smaller copy of the signal")
def _copy(_: Path, __: pytest.CaptureFixture[str]) -> None:
    given = experiment(recorded())
    left = residual(given, {"L": FREE["L"]}, R=5.0)
    assert np.corrcoef(left, given.output_values[:, 0])[0, 1] > 0.95
    assert size(left) < size(given.output_values)
    assert size(residual(given)) < 0.006


@row("has a mean")
def _mean(_: Path, __: pytest.CaptureFixture[str]) -> None:
    free = {"L": FREE["L"], "i_start": Parameter(0.0, nominal=1.0)}
    given = experiment(recorded(offset=0.1, noise=0.2))
    problem = Problem(COIL, given, free, values={"R": 4.0})
    found = str(Document.of(fmuid.analyze_residuals(problem, identify(problem, solver_check="off", restart=False))))
    assert re.search(r"Residual of i has an offset of 0\.10\d \(0\.5 × its standard deviation\)", found)
    assert abs(np.mean(residual(fmuid.data.preprocess(given, Preprocessing(detrend="mean")), free, R=4.0))) < 0.05


@row("grows with time")
def _grows(_: Path, __: pytest.CaptureFixture[str]) -> None:
    t, force, mass = np.arange(200) * 0.01, 10.0, 95.0
    table = pd.DataFrame({"time": t, "v": force / 35.15, "q": force / mass * t**2 / 2})
    given = Experiment(table, ["v"], ["q"])
    values = {"Fv": 0.0, "Fc": 0.0, "offset": 0.5, "M": mass}  # a force that is not there
    left = np.abs(table["q"] - Simulator(FMUS / "PositionDrive/PositionDrive.fmu", given, values=values)([])[:, 0])
    assert left.iloc[-1] > 3 * left.iloc[100] > 9 * left.iloc[50] > 0


@row("equals the whole signal")
def _unfed(_: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = Experiment(recorded(), [], ["i"], source="run.csv")
    simulator = Simulator(COIL, given)
    np.testing.assert_array_equal(simulator([]), 0.0)  # the residual is all of the signal
    show_notes(input_notes([simulator]))  # as `fmuid simulate` does
    assert "run.csv: no column for u; start value used." in capsys.readouterr().err


# --- the search does not end well ---------------------------------------------------------

TIMES = np.linspace(0.0, 2.0, 80)
WAVE = np.sin(9.0 * TIMES) + 0.05 * np.random.default_rng(6).standard_normal(TIMES.size)


EVERYWHERE = fmuid.GlobalSearch("multi-start", starts=12, seed=1)


def wave(start: float, low: float = 0.1, high: float = 40.0) -> LeastSquares:
    """Return the problem of a frequency, which has many optima."""
    free = {"w": Parameter(start, min=low, max=high)}
    return LeastSquares.from_function(lambda theta: np.sin(theta[0] * TIMES), WAVE, free)


@row("it converges to impossible values")
def _wrong_optimum(_: Path, __: pytest.CaptureFixture[str]) -> None:
    assert abs(identify(wave(20.0))["w"] - 9.0) > 3.0
    for problem, method in ((wave(11.0, 6.0, 12.0), None), (wave(20.0), EVERYWHERE)):
        assert identify(problem, method)["w"] == pytest.approx(9.0, abs=0.05)


@row("another initial guess gives other values")
def _other_start(_: Path, __: pytest.CaptureFixture[str]) -> None:
    assert abs(identify(wave(20.0))["w"] - identify(wave(8.0))["w"]) > 3.0
    optima = identify(wave(20.0), EVERYWHERE).history.optima
    assert len(optima) > 1
    assert optima[0].theta[0] == pytest.approx(9.0, abs=0.05)


def both(prior: Normal | None = None, held: bool = False) -> fmuid.Result:
    """Return what a decay tells of two rates that add."""
    free = {"a": Parameter(1.5, prior=prior)} | ({} if held else {"b": Parameter(0.4)})
    measured = np.exp(-2.0 * TIMES) + 0.01 * np.random.default_rng(3).standard_normal(TIMES.size)
    return identify(
        LeastSquares.from_function(lambda x: np.exp(-(x[0] + (1.0 if held else x[1])) * TIMES), measured, free)
    )


@row("parameters are not identifiable")
def _apart(_: Path, __: pytest.CaptureFixture[str]) -> None:
    assert "a and b are not identifiable; only a + b is." in str(Document.of(both()))
    assert np.isinf(both().std).all()
    assert (both(Normal(1.0, 0.05)).std < 0.1).all()
    assert both(held=True)["a"] == pytest.approx(1.0, abs=0.05)


@row("σ above 100 %")
def _weak(_: Path, __: pytest.CaptureFixture[str]) -> None:
    measured = TIMES + 0.5 * np.random.default_rng(1).standard_normal(TIMES.size)

    def found(prior: Normal | None) -> fmuid.Result:
        free = {"gain": Parameter(0.8), "bend": Parameter(0.1, prior=prior)}
        return identify(LeastSquares.from_function(lambda x: x[0] * TIMES + x[1] * TIMES**3 / 9, measured, free))

    assert "end is weakly identifiable: σ is" in str(Document.of(found(None)))
    assert found(Normal(0.0, 0.05)).std[1] < 0.06 < found(None).std[1]


@row("simulations fail on the way")
def _fails(_: Path, __: pytest.CaptureFixture[str]) -> None:
    failed = []

    def flow(theta: Floats) -> Floats:
        if theta[0] > 1.95:
            failed.append(theta[0])
            raise fmuid.SimulationError("Pipe.fmu", 0.0, {"a": float(theta[0])}, "the pipe has burst")
        return np.asarray(TIMES * theta[0] ** 4)

    measured = 1.9**4 * TIMES + 0.01 * np.random.default_rng(1).standard_normal(TIMES.size)
    result = identify(LeastSquares.from_function(flow, measured, {"a": Parameter(1.0)}))
    assert failed
    assert abs(result["a"] - 1.9) < 4 * result["a"].std


@row("it takes long")
def _long(_: Path, __: pytest.CaptureFixture[str]) -> None:
    given = experiment(recorded())
    fewer = fmuid.data.preprocess(given, Preprocessing(resample_interval=5 * STEP))
    assert fewer.times.size == N // 5
    assert identify(Problem(COIL, fewer, FREE))["R"] == pytest.approx(4.0, abs=0.1)


# --- a run ended early ----------------------------------------------------------------------

elsewhere("Ctrl-C, SIGTERM, or a closed terminal (SIGHUP)", "tests.apps.cli.test_interruption:test_a_search")
elsewhere(
    "the output went to `head`, or to a full disk", "tests.apps.cli.test_outputs:test_a_search_ends_whoever_reads"
)
elsewhere("the disk was full", "tests.apps.cli.test_outputs:test_no_room_for_a_result")
elsewhere(
    "`the earlier run cannot be resumed`", "tests.reports.test_following_damage:test_damaged_files_are_put_aside_once"
)

# --- the numbers differ -------------------------------------------------------------------


@row("a run on another machine")
def _again(_: Path, __: pytest.CaptureFixture[str]) -> None:
    one, other = (identify(Problem(COIL, experiment(recorded()), FREE)) for _ in range(2))
    np.testing.assert_array_equal(one.values, other.values)


@row("the tool that made the FMU")
def _tool(_: Path, __: pytest.CaptureFixture[str]) -> None:
    found = identify(Problem(COIL, experiment(recorded()), FREE)).accuracy
    assert found is not None
    assert solver_words(FREE, found)[0].startswith("Solver error is below ")


@row("intervals of another program")
def _white(_: Path, __: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(2)
    slow = lfilter([0.02], [1.0, -0.9], rng.standard_normal(N + 50))[50:]
    table = recorded(noise=0.0)
    result = identify(Problem(COIL, experiment(table.assign(i=table["i"] + slow)), FREE))
    frame = result.to_frame()
    assert (frame["std"] > 1.5 * frame["std_white_noise"]).all()
