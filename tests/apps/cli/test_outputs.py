"""What commands find is written whatever is behind standard output and error: nobody, a full disk, nothing."""

import errno
import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from experiments.coil import study as coil
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.apps.cli.signals import Output
from tests.support.coil_records import warming
from tests.support.coil_study import STUDY, coil_table, fmuid_, result
from tests.support.quick import first

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="descriptors are those of POSIX")


class Failing(io.StringIO):
    """A stream that cannot be written to."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def write(self, _text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize("number", first(1, [errno.ENOSPC, errno.EPIPE, errno.EIO]))
def test_a_search_ends_whoever_reads(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(sys, "stdout", Failing(number))
    code = fmuid_("identify", folder / "study.toml", "--no-report")
    monkeypatch.undo()
    assert result(folder / "results")["outcome"] == "converged"
    kept = f"error: the standard output: No space left on device. Files are written to {folder / 'results'}\n"
    expected = (NOT_SUCCEEDED, kept) if number == errno.ENOSPC else (DONE, "")
    assert (code, capsys.readouterr().err) == expected


def test_an_output_that_failed_is_left() -> None:
    """What waits in it raises no error at the end either."""
    read, write = os.pipe()
    os.close(read)
    stream = os.fdopen(write, "w")
    output = Output(stream)
    assert output.write("told to nobody\n") == 15
    output.flush()
    stream.close()
    assert output.lost is None
    with Path("/dev/null").open("w") as file:
        assert Output(file).fileno() == file.fileno()
    output = Output(None)
    output.write("where the process has none")
    output.flush()
    output.close()


def test_no_room_for_a_result(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """It is shown, and kept among temporary files, which the sentence names."""
    written = Path.write_text
    room = folder / "room"
    room.mkdir()

    def full(self: Path, *arguments: Any, **words: Any) -> int:
        if self.parent == folder / "results":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written(self, *arguments, **words)

    monkeypatch.setattr(Path, "write_text", full)
    monkeypatch.setattr("tempfile.tempdir", str(room))
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    out, error = capsys.readouterr()
    (kept,) = room.glob("*/result.json")
    assert error.startswith(f"error: {folder / 'results/result.json'} cannot be written: No space left on device")
    assert error.endswith(f"he result is kept in {kept}.\n")
    assert "converged" in out
    assert result(kept.parent)["outcome"] == "converged"
    assert not (folder / "results" / "result.json").exists()


COMMANDS = {
    "identify study.toml": ("| true", "> /dev/full", ">&- 2>&-"),
    "simulate study.toml": ("| true",),
    "predict results second.csv": ("> /dev/full",),
    "compare results other": (">&- 2>&-",),
    "design design.toml first.csv second.csv": ("> /dev/full",),
    "diagnose test.toml": (">&- 2>&-",),
    "monitor test.toml test1.csv": ("| true",),
    "batch batch.toml --workers 1": ("> /dev/full",),
}
"""Commands, and what is behind their output."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what all commands need."""
    folder = tmp_path_factory.mktemp("bench")
    for k, name in enumerate(("first.csv", "second.csv")):
        coil_table(folder / name, 0.0, seed=k)
    noise = "[noise]\nvariance = 1e-4\n"
    batch = "[batch.monte_carlo]\nrealizations = 3\nstd = 0.01\n"
    for name, more in (("study", ""), ("design", noise), ("batch", batch)):
        (folder / f"{name}.toml").write_text(STUDY + more)
    assert fmuid_("identify", folder / "study.toml", "--no-report") == DONE
    shutil.copytree(folder / "results", folder / "other")
    shutil.copytree(coil.HERE / "healthy", folder / "healthy")
    warming(3, to=4.0).to_csv(folder / "test1.csv", index=False)
    text = (coil.HERE / "test.toml").read_text().replace("../../fmus", coil.FMUS.as_posix())
    (folder / "test.toml").write_text(text + "[monitoring]\nwindow_length = 1.0\nwarmup = 0.2\n")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_files_are_there_whatever_is_behind_the_output(bench: Path, command: str) -> None:
    line, found = f"{sys.executable} -m fmuid {command} -o found", []
    for way in ("", *COMMANDS[command]):
        shutil.rmtree(bench / "found", ignore_errors=True)
        shell = ["bash", "-c", f"{line} {way}; exit ${{PIPESTATUS[0]}}"]
        done = subprocess.run(shell, cwd=bench, capture_output=True, text=True, check=False)
        full = "error: the standard output: No space left on device. Files are written to found"
        assert done.stderr.startswith(full) if "full" in way else done.stderr == ""
        assert done.returncode == (NOT_SUCCEEDED if "full" in way else DONE)
        found.append({path.name for path in (bench / "found").rglob("*") if "part-" not in path.name})
    assert len(found[0]) > 1
    assert found == [found[0]] * len(found)
