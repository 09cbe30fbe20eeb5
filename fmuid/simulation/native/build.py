"""Compiler of the core, for this machine or a wheel's platform.

It stands alone: it also runs without an installed fmuid. ``python -m fmuid.simulation.native.build`` compiles here.
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
from contextlib import suppress
from pathlib import Path

HERE = Path(__file__).parent
_VERSION = (HERE.parents[1] / "version.py").read_text(encoding="utf-8").split('"')[-2]
DEFINED = f'-DFMUID_VERSION="{_VERSION}"'  # what the sources want defined

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
    """A failed compilation, as one sentence."""


def tag_here() -> str | None:
    """Return the wheel tag of this platform; None without one."""
    machine, system = platform.machine().lower(), _SYSTEMS.get(platform.system(), "")
    if platform.libc_ver()[0] != "glibc" and system == "linux":
        return None
    begin = f"{_MACHINES.get(machine, machine)}-{system}"
    return next((tag for tag, (target, _) in TARGETS.items() if target.startswith(begin)), None)


def target_here() -> str | None:
    """Return this platform as ziglang calls it."""
    tag = tag_here()
    return TARGETS[tag][0] if tag else None


def sources() -> list[Path]:
    """Return the source files; none in an installation without them."""
    return sorted(HERE.glob("*.c"))


def library_name(ending: str | None = None) -> str:
    """Return the library's name with the digest of its sources."""
    digest = hashlib.sha256()
    for path in (*sources(), *sorted(HERE.glob("*.h")), Path(__file__)):
        digest.update(path.read_bytes())
    digest.update(DEFINED.encode())
    here = _ENDINGS.get(_SYSTEMS.get(platform.system(), ""), ".so")
    return f"core-{digest.hexdigest()[:12]}{ending or here}"


def compiler(target: str | None) -> list[str]:
    """Return the compiler's command for a ziglang target, or this machine (``CC``).

    ziglang always gets a target: otherwise it would use features of the building machine.
    """
    if target is not None and importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", target]
    named = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not named:
        raise BuildError("No C compiler found: install the package ziglang, or set CC.")
    return shlex.split(named)


def compiler_here() -> list[str]:
    """Return the compiler's command for this machine, without its processor's own instructions."""
    return compiler(target_here())


def build(output: Path, target: str | None, flags: tuple[str, ...] = FLAGS) -> Path:
    """Compile the library into `output`, whole or not at all."""
    windows = target is not None and "windows" in target
    # on Windows the linker leaves an import library beside what it links
    with tempfile.TemporaryDirectory(dir=output.parent, ignore_cleanup_errors=True) as folder:
        made = Path(folder) / output.name
        system = [] if windows else ["-fPIC", "-lm"]
        command = [*compiler(target), *flags, DEFINED, *map(str, sources()), *system, "-o", str(made)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"{shlex.join(command[:4])} fails: {done.stderr.strip()[:2000]}")
        made.replace(output)
    return output


def build_here() -> Path:
    """Compile the library beside its sources, in place of older ones."""
    path = build(HERE / library_name(), target_here())
    for other in HERE.glob("core-*"):
        if other != path:
            with suppress(OSError):  # another process has it loaded, or deletes it too
                other.unlink()
    return path


if __name__ == "__main__":
    print(build_here())
