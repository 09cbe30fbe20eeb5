"""`fmuid validate`: sound FMUs pass, and each fault is the failed check that it should be, even a crash or a hang."""

import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
import pytest

import fmuid
from fmuid import validate
from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.reports.topics.validation import check_words
from fmuid.simulation import Check, InterfaceTest, Stage, Validation, validation
from fmuid.simulation import smoke_test as smoke
from fmuid.simulation.native.build import compiler_here
from fmuid.simulation.smoke_test import SmokeReport
from tests.support.compiled import ProbeMaker
from tests.support.compiled import write_fmu as write_compiled
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.paths import FMUS, HERE

COIL = FMUS / "Coil/Coil.fmu"


def found(checks: Validation) -> dict[str, str]:
    return {check.name: check.result for check in checks.checks}


def remark(checks: Validation, name: str) -> str:
    (check,) = (check for check in checks.checks if check.name == name)
    return "\n".join(check_words(check))


def test_a_sound_fmu(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["validate", str(COIL)]) == DONE
    out = capsys.readouterr().out
    kinds = ("co-simulation", "model-exchange")
    checks = ["model description", *(f"{kind}: {name}" for kind in kinds for name in STAGES)]
    told = [line for line in out.splitlines() if " ok " in line]
    assert [line.split("   ")[0].strip() for line in told] == checks
    assert "no problems found" in out


STAGES = ("binary", "instantiation", "simulation", "reset")


def test_no_binary_for_this_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is said first: FMPy needs half a minute for a million variables; nothing is unpacked for it either."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = write_fmu(tmp_path / "Linear.fmu", FMI3, "binaries/other64/linear.bin")
    checks = validate(path)
    assert {check.name: check.result for check in checks.checks[1:]} == {
        "co-simulation: binary": "failed",
        "co-simulation: simulation": "left out",
        "model-exchange: binary": "failed",
        "model-exchange: simulation": "left out",
    }
    assert "other64" in remark(checks, "co-simulation: binary")
    assert run(["validate", str(path)]) == NOT_SUCCEEDED
    said = capsys.readouterr()
    assert f"{checks.count('failed')} of 5 checks failed" in said.out
    assert said.err.startswith(f"note: {path}: no binary for this platform")
    assert not (tmp_path / "cache").exists()


@pytest.fixture(scope="session")
def troubled(probe: ProbeMaker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The probe FMU with faults that the environment variable PROBE_FAULT chooses, in whatever process it runs."""
    folder = tmp_path_factory.mktemp("troubled")
    source = (HERE / "probe/probe.c").read_text(encoding="utf-8")
    for start, fault in (
        ("  m->callbacks = callbacks, m->logging = logging;\n", INSTANTIATION_FAULTS),
        ("  if (fabs(t - m->time) > 1e-9)", STEP_FAULTS),
    ):
        assert source.count(start) == 1
        source = source.replace(start, start + fault if start.endswith("\n") else fault + start)
    (folder / "probe.c").write_text("#include <stdio.h>\n" + source, encoding="utf-8")
    with zipfile.ZipFile(probe()) as archive:
        text = archive.read("modelDescription.xml").decode()
    return write_compiled(folder / "troubled.fmu", text, folder / "probe.c")


INSTANTIATION_FAULTS = r"""
  const char *fault = getenv("PROBE_FAULT");
  strncpy(m->name, name, sizeof m->name - 1);
  if (fault && !strcmp(fault, "licence")) { say(m, fmi2Error, "%s: no license found (%g)", 7); return 0; }
  if (fault && !strcmp(fault, "load")) { fprintf(stderr, "out of luck\n"); abort(); }
"""
STEP_FAULTS = r"""
  const char *fault = getenv("PROBE_FAULT");
  if (fault && !strcmp(fault, "crash") && t > 0.5) abort();
  if (fault && !strcmp(fault, "hang")) for (volatile int k = 0; ; k++);
  if (fault && !strcmp(fault, "nan") && t > 0.5) m->r[X] = NAN;
  if (fault && !strcmp(fault, "warning")) say(m, fmi2Warning, "%s: mind the gap (%g)", 7);
"""


@pytest.mark.parametrize(
    ("fault", "name", "result", "sentences"),
    [
        ("licence", "instantiation", "failed", ["no license found (7)", "check the tool's license"]),
        ("load", "instantiation", "failed", ["out of luck", "SIGABRT"]),
        pytest.param("crash", "simulation", "failed", ["during the simulation", "SIGABRT"], marks=pytest.mark.slow),
        ("nan", "simulation", "failed", ["failed at t = 0.52 s: output 'x' is not finite"]),
        ("warning", "simulation", "ok", ["0 to 1 s: 101 samples, 6 outputs finite"]),
        ("warning", "messages", "warning", ["mind the gap (7)"]),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGABRT")
def test_faults_are_failed_checks(
    fault: str,
    name: str,
    result: str,
    sentences: list[str],
    troubled: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Crashes in a process of their own, the others in this one."""
    monkeypatch.setenv("PROBE_FAULT", fault)
    if "SIGABRT" not in sentences:
        monkeypatch.setattr(validation, "_try", partial(in_this_process, tmp_path / "report.json"))
    checks = validate(troubled)
    assert found(checks)[f"co-simulation: {name}"] == result
    for sentence in sentences:
        assert sentence in remark(checks, f"co-simulation: {name}")


def in_this_process(target: Path, fmu: fmuid.FMU, kind: str, share: float) -> InterfaceTest:
    """Try an interface without another process."""
    return InterfaceTest(share, smoke.attempt(fmu.path, kind, share, target))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="links as Linux does")
