"""C sources of tests as libraries, compiled once for all processes and runs, and as FMUs."""

import hashlib
import os
import subprocess
import threading
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy

from fmuid.simulation.native.build import compiler_here
from tests.support.paths import ROOT

ProbeMaker = Callable[..., Path]
CACHE = ROOT / ".pytest_cache" / "compiled"


@cache
def compiled(source: Path, *flags: str) -> Path:
    """Return the library of a source."""
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [*compiler_here(), "-O1", "-shared", "-fPIC", f"-I{headers}", *flags]
    digest = hashlib.sha256(source.read_bytes() + repr(command).encode()).hexdigest()[:16]
    target = CACHE / f"{source.stem}-{digest}{fmpy.sharedLibraryExtension}"
    if not target.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        draft = target.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
        subprocess.run([*command, "-o", str(draft), str(source)], check=True, capture_output=True)
        draft.replace(target)
    return target


def write_fmu(path: Path, description: str, source: Path, *flags: str, version: int = 2) -> Path:
    """Write an FMU whose model identifier is the name of its source; one that is there stays."""
    if path.exists():  # somebody may be reading it
        return path
    draft = path.with_suffix(f".{threading.get_ident()}")
    with zipfile.ZipFile(draft, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        platform = fmpy.platform if version == 2 else fmpy.platform_tuple
        library = f"binaries/{platform}/{source.stem}{fmpy.sharedLibraryExtension}"
        archive.writestr(library, compiled(source, *flags).read_bytes())
    draft.replace(path)
    return path


def real(name: str, reference: int, causality: str = "local", variability: str = "continuous", said: str = "") -> str:
    """Return the declaration of a Real variable of FMI 2.0; attributes ``initial=`` belong to the variable."""
    initial, _, more = said.rpartition("|")
    return (
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}" {initial}><Real {more}/></ScalarVariable>'
    )
