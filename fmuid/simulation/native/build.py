"""Compiles the core: for this machine where its sources lie beside it, and for the platform of a wheel that is built.

It stands alone: it is called where fmuid is not installed. ``python -m fmuid.simulation.native.build`` compiles by
hand.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
_VERSION = (HERE.parents[1] / "version.py").read_text(encoding="utf-8").split('"')[-2]
DEFINED = f'-DFMUID_VERSION="{_VERSION}"'
"""What the sources want defined."""

TARGETS = {
    "manylinux_2_17_x86_64": ("x86_64-linux-gnu.2.17", ".so"),
    "manylinux_2_17_aarch64": ("aarch64-linux-gnu.2.17", ".so"),
    "macosx_11_0_x86_64": ("x86_64-macos.11.0", ".dylib"),
    "macosx_11_0_arm64": ("aarch64-macos.11.0", ".dylib"),
    "win_amd64": ("x86_64-windows-gnu", ".dll"),
    "win_arm64": ("aarch64-windows-gnu", ".dll"),
}
"""What the wheel of a platform is called -> what the compiler calls the platform, and how a library ends there."""

# No fused multiply-add: results would differ from processor to processor. No vectors: an FMU has just written number by
# number what is read here, and a processor waits before it loads two of them at once.
FLAGS = (
    *("-std=c11", "-O2", "-ffp-contract=off", "-fno-tree-vectorize", "-fno-tree-slp-vectorize"),
    *("-fomit-frame-pointer", "-fvisibility=hidden", "-shared", "-s"),
)
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
_MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
_SYSTEMS = {"Linux": "linux", "Darwin": "macos", "Windows": "windows"}
_ENDINGS = {"linux": ".so", "macos": ".dylib", "windows": ".dll"}


class BuildError(Exception):
    """The core cannot be compiled; what it says is one sentence."""


def tag_here() -> str | None:
    """Return what the wheel of this platform is called; None where there is none."""
    machine, system = platform.machine().lower(), _SYSTEMS.get(platform.system(), "")
    if platform.libc_ver()[0] != "glibc" and system == "linux":
        return None
    begin = f"{_MACHINES.get(machine, machine)}-{system}"
    return next((tag for tag, (target, _) in TARGETS.items() if target.startswith(begin)), None)


def sources() -> list[Path]:
    """Return the files that the core is compiled from; none where it was installed without them."""
    return sorted(HERE.glob("*.c"))


def library_name(ending: str | None = None) -> str:
    """Return the name of the library of these sources, which carries their digest; by default that of this platform."""
    digest = hashlib.sha256()
    for path in (*sources(), *sorted(HERE.glob("*.h")), Path(__file__)):
        digest.update(path.read_bytes())
    digest.update(DEFINED.encode())
    here = _ENDINGS.get(_SYSTEMS.get(platform.system(), ""), ".so")
    return f"core-{digest.hexdigest()[:12]}{ending or here}"


def compiler(target: str | None) -> list[str]:
    """Return the command of a compiler.

    The target is always named to ziglang: without it the compiler would use whatever the machine that builds has.

    Parameters
    ----------
    target : str, optional
        The platform; without it this machine, by the compiler of the environment (``CC``).

    Raises
    ------
    BuildError
        If there is no compiler.
    """
    if target is not None and importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", target]
    named = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not named:
        raise BuildError("there is no C compiler: install one of the package ziglang's, or name one in CC")
    return shlex.split(named)


def compiler_here() -> list[str]:
    """Return the command of a compiler for this machine, without instructions that only its own processor has.

    Raises
    ------
    BuildError
        If there is no compiler.
    """
    tag = tag_here()
    return compiler(TARGETS[tag][0] if tag else None)


def build(output: Path, target: str | None, flags: tuple[str, ...] = FLAGS) -> Path:
    """Compile the library.

    Parameters
    ----------
    output : Path
        Where it goes; it is there whole or not at all.
    target : str, optional
        The platform as ziglang calls it; without it this machine.
    flags : tuple of str

    Returns
    -------
    Path
        The output.

    Raises
    ------
    BuildError
        If there is no compiler, or it fails.
    """
    windows = target is not None and "windows" in target
    more = [] if windows else ["-fPIC"]
    # on Windows the linker leaves an import library beside what it links
    with tempfile.TemporaryDirectory(dir=output.parent, ignore_cleanup_errors=True) as folder:
        made = Path(folder) / output.name
        command = [
            *compiler(target),
            *flags,
            *more,
            DEFINED,
            *map(str, sources()),
            *([] if windows else ["-lm"]),
            "-o",
            str(made),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"{shlex.join(command[:4])} fails to compile the core: {done.stderr.strip()[:2000]}")
        made.replace(output)
    return output


def build_here() -> Path:
    """Compile the library for this machine beside its sources, in place of older ones; return its path.

    Raises
    ------
    BuildError
        If there is no compiler, or it fails.
    """
    tag, name = tag_here(), library_name()
    path = build(HERE / name, TARGETS[tag][0] if tag else None)
    for other in HERE.glob("core-*"):
        if other.name != name:
            try:
                other.unlink()
            except OSError:
                continue  # another process has it loaded, or deletes it too
    return path


if __name__ == "__main__":
    print(build_here())