def test_a_shared_library_that_is_missing(probe: ProbeMaker, tmp_path: Path) -> None:
    (tmp_path / "absent.c").write_text("int absent(void) { return 1; }", encoding="utf-8")
    (tmp_path / "probe.c").write_text("int absent(void); int needs(void) { return absent(); }", encoding="utf-8")
    compiler = [*compiler_here(), "-shared", "-fPIC"]
    library = ["-o", "libabsent.so.3", "-Wl,-soname,libabsent.so.3", "absent.c"]
    for arguments in (library, ["-o", "probe.so", "probe.c", "./libabsent.so.3"]):
        subprocess.run([*compiler, *arguments], check=True, capture_output=True, cwd=tmp_path)
    with zipfile.ZipFile(probe()) as sound, zipfile.ZipFile(tmp_path / "needy.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", sound.read("modelDescription.xml"))
        archive.write(tmp_path / "probe.so", f"binaries/{fmpy.platform}/probe.so")
    (tmp_path / "libabsent.so.3").unlink()
    checks = validate(tmp_path / "needy.fmu")
    assert found(checks)["co-simulation: instantiation"] == "failed"
    assert "needs the shared library libabsent.so.3," in remark(checks, "co-simulation: instantiation")


@pytest.mark.slow
def test_a_hang_is_ended(troubled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PROBE_FAULT", "hang")
    monkeypatch.setattr(validation, "TIME_LIMIT", 2.0)
    monkeypatch.setattr(validation, "DURATION_SHARES", (1.0,))
    checks = validate(troubled)
    assert not checks.passed
    assert any("stopped after 2 s" in text for check in checks.checks for text in check_words(check))


def test_missing_reset_and_needed_tool_are_warnings(
    probe: ProbeMaker, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(validation, "_try", partial(in_this_process, tmp_path / "report.json"))
    checks = validate(probe("NO_RESET", needsExecutionTool="true"))
    assert found(checks) | {"stands alone": "warning", "co-simulation: reset": "warning"} == found(checks)
    assert found(checks)["co-simulation: simulation"] == "ok"
    assert "its reset does not work" in remark(checks, "co-simulation: reset")
    assert "co-simulation: messages" not in found(checks)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[InterfaceTest]]:
    """The tries of an interface in turn, in place of processes; what is left over was not tried."""
    tries: list[InterfaceTest] = []

    def next_try(_fmu: fmuid.FMU, _kind: str, share: float) -> InterfaceTest:
        assert tries[0].share == share
        return tries.pop(0)

    monkeypatch.setattr(validation, "_try", next_try)
    yield tries
    assert not tries


def interface(kind: str) -> Sequence[Check]:
    return validation._interface(fmuid.FMU(COIL), kind)


def test_a_slow_model_is_tried_for_a_shorter_time(scripted: list[InterfaceTest]) -> None:
    slow = SmokeReport(Stage.SIMULATION, instantiated=True)
    done = SmokeReport(Stage.REPETITION, instantiated=True, simulated=True)
    scripted += [InterfaceTest(1.0, slow, code=None), InterfaceTest(0.01, done, code=None)]
    _, simulation, reset = interface("co-simulation")
    assert (simulation.result, reset.result) == ("warning", "warning")
    assert "stopped after 60 s" in check_words(simulation)[0]
    assert "1 % of the default experiment" in check_words(simulation)[1]


@pytest.mark.parametrize(
    ("kind", "share", "first", "second", "last", "samples", "step"),
    [
        ("model-exchange", 1.0, 0.0, 0.03, 3.0, 101, None),
        ("co-simulation", 1.0, 0.0, 0.028, 2.996, 108, 0.007),  # four steps of 7 ms to a sample, as many as fit
        ("co-simulation", 0.001, 0.0, 3e-5, 3e-3, 101, None),  # shorter than a step
        ("co-simulation", 0.01, 0.0, 0.007, 0.028, 5, 0.007),
    ],
)
def test_samples(
    kind: str, share: float, first: float, second: float, last: float, samples: int, step: float | None, tmp_path: Path
) -> None:
    given = '<DefaultExperiment startTime="0" stopTime="3" stepSize="0.007"/><ModelVariables>'
    path = write_fmu(tmp_path / "Motor.fmu", FMI2.replace("<ModelVariables>", given))
    times, step_size = smoke.default_times(fmuid.FMU(path).description, kind, share)
    assert times[[0, 1, -1]] == pytest.approx([first, second, last])
    assert (len(times), step_size) == (samples, step)
    assert np.ptp(np.diff(times)) < 1e-12
