"""Studies whose FMU misbehaves: the search goes round the bad points, and commands end with one sentence."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fmuid import Experiment, Isolation, Parameter, Problem, Study, System
from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.estimation import LeastSquares
from fmuid.identification import identify
from tests.support.isolated import RECORD_FRAME, TIMES, U
from tests.support.misbehaving import Mode, lag, misbehaving_fmu

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="processes of their own need fork"),
    pytest.mark.usefixtures("blank_figures"),
]

TRUTH = {"gain": 2.5, "T": 0.6}
FRAME = RECORD_FRAME.assign(x=lag(TIMES, U, **TRUTH) + 0.01 * np.random.default_rng(5).normal(size=TIMES.size))
BAND = {"bad_from": 3.0, "bad_to": 4.2}
STUDY = """
model = {{ fmu = "{fmu}", fixed = {{ mode = {mode}, bad_from = {bad_from}, bad_to = {bad_to} }} }}
experiments = [{{ data = "table.csv", inputs = ["u"], outputs = ["x"], interpolation = "zoh" }}]
parameters = {{ gain = {{ start = 8.0 }}, T = {{ start = 10.0, min = 1e-3 }} }}
isolation = {{ time_limit = 600, memory_limit_mb = 400 }}
"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def write_study(folder: Path, fmu: Path, mode: Mode, bad_from: float = -1e300, bad_to: float = 1e300) -> Path:
    FRAME.to_csv(folder / "table.csv", index=False)
    text = STUDY.format(fmu=fmu.as_posix(), mode=float(mode), bad_from=bad_from, bad_to=bad_to)
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


def problem(fmu: Path, mode: Mode, isolation: Isolation | None, gain: float = 8.0, T: float = 10.0) -> LeastSquares:
    return Problem(
        System(fmu, isolation=isolation),
        Experiment(FRAME, ["u"], ["x"], interpolation="zoh"),
        {"gain": Parameter(gain, min=0.1, max=20.0), "T": Parameter(T, min=0.05, max=20.0)},
        values={"mode": float(mode), **BAND},
    )


def test_the_command_identifies_round_a_band(tmp_path: Path, fmu: Path) -> None:
    study = write_study(tmp_path, fmu, Mode.SEGFAULT, **BAND)
    assert run(["identify", str(study)]) == DONE
    said = json.loads((tmp_path / "results" / "result.json").read_text())
    assert said["converged"]
    right = identify(problem(fmu, Mode.RETURN_ERROR, None))
    for name, value, std in zip(right.names, right.values, right.std, strict=True):
        assert abs(said["parameters"][name]["value"] - value) < 1e-3 * std


@pytest.mark.parametrize(
    ("command", "mode", "words"),
    [
        ("simulate", Mode.SEGFAULT, "its process crashed with SIGSEGV"),
        pytest.param("identify", Mode.EXIT_0, "ended its process with exit code 0", marks=pytest.mark.slow),
    ],
)
def test_a_command_that_cannot_succeed_ends_with_one_sentence(
    tmp_path: Path, fmu: Path, command: str, mode: Mode, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run([command, str(write_study(tmp_path, fmu, mode))]) == NOT_SUCCEEDED
    said = capfd.readouterr()
    assert words in said.err.replace("\n", " ")
    assert "Traceback" not in said.out + said.err
    assert str(fmu) in said.err.replace("\n", "")


def test_what_the_fmu_prints_goes_to_its_log(tmp_path: Path, fmu: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", str(write_study(tmp_path, fmu, Mode.SPEAK))]) == DONE
    assert "the FMU says on" not in "".join(capfd.readouterr())
    assert "the FMU says on" in (tmp_path / "results/fmu.log").read_text()


@pytest.mark.slow
def test_a_command_can_run_the_fmu_in_its_own_process(tmp_path: Path, fmu: Path) -> None:
    """Which then has the fate of the FMU's: that it does crash is what makes the tests of isolation show something."""
    study = write_study(tmp_path, fmu, Mode.ABORT)
    command = [sys.executable, "-m", "fmuid", "simulate", str(study), "--no-isolation"]
    assert subprocess.run(command, capture_output=True, timeout=600).returncode == -signal.SIGABRT


def test_a_study_is_isolated_where_it_is_asked_to_be(tmp_path: Path, fmu: Path) -> None:
    path = write_study(tmp_path, fmu, Mode.SEGFAULT, **BAND)
    assert Study.read(path).system.isolation is None
    assert Study.read(path, isolated=True).system.isolation == Isolation(time_limit=600.0, memory_limit_mb=400.0)
