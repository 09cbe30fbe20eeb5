"""Processes of ours import what this one would, whatever lies in the current folder and in the environment."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

import fmuid
from fmuid.processes import Child
from fmuid.processes.children import search_path
from tests.support.coil_study import COIL, STUDY, coil_table

SPOILT = 'from pathlib import Path\nPath(__file__).with_name("marker").touch()\nraise ImportError("a stranger")\n'
NAMES = ("bisect.py", "random.py", "numpy.py", "logging.py", "distributed.py")
BATCH = "[batch]\nmonte_carlo = { realizations = 3, std = 0.02, true_values = { R = 4.0, L = 0.1 } }\n"


@pytest.fixture
def spoilt(tmp_path: Path) -> Path:
    """A study with modules beside it that must not be imported."""
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(STUDY + BATCH, encoding="utf-8")
    for name in NAMES:
        (tmp_path / name).write_text(SPOILT)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("batch", "study.toml", "-o", "out", "--workers", "1"),
        ("identify", "study.toml", "-o", "out"),
        ("validate", str(COIL)),
    ],
    ids=lambda words: words[0],
)
def test_modules_beside_the_study(spoilt: Path, words: tuple[str, ...]) -> None:
    line = [sys.executable, "-P", "-m", "fmuid", *words]
    done = subprocess.run(line, cwd=spoilt, capture_output=True, text=True, timeout=600, check=False)
    assert not (spoilt / "marker").exists()
    assert done.returncode == 0, done.stderr


def output_of(module: str, folder: Path, environment: dict[str, str]) -> str:
    """Return what a module prints that is started as our processes are, by a process in a folder."""
    code = (
        "import subprocess, sys; from fmuid.processes import python_command; "
        f"sys.exit(subprocess.run(python_command({module!r}, 'a', 'b c')).returncode)"
    )
    line = [sys.executable, "-P", "-c", code]
    done = subprocess.run(
        line, cwd=folder, env=os.environ | environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_gets_in(tmp_path: Path) -> None:
    """Arguments and folders of PYTHONPATH, but not the current folder; into processes of processes neither."""
    (tmp_path / "stranger.py").write_text("")
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "seen.py").write_text(
        "import importlib.util, multiprocessing, sys\n"
        "def seen(channel=None):\n"
        "    found = [name for name in ('stranger', 'fmuid') if importlib.util.find_spec(name)]\n"
        "    channel.put(found) if channel else print(found)\n"
        "if __name__ == '__main__':\n"
        "    print(sys.argv[1:])\n"
        "    seen()\n"
        "    context = multiprocessing.get_context('spawn')\n"
        "    channel = context.Queue()\n"
        "    below = context.Process(target=seen, args=[channel])\n"
        "    below.start()\n"
        "    print(channel.get(timeout=600))\n"
        "    below.join()\n"
    )
    path = os.pathsep.join([str(tmp_path / "library"), "", "."])
    found = output_of("seen", tmp_path, {"PYTHONPATH": path, "PYTHONHOME": ""})
    assert found.splitlines() == ["['a', 'b c']", *["['fmuid']"] * 2]


SLEEPER = "import subprocess, sys, time; "
SLEEPER += "print(subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(3600)']).pid, flush=True); "
SLEEPER += "time.sleep(3600)"


def gone(pid: int) -> bool:
    """Wait until a process has ended."""
    until = time.monotonic() + 600.0
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


@pytest.mark.skipif(os.name != "posix", reason="sessions are of POSIX systems")
def test_a_child_ends_with_what_it_has_started(tmp_path: Path) -> None:
    with (tmp_path / "said").open("w+b") as said:
        child = Child("timeit", "-n1", "-r1", SLEEPER, stdout=said)
        while not (text := (tmp_path / "said").read_text()).endswith("\n"):
            assert child.wait(0.05) is None
        assert child.running
        child.end()
    assert not child.running
    assert child.wait(0.0) == -signal.SIGKILL
    assert gone(int(text))


def test_a_child_ends_with_who_started_it() -> None:
    code = "from fmuid.processes import Child\n"
    waits = "from fmuid.processes import watch_lifeline; import os, time; watch_lifeline(lambda: os._exit(0)); "
    code += f"print(Child('timeit', '-n1', '-r1', {waits + 'time.sleep(3600)'!r}).pid, flush=True)\n"
    code += "import time; time.sleep(3600)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert psutil.pid_exists(pid)
        parent.kill()
    assert gone(pid)


def test_search_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left out, and that fmuid is found last where nothing else says where it is."""
    own = str(Path(fmuid.__file__).parents[1])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(tmp_path / "scripts" / "run.py"), raising=False)
    around = ["", ".", "lib", str(tmp_path), str(tmp_path / "scripts" / ".." / "scripts")]
    monkeypatch.setattr(sys, "path", [*around, str(tmp_path / "lib")])
    assert search_path() == [str(tmp_path / "lib"), own]
    (tmp_path / "older" / "fmuid").mkdir(parents=True)  # installed beside
    monkeypatch.setattr(sys, "path", [str(tmp_path / each) for each in ("lib", "older", "more")])
    assert search_path() == [str(tmp_path / "lib"), own, *(str(tmp_path / each) for each in ("older", "more"))]
    monkeypatch.setattr(sys, "path", [*around, own, str(tmp_path / "lib")])
    assert search_path() == [own, str(tmp_path / "lib")]
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert search_path() == [str(tmp_path), own, str(tmp_path / "lib")]
