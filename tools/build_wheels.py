"""Makes the source archive and the wheels of all platforms on this machine, and looks into each.

Needs hatchling and ziglang: ``python -m tools.build_wheels dist``. The wheel of this platform is also installed into an
environment where no compiler is found, and runs the study of the README.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tools.build_hook import NATIVE, build_module

ROOT = Path(__file__).parent.parent
STUDY = ROOT / "experiments" / "induction_machine" / "study.toml"
# What a library begins with: ELF with its machine at byte 18, Mach-O with its processor at byte 4, PE.
MARKS = {
    "manylinux_2_17_x86_64": (b"\x7fELF", 18, b"\x3e\x00"),
    "manylinux_2_17_aarch64": (b"\x7fELF", 18, b"\xb7\x00"),
    "macosx_11_0_x86_64": (b"\xcf\xfa\xed\xfe", 4, b"\x07\x00\x00\x01"),
    "macosx_11_0_arm64": (b"\xcf\xfa\xed\xfe", 4, b"\x0c\x00\x00\x01"),
    "win_amd64": (b"MZ", 0, b"MZ"),
    "win_arm64": (b"MZ", 0, b"MZ"),
}


def make(kind: str, folder: Path, tag: str = "") -> Path:
    """Build a source archive ("sdist") or a wheel ("wheel") of a platform into a folder; return it."""
    with tempfile.TemporaryDirectory(dir=folder) as own:  # several are built at a time
        command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", own]
        subprocess.run(command, check=True, cwd=ROOT, env=os.environ | {"FMUID_WHEEL_TAG": tag})
        (made,) = Path(own).iterdir()
        return made.replace(folder / made.name)


def check_sources(archive: Path) -> None:
    """Raise ValueError unless a source archive has all that the core is compiled from, and nothing compiled."""
    with tarfile.open(archive) as opened:
        names = {Path(name).name for name in opened.getnames() if f"/{NATIVE.as_posix()}/" in name}
    wanted = {path.name for path in (ROOT / NATIVE).iterdir() if path.suffix in (".c", ".h", ".md", ".py")}
    if names != wanted:
        raise ValueError(f"{archive}: {sorted(names ^ wanted)}")


def check_wheel(archive: Path, tag: str) -> None:
    """Raise ValueError unless a wheel has one library of its platform, no C sources, and the models of the records."""
    with zipfile.ZipFile(archive) as opened:
        models = [name for name in opened.namelist() if re.fullmatch(r"fmuid/datasets/\w+\.fmu", name)]
        if len(models) != len(list((ROOT / "fmuid" / "datasets").glob("*.csv"))):
            raise ValueError(f"{archive}: of the records' models it has {models}")
        names = [name for name in opened.namelist() if name.startswith(NATIVE.as_posix())]
        (library,) = (name for name in names if Path(name).name.startswith("core-"))
        content = opened.read(library)
    begin, place, machine = MARKS[tag]
    if any(name.endswith((".c", ".h")) for name in names) or not archive.stem.endswith(f"-py3-none-{tag}"):
        raise ValueError(f"{archive}: {names}")
    if not content.startswith(begin) or content[place : place + len(machine)] != machine:
        raise ValueError(f"{archive}: {library} is of another platform")


def check_installed(wheel: Path) -> None:
    """Raise CalledProcessError unless a wheel, installed where no compiler is found, identifies a machine."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        venv.create(folder, with_pip=True)
        programs = Path(folder) / ("Scripts" if os.name == "nt" else "bin")
        bare = {key: value for key, value in os.environ.items() if key not in ("CC", "PYTHONPATH")}
        environment = bare | {"PATH": str(programs)}
        for command in (["pip", "install", "-q", str(wheel)], ["fmuid", "identify", str(STUDY), "--output", folder]):
            subprocess.run([str(programs / command[0]), *command[1:]], check=True, cwd=folder, env=environment)


def main(folder: Path) -> None:
    """Make and check all."""
    folder.mkdir(parents=True, exist_ok=True)
    build = build_module(ROOT)
    check_sources(make("sdist", folder))

    def make_wheel(tag: str) -> None:
        wheel = make("wheel", folder, tag)
        check_wheel(wheel, tag)
        print(f"{wheel.name}: {wheel.stat().st_size / 1e3:.0f} kB", flush=True)
        if tag == build.tag_here():
            check_installed(wheel)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        deque(pool.map(make_wheel, build.TARGETS), maxlen=0)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
